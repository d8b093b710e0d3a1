"""The fast solver: single frames in one batch, clips with one shape and over all frames at once."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Final

import numpy as np

from handfit_core.batch import slices, spread
from handfit_core.detect.correction.corrected import landmarked
from handfit_core.detect.keypoints import DetectedTrack, HandDetection, SideBySide
from handfit_core.fit.clips import smoothed
from handfit_core.fit.doubt import (
    among_neighbours,
    doubted,
    doubted_thumb,
    doubtful,
    evidence,
    expected_error,
    side_logits,
)
from handfit_core.fit.gaps import Times, bridged, jumps, missing_between, spans
from handfit_core.fit.levenberg import solve
from handfit_core.fit.meeting import meeting
from handfit_core.fit.observation import Observation, kept_at_distance, observation_of
from handfit_core.fit.problem import Held, Motion, Problem, SharedShape
from handfit_core.fit.rest import palm_motion, wrist_distances
from handfit_core.fit.solution import Solution
from handfit_core.fit.start import relaxed_start
from handfit_core.fit.terms import (
    Apart,
    InFront,
    Limits,
    PosePrior,
    Shape,
    Term,
    Touch,
    coupling,
    depth,
    distance,
    near_pose,
    reprojection,
)
from handfit_core.geometry.camera import Intrinsics
from handfit_core.hand_model.chain import Chain, State
from handfit_core.hand_model.data import HandModel
from handfit_core.hand_model.landmarks import FILE, Landmarks, detector_landmarks
from handfit_core.hand_model.length import betas_of_measured, length_rates
from handfit_core.hand_model.surface import surface_of
from handfit_core.skeleton import NUM_BETAS
from handfit_core.solvers import OnFrame, ShouldStop, TrackFit, never

MAX_ITERATIONS: Final = 20
"""Most need four to seven, fists up to fifteen"""
TOLERANCE: Final = 5e-3
"""Relative decrease of the cost at which to stop"""
PINNED_TOLERANCE: Final = 2e-3
"""Relative decrease of the cost at which to stop where a person has put points in place or made them touch"""

SHAPE_FRAMES: Final = 48
"""So many frames, evenly spread over a clip, decide the hand's one shape"""
CHUNK: Final = 512
"""Frames fitted until somebody may stop; bounds the memory"""
SLICE: Final = 256
"""Frames solved at once; bounds the memory, and what is computed of so many stays near the processor"""
SHAPE_EVIDENCE: Final = 3.0
"""So many of a clip's frames count as independent evidence of the shape: what is off is off in all"""

SMOOTH_ROTATION: Final = 12.5
"""radians per second squared: the acceleration that a joint's rotation is expected to have at strength 1"""
SMOOTH_PLACE: Final = 1.05
"""metres per second squared, of the wrist"""
OVERLAP_SECONDS: Final = 2.4
"""Shared by two windows of a long clip at strength 1"""
JITTER: Final = 1.5
"""times the expected errors of depth, where motion is smoothed: from frame to frame the depth of the landmark
network of December 2020 trembles three to four times as much as the present one's"""
DISTANCE_SIGMA: Final = 0.002
"""of the wrist's distance, from what the whole clip says of it"""


@dataclass(frozen=True, eq=False)
class FrameFits:
    """B independent fits, in the camera frame."""

    betas: np.ndarray
    """(B, 10)"""
    global_orient: np.ndarray
    """(B, 3) radians"""
    hand_pose: np.ndarray
    """(B, 45) radians"""
    transl: np.ndarray
    """(B, 3) metres"""
    solution: Solution
    evidence: np.ndarray
    """(B, 5, 6) what tells of their errors, see `doubt.evidence`"""
    doubted: np.ndarray
    """(B,) times the error that this expects, see `doubt.doubted`"""

    @property
    def expected_error(self) -> np.ndarray:
        """(B, 5) metres that each finger is likely to be off."""
        return expected_error(self.evidence, self.doubted)

    @property
    def doubtful(self) -> np.ndarray:
        """(B,) bool: hands that may well be wrong."""
        return doubtful(self.expected_error)


