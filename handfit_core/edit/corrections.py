"""Corrections of a hand by the artist, and how they fade out over the frames around them.

A correction of a source frame turns every bone by exp(rotation), about the bone's own axes after its
own pose, and moves the wrist. Between corrected frames the field

    c(frame) = sum over the corrected frames g of w_g(frame) c_g

mixes them: w_g is 1 at g, falls along a smoothstep and is 0 from the correction's spread on, or from the
next corrected frame on where that is nearer. Two corrections within each other's spread share what lies
between them: their weights add up to 1.

Keys hold the pose after the field, q = q_base exp(c). A field that changes therefore only multiplies:
q exp(-c_old) exp(c_new). What an artist did to the key by hand stays on it, and a field that is taken
away leaves the key as it was.

Frames that are keyed anew hold a pose of their own, whatever corrections there are: the field is zero there
and corrections around end there. Anchors, corrections without pins, see to that.
"""

from __future__ import annotations

import bisect
import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Final

import numpy as np

from handfit_core.common.arrays import (
    array,
    array_dataclass,
    arrays_of,
    check_arrays,
    declared,
    declared_values,
    value,
)
from handfit_core.common.errors import TakeError
from handfit_core.common.skeleton import NUM_JOINTS, NUM_KEYPOINTS, can_touch
from handfit_core.common.values import Unfit, number
from handfit_core.geometry.rotations import quat_multiply, quat_to_rotvec, rotvec_to_quat, smoothstep

FORMAT_VERSION: Final = 1
_ALWAYS_KEPT: Final = ("pins", "spread", "added_key")
"""Fields that the text of every correction has; the other fields are left out where they are empty"""

_MIN_CHANGE: Final = 0.01
"""radians, or tenths of a metre, from which on a change counts when a frame's key is compared with the
corrected one"""

Pins = Mapping[int, tuple[float, float]]
"""The pins of a frame: from the number of each pinned keypoint to its (x, y) pixels in the upright picture"""
Touches = Mapping[int, int]
"""The touches of a frame: from the number of a keypoint to the smaller number of the one that it touches, as
in `RefineHand.touches`"""


def point_rows(pins: Sequence[Pins], touches: Sequence[Touches]) -> tuple[np.ndarray, np.ndarray]:
    """Return the pins (N, 21, 2) in pixels and the touches (N, 21) of N frames as arrays, NaN for points that
    have none."""
    placed = np.full((len(pins), NUM_KEYPOINTS, 2), np.nan)
    touching = np.full((len(touches), NUM_KEYPOINTS), np.nan)
    for rows, points in ((placed, pins), (touching, touches)):
        for row, of_frame in zip(rows, points, strict=True):
            for keypoint, kept in of_frame.items():
                row[keypoint] = kept
    return placed, touching


def _pins(_: str, given: Any) -> dict[int, tuple[float, float]]:
    pins = {int(k): (round(float(x), 3), round(float(y), 3)) for k, (x, y) in dict(given).items()}
    # Only finite numbers of the right shape ever reach keys.
    if not all(0 <= k < NUM_KEYPOINTS for k in pins) or not np.all(np.isfinite(list(pins.values()))):
        raise Unfit(f"pins belong to keypoints 0 to {NUM_KEYPOINTS - 1}, at finite places")
    return pins


def _touches(_: str, given: Any) -> dict[int, int]:
    touches = {int(k): int(other) for k, other in dict(given).items()}
    if not all(can_touch(*pair) for pair in touches.items()):
        raise Unfit(f"a keypoint touches a smaller one of another finger; got {touches}")
    return touches


def _spread(name: str, given: Any) -> float:
    return number(name, float(given), 0.0)


def _yes(_: str, given: Any) -> bool:
    return bool(given)


