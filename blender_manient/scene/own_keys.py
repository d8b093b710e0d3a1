"""Which of a captured hand's keys are the artist's own: neither a capture nor Re-fit Range put them there.

What the capture found is in the take; what Re-fit Range found is kept on the armature. A key with another
pose than either, after corrections are taken out of it, was made by hand: keyed, moved, applied.

Keys of a motion that was fitted anew lie under the field of corrections, whose corrections turn from the new
pose to the corrected one: so the corrected frame keeps its pose, its neighbours lead there softly, and a
correction that is cleared leaves the new motion. Keys by hand, and the frames next to a range, are led to in
the same way.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import bpy
import numpy as np

from handfit_core.common.skeleton import NUM_JOINTS
from handfit_core.edit.corrections import (
    Correction,
    CorrectionField,
    changed_quats,
    correction_between,
    kept_frame,
)
from handfit_core.hand_model.motion import HandMotion
from handfit_core.take import at_rows

from .corrections import check_writable, corrections_of, keep_field, without_field
from .keys import PoseKeys, nearest, pose_at, read_pose_keys, read_table, table_text, writing_pose_keys
from .store import CapturedHand, hand_of, scene_frames

_SAME_TURN = 1e-4
"""Radians within which rotations count as equal"""
_SAME_PLACE = 1e-5
"""Metres within which places count as equal"""
_POSE = 3 + 45 + 3
"""How many numbers a pose has: global_orient and hand_pose as axis-angle in radians, and where the wrist is
in the camera frame, metres. They stay true when the hand's proportions change"""


def keyed_by_hand(hand: CapturedHand, rows: np.ndarray) -> np.ndarray:
    """Return (N, 17) bool: whether the 16 bones' rotations and the wrist's location have a key of the
    artist's own on the scene frames of the take's `rows` (N,), increasing. Raises TakeError and
    HandModelError."""
    frames = scene_frames(hand.collection, hand.take)[rows]
    found = np.zeros((len(rows), NUM_JOINTS + 1), dtype=bool)
    if len(rows) == 0:
        return found
    keys = without_field(hand.armature, read_pose_keys(hand.rig, float(frames[0]), float(frames[-1])))
    at, on = nearest(frames, keys.frames)
    keyed = np.column_stack([keys.rotation_keyed, keys.location_keyed])
    own = keyed & ~_holds(keys, *captured_poses(hand, rows[at])) & ~_holds(keys, *_fitted(hand, rows[at]))
    found[at[on]] = own[on]
    return found


def captured_poses(hand: CapturedHand, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the poses that the capture found in the take's `rows` (N,): quaternions (N, 16, 4) as (w, x, y,
    z) and wrist locations (N, 3) in metres, about the bones as they are now; NaN where there is no hand.
    Raises HandModelError."""
    return hand.to_bones(at_rows(hand.track, rows))


def note_fitted(
    armature: bpy.types.Object, frames: Sequence[int], quats: np.ndarray, locations: np.ndarray
) -> None:
    """Remember poses that Re-fit Range has keyed: (N,) source frames, quats (N, 16, 4) and wrist locations
    (N, 3) in metres, relative to the bones' rest."""
    hand = hand_of(armature)
    if hand is None or len(frames) == 0:
        return
    shaped = hand.shaped()
    orient, pose, transl = hand.rig.from_bones(shaped, quats, locations)
    new = np.column_stack([frames, orient, np.reshape(pose, (-1, 45)), shaped.joints[0] + transl])
    old = _noted(armature)
    table = np.concatenate([old[~np.isin(old[:, 0], new[:, 0])], new])
    armature.manient.fitted = table_text(table[np.argsort(table[:, 0])])


