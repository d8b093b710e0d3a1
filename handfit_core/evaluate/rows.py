"""From a data set to rows: labelled hands, each with its detected track, or without one.

Everything that cannot become a row is counted as a problem, with its reason.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from handfit_core.detect.keypoints import Track, largest_extent
from handfit_core.detect.tracks import link_tracks
from handfit_core.errors import DatasetError, NoHandFoundError
from handfit_core.evaluate.detections import UnitDetections
from handfit_core.evaluate.labels import Entry, HandLabel, Labels, Problem, Unit
from handfit_core.evaluate.scores import ProtocolName
from handfit_core.geometry.camera import Intrinsics
from handfit_core.skeleton import TIP_KEYPOINTS, Side

PAPER_SIDE: Side = "left"
"""The published evaluation takes every hand for a left one, as both of its data sets hold."""


@dataclass(frozen=True, eq=False)
class TrackInView:
    """A detected track and the camera it is fitted through."""

    track: Track
    intrinsics: Intrinsics


@dataclass(frozen=True, eq=False)
class Row:
    """One labelled hand in one picture."""

    entry: Entry
    hand_index: int
    label: HandLabel
    label_2d: np.ndarray
    """(21, 2) pixels"""
    intrinsics: Intrinsics | None
    """The true camera, where the set gives it"""
    view: str
    detect_ms: float
    track: TrackInView | None
    """None for a miss"""
    frame: int
    """Place in the track"""
    side_correct: float
    """1 or 0; NaN for a miss or an unnamed side"""


@dataclass
class Rows:
    """All rows of an evaluation."""

    rows: list[Row] = field(default_factory=list)
    problems: list[Problem] = field(default_factory=list)
    tracks: list[TrackInView] = field(default_factory=list)
    """Those that rows refer to"""
    pictures: int = 0
    extra_hands: int = 0
    """Detections in a kept track that belong to no labelled hand"""


Frame = tuple[int, Entry, Labels]
"""A picture's place in its unit, the picture, and its labels"""
ReadUnit = Callable[[Unit], UnitDetections]


def rows_of(
    units: Sequence[Unit], detect: ReadUnit, *, protocol: ProtocolName, max_hands: int | None, camera: str
) -> Rows:
    """Detect and pair with labels. `camera` is `assumed` or `labelled`: what solvers are told."""
    found = Rows()
    for unit in units:
        labels = [_labels(entry, found) for entry in unit.entries]
        if not any(labels):
            continue
        detections = detect(unit)
        _note_unreadable(unit, detections, found)
        readable = detections.readable
        used = [bool(readable[t]) and labels[t] is not None for t in range(len(unit.entries))]
        if not any(used):
            continue
        found.pictures += sum(used)
        first = used.index(True)
        one = labels[first]
        intrinsics = one.intrinsics if camera == "labelled" and one is not None else None
        if intrinsics is None:
            if camera == "labelled":
                found.problems.append(Problem("camera missing: one is assumed", unit.entries[first].name))
            width, height = (int(side) for side in detections.sizes[first])
            extents = detections.hands.extent[np.array(used)[detections.hands.frame]]
            intrinsics = Intrinsics.assumed(width, height, largest_extent(extents))
        elif camera == "labelled":
            changed = [
                entry.name
                for entry, one, is_used in zip(unit.entries, labels, used, strict=True)
                if is_used and one is not None and one.intrinsics != intrinsics
            ]
            if changed:
                kind = "camera changes within the clip: its first one is used throughout"
                found.problems.append(Problem(kind, changed[0]))
        frames = [(t, unit.entries[t], one) for t, one in enumerate(labels) if used[t] and one is not None]
        if protocol == "paper":
            _paper_rows(frames, detections, intrinsics, found)
        else:
            _strict_rows(unit, frames, detections, intrinsics, max_hands, found)
    return found


def _labels(entry: Entry, found: Rows) -> Labels | None:
    try:
        labels = entry.read_labels()
    except DatasetError as error:
        found.problems.append(Problem("labels cannot be read", f"{entry.name}: {error}"))
        return None
    # A picture that is said to show no hand is a label too: whatever is found in it is a stray.
    if labels.hands and not any(_is_labelled(hand) for hand in labels.hands):
        found.problems.append(Problem("no labelled hand", entry.name))
        return None
    return labels


def _is_labelled(hand: HandLabel) -> bool:
    return bool(np.isfinite(hand.joints_3d).any() or np.isfinite(hand.keypoints_2d).any())


def _note_unreadable(unit: Unit, detections: UnitDetections, found: Rows) -> None:
    unreadable = (unit.entries[t] for t in np.flatnonzero(~detections.readable))
    found.problems += [Problem("picture cannot be read", entry.name) for entry in unreadable]