class FastFitter:
    """One hand model, ready to be fitted.

    `hand_length`: metres from the wrist joint to the tip of the middle finger that the shape is expected to
    have; None: the mean shape is. `landmarks`: where on the hand its keypoints lie; None: where the detector
    sees them.
    """

    def __init__(
        self, model: HandModel, hand_length: float | None = None, landmarks: Landmarks | None = None
    ) -> None:
        self.model = model
        self.chain = Chain(model, landmarks or detector_landmarks())
        with np.load(FILE, allow_pickle=False) as arrays:
            prior = PosePrior(arrays["pose_mean"], arrays["pose_covariance"], model.side)
        self._relaxed = prior.mean
        limits = Limits(model.side, model.name)
        self.reach = limits.reach
        self._terms: tuple[Term, ...] = (reprojection, depth, limits, prior, coupling)
        self.surface = surface_of(model)
        self._apart = Apart(self.surface)
        self._in_front, self._touch = InFront(self.surface), Touch(self.surface)
        self._measured = hand_length is not None
        self._betas = np.zeros(NUM_BETAS) if hand_length is None else betas_of_measured(model, hand_length)
        self._length_rates = length_rates(model, self._betas)

    def observe(self, detections: Sequence[HandDetection], intrinsics: Intrinsics) -> Observation:
        """What is seen of those detections through that camera."""
        far = np.array([d.distance for d in detections], dtype=np.float64)
        seen = landmarked(detections, self.model.side)
        return observation_of(seen, intrinsics, far if np.isfinite(far).any() else None)

    def start(self, seen: Observation, betas: np.ndarray | None = None) -> State:
        """A relaxed hand laid over the landmarks, of the expected shape or of betas (10,)."""
        return relaxed_start(self.chain, seen, self._relaxed, self._betas if betas is None else betas)

    def problem(
        self,
        seen: Observation,
        shape: SharedShape = "given",
        held: Held | None = None,
        *,
        solid: bool = False,
    ) -> Problem:
        """Those hands as the solver is to find them; near to poses where `seen` has some to keep.

        `solid`: their parts do not pass through each other, and meet as `seen` says if it has been asked. The
        shape must be given, and the start roughly right: a finger on the wrong side would be held there.
        """
        terms = (*self._terms, *self._meeting_terms(seen)) if solid else self._terms
        if seen.kept is not None:
            terms = (*terms, near_pose, distance)
        if shape != "given":
            weight = 1.0 if shape == "each" else 1.0 / min(len(seen), SHAPE_EVIDENCE)
            terms = (*terms, Shape(self._betas, self._length_rates, weight, measured=self._measured))
        reach = self.reach if seen.kept is None else None
        return Problem(self.chain, seen, terms, shape, held, reach=reach)

    def solve_each(self, problem: Problem, start: State, max_iterations: int | None = None) -> Solution:
        """Independent frames. `max_iterations`: None for MAX_ITERATIONS."""
        most = MAX_ITERATIONS if max_iterations is None else max_iterations
        # Fingers that are made to touch have none of `pinned`.
        corrected = problem.seen.pinned is not None or problem.seen.touches is not None
        tolerance = PINNED_TOLERANCE if corrected else TOLERANCE
        return Solution.filled(
            len(start),
            (
                solve(problem.select(part), start.select(part), max_iterations=most, tolerance=tolerance)
                for part in slices(len(start), SLICE)
            ),
        )

    def solve_solid(
        self, seen: Observation, plain: Solution, times: Times | None = None, held: Held | None = None
    ) -> tuple[Observation, Solution]:
        """The same hands as solid ones, from where they are without; and what is seen of how their parts
        meet. `times`: when they were seen in a clip; None: they know nothing of each other."""
        seen = replace(seen, meeting=meeting(self.surface, seen, plain.state, times))
        rows = []
        for first in range(0, len(plain), CHUNK):
            part = slice(first, first + CHUNK)
            posed, here = self.chain.pose(plain.state.select(part)), seen.select(part)
            rows += [first + term(posed, here).hand for term in self._meeting_terms(seen)]
        meet = np.unique(np.concatenate(rows))
        if not len(meet):
            return seen, plain
        solid = self.problem(seen, held=held, solid=True)
        chosen = (meet[part] for part in slices(len(meet), SLICE))
        found = (self.solve_each(solid.select(rows), plain.state.select(rows)) for rows in chosen)
        return seen, plain.replaced(meet, Solution.filled(len(meet), found))

    def _meeting_terms(self, seen: Observation) -> tuple[Apart | InFront | Touch, ...]:
        """Those that couple parts of a hand."""
        in_front = () if seen.meeting is None else (self._in_front,)
        touch = () if seen.meeting is None and seen.touches is None else (self._touch,)
        return (self._apart, *in_front, *touch)

    def solve_shape(self, seen: Observation) -> np.ndarray:
        """(10,) the one shape of all frames, whose poses are solved beside it and dropped."""
        alone = self.solve_each(self.problem(seen), self.start(seen)).state
        together = self.problem(seen, "one")
        return solve(together, alone, max_iterations=MAX_ITERATIONS, tolerance=TOLERANCE).state.betas[0]


