"""Errors of points and surfaces, shares of correct points, and how much a hand trembles over a clip. These
are pure functions that name their alignment.

Points are (P, 3) or (..., P, 3), most often (21, 3). Distances come in the unit of the input. A point is
labelled where the truth has no NaN; where it is not, the result is NaN. Every label counts the same.
A prediction that is NaN at a labelled point (a miss) gives NaN wherever it takes part in an alignment.

A clip is (T, 21, 3) points of one hand in the order of time, NaN in the frames where it was missed or is
not labelled. Frames around a gap are left out, never bridged.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from handfit_core.common.skeleton import WRIST_KEYPOINT
from handfit_core.geometry.similarity import align

PCK_THRESHOLDS_MM: Final = np.linspace(20.0, 50.0, 100)
"""(100,) mm: the range that EgoDexter and Dexter+Object are usually reported on"""
PCK_THRESHOLDS_MM.setflags(write=False)
JITTER_ABOVE_HZ: Final = 5.0
"""The frequency in Hz that hands mostly do not move faster than on purpose; faster motion is called jitter"""


def mean_of_labelled(errors: np.ndarray, axis: int | None = None) -> np.ndarray:
    """Return the mean along an axis (None: of all) over what is not NaN; NaN where nothing is left."""
    errors = np.asarray(errors, dtype=np.float64)
    there = ~np.isnan(errors)
    count = np.asarray(there.sum(axis=axis))
    total = np.asarray(np.where(there, errors, 0.0).sum(axis=axis))
    return np.divide(total, count, out=np.full(total.shape, np.nan), where=count > 0)


def labelled_points(truth: np.ndarray) -> np.ndarray:
    """Return (..., P) bool: the points of (..., P, 2 or 3) labels that have no NaN."""
    return np.asarray(~np.isnan(truth).any(axis=-1))


def camera_distances(points: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """Return (..., P) distances of (..., P, 3) points to the truth. Alignment: none."""
    return np.linalg.norm(np.asarray(points, dtype=np.float64) - truth, axis=-1)


def centroid_aligned_distances(points: np.ndarray, truth: np.ndarray, *, min_points: int = 2) -> np.ndarray:
    """(..., P) distances. Alignment: the translation that makes the centroids of the labelled points meet.

    All NaN where fewer than `min_points` are labelled: a single point would always score 0.
    """
    offsets = np.asarray(points, dtype=np.float64) - truth
    labelled = labelled_points(truth)
    count = labelled.sum(axis=-1)
    total = np.where(labelled[..., None], offsets, 0.0).sum(axis=-2)
    shift = total / np.maximum(count, 1)[..., None]
    distances = np.linalg.norm(offsets - shift[..., None, :], axis=-1)
    return np.where(labelled & (count >= min_points)[..., None], distances, np.nan)


def root_aligned_distances(points: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """(..., P) distances. Alignment: the translation that makes the root points (the wrists) meet.

    All NaN where the root is not labelled, or nothing but the root. The root itself is given, and counted
    in averages, as 0, as evaluations over all 21 points do; over the 20 others the mean is 5 % higher.
    """
    points, truth = np.asarray(points, dtype=np.float64), np.asarray(truth, dtype=np.float64)
    distances = camera_distances(points - points[..., :1, :], truth - truth[..., :1, :])
    enough = labelled_points(truth).sum(axis=-1, keepdims=True) >= 2
    return np.where(enough, distances, np.nan)


def similarity_aligned_distances(points: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """(..., P) distances. Alignment: the best rotation, translation and scale over the labelled points.

    That is Procrustes analysis (Umeyama 1991), as in PA-MPJPE; a reflection is never aligned away. All
    NaN where fewer than four are labelled: three points are a triangle, whose handedness is free.
    """
    points, truth = np.asarray(points, dtype=np.float64), np.asarray(truth, dtype=np.float64)
    distances = np.full(truth.shape[:-1], np.nan)
    labelled = labelled_points(truth)
    for index in np.ndindex(truth.shape[:-2]):
        mask = labelled[index]
        source, target = points[index][mask], truth[index][mask]
        if len(target) < 4 or np.isnan(source).any():
            continue
        moved = align(source, target, with_scale=True).apply(source)
        distances[index][mask] = np.linalg.norm(moved - target, axis=-1)
    return distances


def distances_2d(points: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """(..., P) distances of (..., P, 2) points in the picture over the hand's size. Alignment: none.

    The size is the longer side of the labelled points' box. All NaN where fewer than two points are
    labelled, or all of them stand in one place.
    """
    truth = np.asarray(truth, dtype=np.float64)
    labelled = labelled_points(truth)[..., None]
    extent = np.where(labelled, truth, -np.inf).max(axis=-2) - np.where(labelled, truth, np.inf).min(axis=-2)
    size = extent.max(axis=-1)[..., None]
    return camera_distances(points, truth) / np.where(size > 0.0, size, np.nan)


def aligned_vertices(vertices: np.ndarray, points: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """(V, 3) vertices after the best similarity transform of (P, 3) points onto the truth where labelled.

    For meshes of the same topology the points are the vertices themselves, as in FreiHAND's PA-MPVPE. All
    NaN with fewer than four labelled points, and for a miss.
    """
    labelled = labelled_points(truth)
    if labelled.sum() < 4 or np.isnan(points[labelled]).any():
        return np.full_like(vertices, np.nan)
    return align(points[labelled], truth[labelled], with_scale=True).apply(vertices)


def f_score(vertices: np.ndarray, truth: np.ndarray, threshold: float) -> float:
    """F-score, 0..1, of (V, 3) vertices against (W, 3) true ones. Alignment: none; pass aligned sets.

    The harmonic mean of precision (share of vertices nearer than `threshold` to some true vertex) and
    recall (the reverse); Knapitsch et al. 2017, "Tanks and Temples", as in FreiHAND (Zimmermann et al.
    2019). NaN where a vertex is NaN.
    """
    from scipy.spatial import KDTree

    if np.isnan(vertices).any() or np.isnan(truth).any():
        return float("nan")
    precision = np.mean(KDTree(truth).query(vertices)[0] < threshold)
    recall = np.mean(KDTree(vertices).query(truth)[0] < threshold)
    total = precision + recall
    return float(2.0 * precision * recall / total) if total > 0.0 else 0.0


def pck_curve(errors: np.ndarray, thresholds: np.ndarray, *, misses: int = 0) -> np.ndarray:
    """(T,) share, 0..1, of labelled points with an error of at most each threshold (PCK).

    errors of any shape, NaN where not labelled; their alignment is the caller's. `misses` is the number
    of labelled points of hands that were not detected: wrong at every threshold. NaN without any point.
    """
    errors = np.asarray(errors, dtype=np.float64)
    known = np.sort(errors[~np.isnan(errors)])
    total = len(known) + misses
    if total == 0:
        return np.full(len(thresholds), np.nan)
    return np.searchsorted(known, thresholds, side="right") / total


def auc(curve: np.ndarray, thresholds: np.ndarray) -> float:
    """Area under a (T,) PCK curve by the trapezoid rule, over the thresholds' range: 0..1."""
    from scipy.integrate import trapezoid

    return float(trapezoid(curve, thresholds) / (thresholds[-1] - thresholds[0]))


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
    error = np.asarray(points, dtype=np.float64) - truth
    error = np.delete(error - error[:, [WRIST_KEYPOINT]], WRIST_KEYPOINT, axis=1)  # (T, 20, 3)
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


def _runs(valid: np.ndarray) -> list[slice]:
    """Return slices of the unbroken runs of True in (T,) booleans."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], valid.astype(int), [0]])))
    return [slice(int(start), int(stop)) for start, stop in edges.reshape(-1, 2)]
