"""The heavy half of re-fitting: what is fitted to, and the fast solver over it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields

import numpy as np
import torch

from handfit_core.errors import Cancelled
from handfit_core.hand_model.data import HandModel
from handfit_core.refine import pins as pinning
from handfit_core.refine.hand import START_ARRAYS, RefineHand, RefineResult
from handfit_core.refine.handles import landmark_points
from handfit_core.refine.refit import ShouldStop
from handfit_core.residuals.reprojection import NEAREST
from handfit_core.skeleton import NUM_KEYPOINTS
from handfit_core.solvers.fast.chain import State, joined
from handfit_core.solvers.fast.fit import CHUNK, TRUST, FastFitter, fitter_of, over_time
from handfit_core.solvers.fast.gaps import jumps, missing_between
from handfit_core.solvers.fast.holding import Held
from handfit_core.solvers.fast.observe import Landmarked, landmarked
from handfit_core.torch_threads import one_thread

LOOSE: float = 4.0
"""times the expected errors of a pose's points, where they stand in for a detection among others"""


def load() -> None:
    """What is else imported with the first range."""
    import scipy.linalg  # noqa: F401


def each(hand: RefineHand, model: HandModel, guess: RefineResult | None) -> dict[str, np.ndarray]:
    """Poses (T rows) of all frames, each by itself."""
    pose = {name: np.array(getattr(hand, name), dtype=np.float64) for name in START_ARRAYS}
    posed, points = _posed(hand, model)
    for rows in pose.values():
        rows[~posed] = np.nan
    rows = np.flatnonzero(np.where(posed, hand.pinned.any(axis=1), hand.detected))
    if not len(rows):
        return pose
    detected = _detected(hand, rows)
    keep = pinning.kept(points[rows], hand.intrinsics)
    seen = _first_or_second(posed[rows], keep, detected)
    pins = hand.pins[rows]
    doubt = pinning.followed(pinning.displacement(pins, seen.pixels))
    seen = pinning.pinned(seen, pins, doubt, detected)
    fitter = fitter_of(model, torch.float32)
    begin = _Begin.of(hand, model, posed, points, guess)
    with one_thread(), torch.inference_mode():
        for at, part in _chunks(rows):
            state = _solved(fitter, hand, _rows(seen, part), begin, posed, at)
            for name, values in zip(START_ARRAYS, fitter.chain.parameters(state)[1:], strict=True):
                pose[name][at] = values
    return _with_locked(hand, posed, pose)


def over_range(hand: RefineHand, model: HandModel, should_stop: ShouldStop) -> dict[str, np.ndarray]:
    """Poses (T rows) of all frames, over time."""
    pose = {name: np.full((len(hand), *shape), np.nan) for name, shape in START_ARRAYS.items()}
    posed, points = _posed(hand, model)
    rows = np.flatnonzero(hand.detected | (posed & hand.pinned.any(axis=1)))
    if not len(rows):
        return pose
    keep = pinning.kept(points[rows], hand.intrinsics)
    seen = _first_or_second(hand.detected[rows], _detected(hand, rows), _loosely(keep))
    # Before the pins, of which one may lie far away.
    cuts = jumps(seen.pixels) | missing_between(rows, hand.holes)
    pins = hand.pins[rows]
    displaced = pinning.over_time(pinning.displacement(pins, seen.pixels), rows, hand.fps)
    seen = pinning.pinned(seen, pins, pinning.followed(displaced))
    fitter = fitter_of(model, torch.float64)
    begin = _Begin.of(hand, model, posed, points)
    with one_thread(), torch.inference_mode():
        states = []
        for at, part in _chunks(rows):
            _check(should_stop)
            states.append(_solved(fitter, hand, _rows(seen, part), begin, posed, at))
        observed = seen.observation(hand.intrinsics, fitter.dtype)
        held = _held(fitter, hand, posed, np.arange(len(hand)))
        frames, state = over_time(
            fitter, observed, joined(states), rows, cuts, hand.smoothing, hand.fps, held,
            lambda: _check(should_stop),
        )  # fmt: skip
    for name, values in zip(START_ARRAYS, fitter.chain.parameters(state)[1:], strict=True):
        pose[name][frames] = values
    return _with_locked(hand, posed, pose)