@lru_cache(maxsize=8)
def fitter_of(
    model: HandModel, hand_length: float | None = None, landmarks: Landmarks | None = None
) -> FastFitter:
    """Kept between calls: an edit that is answered while the artist drags should not build it again."""
    return FastFitter(model, hand_length, landmarks)


def fit_frames(
    model: HandModel,
    detections: Sequence[HandDetection],
    intrinsics: Intrinsics,
    hand_length: float | None = None,
) -> FrameFits:
    """Fit B pictures of a hand independently, each with a shape of its own, which is expected to have that
    length (metres; None: an average one)."""
    fitter = fitter_of(model, hand_length)
    seen = fitter.observe(detections, intrinsics)
    plain = fitter.solve_each(fitter.problem(seen, "each"), fitter.start(seen))
    seen, solution = fitter.solve_solid(seen, plain)
    return FrameFits(
        *fitter.chain.parameters(solution.state),
        solution=solution,
        evidence=evidence(seen, fitter.chain.points(solution.state), side_logits(detections, model.side)),
        doubted=doubted(detections) * doubted_thumb(seen),
    )


def fit_track(
    smoothing: float,
    model: HandModel,
    track: DetectedTrack,
    intrinsics: Intrinsics,
    on_frame: OnFrame,
    should_stop: ShouldStop = never,
    hand_length: float | None = None,
) -> TrackFit:
    """Fit a followed hand: one shape, and motion as smooth as `smoothing` asks (0: each frame by itself).

    Gaps up to `gaps.LONGEST_GAP` are filled. `should_stop` is asked after every `CHUNK` frames; those that
    were not reached are NaN. `hand_length` is as `FastFitter` has it.
    """
    found, count = np.flatnonzero(track.detected), len(track.detections)
    fitter = fitter_of(model, hand_length, track.landmarks)
    detections = [d for d in track.detections if d is not None]
    seen = fitter.observe(detections, intrinsics)
    # A track's side is voted for by all of its frames.
    sure = side_logits(detections, model.side).mean()
    of_looks = doubted(detections)
    del detections
    if isinstance(track.detections, SideBySide):
        track.detections.forget_corrections()
    cuts = jumps(seen.pixels) | missing_between(found, track.holes)
    if len(found) == 1:
        solution = fitter.solve_each(fitter.problem(seen, "each"), fitter.start(seen))
        seen, solution = fitter.solve_solid(seen, solution)
        frames, state = found, solution.state
    else:
        solution = _clip(fitter, seen, should_stop)
        found = found[: len(solution)]
        cuts = cuts[: len(found) - 1]
        times = Times.between(found, cuts, track.fps)
        seen, solution = fitter.solve_solid(seen.select(slice(len(found))), solution, times)
        frames, state = over_time(fitter, seen, solution.state, found, cuts, smoothing, track.fps)
    for _ in found:
        on_frame()
    rows = np.flatnonzero(np.isin(frames, found))
    told = np.empty((len(rows), 5, 6))
    for part in slices(len(rows)):
        points = fitter.chain.points(state.select(rows[part]))
        told[part] = evidence(seen.select(part), points, np.full(len(points), sure))
    converged = solution.converged
    times = of_looks[: len(found)] * doubted_thumb(seen)
    del seen, solution
    expected = among_neighbours(expected_error(told, times), Times.between(found, cuts, track.fps))
    betas, orient, pose, transl = fitter.chain.parameters(state)
    return TrackFit(
        betas=betas[0],
        global_orient=spread(orient, frames, count),
        hand_pose=spread(pose, frames, count),
        transl=spread(transl, frames, count),
        converged=spread(converged, found, count, False),
        filled=spread(True, np.setdiff1d(frames, found), count, False),
        doubtful=spread(doubtful(expected), found, count, False) if track.calibrated else None,
        expected_error=spread(expected, found, count) if track.calibrated else None,
    )


