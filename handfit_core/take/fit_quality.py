"""How good a fitted hand is, in numbers and in a word: by how far it is likely to be off, in millimetres, and
where the solver did not tell, by how far it lies from the picture, in shares of its own size.

Pixels alone say little: ten are much for a hand of a hundred pixels and nothing for one of a thousand. Words
begin where hands, drawn over their pictures, begin to be wrong: docs/method.md has what was seen.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal

import numpy as np

from handfit_core.common.skeleton import FINGERS, KEYPOINT_PARENTS
from handfit_core.fit.doubt import DOUBT
from handfit_core.geometry.camera import Intrinsics
from handfit_core.take import HandTrack, Take

Quality = Literal["good", "fair", "poor"]

GOOD_BELOW: Final = 0.025
FAIR_BELOW: Final = 0.035
"""Mean errors as shares of the hand's length. Of 103 hands in photos and clips, drawn over their pictures:
below 2.5 % the outline lies on the hand's; from there to 3.5 % a finger or the wrist lies beside it by up to
its own width; above, a finger or the whole hand is elsewhere."""


@dataclass(frozen=True)
class Scale:
    """A scale on which errors are told, with its unit and the bounds of its words."""

    title: str
    unit: str
    per_unit: float
    good_below: float
    fair_below: float

    @property
    def levels(self) -> tuple[float, float, float]:
        """Errors that are shown as green, yellow and red: a hand that is called poor is yellow at best."""
        return self.good_below, self.fair_below, 2.0 * self.fair_below

    def said(self, error: float) -> str:
        """Return an error as text with its unit."""
        return f"{self.per_unit * error:.1f} {self.unit}"

    def quality(self, error: float) -> Quality:
        """Return the word for an error: how good the fit is."""
        if error < self.good_below:
            return "good"
        return "fair" if error < self.fair_below else "poor"


IN_PICTURE: Final = Scale("Error", "% of the hand", 100.0, GOOD_BELOW, FAIR_BELOW)
"""Scale for `relative_errors`: shares of the hand's length"""
EXPECTED: Final = Scale("Likely error", "mm", 1000.0, 0.008, DOUBT.doubtful_error)
"""Scale for `HandTrack.expected_error` of a clip: metres, told in millimetres"""
EXPECTED_OF_STILL: Final = Scale("Likely error", "mm", 1000.0, DOUBT.doubtful_error, 0.022)
"""For `HandTrack.expected_error` of a still, in which much is expected of a small hand and of one seen edge
on, right or wrong, and no neighbours in time tell them apart. Of 70 hands drawn over their pictures all 31
below 12 mm are right, as are 14 of 32 from there to 22 mm, and none of 7 beyond; in clips, 10 of 11 frames
beyond 12 mm are not."""
NOT_KNOWN: Final = "likely error not known"
"""Text in place of the likely error, for hands whose keypoints are of a source for which nobody has measured
it"""

_MIDDLE: Final = [1 + 4 * FINGERS.index("middle") + i for i in range(4)]
"""Indices of the middle finger's keypoints; the parent of the first one is the wrist"""


def relative_errors(track: HandTrack, intrinsics: Intrinsics) -> np.ndarray:
    """Return (T,) the mean distance of the fitted hand's 21 keypoints from the detected ones, as a share of
    the hand's length in the picture: that of wrist and stretched middle finger, seen from the front where the
    hand is. NaN in frames without a detection."""
    errors = np.full(len(track.detected), np.nan)
    rows = track.detected
    with np.errstate(divide="ignore", invalid="ignore"):
        errors[rows] = track.reprojection_error[rows] / length_in_picture(track.joints_3d[rows], intrinsics)
    return errors


def view_errors(take: Take, track: HandTrack) -> tuple[float, ...]:
    """Return for each view the mean distance in pixels, over all detections that a fit took notice of, from
    the fitted hand's 21 keypoints to the detected ones; NaN for a view without any."""
    found = [finite_mean(track.reprojection_error[track.detected])]
    numbers = np.asarray(take.frame_numbers)
    moments = (numbers - numbers[0]) / take.fps
    for view, seen in enumerate(track.seen_by, start=1):
        if seen is None or take.cameras is None or len(moments) < 2:
            found.append(None)
            continue
        rows = np.flatnonzero(seen.detected & seen.used)
        times = take.cameras.seconds(view)[rows]
        after = np.clip(np.searchsorted(moments, times), 1, len(moments) - 1)
        part = (times - moments[after - 1]) / (moments[after] - moments[after - 1])
        points = np.asarray(track.joints_3d)
        points = points[after - 1] + part[:, None, None] * (points[after] - points[after - 1])
        within = (part >= 0.0) & (part <= 1.0) & np.isfinite(points).all(axis=(1, 2))
        shown = take.cameras.camera(view).project(points[within])
        off = np.linalg.norm(shown - seen.keypoints_2d[rows[within]], axis=-1)
        found.append(finite_mean(off.mean(axis=1)))
    return tuple(np.nan if error is None else error for error in found)


def length_in_picture(joints: np.ndarray, intrinsics: Intrinsics) -> np.ndarray:
    """Return (N,) the pixels from the wrist to the tip of the stretched middle finger, seen from the front
    where the hand is, of N hands with keypoints (N, 21, 3) in metres in the camera frame."""
    bones = joints[:, _MIDDLE] - joints[:, [KEYPOINT_PARENTS[point] for point in _MIDDLE]]
    length = np.linalg.norm(bones, axis=-1).sum(axis=-1)
    return intrinsics.fx * length / joints[..., 2].mean(axis=-1)


def expected_scale(frames: float) -> Scale:
    """Return the scale for `HandTrack.expected_error` of a hand that was seen in so many frames: the one of a
    still, or the one of a clip."""
    return EXPECTED if frames > 1 else EXPECTED_OF_STILL


def error_is_known(track: HandTrack) -> bool:
    """Return True if somebody can tell how far off the hand is likely to be, or how far off it is called goes
    by the picture, as in older takes. For a hand that was doubted that is known, though a person has
    corrected it."""
    expected = track.expected_error
    return expected is None or track.doubtful is not None or bool(np.isfinite(expected).any())


def mean_relative_error(track: HandTrack, intrinsics: Intrinsics) -> float | None:
    """Return the mean of `relative_errors` over the frames with a detection; None where it has no value."""
    return finite_mean(relative_errors(track, intrinsics)[track.detected])


def mean_expected_error(track: HandTrack) -> float | None:
    """Return the metres that the hand is likely to be off, averaged over the frames of which that is told;
    None where it is told of none."""
    if track.expected_error is None:
        return None
    return finite_mean(track.expected_error[np.isfinite(track.expected_error).all(axis=1)])


def finite_mean(errors: np.ndarray) -> float | None:
    """Return the mean of (N,) errors; None where there is no mean that JSON can hold."""
    with np.errstate(over="ignore"):
        mean = float(errors.mean()) if len(errors) else np.nan
    return mean if np.isfinite(mean) else None
