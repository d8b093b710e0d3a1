"""The methods that can be evaluated: the raw detector and every solver turn a detected track into 3D hands.

The detector gives two sets of landmarks: image landmarks are pixels with a depth on the scale of x, world
landmarks are metres. Their errors differ, so that both together (`fused`) beat either. A fit must beat them.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Final

import numpy as np

from handfit_core.common.batch import Batch
from handfit_core.common.errors import OptionError
from handfit_core.common.skeleton import NUM_KEYPOINTS
from handfit_core.detect.keypoints import Track
from handfit_core.evaluate import ProtocolName
from handfit_core.fit.solvers import SOLVERS, get_solver, solver_names
from handfit_core.geometry.camera import Intrinsics
from handfit_core.geometry.similarity import align
from handfit_core.hand_model import HandModel
from handfit_core.paper import EXPERIMENTS
from handfit_core.paper.fitter import PaperFitter


@dataclass(frozen=True, eq=False)
class TrackResult(Batch):
    """One method's hand over a track's T frames; NaN where nothing was detected."""

    points_3d: np.ndarray
    """(T, 21, 3) metres in the camera frame: the hand's keypoints"""
    picture_points: np.ndarray
    """(T, 21, 3) pixels: the keypoints in the picture, with a relative depth on the scale of x"""
    milliseconds: np.ndarray
    """(T,) milliseconds of fitting, spread evenly over the frames with a hand"""
    parameters: np.ndarray
    """(T, 61) betas, global_orient (radians), hand_pose (radians), transl (metres); (T, 0) where there is no
    hand model"""
    expected_error: np.ndarray
    """(T,) metres that the hand is likely to be off, as the solver says; NaN where it says nothing"""

    @classmethod
    def of_points(
        cls, points: np.ndarray, picture_points: np.ndarray, milliseconds: np.ndarray | None = None
    ) -> TrackResult:
        """Make a result of points that have no hand model behind them."""
        nothing = np.full(len(points), np.nan)
        times = nothing if milliseconds is None else milliseconds
        return cls(points, picture_points, times, np.empty((len(points), 0)), nothing)


Method = Callable[[HandModel, Track, Intrinsics], TrackResult]
"""Fits a whole track, seen through one camera, with a model of its side."""


def image_landmarks(keypoints: np.ndarray, world: np.ndarray) -> np.ndarray:  # noqa: ARG001
    """Return image landmarks (21, 3) in pixels with depth, which the keypoints are already; `world` (21, 3)
    in metres does not count."""
    return keypoints


def world_landmarks(keypoints: np.ndarray, world: np.ndarray) -> np.ndarray:
    """Return (21, 3) pixels with depth: world landmarks (21, 3) in metres, laid over the keypoints (21, 3) in
    pixels by a similarity transform."""
    return align(world, keypoints, with_scale=True).apply(world)


def fused_landmarks(keypoints: np.ndarray, world: np.ndarray) -> np.ndarray:
    """Return (21, 3) pixels with depth: x and y of the keypoints (21, 3), the depth averaged over these and
    world landmarks (21, 3) in metres."""
    fused = keypoints.copy()
    fused[:, 2] = (fused[:, 2] + world_landmarks(keypoints, world)[:, 2]) / 2.0
    return fused


def in_metres(picture_points: np.ndarray, world: np.ndarray, intrinsics: Intrinsics) -> np.ndarray:
    """Turn points (21, 3) in pixels with depth into (21, 3) metres in the camera frame.

    The size is that of the world landmarks (21, 3) in metres: the scale of the similarity transform from the
    points to them.
    The shape is left as it is, as if seen from far away, and stands where a pinhole camera sees a hand
    of that size that large.
    """
    metres_per_pixel = align(picture_points, world, with_scale=True).scale
    centre = picture_points[:, :2].mean(axis=0)
    depth = metres_per_pixel * (intrinsics.fx + intrinsics.fy) / 2.0
    offsets = picture_points - np.array([*centre, picture_points[:, 2].mean()])
    return intrinsics.rays(centre) * depth + offsets * metres_per_pixel