def _strict_rows(
    unit: Unit,
    frames: Sequence[Frame],
    detections: UnitDetections,
    intrinsics: Intrinsics,
    max_hands: int | None,
    found: Rows,
) -> None:
    """Tracks as a capture makes them; every labelled hand is a row, found or not."""
    try:
        tracks = link_tracks(detections.hands, len(unit.entries), "auto", max_hands, _fps(unit))
    except NoHandFoundError:
        tracks = ()
    in_view = [TrackInView(track, intrinsics) for track in tracks]
    found.tracks += in_view
    for t, entry, labels in frames:
        hands = [i for i, hand in enumerate(labels.hands) if _is_labelled(hand)]
        pixels = [label_pixels(labels.hands[i], labels.intrinsics) for i in hands]
        found_in = [(view, view.track.detections) for view in in_view]
        present = [(view, points) for view, d in found_in for points in d.keypoints_2d[d.frame == t]]
        matched = match(pixels, [points for _, points in present])
        found.extra_hands += len(present) - sum(m is not None for m in matched)
        for index, which in zip(hands, matched, strict=True):
            track = None if which is None else present[which][0]
            found.rows.append(_row(entry, labels, index, float(detections.milliseconds[t]), track, t))


def _fps(unit: Unit) -> float:
    """Frames per second, by the entries' times; 25 for a still."""
    steps = np.diff([entry.time for entry in unit.entries])
    steps = steps[steps > 0]
    return float(1.0 / np.median(steps)) if len(steps) else 25.0


def _paper_rows(
    frames: Sequence[Frame], detections: UnitDetections, intrinsics: Intrinsics, found: Rows
) -> None:
    """One row a picture: its first labelled hand and its first detection, whoever's it is, taken for a
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
        track, hands = None, detections.hands
        if len(at := np.flatnonzero(hands.frame == t)):
            first = replace(hands.select(at[:1]), frame=np.zeros(1, dtype=int))
            track = TrackInView(Track(PAPER_SIDE, first, frame_count=1), intrinsics)
            found.tracks.append(track)
        else:
            found.problems.append(Problem("no hand detected: dropped as in the paper", entry.name))
        found.rows.append(_row(entry, labels, with_tips[0], float(detections.milliseconds[t]), track, 0))


def _row(
    entry: Entry, labels: Labels, index: int, detect_ms: float, track: TrackInView | None, frame: int
) -> Row:
    hand = labels.hands[index]
    known = track is not None and hand.side is not None
    return Row(
        entry=entry,
        hand_index=index,
        label=hand,
        label_2d=label_pixels(hand, labels.intrinsics),
        intrinsics=labels.intrinsics,
        view=view_of(hand.joints_3d, hand.side),
        detect_ms=detect_ms,
        track=track,
        frame=frame,
        side_correct=float(track.track.side == hand.side) if known and track else float("nan"),
    )


MATCH_DISTANCE = 0.5
"""A detection whose points lie farther from the labels than half the hand's size (on average) has found
something else."""


def label_pixels(hand: HandLabel, intrinsics: Intrinsics | None) -> np.ndarray:
    """(21, 2) labelled pixels; where the set has none, the 3D labels through its camera; else NaN."""
    if np.isfinite(hand.keypoints_2d).any() or intrinsics is None:
        return hand.keypoints_2d
    in_front = np.where(hand.joints_3d[:, 2:] > 0.0, hand.joints_3d, np.nan)
    return intrinsics.project(in_front)


def match(labels_2d: Sequence[np.ndarray], detections: Sequence[np.ndarray]) -> list[int | None]:
    """For each labelled hand's (21, 2) pixels the index of its detection, whose keypoints are (21, 2) pixels,
    too, or None for a miss.

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
    """Mean distance of the labelled points in units of the hand's size."""
    known = np.isfinite(pixels).all(axis=-1)
    distance = np.linalg.norm(keypoints[known] - pixels[known], axis=-1).mean()
    # One labelled point has no size, and a few may lie close together: the detection's then decides.
    size = max(*(float(np.ptp(points, axis=0).max()) for points in (pixels[known], keypoints)), 1e-9)
    return float(distance) / size


def view_of(joints_3d: np.ndarray, side: Side | None) -> str:
    """How the camera sees the palm of (21, 3) labels in its frame: `palm`, `back`, `edge` or `unknown`.

    The palm's plane is that of wrist, index knuckle and little finger's knuckle; `unknown` where one of
    them has no label or the side is not known.
    """
    wrist, index, little = joints_3d[[0, 5, 17]]
    # Out of the palm, for a right hand.
    normal = np.cross(index - wrist, little - wrist)
    sight = (wrist + index + little) / 3.0
    size = np.linalg.norm(normal) * np.linalg.norm(sight)
    if side is None or not np.isfinite(size) or size == 0.0:
        return "unknown"
    towards_camera = -float(normal @ sight) / size * (1.0 if side == "right" else -1.0)
    # The palm's plane within so many degrees of the line of sight is an edge.
    if abs(towards_camera) < math.sin(math.radians(30.0)):
        return "edge"
    return "palm" if towards_camera > 0.0 else "back"