def _with_locked(hand: RefineHand, posed: np.ndarray, pose: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """The solver's poses with the locked joints as they came, to the last bit."""
    wrist = np.repeat(np.asarray(hand.locked[:1], dtype=bool), 3)
    fingers = np.repeat(np.asarray(hand.locked[1:], dtype=bool), 3)
    held = {"global_orient": wrist, "hand_pose": fingers, "transl": wrist}
    return {
        name: np.where(posed[:, None] & np.isfinite(rows) & held[name], getattr(hand, name), rows)
        for name, rows in pose.items()
    }


def _check(should_stop: ShouldStop) -> None:
    if should_stop():
        raise Cancelled("re-fitting was stopped; nothing was changed")


def _posed(hand: RefineHand, model: HandModel) -> tuple[np.ndarray, np.ndarray]:
    """(T,) bool: frames whose pose can be seen, which is before the camera; and the landmarks (T, 21, 3) of
    those poses, of others some that harm nothing."""
    posed = hand.posed
    points = np.ones((len(hand), NUM_KEYPOINTS, 3))
    points[posed] = landmark_points(model, hand.betas, *(getattr(hand, n)[posed] for n in START_ARRAYS))
    behind = points[..., 2].min(axis=1) <= NEAREST
    points[behind] = 1.0
    return posed & ~behind, points


def _detected(hand: RefineHand, rows: np.ndarray) -> Landmarked:
    """Corrected landmarks of those frames; NaN where nothing is detected."""
    detections = [d for row in rows if (d := hand.detections[row]) is not None]
    there = hand.detected[rows]
    count = len(rows)
    points = (count, NUM_KEYPOINTS)
    whole = Landmarked(*(np.full(shape, np.nan) for shape in ((*points, 2), (*points, 2), points, points)))
    if detections:
        found = landmarked(detections, hand.side, TRUST)
        for name in _ARRAYS:
            getattr(whole, name)[there] = getattr(found, name)
    return whole


_ARRAYS = tuple(f.name for f in fields(Landmarked) if f.name != "pinned")


def _first_or_second(choose_first: np.ndarray, first: Landmarked, second: Landmarked) -> Landmarked:
    def choose(name: str) -> np.ndarray:
        mine, theirs = getattr(first, name), getattr(second, name)
        return np.where(choose_first.reshape(-1, *[1] * (mine.ndim - 1)), mine, theirs)

    return Landmarked(*(choose(name) for name in _ARRAYS))


def _loosely(seen: Landmarked) -> Landmarked:
    return Landmarked(seen.pixels, LOOSE * seen.pixel_sigma, seen.depth, LOOSE * seen.depth_sigma)


def _rows(seen: Landmarked, rows: np.ndarray) -> Landmarked:
    return Landmarked(*(getattr(seen, name)[rows] for name in (*_ARRAYS, "pinned")))


def _chunks(rows: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """(frames, which of `rows` they are), as many as are solved at once."""
    for first in range(0, len(rows), CHUNK):
        part = np.arange(first, min(first + CHUNK, len(rows)))
        yield rows[part], part


@dataclass(frozen=True, eq=False)
class _Begin:
    """Where the solver begins in T frames."""

    known: np.ndarray
    """(T,) bool"""
    pose: dict[str, np.ndarray]
    """START_ARRAYS, of T rows"""
    points: np.ndarray
    """(T, 21, 3) landmarks of those poses, metres"""

    @classmethod
    def of(
        cls,
        hand: RefineHand,
        model: HandModel,
        posed: np.ndarray,
        points: np.ndarray,
        guess: RefineResult | None = None,
    ) -> _Begin:
        """From the frames' poses, or from a guess where there is one."""
        pose = {name: np.asarray(getattr(hand, name), dtype=np.float64) for name in START_ARRAYS}
        if guess is None:
            return cls(posed, pose, points)
        near = guess.present
        pose = {name: np.where(near[:, None], getattr(guess, name), pose[name]) for name in START_ARRAYS}
        points = points.copy()
        points[near] = landmark_points(model, hand.betas, *(pose[name][near] for name in START_ARRAYS))
        return cls(posed | near, pose, points)


def _solved(
    fitter: FastFitter,
    hand: RefineHand,
    seen: Landmarked,
    begin: _Begin,
    posed: np.ndarray,
    rows: np.ndarray,
) -> State:
    """Those frames, each by itself; locked joints are held where `posed` (T,) says so."""
    observed = seen.observation(hand.intrinsics, fitter.dtype)
    ray = observed.ray.double().numpy()
    along = np.einsum("nkc,nc->nk", begin.points[rows], ray).mean(axis=1, keepdims=True)
    known = begin.known[rows]
    start = _pose_state(fitter, hand, begin.pose, known, along, rows)
    if not known.all():
        betas = torch.tensor(hand.betas, dtype=fitter.dtype)
        start = start.where(torch.tensor(known), fitter.start(observed, betas))
    held = _held(fitter, hand, posed[rows], rows)
    start = start if held is None else held.put(start)
    return fitter.solve_each(observed, start, shape=False, held=held).state


def _pose_state(
    fitter: FastFitter,
    hand: RefineHand,
    pose: dict[str, np.ndarray],
    known: np.ndarray,
    offsets: np.ndarray,
    rows: np.ndarray,
) -> State:
    """Those frames' poses, of the others a flat hand; `known` and `offsets` are theirs."""
    orient, fingers, place = (np.where(known[:, None], pose[name][rows], 0.0) for name in START_ARRAYS)
    betas = np.broadcast_to(np.asarray(hand.betas, dtype=np.float64), (len(rows), len(hand.betas)))
    return fitter.chain.state(betas, orient, fingers, place, offsets)


def _held(fitter: FastFitter, hand: RefineHand, posed: np.ndarray, rows: np.ndarray) -> Held | None:
    """Locked joints of those frames; `posed` is theirs."""
    locked = np.asarray(hand.locked, dtype=bool)
    if not locked.any():
        return None
    joints = posed[:, None] & locked
    pose = {name: np.asarray(getattr(hand, name), dtype=np.float64) for name in START_ARRAYS}
    return Held(joints, _pose_state(fitter, hand, pose, posed, np.zeros((len(rows), 1)), rows))
