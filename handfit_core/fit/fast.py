"""The fast solver: single frames in one batch, clips with one shape and over all frames at once."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from handfit_core.common.batch import scatter, slices
from handfit_core.common.skeleton import NUM_BETAS
from handfit_core.detect.correction.corrected import landmarked
from handfit_core.detect.keypoints import Detections, Track
from handfit_core.fit.clips import ClipProblem, MotionPrior, smooth_clip
from handfit_core.fit.doubt import (
    crop_spread_factor,
    doubtful,
    evidence,
    expected_error,
    lifted_thumb_factor,
    side_logits,
    temporal_mean,
)
from handfit_core.fit.gaps import Times, detect_cuts, interpolate_gaps, missing_between, segments
from handfit_core.fit.levenberg import solve
from handfit_core.fit.observation import Observation, PoseAnchor, observation_of
from handfit_core.fit.problem import FixedJoints, Problem, SharedShape
from handfit_core.fit.self_contact import find_self_contact
from handfit_core.fit.settings import MOTION, SOLVER, TERMS, VIEWS
from handfit_core.fit.solution import Solution
from handfit_core.fit.solvers import OnFrame, ShouldStop, never
from handfit_core.fit.start import relaxed_start
from handfit_core.fit.stationary import palm_motion_scale, wrist_distance_factors
from handfit_core.fit.terms import (
    Contact,
    Interpenetration,
    Limits,
    OrdinalDepth,
    PosePrior,
    Shape,
    Term,
    coupling,
    depth,
    distance,
    grip,
    near_pose,
    near_wrist,
    reprojection,
    second_view,
)
from handfit_core.geometry.camera import Intrinsics
from handfit_core.hand_model.anatomy import LANDMARKS_FILE
from handfit_core.hand_model.chain import Chain, State
from handfit_core.hand_model.data import HandModel
from handfit_core.hand_model.landmarks import Landmarks, detector_landmarks
from handfit_core.hand_model.length import betas_of_measured, length_rates
from handfit_core.hand_model.motion import HandMotion
from handfit_core.hand_model.surface import surface_of


class FastFitter:
    """The terms and kinematics of one hand model.

    `hand_length`: expected metres from the wrist joint to the tip of the middle finger; None: those of the
    mean shape. `landmarks`: where the keypoints lie on the hand; None: where the detector sees them.
    """

    def __init__(
        self, model: HandModel, hand_length: float | None = None, landmarks: Landmarks | None = None
    ) -> None:
        self.model = model
        self.chain = Chain(model, landmarks or detector_landmarks())
        with np.load(LANDMARKS_FILE, allow_pickle=False) as arrays:
            mean, covariance = arrays["pose_mean"], arrays["pose_covariance"]
        prior = PosePrior(mean, covariance, model.side)
        self._firm_prior = PosePrior(mean, covariance * (TERMS.pose_weight / VIEWS.pose_weight), model.side)
        self._relaxed = prior.mean
        self._limits = Limits(model.side, model.name)
        self.angle_bounds = self._limits.angle_bounds
        self._terms: tuple[Term, ...] = (reprojection, depth, self._limits, prior, coupling)
        self.surface = surface_of(model)
        self._interpenetration = Interpenetration(self.surface)
        self._ordinal_depth, self._contact = OrdinalDepth(self.surface), Contact(self.surface)
        self._measured = hand_length is not None
        self._betas = np.zeros(NUM_BETAS) if hand_length is None else betas_of_measured(model, hand_length)
        self._length_rates = length_rates(model, self._betas)

    def observe(self, hands: Detections, intrinsics: Intrinsics) -> Observation:
        """Return the observation of B detected hands as seen through a camera."""
        depth_zero = hands.distance if np.isfinite(hands.distance).any() else None
        return observation_of(landmarked(hands, self.model.side), intrinsics, depth_zero)

    def start(self, seen: Observation, betas: np.ndarray | None = None) -> State:
        """Return relaxed hands laid over the landmarks of B hands; `betas` (10,) is their shape, None for the
        expected one."""
        return relaxed_start(self.chain, seen, self._relaxed, self._betas if betas is None else betas)

    def relaxed_pose(self) -> np.ndarray:
        """(45,) radians, the hand_pose of a relaxed hand."""
        nothing = np.zeros((1, 3))
        state = State(np.eye(3)[None], self._relaxed[None], nothing, self._betas[None], nothing[:, 0])
        return self.chain.parameters(state)[2][0]

    def problem(
        self,
        seen: Observation,
        shape: SharedShape = "given",
        fixed: FixedJoints | None = None,
        *,
        solid: bool = False,
    ) -> Problem:
        """Make the problem of fitting B hands to an observation, near `seen.anchor`, if there is one.

        `solid`: with the terms that couple parts of a hand, so that these do not pass through each other. The
        shape must be given, and the start roughly right: a finger on the wrong side would be held there.
        """
        terms = (*self._terms, *self._coupling_terms(seen)) if solid else self._terms
        if seen.second is not None:
            terms = (*terms, second_view)
        if seen.anchor is not None:
            terms = (*terms, near_pose, distance)
        if seen.grip is not None:
            terms = (*terms, grip, near_wrist)
        if shape != "given":
            weight = 1.0 if shape == "each" else 1.0 / min(len(seen), SOLVER.shape_evidence)
            terms = (*terms, Shape(self._betas, self._length_rates, weight, measured=self._measured))
        angle_bounds = self.angle_bounds if seen.anchor is None else None
        return Problem(self.chain, seen, terms, shape, fixed, angle_bounds=angle_bounds)

    def camera_terms(self, count: int) -> tuple[Term, ...]:
        """The residual terms of `count` frames that are used while cameras are looked for, without those of
        the pictures."""
        weight = 1.0 / min(count, SOLVER.shape_evidence)
        terms = (depth, self._limits, self._firm_prior, coupling)
        return (*terms, Shape(self._betas, self._length_rates, weight, measured=self._measured))

    def solve_each(
        self,
        problem: Problem,
        start: State,
        max_iterations: int | None = None,
        tolerance: float | None = None,
        first_damping: float | None = None,
    ) -> Solution:
        """Solve independent frames in batches, starting from `start`. `max_iterations`, `tolerance` and
        `first_damping` are those of `levenberg.solve`, and None for the ones in `SOLVER`."""
        most = SOLVER.max_iterations if max_iterations is None else max_iterations
        if tolerance is None:
            # Fingers that are made to touch have none of `pinned`.
            corrected = problem.seen.pinned is not None or problem.seen.touches is not None
            tolerance = SOLVER.pinned_tolerance if corrected else SOLVER.tolerance

        def solved(rows: slice) -> Solution:
            return solve(
                problem.select(rows),
                start.select(rows),
                max_iterations=most,
                tolerance=tolerance,
                first_damping=first_damping,
            )

        return Solution.collect(len(start), map(solved, slices(len(start), SOLVER.solve_batch)))

    def solve_solid(
        self, seen: Observation, plain: Solution, times: Times | None = None, fixed: FixedJoints | None = None
    ) -> tuple[Observation, Solution]:
        """Fit once more so that parts of a hand do not pass through each other; returns the observation, with
        the self-contact found in it, and the solution.

        `plain`: the solution without these terms, to start from. `times`: when the frames of a clip were
        seen; None: pictures are independent.
        """
        seen = replace(seen, self_contact=find_self_contact(self.surface, seen, plain.state, times))
        rows = []
        for first in range(0, len(plain), SOLVER.chunk_frames):
            chunk = slice(first, first + SOLVER.chunk_frames)
            posed, here = self.chain.pose(plain.state.select(chunk)), seen.select(chunk)
            rows += [first + term(posed, here).hand for term in self._coupling_terms(seen)]
        coupled = np.unique(np.concatenate(rows))
        if not len(coupled):
            return seen, plain
        solid = self.problem(seen, fixed=fixed, solid=True)
        found = self.solve_each(solid.select(coupled), plain.state.select(coupled))
        return seen, plain.replaced(coupled, found)

    def solve_pictures(self, seen: Observation) -> tuple[Observation, Solution]:
        """Solve B pictures of hands independently, each with a shape of its own. Returns the observation with
        the self-contact found in it, and the solution."""
        return self.solve_solid(seen, self.solve_each(self.problem(seen, "each"), self.start(seen)))

    def _coupling_terms(self, seen: Observation) -> tuple[Interpenetration | OrdinalDepth | Contact, ...]:
        """The terms that couple two parts of a hand: interpenetration, order in depth, and contact."""
        ordinal = () if seen.self_contact is None else (self._ordinal_depth,)
        contact = () if seen.self_contact is None and seen.touches is None else (self._contact,)
        return (self._interpenetration, *ordinal, *contact)

    def solve_shape(self, seen: Observation) -> np.ndarray:
        """Return the one shape of all frames, betas (10,). Their poses are solved together with it and
        dropped."""
        alone = self.solve_each(self.problem(seen), self.start(seen)).state
        together = self.problem(seen, "one")
        return solve(
            together, alone, max_iterations=SOLVER.max_iterations, tolerance=SOLVER.tolerance
        ).state.betas[0]


@lru_cache(maxsize=8)
def fitter_of(
    model: HandModel, hand_length: float | None = None, landmarks: Landmarks | None = None
) -> FastFitter:
    """Return the fitter of a model. It is cached, so that an edit while the artist drags does not build it
    again."""
    return FastFitter(model, hand_length, landmarks)


def fit_track(
    smoothing: float,
    model: HandModel,
    track: Track,
    intrinsics: Intrinsics,
    on_frame: OnFrame,
    should_stop: ShouldStop = never,
    hand_length: float | None = None,
) -> HandMotion:
    """Fit a tracked hand with one shape for all frames, and motion as smooth as `smoothing` asks (0: each
    frame by itself).

    Gaps up to `max_gap_seconds` are filled. `should_stop` is asked after every `chunk_frames` frames; frames
    that were not reached are NaN. `hand_length`: the expected metres from wrist joint to the tip of the
    middle finger; None: those of the mean shape.
    """
    fitter = fitter_of(model, hand_length, track.landmarks)
    seen = fitter.observe(track.detections, intrinsics)
    return fit_observed(smoothing, fitter, track, seen, on_frame, should_stop)


@dataclass(frozen=True, eq=False)
class Guess:
    """A first estimate of a clip's hand, and of its errors."""

    state: State
    """N hands, roughly in the right pose, and of their true shape"""
    judged: Observation
    """N hands as one camera sees them, from which `doubt` estimates their errors"""
    error_factor: np.ndarray
    """(N,) factors by which the expected errors are multiplied"""


