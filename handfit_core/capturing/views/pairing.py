"""Hands of two views paired by their sides, and the cameras that follow from a pairing."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from handfit_core.capturing.options import CaptureOptions
from handfit_core.capturing.views.cameras import Adjusted, CameraPriors, HandPair, adjust
from handfit_core.capturing.views.hands import ViewedHand
from handfit_core.capturing.views.readings import ViewTake
from handfit_core.capturing.views.rig_file import Rig
from handfit_core.capturing.views.sync import OffsetScore, offset_scores
from handfit_core.capturing.views.verdict import rotation_between
from handfit_core.common.batch import slices
from handfit_core.common.skeleton import SIDES, Side
from handfit_core.fit.fast import FastFitter, fitter_of
from handfit_core.fit.observation import Observation
from handfit_core.fit.settings import VIEWS
from handfit_core.fit.terms import reprojection, second_view
from handfit_core.geometry.camera import Intrinsics, PlacedCamera
from handfit_core.hand_model import load_model
from handfit_core.hand_model.chain import State
from handfit_core.hand_model.length import flat_hand_length
from handfit_core.take import Take

HAND_LENGTHS: Final = (0.06, 0.28)
"""metres, between which a measured distance of the cameras may make a hand"""


@dataclass(frozen=True, eq=False)
class PairingAttempt:
    """One way to pair the hands of two views, and the cameras found with it."""

    second: ViewTake
    mirrored: bool
    hands: list[tuple[int, int]]
    """Indices in both takes, of each pair"""
    pairs: list[HandPair]
    priors: CameraPriors
    found: Adjusted
    score: float
    """of the offset; NaN where it was given"""
    dropped: float = 0.0
    """Share of common frames in which the views show different hands"""

    @property
    def cameras(self) -> tuple[Intrinsics, Intrinsics]:
        """Both views' cameras, with the focal lengths that were found."""
        pair = self.pairs[0]
        first, second = (
            replace(lens, fx=float(focal), fy=float(focal) * lens.fy / lens.fx)
            for lens, focal in zip(
                (pair.first.intrinsics, pair.second.intrinsics), self.found.focal, strict=True
            )
        )
        return first, second

    @property
    def common(self) -> int:
        """Frames of the slower view in which both have a hand."""
        return _common(self.pairs, self.found.offset)

    def adjusted(
        self, pairs: list[HandPair], start: Adjusted | None = None, **effort: int
    ) -> Adjusted | None:
        """The cameras found again from `pairs`, from `start` or where they stand now; None where too few
        frames are common."""
        return adjust(pairs, self.found.offset, self.priors, start or self.found, **effort)

    def posed(self, at: int) -> tuple[Observation, State, np.ndarray]:
        """One pair's hand in the N frames of the first view as both cameras see it, its poses solved frame by
        frame, and the root mean squares (N,) of both views' residuals, in sigmas."""
        first, second, fitter = self.pairs[at].first, self.pairs[at].second, self.pairs[at].fitter
        found, (own, other) = self.found, self.cameras
        placed = PlacedCamera(other, found.rotation, found.translation)
        seen = second.in_second_view(first.observed(own), first.sigmas, first.times - found.offset, placed)
        start = first.placed(found.focal[0])
        start = replace(start, betas=np.broadcast_to(found.betas, start.betas.shape))
        state = fitter.solve_each(fitter.problem(seen), start).state
        residual = np.empty(len(state))
        for rows in slices(len(state)):
            posed, here = fitter.chain.pose(state.select(rows)), seen.select(rows)
            squares = [
                np.square(term(posed, here).residual).sum(axis=2) for term in (reprojection, second_view)
            ]
            residual[rows] = np.sqrt(np.concatenate(squares, axis=1).mean(axis=1))
        return seen, state, residual

    @property
    def halves_apart(self) -> float:
        """degrees between the cameras that both halves of the common frames give; NaN where one is too
        short."""
        rotations = []
        for half in (0, 1):
            pairs = []
            for pair in self.pairs:
                rows = pair.common(self.found.offset)
                middle = len(rows) // 2
                pairs.append(pair.at(rows[middle:] if half else rows[:middle]))
            if min(len(pair.first) for pair in pairs) < VIEWS.least_hand_frames:
                return np.nan
            alone = self.adjusted(pairs, frames=VIEWS.start_frames, iterations=VIEWS.start_iterations)
            if alone is None:
                return np.nan
            rotations.append(alone.rotation)
        return rotation_between(*rotations)

    def scaled(self, baseline: float) -> PairingAttempt:
        """Cameras and hands of the size that a measured distance between the cameras, in metres, tells."""
        factor = baseline / max(float(np.linalg.norm(self.found.translation)), 1e-6)
        length = flat_hand_length(self.pairs[0].fitter.model, self.found.betas) * factor
        length = float(np.clip(length, *HAND_LENGTHS))
        pairs = [replace(pair, fitter=fitter_of(pair.fitter.model, length)) for pair in self.pairs]
        again = self.adjusted(pairs, replace(self.found, translation=self.found.translation * factor))
        if again is None:
            return self
        exact = baseline / max(float(np.linalg.norm(again.translation)), 1e-6)
        return replace(self, pairs=pairs, found=replace(again, translation=again.translation * exact))


