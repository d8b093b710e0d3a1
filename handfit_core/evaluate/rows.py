"""From a data set to rows: labelled hands, each with its detected track, or without one.

Everything that cannot become a row is counted as a problem, with its reason.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from handfit_core.common.errors import NoHandFoundError
from handfit_core.common.skeleton import TIP_KEYPOINTS, Side
from handfit_core.detect.keypoints import Track, largest_extent
from handfit_core.detect.tracks import link_tracks
from handfit_core.evaluate import ProtocolName
from handfit_core.evaluate.detections import UnitDetections
from handfit_core.evaluate.labels import Entry, HandLabel, Labels, Problem, Unit, said
from handfit_core.geometry.camera import Intrinsics

PAPER_SIDE: Side = "left"
"""The published evaluation takes every hand for a left one, as both of its data sets hold."""


class TrackInView(NamedTuple):
    """A detected track and the camera it is fitted through."""

    track: Track
    intrinsics: Intrinsics


@dataclass
class Rows:
    """All labelled hands of an evaluation, and the tracks that were detected of them."""

    listed: list[dict[str, Any]] = field(default_factory=list)
    """The labelled hands, each as a row of `hands`"""
    problems: list[Problem] = field(default_factory=list)
    tracks: list[TrackInView] = field(default_factory=list)
    """The detected tracks that rows refer to by number"""
    pictures: int = 0
    extra_hands: int = 0
    """Detections in a kept track that belong to no labelled hand"""

    @cached_property
    def hands(self) -> pd.DataFrame:
        """The N labelled hands as a table, with the columns that `_row` gives."""
        return pd.DataFrame(self.listed)

    @cached_property
    def labels_3d(self) -> np.ndarray:
        """(N, 21, 3) metres in the camera frame: the true keypoints of each row."""
        return np.array([row["label"].joints_3d for row in self.listed])


Frame = tuple[int, Entry, Labels]
"""A picture's place in its unit, the picture, and its labels"""
ReadUnit = Callable[[Unit], UnitDetections]


def rows_of(units: Sequence[Unit], detect: ReadUnit, *, protocol: ProtocolName, camera: str) -> Rows:
    """Detect the hands in units and pair them with labels. `camera` is `assumed` or `labelled`: which one
    solvers are told."""
    found = Rows()
    for unit in units:
        labels = [_labels(entry, found) for entry in unit.entries]
        if not any(labels):
            continue
        seen = detect(unit)
        unreadable = (unit.entries[t] for t in np.flatnonzero(~seen.readable))
        found.problems += [Problem("picture cannot be read", entry.name) for entry in unreadable]
        told = zip(unit.entries, labels, seen.readable, strict=True)
        frames = [(t, entry, one) for t, (entry, one, readable) in enumerate(told) if readable and one]
        if frames:
            found.pictures += len(frames)
            intrinsics = _camera(frames, seen, camera, found)
            if protocol == "paper":
                _paper_rows(frames, seen, intrinsics, found)
            else:
                _strict_rows(unit, frames, seen, intrinsics, found)
    return found


def _camera(frames: Sequence[Frame], seen: UnitDetections, camera: str, found: Rows) -> Intrinsics:
    """Return the camera through which a unit is fitted."""
    first, entry, labels = frames[0]
    if camera == "labelled" and labels.intrinsics:
        changed = [e.name for _, e, one in frames if one.intrinsics != labels.intrinsics]
        if changed:
            kind = "camera changes within the clip: its first one is used throughout"
            found.problems.append(Problem(kind, changed[0]))
        return labels.intrinsics
    if camera == "labelled":
        found.problems.append(Problem("camera missing: one is assumed", entry.name))
    width, height = (int(side) for side in seen.sizes[first])
    extents = seen.hands.extent[np.isin(seen.hands.frame, [t for t, *_ in frames])]
    return Intrinsics.assumed(width, height, largest_extent(extents))


def _labels(entry: Entry, found: Rows) -> Labels | None:
    try:
        labels = entry.read_labels()
    except Exception as error:  # a damaged file can fail in any way
        found.problems.append(Problem("labels cannot be read", f"{entry.name}: {said(error)}"))
        return None
    # A picture that is said to show no hand is a label too: whatever is found in it is a stray.
    if labels.hands and not any(_is_labelled(hand) for hand in labels.hands):
        found.problems.append(Problem("no labelled hand", entry.name))
        return None
    return labels


def _is_labelled(hand: HandLabel) -> bool:
    return bool(np.isfinite(hand.joints_3d).any() or np.isfinite(hand.keypoints_2d).any())


def _strict_rows(
    unit: Unit, frames: Sequence[Frame], seen: UnitDetections, intrinsics: Intrinsics, found: Rows
) -> None:
    """Add rows for tracks as a capture makes them; every labelled hand is a row, found or not."""
    try:
        tracks = link_tracks(seen.hands, len(unit.entries), "auto", 2, _fps(unit))
    except NoHandFoundError:
        tracks = ()
    first = len(found.tracks)
    found.tracks += [TrackInView(track, intrinsics) for track in tracks]
    for t, entry, labels in frames:
        hands = [i for i, hand in enumerate(labels.hands) if _is_labelled(hand)]
        pixels = [label_pixels(labels.hands[i], labels.intrinsics) for i in hands]
        found_in = [(i, track.detections) for i, track in enumerate(tracks, first)]
        present = [(i, points) for i, d in found_in for points in d.keypoints_2d[d.frame == t]]
        matched = match(pixels, [points for _, points in present])
        found.extra_hands += len(present) - sum(m is not None for m in matched)
        for index, which in zip(hands, matched, strict=True):
            track = -1 if which is None else present[which][0]
            found.listed.append(_row(entry, labels, index, found, track, t))