def fit_observed(
    smoothing: float,
    fitter: FastFitter,
    track: Track,
    seen: Observation,
    on_frame: OnFrame = lambda: None,
    should_stop: ShouldStop = never,
    guess: Guess | None = None,
) -> HandMotion:
    """Fit a tracked hand as `fit_track` does, but to an observation `seen` that was already made of its N
    detections."""
    hands, found, count = track.detections, track.detections.frame, track.frame_count
    # A track's side is voted for by all of its frames.
    side_logit = side_logits(hands, fitter.model.side).mean()
    error_factor = crop_spread_factor(hands)
    cuts = detect_cuts(seen.pixels) | missing_between(found, track.holes)
    if len(found) == 1:
        seen, solution = fitter.solve_pictures(seen)
        frames, state = found, solution.state
    else:
        solution = _clip(fitter, seen, should_stop, guess)
        found = found[: len(solution)]
        cuts = cuts[: len(found) - 1]
        times = Times.between(found, cuts, track.fps)
        seen, solution = fitter.solve_solid(seen.select(slice(len(found))), solution, times)
        frames, state = smooth_track(fitter, seen, solution.state, found, cuts, smoothing, track.fps)
    for _ in found:
        on_frame()
    rows = np.flatnonzero(np.isin(frames, found))
    features = np.empty((len(rows), 5, 6))
    judged = seen if guess is None else guess.judged
    for chunk in slices(len(rows)):
        points = fitter.chain.points(state.select(rows[chunk]))
        features[chunk] = evidence(judged.select(chunk), points, np.full(len(points), side_logit))
    error_factor = error_factor[: len(found)] * lifted_thumb_factor(seen)
    if guess is not None:
        error_factor = error_factor * guess.error_factor[: len(found)]
    del seen, solution
    expected = temporal_mean(expected_error(features, error_factor), Times.between(found, cuts, track.fps))
    betas, orient, pose, transl = fitter.chain.parameters(state)
    return HandMotion(
        side=fitter.model.side,
        betas=betas[0],
        global_orient=scatter(orient, frames, count),
        hand_pose=scatter(pose, frames, count),
        transl=scatter(transl, frames, count),
        doubtful=scatter(doubtful(expected), found, count, False) if track.calibrated else None,
        expected_error=scatter(expected, found, count) if track.calibrated else None,
    )