@array_dataclass
class Correction:
    """The correction of one source frame: what the artist changed, and how the key looked when it was
    made."""

    pins: Pins = value(_pins)
    """The keypoints that the artist dragged, each with the pixels where it belongs"""
    rotation: np.ndarray = array(NUM_JOINTS, 3, finite="all", default=0.0)
    """(16, 3) radians: the axis-angle by which each bone is turned, in the bone's own axes after posing"""
    location: np.ndarray = array(3, finite="all", default=0.0)
    """(3,) metres, added to the wrist bone's location"""
    spread: float = value(_spread, default=0.0)
    """frames, before and after its own, over which the correction fades out"""
    added_key: bool = value(_yes, default=False)
    """True if the frame had no key before, so that its key goes with the correction"""
    start_rotation: np.ndarray = array(NUM_JOINTS, 3, finite="all", default=0.0)
    """(16, 3) radians: the part of `rotation` that corrections of neighbouring frames made here before this
    one. Pins are not answerable for it, and it stays when they change"""
    start_location: np.ndarray = array(3, finite="all", default=0.0)
    """(3,) metres: the part of `location` that corrections of neighbouring frames made here before this
    one"""
    pose: np.ndarray = array(NUM_JOINTS, 4, finite="all", default=0.0)
    """(16, 4) the key's rotations as (w, x, y, z) when the correction was made, by which the key is known
    again; zeros where they are unknown"""
    place: np.ndarray = array(3, finite="all", default=0.0)
    """(3,) metres: the key's location of the wrist when the correction was made; zeros where it is unknown"""
    keyed: bool = value(_yes, default=False)
    """True if the frame was keyed anew, so that without this correction the field is zero there"""
    posed: bool = value(_yes, default=False)
    """True if the artist gave the frame a pose before any pin: then pins are measured against that pose"""
    begins: bool = value(_yes, default=False)
    """True if a pose begins here that the frames after it may go on with"""
    touches: Touches = value(_touches, default=())
    """The keypoints that were made to touch, each with the one that it touches"""

    @property
    def placed(self) -> int:
        """Number of the points that the artist holds: pinned, or made to touch."""
        return len(self.pins) + len(self.touches)

    @property
    def is_anchor(self) -> bool:
        """True if this is no correction by the artist, and only ends the corrections around it."""
        return self.keyed and not self.placed and not self.posed

    def is_in(self, pose: np.ndarray, place: np.ndarray) -> bool:
        """Tell whether the frame's key, rotations (16, 4) as (w, x, y, z) and the wrist's place (3,) in
        metres, can still hold this correction: most of what it turned or moved is where it was put. Else keys
        were moved in time, or another pose was keyed."""
        if not np.any(self.pose):
            return True
        turned = np.linalg.norm(self.rotation, axis=-1) > _MIN_CHANGE
        same = np.linalg.norm(correction_between(self.pose, pose), axis=-1) < _MIN_CHANGE
        found = same[turned].tolist()
        if np.linalg.norm(self.location) > _MIN_CHANGE / 10 and np.any(self.place):
            found.append(bool(np.linalg.norm(place - self.place) < _MIN_CHANGE / 10))
        return not found or 2 * sum(found) >= len(found)

    @property
    def changes(self) -> bool:
        """True if the correction turns a bone or moves the wrist, so that keys change."""
        return bool(np.any(self.rotation) or np.any(self.location))

    def __post_init__(self) -> None:
        for name, each in declared_values(self).items():
            object.__setattr__(self, name, each.kind(name, getattr(self, name)))
        for name in declared(self):
            numbers = np.asarray(getattr(self, name), dtype=np.float64)
            # Rounded, so that the .blend holds exactly what was applied
            object.__setattr__(self, name, np.round(numbers, 8))
        check_arrays(self, ValueError)


