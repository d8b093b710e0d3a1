"""How steady a hand is over a clip: bones that breathe, accelerations that are not there, tremble.

A clip is (T, 21, 3) points of one hand in the order of time, NaN in the frames where it was missed or is
not labelled. Only frames without a gap between them are compared: a gap is left out, never bridged, so
read these numbers beside the detection rate.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from handfit_core.evaluate.metrics import labelled_points, mean_of_labelled
from handfit_core.skeleton import KEYPOINT_PARENTS, WRIST_KEYPOINT

JITTER_ABOVE_HZ: Final = 5.0
"""Faster than hands move on purpose, mostly; what is above is called jitter"""


def bone_length_variation(points: np.ndarray) -> float:
    """Percent by which the 20 bones of (T, 21, 3) points change over time. Alignment: none needed.

    Standard deviation over mean of each bone's length over the frames that have it, averaged over the
    bones. 0 for a rigid skeleton, whatever it does. NaN with fewer than two frames.
    """
    points = np.asarray(points, dtype=np.float64)
    lengths = np.linalg.norm(points[:, 1:] - points[:, KEYPOINT_PARENTS[1:]], axis=-1)  # (T, 20)
    mean = mean_of_labelled(lengths, axis=0)
    deviation = np.sqrt(mean_of_labelled((lengths - mean) ** 2, axis=0))
    enough = ((~np.isnan(lengths)).sum(axis=0) >= 2) & (mean > 0.0)
    ratio = np.divide(deviation, mean, out=np.full(len(mean), np.nan), where=enough)
    return 100.0 * float(mean_of_labelled(ratio))


def acceleration_error(points: np.ndarray, truth: np.ndarray, times: np.ndarray) -> float:
    """Mean length of the difference between predicted and true acceleration, in unit/s^2.

    points, truth (T, 21, 3); times (T,) seconds. Acceleration is the second divided difference over
    three neighbouring frames, all of them valid in both; steps may be unequal. Alignment: each wrist at
    the origin, and the wrist left out of the mean. NaN without such frames, or without a labelled wrist.
    """
    steps = np.diff(np.asarray(times, dtype=np.float64))
    # The difference of the accelerations is the acceleration of the difference.
    error = _prediction_error(points, truth)
    velocity = np.diff(error, axis=0) / steps[:, None, None]
    spans = 0.5 * (steps[1:] + steps[:-1])
    acceleration = np.diff(velocity, axis=0) / spans[:, None, None]
    return float(mean_of_labelled(np.linalg.norm(acceleration, axis=-1)))


def jitter_spectrum(points: np.ndarray, truth: np.ndarray, fps: float) -> float:
    """RMS, in the unit, of that part of the prediction error that is faster than 5 Hz (spectral jitter).

    points, truth (T, 21, 3) at a constant `fps`. Alignment: each wrist at the origin; the wrist left out.
    The error's power density (Welch 1967: Hann windows of 2 s that overlap by half, each without its
    linear trend) is summed above `JITTER_ABOVE_HZ` over x, y and z, then averaged over frames and points:
    white noise of standard deviation s per axis at 25 fps gives about s * sqrt(3 * 7.5 / 12.5). A constant
    or slow error counts nothing; tremble in the labels counts too. Runs without a gap for at least one
    second are used; NaN without any, and where `fps` is too low (10 or less) to tell.
    """
    from scipy.signal import welch

    if fps <= 2.0 * JITTER_ABOVE_HZ:
        return float("nan")
    error = _prediction_error(points, truth)
    valid = labelled_points(error)  # (T, P)
    power, frames = 0.0, 0
    for point in range(error.shape[1]):
        for run in _runs(valid[:, point]):
            length = run.stop - run.start
            if length < 1.0 * fps:
                continue
            frequencies, density = welch(
                error[run, point],
                fs=fps,
                window="hann",
                nperseg=min(length, round(2.0 * fps)),
                detrend="linear",
                axis=0,
            )
            fast = density[frequencies > JITTER_ABOVE_HZ].sum() * frequencies[1]
            power += length * fast
            frames += length
    return float(np.sqrt(power / frames)) if frames else float("nan")


def _prediction_error(points: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """(T, 20, 3) points - truth about the wrists, without these, whose error is always 0."""
    error = np.asarray(points, dtype=np.float64) - truth
    return np.delete(error - error[:, [WRIST_KEYPOINT]], WRIST_KEYPOINT, axis=1)


def _runs(valid: np.ndarray) -> list[slice]:
    """The unbroken runs of True in (T,) booleans."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], valid.astype(int), [0]])))
    return [slice(int(start), int(stop)) for start, stop in edges.reshape(-1, 2)]