def _clip(
    fitter: FastFitter, seen: Observation, should_stop: ShouldStop, guess: Guess | None = None
) -> Solution:
    """Fit every frame by itself, all with one common shape; fewer frames when `should_stop` said so."""
    count = len(seen)
    betas = None
    if guess is None:
        chosen = np.linspace(0, count - 1, min(SOLVER.shape_frames, count)).round().astype(int)
        betas = fitter.solve_shape(seen.select(np.unique(chosen)))

    def chunks() -> Iterator[Solution]:
        for rows in slices(count, SOLVER.chunk_frames):
            chunk = seen.select(rows)
            start = fitter.start(chunk, betas) if guess is None else guess.state.select(rows)
            yield fitter.solve_each(fitter.problem(chunk), start)
            if should_stop():
                return

    return Solution.collect(count, chunks())


def _motion_prior(smoothing: float, fps: float) -> MotionPrior:
    """Return the motion prior of a clip of `fps` frames per second: expected accelerations per frame, and how
    many frames two windows share, which are more with stronger smoothing."""
    per_frame = 1.0 / (max(smoothing, 1e-6) * fps**2)
    overlap = int(np.clip(MOTION.overlap_seconds * fps * np.sqrt(max(smoothing, 1.0)), 60, 400))
    return MotionPrior(
        MOTION.rotation_acceleration * per_frame, MOTION.wrist_acceleration * per_frame, overlap
    )