@dataclass(frozen=True, eq=False)
class CorrectionField:
    """All corrections of a hand by their source frames, and the field that they make over time."""

    corrections: Mapping[float, Correction] = field(default_factory=dict)
    """The corrections by source frame. Most are on whole frames; poses that were not dragged, and anchors,
    may lie between two frames"""

    @cached_property
    def frames(self) -> np.ndarray:
        """(K,) the source frames of all corrections and anchors, increasing."""
        return np.array(sorted(self.corrections), dtype=np.float64)

    @property
    def corrected(self) -> list[float]:
        """The source frames that the artist corrected, increasing, without those of anchors."""
        return [g for g in sorted(self.corrections) if not self.corrections[g].is_anchor]

    def weights(self, frames: np.ndarray) -> np.ndarray:
        """Return the weights (N, K), 0..1, of the K corrections on the source frames (N,), whole or not."""
        frames = np.asarray(frames, dtype=np.float64)
        own = self.frames
        spread = np.array([self.corrections[g].spread for g in own.tolist()])
        gap = np.diff(own)
        before = np.minimum(spread, np.concatenate([[np.inf], gap]))[: len(own)]
        after = np.minimum(spread, np.concatenate([gap, [np.inf]]))[: len(own)]
        away = frames[:, None] - own
        reach = np.where(away < 0, before, after)
        part = np.abs(away) / np.where(reach > 0, reach, 1.0)
        # Without a spread a correction stays on its own frame.
        part = np.where(reach > 0, part, np.where(away == 0, 0.0, 1.0))
        return fade(part)

    def at(self, frames: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the field on the source frames (N,): rotations (N, 16, 3) in radians, and movements of the
        wrist (N, 3) in metres."""
        weights = self.weights(frames)
        chosen = [self.corrections[g] for g in self.frames.tolist()]
        rotation = np.array([c.rotation for c in chosen]).reshape(-1, NUM_JOINTS, 3)
        location = np.array([c.location for c in chosen]).reshape(-1, 3)
        return np.einsum("nk,kja->nja", weights, rotation), weights @ location

    def pins(self, frame: float) -> Pins:
        """Return the pins of a source frame; none where it has no correction."""
        correction = self.corrections.get(kept_frame(frame))
        return correction.pins if correction is not None else {}

    def touching(self, frame: float) -> Touches:
        """Return the touches of a source frame; none where it has no correction."""
        correction = self.corrections.get(kept_frame(frame))
        return correction.touches if correction is not None else {}

    def having(self, corrections: Mapping[float, Correction]) -> CorrectionField:
        """Return a copy in which these corrections, by their source frames, are added or replaced."""
        return CorrectionField({**self.corrections, **{kept_frame(g): c for g, c in corrections.items()}})

    def without(self, frames: Iterable[float]) -> CorrectionField:
        """Return a copy without the corrections of these source frames."""
        gone = {float(f) for f in frames}
        return CorrectionField({g: c for g, c in self.corrections.items() if g not in gone})

    def cleared(self, frames: Iterable[float]) -> CorrectionField:
        """Return a copy with the corrections of these source frames taken back. Where a frame had been keyed
        anew, an anchor stays as long as it ends another correction."""
        gone = {float(f) for f in frames}
        kept = {g: c for g, c in self.corrections.items() if g not in gone}
        kept |= {g: Correction({}, keyed=True) for g, c in self.corrections.items() if g in gone and c.keyed}
        return CorrectionField(kept)._pruned()

    def keyed_anew(
        self,
        frames: Iterable[float],
        *,
        whole: bool = False,
        joints: Sequence[int] = range(NUM_JOINTS),
        location: bool = True,
        keep_pins: bool = False,
    ) -> CorrectionField:
        """Return a copy for source frames that get keys with poses of their own: the field is zero on them.

        With `whole` everything from the first to the last of these frames counts as keyed, else corrections
        on the frames between stay. `joints` and `location` say what is keyed; corrections of other joints
        stay. `keep_pins` leaves the frames' pins and touches, for poses that were fitted to them.
        """
        own = np.array(sorted({kept_frame(f) for f in frames}), dtype=np.float64)
        if len(own) == 0:
            return self
        first, last = float(own[0]), float(own[-1])
        inside = {
            g for g in self.corrections if (first <= g <= last if whole else bool(np.any(own == float(g))))
        }
        new = {g: c for g, c in self.corrections.items() if g not in inside}
        ends = {first, last}
        for g in [g for g in new if first < g < last]:
            at = int(np.searchsorted(own, g))
            ends |= {float(own[at - 1]), float(own[at])}

        keyed = list(joints)

        def left(one: Correction, rotation: np.ndarray, place: np.ndarray, spread: float) -> Correction:
            rotation = rotation.copy()
            rotation[keyed] = 0.0
            place = np.zeros(3) if location else place
            return Correction(one.pins, rotation, place, spread, keyed=True, touches=one.touches)

        for g in sorted(inside):
            one = self.corrections[g]
            rest = left(one, one.rotation, one.location, one.spread)
            if keep_pins or rest.changes:
                new[g] = rest
        rotations, places = self.at(np.array(sorted(ends)))
        for g, rotation, place in zip(sorted(ends), rotations, places, strict=True):
            if g not in new:
                new[kept_frame(g)] = left(Correction({}), rotation, place, self._reach(g))
        return CorrectionField(new)._pruned()

    def _reach(self, frame: float) -> float:
        """Return by how many frames the corrections around this source frame reach beyond it."""
        return max([0.0, *(c.spread - abs(g - frame) for g, c in self.corrections.items())])

    def _pruned(self) -> CorrectionField:
        """Return a copy without the anchors that end nothing, since no correction reaches them."""
        needed = set()
        for sign in (1.0, -1.0):
            reach = -np.inf
            for g in sorted(self.corrections, key=lambda g: sign * g):
                one = self.corrections[g]
                if not one.is_anchor or sign * g < reach:
                    needed.add(g)
                    reach = sign * g + one.spread if one.changes else -np.inf
        return CorrectionField({g: c for g, c in self.corrections.items() if g in needed})

    def to_json(self) -> str:
        """Return the corrections as JSON text for the .blend file; empty where there are none."""
        if not self.corrections:
            return ""
        kept = {
            str(frame): {
                **{n: given for n in declared_values(c) if (given := getattr(c, n)) or n in _ALWAYS_KEPT},
                **{name: rows.tolist() for name, rows in arrays_of(c).items() if np.any(rows)},
            }
            for frame, c in sorted(self.corrections.items())
        }
        return json.dumps({"version": FORMAT_VERSION, "frames": kept}, separators=(",", ":"))

    @classmethod
    def from_json(cls, text: str) -> CorrectionField:
        """Read the text that `to_json` wrote. Raises TakeError for anything else, and for a newer format."""
        if not text:
            return cls()
        try:
            content = json.loads(text)
            version = int(content["version"])
            if version <= FORMAT_VERSION:
                return cls({kept_frame(frame): _correction(c) for frame, c in content["frames"].items()})
        except (LookupError, TypeError, ValueError, ArithmeticError, AttributeError, RecursionError) as error:
            raise TakeError(
                "the hand's corrections cannot be read; undo what changed them, or clear all corrections"
            ) from error
        raise TakeError(
            f"the hand's corrections have format version {version}, this add-on reads up to "
            f"{FORMAT_VERSION}; update the add-on"
        )


def changed_segments(old: CorrectionField, new: CorrectionField) -> list[tuple[float, float]]:
    """Return disjoint segments of source frames, as (first, last), outside of which the two fields are equal.

    A correction that comes, goes or changes matters up to the nearest unchanged corrections, which then reach
    further, or less far, towards it.
    """
    same = sorted(
        g for g, c in old.corrections.items() if g in new.corrections and _equal(c, new.corrections[g])
    )
    segments = []
    for g in sorted((set(old.corrections) | set(new.corrections)) - set(same)):
        spread = max(one.corrections[g].spread for one in (old, new) if g in one.corrections)
        first, last = float(g - spread), float(g + spread)
        at = bisect.bisect_left(same, g)
        if at > 0:
            left = same[at - 1]
            reach = left + old.corrections[left].spread
            first, last = (left, max(last, reach)) if reach > g else (max(first, left), last)
        if at < len(same):
            right = same[at]
            reach = right - old.corrections[right].spread
            first, last = (min(first, reach), right) if reach < g else (first, min(last, right))
            first = first if at == 0 else max(first, same[at - 1])
        segments.append((float(first), float(last)))
    merged: list[tuple[float, float]] = []
    for first, last in sorted(segments):
        if merged and first <= merged[-1][1]:
            first, last = merged[-1][0], max(last, merged.pop()[1])
        merged.append((first, last))
    return merged


def _equal(one: Correction, other: Correction) -> bool:
    """Tell whether two corrections change keys in one and the same way; pins do not matter."""
    return (
        one.spread == other.spread
        and np.array_equal(one.rotation, other.rotation)
        and np.array_equal(one.location, other.location)
    )


def kept_frame(frame: Any) -> float:
    """Return a source frame as corrections are kept under it: a whole number, or a place between two frames
    rounded to four digits."""
    place = round(float(frame), 4)
    if not np.isfinite(place):
        raise ValueError(f"a frame is a finite number; got {frame}")
    return int(place) if place == int(place) else place


def _correction(content: Mapping[str, Any]) -> Correction:
    return Correction(**{name: content[name] for name in Correction.__dataclass_fields__ if name in content})


def fade(part: np.ndarray) -> np.ndarray:
    """Fall along a smoothstep from 1 at a `part` of 0 to 0 at 1 and beyond."""
    return 1.0 - smoothstep(part)


def changed_quats(quats: np.ndarray, old: np.ndarray, new: np.ndarray) -> np.ndarray:
    """Return keys (..., 4) as quaternions (w, x, y, z) under a field (..., 3) that changes from `old` to
    `new`, in radians.

    They are q exp(-old) exp(new), of the same length as before. Signs are kept as they come: the field
    changes gradually from key to key, so neighbouring quaternions stay on the same side.
    """
    return quat_multiply(quat_multiply(quats, rotvec_to_quat(-old)), rotvec_to_quat(new))


def correction_between(before: np.ndarray, after: np.ndarray) -> np.ndarray:
    """Return the turns (..., 3), axis-angle in radians, that lead from quaternions `before` (..., 4) to
    `after` (..., 4)."""
    before, after = (q / np.linalg.norm(q, axis=-1, keepdims=True) for q in (before, after))
    return quat_to_rotvec(quat_multiply(before * np.array([1.0, -1.0, -1.0, -1.0]), after))
