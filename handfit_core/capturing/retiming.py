"""A take at another frame rate: one row for each frame of a scene that plays it at the speed at which it was
filmed.

Poses are interpolated at the moment of the scene's frame, rotations along the shortest arc. What was
measured in a picture stays that of the nearest picture, which is the one that the scene shows there.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from handfit_core.common.errors import OptionError
from handfit_core.edit.corrections import Correction, CorrectionField
from handfit_core.geometry.rotations import quat_multiply, quat_to_rotvec, rotvec_to_quat
from handfit_core.hand_model.arm import ArmMotion
from handfit_core.take import HandTrack, Take, at_rows

LOWEST_RATE, HIGHEST_RATE = 1.0, 120.0
"""Lowest and highest rate, in frames per second, to which a clip is retimed"""
_ON_ROW = 1e-3
"""Source frames within which a moment counts as that of a row"""
_ON_KEY = 0.01
"""Frames of the scene within which a frame counts as that of a key"""


def check_rate(fps: float) -> None:
    """Raise OptionError for a rate in frames per second that no clip is retimed to."""
    if not LOWEST_RATE <= fps <= HIGHEST_RATE:
        raise OptionError(
            f"the scene has {fps:.5g} frames per second, and clips are retimed to {LOWEST_RATE:g} to "
            f"{HIGHEST_RATE:g}: set its frame rate, or match the scene to the clip"
        )


def is_other_rate(scene_rate: float, fps: float) -> bool:
    """Return True if a clip of `fps` frames per second is retimed for a scene of `scene_rate` frames per
    second."""
    # Rates that differ less are the same
    return abs(scene_rate / fps - 1.0) >= 1e-4


def moments(take: Take, scale: float) -> np.ndarray:
    """Return (N,) the source frames, whole or not, that a scene shows on its frames from the take's first one
    on; `scale`: scene frames per source frame."""
    first, last = (int(n) for n in take.frame_numbers[[0, -1]])
    count = int(np.floor((last - first) * scale + _ON_ROW)) + 1
    return first + np.arange(count) / scale


def shown_numbers(source_frames: np.ndarray) -> np.ndarray:
    """Return (N,) the numbers of the pictures that are shown for source frames (N,), whole or not."""
    return _nearest(source_frames).astype(np.int64)


def retimed(take: Take, scale: float) -> Take:
    """Return the take with a row for each scene frame from its first one on, numbered from its first number
    on; `scale`: scene frames per source frame."""
    times = moments(take, scale)
    numbers = int(take.frame_numbers[0]) + np.arange(len(times))
    hands = tuple(sampled(track, np.asarray(take.frame_numbers), times) for track in take.hands)
    return replace(take, fps=take.fps * scale, frame_numbers=numbers, hands=hands)


def sampled(track: HandTrack, numbers: np.ndarray, times: np.ndarray) -> HandTrack:
    """Return a track's rows at `times` (N,), which count as its frame `numbers` (T,) do, whole or not.

    A hand is there where its nearest row has one, and detected where that row lies within half a frame.
    """
    nearest, before, after, part = _around(numbers, times)
    step = int(np.diff(numbers).min()) if len(numbers) > 1 else 1
    away = np.abs(numbers[nearest] - times)
    there = track.present[nearest] & (away <= 0.5 * step + _ON_ROW)
    detected = np.asarray(track.detected)[nearest] & (away <= 0.5 + _ON_ROW)
    rows = at_rows(track, nearest)
    # Beside a gap the pose of its edge holds: nothing is known on the other side.
    between = there & track.present[before] & track.present[after]
    before, after = np.where(between, before, nearest), np.where(between, after, nearest)
    filled = there & ~detected

    def kept(value: np.ndarray | None, where: np.ndarray) -> np.ndarray | None:
        return None if value is None else np.where(where.reshape(-1, *[1] * (value.ndim - 1)), value, np.nan)

    first, last = at_rows(track, before), at_rows(track, after)
    poses = {
        "global_orient": _turned(first.global_orient, last.global_orient, part),
        "hand_pose": _turned(first.hand_pose, last.hand_pose, part),
        "transl": first.transl + part[:, None] * (last.transl - first.transl),
    }
    return replace(
        rows,
        arm=None if track.arm is None else _sampled_arm(track.arm, before, after, part, there),
        **{name: kept(pose, there) for name, pose in poses.items()},
        detections=rows.detections.select(detected[rows.detections.frame]),
        filled=filled if filled.any() else None,
        **{
            name: kept(getattr(rows, name), there)
            for name in ("joints_3d", "expected_error", "placed", "touches")
        },
        reprojection_error=kept(rows.reprojection_error, detected),
    )


def _sampled_arm(
    arm: ArmMotion, before: np.ndarray, after: np.ndarray, part: np.ndarray, there: np.ndarray
) -> ArmMotion:
    """Interpolate an arm between its rows `before` and `after`, `part` (0..1) of the way, where its hand is
    `there`; all (N,)."""
    nearest = np.where(part >= 0.5, after, before)
    present = there & arm.present[nearest]
    between = arm.present[before] & arm.present[after]
    before, after = np.where(between, before, nearest), np.where(between, after, nearest)

    def moved(points: np.ndarray) -> np.ndarray:
        way = points[before] + part[:, None] * (points[after] - points[before])
        return np.where(present[:, None], way, np.nan)

    def bone(of: np.ndarray, length: float) -> np.ndarray:
        """Interpolate the vectors along a bone, metres, at the constant `length` of the bone."""
        along = moved(of)
        return along * (length / np.linalg.norm(along, axis=1, keepdims=True))

    wrist = moved(arm.wrist)
    elbow = wrist - bone(arm.wrist - arm.elbow, arm.lengths[1])
    shoulder = elbow - bone(arm.elbow - arm.shoulder, arm.lengths[0])
    return ArmMotion(shoulder, elbow, wrist, arm.lengths, present, moved(arm.expected_error))


def shown_rows(take: Take, numbers: np.ndarray, scale: float) -> tuple[np.ndarray, np.ndarray]:
    """Of a take that `retimed` made of one with frame `numbers` (T,): the rows (M,) that show a picture of
    that one best, and the numbers (M,) of these pictures, increasing."""
    times = numbers[0] + (np.asarray(take.frame_numbers) - take.frame_numbers[0]) / scale
    pictures = shown_numbers(times)
    order = np.lexsort([np.abs(times - pictures), pictures])
    first = np.unique(pictures[order], return_index=True)[1]
    return order[first], pictures[order[first]]


def _nearest(values: np.ndarray | float) -> np.ndarray:
    """Return the nearest whole numbers; of two equally near ones the later."""
    return np.floor(np.asarray(values, dtype=np.float64) + 0.5)


def _around(numbers: np.ndarray, times: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return for moments `times` (N,) the nearest rows, the rows before and after, and how far (0..1) each
    moment is from the one before to the one after; (N,) each."""
    after = np.clip(np.searchsorted(numbers, times - _ON_ROW), 0, len(numbers) - 1)
    before = np.where(np.abs(numbers[after] - times) <= _ON_ROW, after, np.maximum(after - 1, 0))
    apart = numbers[after] - numbers[before]
    part = np.where(apart > 0, (times - numbers[before]) / np.where(apart > 0, apart, 1), 0.0)
    # The picture that is shown is the later one of two that are as near.
    return np.where(part >= 0.5, after, before), before, after, np.clip(part, 0.0, 1.0)


