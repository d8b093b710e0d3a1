"""Where a second camera stands, both focal lengths and the offset in time: one adjustment with the hands.

Unknown are the poses of the hands in the common frames, their one shape, and nine variables of the cameras.
It starts from the rotation that lays the hands of one view over those of the other.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from handfit_core.fit.blocks import Blocks
from handfit_core.fit.fast import FastFitter
from handfit_core.fit.levenberg import solve
from handfit_core.fit.observation import Observation
from handfit_core.fit.problem import Problem
from handfit_core.fit.settings import VIEWS
from handfit_core.fit.terms import Shape, Term, depth
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
from handfit_core.fit.views.hands import ViewedHand
from handfit_core.geometry.camera import Intrinsics
from handfit_core.hand_model.chain import BETAS, HAND_SIZE, Posed, State

Pair = tuple[ViewedHand, ViewedHand]
"""One hand, as both views have it"""


@dataclass(frozen=True, eq=False)
class Known:
    """What is known of both cameras beforehand."""

    focal: tuple[float, float]
    """pixels"""
    focal_sigma: tuple[float, float]
    """of their logarithms; 0: certain"""
    rotation: np.ndarray | None = None
    """(3, 3), with `translation` (3,) in metres: x_2 = rotation x_1 + translation; None: not known"""
    translation: np.ndarray | None = None
    offset_sigma: float | None = None
    """frames; None: as a search by courses leaves it"""


@dataclass(frozen=True, eq=False)
class SolvedHand:
    """One pair of hands in the B frames that cameras were found from."""

    state: State
    rows: np.ndarray
    """(B,) rows of the first view's hand"""
    residual: np.ndarray
    """(B,) root mean squares of both views' residuals, in sigmas"""


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
    """(10,)"""
    hands: tuple[SolvedHand | None, ...]
    """Of each pair of hands; None: it has no common frame"""
    cost: float
    """a frame"""
    residual: float
    """Root mean square of both views' residuals, in sigmas"""
    error: tuple[float, float]
    """pixels: median distance of landmarks in each view"""