def attempt_pairing(
    first: ViewTake,
    second: ViewTake,
    options: CaptureOptions,
    rig: Rig | None,
    on_step: Callable[[], None],
    *,
    mirrored: bool,
) -> PairingAttempt | None:
    """The cameras of hands that are paired by their sides; None where nothing is in common."""
    hands: list[tuple[int, int]] = []
    pairs: list[HandPair] = []
    for side in SIDES:
        at = _surest(first.take, side), _surest(second.take, side)
        if at[0] is None or at[1] is None:
            continue
        fitter = fitter_of(load_model(options.model, side), options.hand_length)
        pair = HandPair(fitter, _viewed(fitter, first, at[0]), _viewed(fitter, second, at[1]))
        if min(len(pair.first), len(pair.second)) >= VIEWS.least_hand_frames:
            hands.append((at[0], at[1]))
            pairs.append(pair)
    if not pairs:
        return None
    priors = _priors(first, second, options, rig)
    starts = _starts(pairs, options)
    found = []
    for start in starts:
        on_step()
        adjusted = adjust(
            pairs,
            start.offset,
            priors,
            frames=VIEWS.start_frames if len(starts) > 1 else VIEWS.frames,
        )
        if adjusted is not None and _common(pairs, adjusted.offset) >= min(
            VIEWS.least_frames, 0.5 * _common(pairs, start.offset)
        ):
            found.append((adjusted, start.score))
    if not found:
        return None
    adjusted, score = min(found, key=lambda each: each[0].cost)
    if len(starts) > 1:
        adjusted = adjust(pairs, adjusted.offset, priors, adjusted) or adjusted
    on_step()
    return _drop_mismatches(PairingAttempt(second, mirrored, hands, pairs, priors, adjusted, score))


def _viewed(fitter: FastFitter, clip: ViewTake, hand: int) -> ViewedHand:
    take = clip.take
    return ViewedHand.of(fitter, take.hands[hand], clip.times, take.fps, take.intrinsics)


def _surest(take: Take, side: Side) -> int | None:
    """The index of the take's hand of that side that was seen best."""
    of_side = [i for i, hand in enumerate(take.hands) if hand.side == side and hand.refinable]
    return max(of_side, key=lambda i: float(np.nansum(take.hands[i].score)), default=None)


def _priors(first: ViewTake, second: ViewTake, options: CaptureOptions, rig: Rig | None) -> CameraPriors:
    offset_sigma = None if options.offset is None else VIEWS.told_offset_sigma
    if rig is not None:
        focal = tuple(lens.intrinsics.fx for lens in rig.lenses)
        return CameraPriors(focal, (0.0, 0.0), rig.rotation, rig.translation, offset_sigma)  # type: ignore[arg-type]
    focal, sigma = [], []
    for clip in (first, second):
        camera = clip.take.intrinsics
        focal.append(camera.fx if clip.lens_known else camera.fx * VIEWS.focal_of_assumed)
        sigma.append(VIEWS.known_focal_sigma if clip.lens_known else VIEWS.focal_sigma)
    return CameraPriors(tuple(focal), tuple(sigma), offset_sigma=offset_sigma)


def _starts(pairs: list[HandPair], options: CaptureOptions) -> list[OffsetScore]:
    if options.offset is not None:
        return [OffsetScore(options.offset, np.nan)]
    found = offset_scores(pairs)
    if found and found[0].score >= VIEWS.weak_score:
        return found
    # Fingers that hardly move tell no offset: any that leaves enough in common may be the one.
    rate = min(pairs[0].first.fps, pairs[0].second.fps)
    ends = max(pair.first.times[-1] for pair in pairs), max(pair.second.times[-1] for pair in pairs)
    shorter = min(ends)
    least, most = -ends[1] + VIEWS.least_overlap * shorter, ends[0] - VIEWS.least_overlap * shorter
    count = int(np.clip((most - least) * rate / VIEWS.peaks_apart, 1, VIEWS.most_starts))
    grid = np.linspace(least, most, count + 2)[1:-1]
    return [*found, *(OffsetScore(float(offset), 0.0) for offset in grid)]


def _common(pairs: list[HandPair], offset: float) -> int:
    """Frames of the slower view in which both have a hand."""
    slower = min(1.0, pairs[0].second.fps / pairs[0].first.fps)
    return round(max(len(pair.common(offset)) for pair in pairs) * slower)


def _drop_mismatches(attempt: PairingAttempt) -> PairingAttempt:
    """The cameras found without frames in which the views show different hands."""
    pairs, dropped, total = [], 0, 0
    for at, pair in enumerate(attempt.pairs):
        seen, _, residual = attempt.posed(at)
        assert seen.second is not None
        second, saw = pair.second, seen.second.saw
        other = saw & (residual > VIEWS.different_hand)
        total, dropped = total + int(saw.sum()), dropped + int(other.sum())
        times = pair.first.times[other] - attempt.found.offset
        near = np.abs(second.times[:, None] - times).min(axis=1, initial=np.inf) * second.fps
        left = near > VIEWS.seen_within
        enough = left.sum() >= VIEWS.least_hand_frames
        pairs.append(replace(pair, second=second.select(left)) if enough else pair)
    share = dropped / max(total, 1)
    if not 0.0 < share < VIEWS.most_dropped:
        return attempt
    again = attempt.adjusted(pairs)
    return attempt if again is None else replace(attempt, pairs=pairs, found=again, dropped=share)
