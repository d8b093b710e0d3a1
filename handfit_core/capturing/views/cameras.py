"""Where a second camera stands, both focal lengths and the offset in time: one adjustment with the hands.

Unknown are the poses of the hands in the common frames, their one shape, and nine variables of the cameras.
It starts from the rotation that lays the hands of one view over those of the other.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from handfit_core.capturing.views.hands import ViewedHand
from handfit_core.fit.blocks import Blocks
from handfit_core.fit.fast import FastFitter
from handfit_core.fit.levenberg import solve
from handfit_core.fit.observation import Observation
from handfit_core.fit.problem import Problem
from handfit_core.fit.settings import VIEWS
from handfit_core.fit.solution import Solution
from handfit_core.fit.terms.free_cameras import (
    CAMERA_SIZE,
    FOCAL,
    OFFSET,
    SHIFT,
    TURN,
    CameraPrior,
    Filmed,
    FilmedState,
    projected,
)
from handfit_core.fit.terms.rows import Rows
from handfit_core.geometry.camera import Intrinsics
from handfit_core.hand_model.chain import BETAS, HAND_SIZE, Posed, State


@dataclass(frozen=True, eq=False)
class HandPair:
    """One hand, as both views have it."""

    fitter: FastFitter
    first: ViewedHand
    second: ViewedHand

    def common(self, offset: float) -> np.ndarray:
        """Rows of the first view's hand at whose moments the second view has it, too; `offset` in seconds."""
        return np.flatnonzero(self.second.seen_at(self.first.times - offset))

    def at(self, first: np.ndarray) -> HandPair:
        """The pair in those rows of the first view's hand."""
        return HandPair(self.fitter, self.first.select(first), self.second)


@dataclass(frozen=True, eq=False)
class CameraPriors:
    """What is known of both cameras beforehand."""

    focal: tuple[float, float]
    """pixels"""
    focal_sigma: tuple[float, float]
    """of their logarithms; 0: certain"""
    rotation: np.ndarray | None = None
    """(3, 3), with `translation` (3,) in metres: x_2 = rotation x_1 + translation; None: not known"""
    translation: np.ndarray | None = None
    offset_sigma: float | None = None
    """frames; None: as the search of `sync` leaves it"""


@dataclass(frozen=True, eq=False)
class Adjusted:
    """Cameras as they were found."""

    rotation: np.ndarray
    """(3, 3)"""
    translation: np.ndarray
    """(3,) metres; x_2 = rotation x_1 + translation"""
    focal: np.ndarray
    """(2,) pixels"""
    offset: float
    """seconds from the first view's start to the second one's"""
    betas: np.ndarray
    """(10,) shape of the hand"""
    state: State
    """The hands in the frames that the cameras were found from"""
    cost: float
    """a frame"""
    residual: float
    """Root mean square of both views' residuals, in `ViewedHand.sigma`"""
    error: tuple[float, float]
    """pixels: median distance of landmarks in each view"""
    left_open: tuple[float, float]
    """Standard deviations of the rotation and of the direction of `translation` if all residuals were
    independent, degrees; without meaning where these are known"""