def _fps(unit: Unit) -> float:
    """Return frames per second by the entries' times; 25 for a still."""
    steps = np.diff([entry.time for entry in unit.entries])
    steps = steps[steps > 0]
    return float(1.0 / np.median(steps)) if len(steps) else 25.0


def _paper_rows(frames: Sequence[Frame], seen: UnitDetections, intrinsics: Intrinsics, found: Rows) -> None:
    """Add one row a picture: its first labelled hand and its first detection, whoever's it is, taken for a
    left hand. What the published evaluation drops in silence is dropped too, and named."""
    for t, entry, labels in frames:
        tips = list(TIP_KEYPOINTS)
        with_tips = [i for i, h in enumerate(labels.hands) if np.isfinite(h.joints_3d[tips]).any()]
        if labels.intrinsics is None:
            found.problems.append(Problem("camera missing: the paper's protocol needs it", entry.name))
            continue
        if not with_tips:
            found.problems.append(Problem("no labelled fingertip: dropped as in the paper", entry.name))
            continue
        track, hands = -1, seen.hands
        if len(at := np.flatnonzero(hands.frame == t)):
            first = replace(hands.select(at[:1]), frame=np.zeros(1, dtype=int))
            track = len(found.tracks)
            found.tracks.append(TrackInView(Track(PAPER_SIDE, first, frame_count=1), intrinsics))
        else:
            found.problems.append(Problem("no hand detected: dropped as in the paper", entry.name))
        found.listed.append(_row(entry, labels, with_tips[0], found, track, 0))


def _row(entry: Entry, labels: Labels, index: int, found: Rows, track: int, frame: int) -> dict[str, Any]:
    """Return the row of one labelled hand in one picture."""
    hand = labels.hands[index]
    side = found.tracks[track].track.side if track >= 0 else None
    return {
        "sample": entry.name,
        "hand": index,
        "clip": entry.clip,
        "time": entry.time,
        "tags": entry.tags,
        "label": hand,
        "label_2d": label_pixels(hand, labels.intrinsics),
        # The true camera, None where the set does not give it
        "camera": labels.intrinsics,
        # Place among the tracks, -1 for a miss; and in the track
        "track": track,
        "frame": frame,
        "side": side,
        "side_correct": float(side == hand.side) if side and hand.side else np.nan,
    }


MATCH_DISTANCE = 0.5
"""The mean distance, in parts of the hand's size, beyond which a detection's points lie too far from the
labels to be of that hand: it has found something else."""


def label_pixels(hand: HandLabel, intrinsics: Intrinsics | None) -> np.ndarray:
    """Return (21, 2) labelled pixels; where the set has none, the 3D labels through its camera; else NaN."""
    if np.isfinite(hand.keypoints_2d).any() or intrinsics is None:
        return hand.keypoints_2d
    in_front = np.where(hand.joints_3d[:, 2:] > 0.0, hand.joints_3d, np.nan)
    return intrinsics.project(in_front)


def match(labels_2d: Sequence[np.ndarray], detections: Sequence[np.ndarray]) -> list[int | None]:
    """Return for each labelled hand, (21, 2) pixels, the index of its detection, whose keypoints are (21, 2)
    pixels, too, or None for a miss.

    The assignment with the least total distance; the side plays no part, so that wrong sides are
    seen as such. Labels without any pixels can only be told by their order: they take what is left.
    """
    from scipy.optimize import linear_sum_assignment

    matched: list[int | None] = [None] * len(labels_2d)
    placed = [i for i, pixels in enumerate(labels_2d) if np.isfinite(pixels).any()]
    if placed and detections:
        cost = np.array([[_distance(labels_2d[i], d) for d in detections] for i in placed])
        # A pair too far apart costs as much as none, or one stray would push another pair apart.
        for row, column in zip(*linear_sum_assignment(np.minimum(cost, 2 * MATCH_DISTANCE)), strict=True):
            if cost[row, column] < MATCH_DISTANCE:
                matched[placed[row]] = int(column)
    left = iter(j for j in range(len(detections)) if j not in matched)
    for i in range(len(labels_2d)):
        if i not in placed:
            matched[i] = next(left, None)
    return matched


def _distance(pixels: np.ndarray, keypoints: np.ndarray) -> float:
    """Return the mean distance of the labelled points in units of the hand's size."""
    known = np.isfinite(pixels).all(axis=-1)
    distance = np.linalg.norm(keypoints[known] - pixels[known], axis=-1).mean()
    # One labelled point has no size, and a few may lie close together: the detection's then decides.
    size = max(*(float(np.ptp(points, axis=0).max()) for points in (pixels[known], keypoints)), 1e-9)
    return float(distance) / size