def start_rotation(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """(3, 3) rotation that lays hands (N, 21, 3) of the first view over those of the second: the median of
    the frames' own."""
    a, b = (points - points.mean(axis=1, keepdims=True) for points in (first, second))
    turns = _nearest_rotation(b.swapaxes(1, 2) @ a)
    weight = np.ones(len(turns))
    for _ in range(20):
        mean = _nearest_rotation(np.einsum("n,nij->ij", weight, turns)[None])[0]
        cosine = (np.einsum("nij,ij->n", turns, mean) - 1.0) / 2.0
        weight = 1.0 / np.maximum(np.arccos(np.clip(cosine, -1.0, 1.0)), 0.03)
    return mean


def _nearest_rotation(matrices: np.ndarray) -> np.ndarray:
    u, _, vt = np.linalg.svd(matrices)
    u[..., 2] *= np.sign(np.linalg.det(u @ vt))[:, None]
    return u @ vt


@dataclass(frozen=True, eq=False)
class _Side:
    """One hand's problem."""

    fitter: FastFitter
    first: ViewedHand
    second: ViewedHand
    rows: np.ndarray
    """(B,) of `first`"""
    seen: Observation

    def terms(self, prior: CameraPrior, total: int) -> tuple[Term, ...]:
        first = self.first.select(self.rows)
        filmed = Filmed(
            first.seen.pixels, None, np.ones(len(first), dtype=bool), first.centre, self.first.sigma()
        )

        def of_first(posed: Posed, seen: Observation) -> Rows:  # noqa: ARG001 (a term)
            return projected(posed, filmed, 0)

        def of_second(posed: Posed, seen: Observation) -> Rows:  # noqa: ARG001
            return projected(posed, self.filmed(posed.state), 1)

        return (of_first, of_second, *self.fitter.camera_terms(total), prior)

    def filmed(self, state: State) -> Filmed:
        """What the second camera sees at the state's offset."""
        assert isinstance(state, FilmedState)
        times = self.first.times[self.rows] - state.offset
        pixels, _, speed = self.second.at(times)
        return Filmed(pixels, speed, self.second.seen_at(times), self.second.centre, self.second.sigma())


@dataclass(frozen=True, eq=False)
class _Together:
    """The problems of all hands, whose shape and cameras are one. Stands for a `Problem` in `solve`."""

    sides: list[Problem]
    counts: list[int]
    fixed: np.ndarray
    """(26,) bool, of a hand's own variables and the cameras'"""
    shape: str = "one"

    def parts(self, state: FilmedState) -> list[FilmedState]:
        ends = np.cumsum(self.counts)
        return [state.select(slice(end - n, end)) for end, n in zip(ends, self.counts, strict=True)]

    def blocks(self, state: FilmedState) -> Blocks:
        """As `Problem.blocks`."""
        found = [problem.blocks(part) for problem, part in zip(self.sides, self.parts(state), strict=True)]
        whole = found[0] if len(found) == 1 else Blocks.concatenate(found)
        if not self.fixed.any():
            return whole
        of_hand = np.broadcast_to(self.fixed, (len(state), len(self.fixed)))
        return whole.with_fixed(of_hand, np.zeros((len(state), 5, 9), dtype=bool))

    def clip_to_bounds(self, state: FilmedState, of_fingers: np.ndarray) -> np.ndarray:
        """As `Problem.clip_to_bounds`."""
        first, ends = self.sides[0], np.clip(of_fingers, -0.5, 0.5)
        return first.clip_to_bounds(state, ends) if len(self.sides) == 1 else ends


def common_rows(pair: Pair, offset: float) -> np.ndarray:
    """Rows of the first view's hand at whose moments the second view has it, too."""
    return np.flatnonzero(pair[1].seen_at(pair[0].times - offset))


def adjust(
    fitters: list[FastFitter], pairs: list[Pair], offset: float, known: Known, start: Adjusted | None = None,
    *, frames: int = VIEWS.frames, iterations: int = VIEWS.iterations,
) -> Adjusted | None:  # fmt: skip
    """Solve for the cameras from an offset in seconds, on up to so many frames; None where none are common.

    `start`: an earlier result, to go on from.
    """
    chosen = []
    for pair in pairs:
        rows = common_rows(pair, offset)
        share = max(frames // len(pairs), 4)
        if len(rows) > share:
            rows = rows[np.linspace(0, len(rows) - 1, share).round().astype(int)]
        chosen.append(rows)
    if sum(map(len, chosen)) < 4:
        return None
    total = len(pairs)
    kept = [i for i, rows in enumerate(chosen) if len(rows)]
    fitters, pairs, chosen = ([of[i] for i in kept] for of in (fitters, pairs, chosen))
    rate = min(pairs[0][0].fps, pairs[0][1].fps)
    sigma = VIEWS.offset_sigma if known.offset_sigma is None else known.offset_sigma
    prior = CameraPrior(
        np.log(known.focal), np.maximum(known.focal_sigma, 1e-6), offset, sigma / rate
    )
    sides, states = [], []
    for fitter, (first, second), rows in zip(fitters, pairs, chosen, strict=True):
        part = first.select(rows)
        seen = part.observed(Intrinsics(known.focal[0], known.focal[0], *first.centre))
        seen = replace(seen, depth_sigma=seen.depth_sigma * VIEWS.depth_factor)
        side = _Side(fitter, first, second, rows, seen)
        terms = side.terms(prior, sum(map(len, chosen)))
        sides.append(Problem(fitter.chain, seen, terms, "one", angle_bounds=fitter.angle_bounds))
        states.append(part.placed(known.focal[0]))
    rotation, translation, focal, betas = _start(pairs, chosen, states, offset, known, start)
    state = State.concatenate(states)
    count = len(state)
    filmed = FilmedState(
        **{**vars(state), "betas": np.broadcast_to(betas, (count, len(betas))).copy()},
        rotation=np.broadcast_to(rotation, (count, 3, 3)).copy(),
        translation=np.broadcast_to(translation, (count, 3)).copy(),
        log_focal=np.broadcast_to(np.log(focal), (count, 2)).copy(),
        offset=np.full(count, offset),
    )
    fixed = np.zeros(HAND_SIZE + CAMERA_SIZE, dtype=bool)
    cameras = fixed[HAND_SIZE:]
    cameras[FOCAL] = np.asarray(known.focal_sigma) == 0.0
    if known.rotation is not None:
        cameras[TURN] = cameras[SHIFT] = True
    cameras[OFFSET] = known.offset_sigma == 0.0
    counts = [len(rows) for rows in chosen]
    if start is None:
        # The shape waits until the cameras stand about where they should.
        rigid = fixed.copy()
        rigid[BETAS] = True
        first_part = _Together(sides, counts, rigid)
        filmed = solve(
            first_part, filmed, max_iterations=VIEWS.start_iterations, tolerance=VIEWS.tolerance
        ).state
    together = _Together(sides, counts, fixed)
    solution = solve(together, filmed, max_iterations=iterations, tolerance=VIEWS.tolerance)
    filmed = solution.state
    found = _result(together, filmed, pairs, float(solution.cost.sum()))
    hands = dict(zip(kept, zip(together.parts(filmed), chosen, found.pop("residuals"), strict=True), strict=True))
    return Adjusted(**found, hands=tuple(SolvedHand(*hands[i]) if i in hands else None for i in range(total)))


def _start(pairs, chosen, states, offset, known, start):
    if start is not None:
        return start.rotation, start.translation, start.focal, start.betas
    there, here = [], []
    for (first, second), rows, state in zip(pairs, chosen, states, strict=True):
        times = first.times[rows] - offset
        nearest = np.clip(np.round(np.interp(times, second.times, np.arange(len(second.times)))).astype(int), 0, None)
        matching = second.select(nearest)
        moved = matching.placed(known.focal[1]).wrist - matching.state.wrist
        there.append(matching.points + moved[:, None])
        here.append(first.points[rows] + (state.wrist - first.state.wrist[rows])[:, None])
    a, b = np.concatenate(here), np.concatenate(there)
    rotation = start_rotation(a, b) if known.rotation is None else known.rotation
    if known.translation is not None:
        translation = known.translation
    else:
        translation = np.median(b.mean(axis=1) - a.mean(axis=1) @ rotation.T, axis=0)
    betas = np.concatenate([state.betas for state in states]).mean(axis=0)
    return rotation, translation, np.asarray(known.focal), betas


def _result(together: _Together, state: FilmedState, pairs: list[Pair], cost: float) -> dict[str, Any]:
    """The fields of `Adjusted` but for its hands, and these hands' residuals."""
    squares, pixels, residuals = [], ([], []), []
    for problem, part in zip(together.sides, together.parts(state), strict=True):
        posed = problem.chain.pose(part)
        of_frames, counts = np.zeros(len(part)), np.zeros(len(part))
        for camera, term in enumerate(problem.terms[:2]):
            rows = term(posed, problem.seen)
            assert isinstance(rows, Rows)
            length = np.linalg.norm(rows.residual, axis=2)
            seen = rows.jacobian.any(axis=(1, 2, 3))
            squares.append(np.minimum(length[seen], VIEWS.worst_residual) ** 2)
            pixels[camera].append(length[seen])
            of_frames += np.where(seen, np.square(length).sum(axis=1), 0.0)
            counts += seen * length.shape[1]
        residuals.append(np.sqrt(of_frames / np.maximum(counts, 1.0)))
    sizes = [pairs[0][camera].sigma() for camera in (0, 1)]
    return {
        "rotation": state.rotation[0],
        "translation": state.translation[0],
        "focal": np.exp(state.log_focal[0]),
        "offset": float(state.offset[0]),
        "betas": state.betas[0],
        "cost": cost / len(state),
        "residual": float(np.sqrt(np.concatenate(squares).mean())),
        "error": tuple(
            float(np.median(np.concatenate(each)) * size) for each, size in zip(pixels, sizes, strict=True)
        ),
        "residuals": residuals,
    }