def _clip(fitter: FastFitter, seen: Observation, should_stop: ShouldStop) -> Solution:
    """Every frame by itself, all with one shape; fewer when stopped."""
    count = len(seen)
    chosen = np.linspace(0, count - 1, min(SHAPE_FRAMES, count)).round().astype(int)
    betas = fitter.solve_shape(seen.select(np.unique(chosen)))

    def parts() -> Iterator[Solution]:
        for part in slices(count, CHUNK):
            chunk = seen.select(part)
            yield fitter.solve_each(fitter.problem(chunk), fitter.start(chunk, betas))
            if should_stop():
                return

    return Solution.filled(count, parts())


def _motion(smoothing: float, fps: float) -> Motion:
    """Per second -> per frame. The stiffer, the farther frames influence each other."""
    per_frame = 1.0 / (max(smoothing, 1e-6) * fps**2)
    overlap = int(np.clip(OVERLAP_SECONDS * fps * np.sqrt(max(smoothing, 1.0)), 60, 400))
    return Motion(SMOOTH_ROTATION * per_frame, SMOOTH_PLACE * per_frame, overlap)


def over_time(
    fitter: FastFitter,
    seen: Observation,
    state: State,
    found: np.ndarray,
    cuts: np.ndarray,
    smoothing: float,
    fps: float,
    held: Held | None = None,
    before_each: Callable[[], None] = lambda: None,
) -> tuple[np.ndarray, State]:
    """Stretch by stretch: gaps bridged, motion smoothed. Returns the frames that have a hand, and their
    states. `held` has a row for each of the track's frames; `before_each` stretch, window and iteration may
    raise to stop."""
    motion = _motion(smoothing, fps)
    frames, states = [], []
    for stretch in spans(found, fps, cuts):
        before_each()
        known = np.isin(stretch, found)
        rows = np.flatnonzero(np.isin(found, stretch))
        guess = bridged(state.select(slice(rows[0], rows[-1] + 1)), known)
        here = None if held is None else held.select(stretch)
        guess = guess if here is None else here.put(guess)
        if smoothing > 0:
            # Rows of frames without a detection repeat another's; they are not looked at.
            nearest = rows[np.clip(np.cumsum(known) - 1, 0, None)]
            observed = seen.select(slice(rows[0], rows[-1] + 1) if known.all() else nearest)
            observed = replace(observed, depth_sigma=JITTER * observed.depth_sigma)
            problem = fitter.problem(observed, held=here, solid=True)
            if observed.kept is None and observed.depth_zero is None and len(stretch) > 2:
                certain = known & False if here is None else here.joints[:, 0]
                far = wrist_distances(guess, known, certain, fps, smoothing)
                guess = replace(guess, wrist=guess.wrist * far[:, None], depth_zero=guess.depth_zero * far)
                kept = kept_at_distance(guess, np.full(len(far), DISTANCE_SIGMA))
                problem = replace(
                    problem, seen=replace(observed, kept=kept), terms=(*problem.terms, distance)
                )
            calm = palm_motion(observed, known, fps)
            problem = replace(problem, motion=motion, calm=calm, looked_at=known)
            guess = smoothed(problem, guess, before_each)
        frames.append(stretch)
        states.append(guess)
    return np.concatenate(frames), State.joined(states)