def _fitted(hand: CapturedHand, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the noted poses of the take's `rows` (N,), shaped as those of `captured_poses`; NaN for rows
    that were not fitted again."""
    noted, poses = _noted(hand.armature), np.full((len(rows), _POSE), np.nan)
    if len(noted):
        at, on = nearest(noted[:, 0], np.asarray(hand.take.frame_numbers, dtype=np.float64)[rows])
        poses[on] = noted[at[on], 1:]
    pose = poses[:, :3], poses[:, 3:48], poses[:, 48:] - hand.shaped().joints[0]
    return hand.to_bones(HandMotion(hand.side, hand.betas, *pose))


def _holds(keys: PoseKeys, quats: np.ndarray, locations: np.ndarray) -> np.ndarray:
    """Return (N, 17) bool: whether keys on N frames hold these rotations (N, 16, 4) and wrist locations (N,
    3); never where one is NaN."""
    turned = np.linalg.norm(correction_between(keys.quats, quats), axis=-1)
    moved = np.linalg.norm(keys.locations - locations, axis=-1)
    return np.column_stack([turned < _SAME_TURN, moved < _SAME_PLACE])


def _noted(armature: bpy.types.Object) -> np.ndarray:
    """Return (N, 52), the source frames, increasing, and poses that `note_fitted` has kept; nothing where
    that cannot be read: then keys count as made by hand."""
    try:
        return read_table(armature.manient.fitted, 1 + _POSE)
    except ValueError:
        return np.empty((0, 1 + _POSE))


@dataclass(frozen=True, eq=False)
class Smoothed:
    """Keys of a motion that was fitted again, which are not written yet."""

    keys: PoseKeys
    field: CorrectionField
    """The corrections on top of the new motion"""
    numbers: list[int]
    """The M source frames that were fitted again"""
    quats: np.ndarray
    """(M, 16, 4) the quaternions (w, x, y, z) of these frames' keys without corrections; where the artist has
    keyed: of the new motion"""
    locations: np.ndarray
    """(M, 3) metres: the wrist locations of these frames' keys without corrections"""

    @property
    def written(self) -> int:
        """Return how many frames get new keys on at least one bone."""
        return int((self.keys.rotation_keyed.any(axis=1) | self.keys.location_keyed).sum())


def smoothed(
    hand: CapturedHand,
    rows: np.ndarray,
    wanted: np.ndarray,
    quats: np.ndarray,
    locations: np.ndarray,
    spread: float,
) -> Smoothed:
    """Compute the keys on the take's `rows` (N,), increasing, where the motion is fitted again.

    `wanted` (N,) bool: the rows that get it; the others are fitted to lead there. quats (N, 16, 4) and
    locations (N, 3) in metres are the motion about the bones' rest, NaN without a hand. What stays is led to
    over `spread` source frames. Raises TakeError and HandModelError."""
    places = scene_frames(hand.collection, hand.take)[rows]
    numbers = np.asarray(hand.take.frame_numbers, dtype=np.float64)[rows]
    there = np.asarray(np.isfinite(locations).all(axis=1))
    shown, shown_at = pose_at(hand.rig, places)
    quats, locations = (
        np.where(there[:, None, None], quats, shown),
        np.where(there[:, None], locations, shown_at),
    )
    own = keyed_by_hand(hand, rows)
    old = corrections_of(hand.armature)
    new: dict[float, Correction] = {}
    corrected = np.zeros(len(rows), dtype=bool)
    for at in range(len(rows)):
        one = old.corrections.get(kept_frame(numbers[at]))
        if one is None or one.is_anchor:
            continue
        corrected[at] = True
        if there[at] and wanted[at]:
            new[numbers[at]] = _on_top(one, quats[at], locations[at], shown[at], shown_at[at])
    field = old.having(new)
    turned, moved = field.at(numbers)
    plain, plain_at = quats, locations
    quats, locations = changed_quats(quats, np.zeros_like(turned), turned), locations + moved

    # What stays beside corrections: all of the frames around the range, of others what was keyed by hand.
    stays = own & wanted[:, None]
    around = np.flatnonzero(wanted)[[0, -1]] + [-1, 1]
    stays[around[(around >= 0) & (around < len(rows))]] = True
    turns = np.where(stays[:, :-1, None], correction_between(quats, shown), 0.0)
    moves = np.where(stays[:, -1:], shown_at - locations, 0.0)
    led = {
        numbers[at]: Correction({})
        if corrected[at]
        else Correction({}, rotation=turns[at], location=moves[at], spread=spread)
        for at in np.flatnonzero((corrected & wanted) | (stays.any(axis=1) & there))
    }
    turns, moves = CorrectionField(led).at(numbers)
    quats, locations = changed_quats(quats, np.zeros_like(turns), turns), locations + moves
    free = wanted & there & ~corrected
    keys = PoseKeys(places, quats, locations, free[:, None] & ~own[:, :-1], free & ~own[:, -1])
    quats = np.where(own[:, :-1, None], plain, changed_quats(quats, turned, np.zeros_like(turned)))
    locations = np.where(own[:, -1:], plain_at, locations - moved)
    new_rows = wanted & there
    return Smoothed(keys, field, numbers[new_rows].astype(int).tolist(), quats[new_rows], locations[new_rows])


def _on_top(
    one: Correction, quats: np.ndarray, location: np.ndarray, shown: np.ndarray, shown_at: np.ndarray
) -> Correction:
    """Return the correction that leads from another pose, (16, 4) and (3,), to the frame's present one."""
    start = one.start_rotation, one.start_location
    if one.posed:  # pins are measured against the pose that the artist gave, which is the same as before
        posed = changed_quats(shown, one.rotation, one.start_rotation)
        start = correction_between(quats, posed), shown_at - one.location + one.start_location - location
    return replace(
        one,
        rotation=correction_between(quats, shown),
        location=shown_at - location,
        start_rotation=start[0],
        start_location=start[1],
    )


def writing(find: Callable[[], CapturedHand], smoothed: Smoothed) -> Iterator[float]:
    """Write the keys bone by bone, and keep the corrections; yields how much is done, 0..1. `find` gives the
    hand, which may have gone between two steps. Raises what it raises, and `corrections.check_writable`."""
    check_writable(find().armature)
    keep_field(find().armature, smoothed.field)
    yield from writing_pose_keys(lambda: find().rig, smoothed.keys)
    # For whoever asks next they are no keys by hand.
    note_fitted(find().armature, smoothed.numbers, smoothed.quats, smoothed.locations)