def start_rotation(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """(3, 3) rotation that lays hands (N, 21, 3) of the first view over those of the second: the median of
    the frames' own."""
    a, b = (points - points.mean(axis=1, keepdims=True) for points in (first, second))
    turns = _nearest_rotation(b.swapaxes(1, 2) @ a)
    mean = _nearest_rotation(turns.sum(axis=0)[None])[0]
    for _ in range(20):
        cosine = (np.einsum("nij,ij->n", turns, mean) - 1.0) / 2.0
        weight = 1.0 / np.maximum(np.arccos(np.clip(cosine, -1.0, 1.0)), 0.03)
        mean = _nearest_rotation(np.einsum("n,nij->ij", weight, turns)[None])[0]
    return mean


def _nearest_rotation(matrices: np.ndarray) -> np.ndarray:
    u, _, vt = np.linalg.svd(matrices)
    u[..., 2] *= np.sign(np.linalg.det(u @ vt))[:, None]
    return u @ vt


@dataclass(frozen=True, eq=False)
class JointProblem(Problem):
    """The problems of several hands, whose shape and cameras are one. Its own fields are the first hand's."""

    parts: tuple[Problem, ...] = ()
    fixed_variables: np.ndarray | None = None
    """(26,) bool, of a hand's own variables and the cameras'"""

    def split(self, state: State) -> list[State]:
        """The hands' states, one after the other in `state`."""
        ends = np.cumsum([len(part.seen) for part in self.parts])
        return [
            state.select(slice(end - len(part.seen), end)) for end, part in zip(ends, self.parts, strict=True)
        ]

    def blocks(self, state: State) -> Blocks:
        """Cost and Gauss-Newton matrices of all hands and the cameras, as `Problem.blocks` gives them."""
        assert self.fixed_variables is not None
        found = [part.blocks(of_part) for part, of_part in zip(self.parts, self.split(state), strict=True)]
        of_hand = np.broadcast_to(self.fixed_variables, (len(state), len(self.fixed_variables)))
        return Blocks.concatenate(found).with_fixed(of_hand, np.zeros((len(state), 5, 9), dtype=bool))

    def clip_to_bounds(self, state: State, of_fingers: np.ndarray) -> np.ndarray:
        """As `Problem.clip_to_bounds`; far from the minimum steps of a hand lead astray."""
        steps = np.clip(of_fingers, -VIEWS.longest_step, VIEWS.longest_step)
        ends = np.cumsum([len(part.seen) for part in self.parts])[:-1]
        pieces = zip(self.parts, self.split(state), np.split(steps, ends), strict=True)
        return np.concatenate([part.clip_to_bounds(of_part, step) for part, of_part, step in pieces])


def adjust(
    pairs: Sequence[HandPair],
    offset: float,
    priors: CameraPriors,
    start: Adjusted | None = None,
    *,
    frames: int = VIEWS.frames,
    iterations: int = VIEWS.iterations,
) -> Adjusted | None:
    """Solve for the cameras from an offset in seconds, on up to so many frames; None where fewer than four
    are common. `start`: an earlier result, to go on from."""
    chosen = [_spread(pair.common(offset), max(frames // len(pairs), 4)) for pair in pairs]
    count = sum(map(len, chosen))
    if count < 4:
        return None
    here = [pair.at(rows) for pair, rows in zip(pairs, chosen, strict=True) if len(rows)]
    sigma = VIEWS.offset_sigma if priors.offset_sigma is None else priors.offset_sigma
    rate = min(here[0].first.fps, here[0].second.fps)
    focal_sigma = np.maximum(priors.focal_sigma, 1e-6)
    prior = CameraPrior(np.log(priors.focal), focal_sigma, offset, max(sigma / rate, 1e-6))
    parts = tuple(_problem(pair, priors, prior, count) for pair in here)
    states = State.concatenate([pair.first.placed(priors.focal[0]) for pair in here])
    rotation, translation, focal, betas = _start(here, offset, priors, start)
    filmed: State = FilmedState(
        states.root,
        states.angles,
        states.wrist,
        np.tile(betas, (count, 1)),
        states.depth_zero,
        rotation=np.tile(rotation, (count, 1, 1)),
        translation=np.tile(translation, (count, 1)),
        log_focal=np.tile(np.log(focal), (count, 1)),
        offset=np.full(count, offset),
    )
    fixed = np.zeros(HAND_SIZE + CAMERA_SIZE, dtype=bool)
    fixed[HAND_SIZE:][FOCAL] = np.asarray(priors.focal_sigma) == 0.0
    fixed[HAND_SIZE:][OFFSET] = priors.offset_sigma == 0.0
    if priors.rotation is not None:
        fixed[HAND_SIZE:][TURN] = fixed[HAND_SIZE:][SHIFT] = True
    whole = JointProblem(
        parts[0].chain, parts[0].seen, parts[0].terms, "one", parts=parts, fixed_variables=fixed
    )
    if start is None:
        # The shape waits until the cameras stand about where they should.
        rigid = fixed.copy()
        rigid[BETAS] = True
        first = replace(whole, fixed_variables=rigid)
        filmed = solve(first, filmed, max_iterations=VIEWS.start_iterations, tolerance=VIEWS.tolerance).state
    solution = solve(whole, filmed, max_iterations=iterations, tolerance=VIEWS.tolerance)
    return _result(whole, solution, here)


def _spread(rows: np.ndarray, most: int) -> np.ndarray:
    if len(rows) <= most:
        return rows
    return rows[np.linspace(0, len(rows) - 1, most).round().astype(int)]


def _problem(pair: HandPair, priors: CameraPriors, prior: CameraPrior, count: int) -> Problem:
    """One hand's problem, of `count` frames that all hands have."""
    first, second, fitter = pair.first, pair.second, pair.fitter
    seen = first.observed(Intrinsics(priors.focal[0], priors.focal[0], *first.centre))
    seen = replace(seen, depth_sigma=seen.depth_sigma * VIEWS.depth_factor)
    filmed = Filmed(first.seen.pixels, None, first.centre, first.sigmas)

    def in_first(posed: Posed, seen: Observation) -> Rows:  # noqa: ARG001 (a term)
        return projected(posed, filmed, 0)

    def in_second(posed: Posed, seen: Observation) -> Rows:  # noqa: ARG001 (a term)
        assert isinstance(posed.state, FilmedState)
        times = first.times - posed.state.offset
        return projected(posed, Filmed(*second.at(times), second.centre, second.sigmas_at(times)), 1)

    terms = (in_first, in_second, *fitter.camera_terms(count), prior)
    return Problem(fitter.chain, seen, terms, "one", angle_bounds=fitter.angle_bounds)


def _start(
    pairs: Sequence[HandPair], offset: float, priors: CameraPriors, start: Adjusted | None
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Rotation (3, 3), translation (3,), focal lengths (2,) and betas (10,)."""
    if start is not None:
        return start.rotation, start.translation, start.focal, start.betas
    here, there = [], []
    for pair in pairs:
        matching = pair.second.select(pair.second.nearest(pair.first.times - offset))
        for found, hand, focal in ((here, pair.first, priors.focal[0]), (there, matching, priors.focal[1])):
            found.append(hand.points + (hand.placed(focal).wrist - hand.state.wrist)[:, None])
    a, b = np.concatenate(here), np.concatenate(there)
    rotation = start_rotation(a, b) if priors.rotation is None else priors.rotation
    translation = priors.translation
    if translation is None:
        translation = np.median(b.mean(axis=1) - a.mean(axis=1) @ rotation.T, axis=0)
    betas = np.concatenate([pair.first.state.betas for pair in pairs]).mean(axis=0)
    return rotation, translation, np.asarray(priors.focal), betas


def _result(whole: JointProblem, solution: Solution, pairs: Sequence[HandPair]) -> Adjusted:
    state = solution.state
    assert isinstance(state, FilmedState)
    squares, pixels = [], ([], [])
    for pair, problem, part in zip(pairs, whole.parts, whole.split(state), strict=True):
        posed = problem.chain.pose(part)
        sigmas = pair.first.sigmas, pair.second.sigmas_at(pair.first.times - state.offset[0])
        # Agreement is judged with one expected error for all points, or doubted ones would fit anything.
        for hand, term, sigma, of_view in zip(
            (pair.first, pair.second), problem.terms[:2], sigmas, pixels, strict=True
        ):
            rows = term(posed, problem.seen)
            assert isinstance(rows, Rows)
            seen = np.isfinite(sigma).all(axis=(1, 2))
            distance = np.linalg.norm(rows.residual[seen] * sigma[seen], axis=2)
            squares.append(np.minimum(distance / hand.sigma, VIEWS.worst_residual).reshape(-1) ** 2)
            of_view.append(distance.reshape(-1))
    errors = [float(np.median(np.concatenate(each))) for each in pixels]
    return Adjusted(
        rotation=state.rotation[0],
        translation=state.translation[0],
        focal=np.exp(state.log_focal[0]),
        offset=float(state.offset[0]),
        betas=state.betas[0],
        state=state,
        cost=float(solution.cost.mean()),
        residual=float(np.sqrt(np.concatenate(squares).mean())),
        error=(errors[0], errors[1]),
        left_open=_left_open(whole, state),
    )


def _left_open(whole: JointProblem, state: FilmedState) -> tuple[float, float]:
    """What the normal equations leave open of the second camera's rotation and direction, degrees."""
    covariance = np.linalg.inv(whole.blocks(state).common_information())[-CAMERA_SIZE:, -CAMERA_SIZE:]
    way = state.translation[0]
    length = max(float(np.linalg.norm(way)), 1e-6)
    across = np.eye(3) - np.outer(way, way) / length**2
    turned = np.trace(covariance[TURN, TURN])
    moved = np.trace(across @ covariance[SHIFT, SHIFT]) / length**2
    return tuple(np.degrees(np.sqrt([turned, moved])).tolist())