def raw(
    landmarks: Callable[[np.ndarray, np.ndarray], np.ndarray],
    model: HandModel,  # noqa: ARG001 (a method's signature)
    track: Track,
    intrinsics: Intrinsics,
) -> TrackResult:
    """Return the detector's landmarks without a fit, as a method's result."""
    hands, count = track.detections, track.frame_count
    points, picture = _empty(count), _empty(count)
    for i, keypoints, world in zip(hands.frame, hands.keypoints, hands.world, strict=True):
        picture[i] = landmarks(keypoints, world)
        points[i] = in_metres(picture[i], world, intrinsics)
    return TrackResult.of_points(points, picture)


def solved(solver: str, model: HandModel, track: Track, intrinsics: Intrinsics) -> TrackResult:
    """Run a solver as a capture runs it."""
    seen = track.detected
    started = time.perf_counter()
    fit = get_solver(solver)(model, track, intrinsics, lambda: None)
    spent = 1000 * (time.perf_counter() - started) / max(1, int(seen.sum()))
    points = _empty(len(seen))
    points[seen] = model.keypoints(fit.betas, fit.global_orient[seen], fit.hand_pose[seen], fit.transl[seen])
    betas = np.where(seen[:, None], fit.betas, np.nan)
    return TrackResult(
        points_3d=points,
        picture_points=_seen_from_afar(points, intrinsics),
        milliseconds=np.where(seen, spent, np.nan),
        parameters=np.concatenate([betas, fit.global_orient, fit.hand_pose, fit.transl], axis=1),
        expected_error=np.full(len(seen), np.nan)
        if fit.expected_error is None
        else fit.expected_error.mean(axis=1),
    )


def published(solver: str, model: HandModel, track: Track, intrinsics: Intrinsics) -> TrackResult:
    """Run one of the paper's solvers as its evaluation uses it: frame by frame, laid back over the picture by
    the inverse of its alignment, with no camera anywhere."""
    fitter = PaperFitter(model, EXPERIMENTS[solver])
    hands, count = track.detections, track.frame_count
    points, picture, spent = _empty(count), _empty(count), np.full(count, np.nan)
    for i, keypoints, world in zip(hands.frame, hands.keypoints, hands.world, strict=True):
        started = time.perf_counter()
        fit = fitter.fit(keypoints)
        spent[i] = 1000 * (time.perf_counter() - started)
        fitted = model.keypoints(fit.betas, fit.global_orient, fit.hand_pose, np.zeros(3))
        picture[i] = fit.in_picture(fitted)
        points[i] = in_metres(picture[i], world, intrinsics)
    return TrackResult.of_points(points, picture, spent)


def _empty(count: int) -> np.ndarray:
    return np.full((count, NUM_KEYPOINTS, 3), np.nan)


def _seen_from_afar(points: np.ndarray, intrinsics: Intrinsics) -> np.ndarray:
    """Project points (T, 21, 3) in metres to pixels, with depths about their mean in pixels of the mean
    depth."""
    mean_depth = points[..., 2:].mean(axis=-2, keepdims=True)
    depth = (points[..., 2:] - mean_depth) * intrinsics.fx / mean_depth
    return np.concatenate([intrinsics.project(points), depth], axis=-1)


_RAW: Final = {"raw-image": image_landmarks, "raw-world": world_landmarks, "fused": fused_landmarks}
"""The methods that give the detector's landmarks without a fit, by name"""

_GROUPS: Final[dict[str, tuple[str, ...]]] = {
    "raw": ("raw-image", "raw-world"),
    "paper": tuple(name for name, solver in SOLVERS.built_in().items() if solver.published),
    "all": (*_RAW, *solver_names()),
}
"""For each name that stands for several methods, their names."""


def method_names(asked: list[str]) -> list[str]:
    """Return every method once, in the order asked for, with groups opened. Raises OptionError."""
    known = _GROUPS["all"]
    names = [name for word in asked for name in _GROUPS.get(word, (word,))]
    for name in names:
        if name not in known:
            raise OptionError(f"there is no solver '{name}'; choose from {', '.join((*_GROUPS, *known))}")
    return list(dict.fromkeys(names))


def get_method(name: str, protocol: ProtocolName) -> Method:
    """Return the method of that name, as the protocol runs it."""
    if name in _RAW:
        return partial(raw, _RAW[name])
    if protocol == "paper" and SOLVERS.get(name).published:
        return partial(published, name)
    return partial(solved, name)