def smooth_track(
    fitter: FastFitter,
    seen: Observation,
    state: State,
    found: np.ndarray,
    cuts: np.ndarray,
    smoothing: float,
    fps: float,
    fixed: FixedJoints | None = None,
    before_each: Callable[[], None] = lambda: None,
) -> tuple[np.ndarray, State]:
    """Interpolate the gaps of a track and smooth its motion, segment by segment.

    Returns the numbers (F,) of the frames that have a hand, and their states. `found`: (N,) numbers of the
    detected frames, of each of which `seen` and `state` have one row; `cuts`: (N - 1,) bool, true where a cut
    lies between two detections. `fixed` has a row for each frame of the clip. `before_each` is called before
    each segment, window and iteration, and may raise to stop.
    """
    motion = _motion_prior(smoothing, fps)
    frames, states = [], []
    for segment in segments(found, fps, cuts):
        before_each()
        known = np.isin(segment, found)
        rows = np.flatnonzero(np.isin(found, segment))
        guess = interpolate_gaps(state.select(slice(rows[0], rows[-1] + 1)), known)
        here = None if fixed is None else fixed.select(segment)
        guess = guess if here is None else here.put(guess)
        if smoothing > 0:
            # Frames without a detection repeat another one's row, which is not used.
            nearest = rows[np.clip(np.cumsum(known) - 1, 0, None)]
            segment_seen = seen.select(slice(rows[0], rows[-1] + 1) if known.all() else nearest)
            segment_seen = replace(segment_seen, depth_sigma=MOTION.depth_factor * segment_seen.depth_sigma)
            problem = fitter.problem(segment_seen, fixed=here, solid=True)
            # A second view sees the distance.
            unknown = segment_seen.anchor is None and segment_seen.depth_zero is None
            if unknown and segment_seen.second is None and len(segment) > 2:
                certain = known & False if here is None else here.joints[:, 0]
                distance_factor = wrist_distance_factors(guess, known, certain, fps, smoothing)
                guess = replace(
                    guess,
                    wrist=guess.wrist * distance_factor[:, None],
                    depth_zero=guess.depth_zero * distance_factor,
                )
                anchor = PoseAnchor.at(guess, MOTION.distance_sigma)
                problem = replace(
                    problem, seen=replace(segment_seen, anchor=anchor), terms=(*problem.terms, distance)
                )
            motion_scale = palm_motion_scale(segment_seen, known, fps)
            guess = smooth_clip(ClipProblem(problem, motion, motion_scale, known, before_each), guess)
        frames.append(segment)
        states.append(guess)
    return np.concatenate(frames), State.concatenate(states)