def _turned(first: np.ndarray, last: np.ndarray, part: np.ndarray) -> np.ndarray:
    """Return (N, 3 J) axis-angle in radians, turned `part` (N,) of the way from the first to the last, about
    one axis."""
    start, end = (rotvec_to_quat(v.reshape(len(part), -1, 3)) for v in (first, last))
    way = quat_to_rotvec(quat_multiply(start * [1.0, -1.0, -1.0, -1.0], end))
    turned = quat_to_rotvec(quat_multiply(start, rotvec_to_quat(part[:, None, None] * way)))
    return np.where((part == 0.0)[:, None], first, turned.reshape(first.shape))


def moved_keys(
    keyed: np.ndarray, first: float, ratio: float, dense: float, kept: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the whole frames (N,) of a scene that plays `ratio` times as many frames, for a curve with keys
    on frames (K,), increasing, and the former frames (N,) whose values belong there; frame `first` stays
    where it is.

    Keys up to `dense` frames apart are sampled on every frame between them; others only move, and so do those
    on the frames `kept` (M,): their values stay to the last digit.
    """
    if len(keyed) == 0:
        return np.empty(0), np.empty(0)
    moved = first + _nearest((keyed - first) * ratio)
    frames = np.arange(moved[0], moved[-1] + 1.0)
    wanted = first + (frames - first) / ratio
    times = np.clip(wanted, keyed[0], keyed[-1])
    after = np.clip(np.searchsorted(keyed, times), 0, len(keyed) - 1)
    between = keyed[after] - keyed[np.maximum(after - 1, 0)] <= dense
    between |= np.abs(keyed[after] - times) < _ON_KEY  # the first key behind a gap
    between &= np.abs(wanted - times) < _ON_KEY
    still = np.ones(len(keyed), dtype=bool)
    if len(keyed) > 1:
        apart = np.diff(keyed) > dense
        near = np.abs(keyed[:, None] - kept).min(axis=1, initial=np.inf) < _ON_KEY
        still = np.append(apart, True) & np.insert(apart, 0, True) | near
    at = (moved[still] - moved[0]).astype(int)
    times[at] = keyed[still]
    between[at] = True
    between[0] |= not between.any()
    return frames[between], times[between]


def retimed_field(field: CorrectionField, first: int, ratio: float) -> CorrectionField:
    """Return corrections by frame number as they are in a scene that plays `ratio` times as many frames;
    number `first` stays. Of two that would lie on one frame the artist's last one stays."""
    moved: dict[float, Correction] = {}
    for number, one in sorted(field.corrections.items(), key=lambda item: (not item[1].is_anchor, item[0])):
        moved[first + float(_nearest((number - first) * ratio))] = replace(one, spread=one.spread * ratio)
    return CorrectionField(moved)
