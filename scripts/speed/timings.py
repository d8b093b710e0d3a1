"""Timing in turns, which a busy machine slows alike: solvers with each other, captures with detection."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from handfit_core.detect.keypoints import Detections, Track
from handfit_core.detect.tracks import link_tracks
from handfit_core.detection import detect_frames
from handfit_core.fit.doubt import (
    crop_spread_factor,
    doubtful,
    evidence,
    expected_error,
    lifted_thumb_factor,
    side_logits,
)
from handfit_core.fit.fast import fitter_of
from handfit_core.geometry.camera import Intrinsics
from handfit_core.hand_model import HandModel, load_model
from handfit_core.media.frame_range import FrameRange
from handfit_core.media.opening import open_media
from handfit_core.options import CaptureOptions
from handfit_core.pipeline import capture
from handfit_core.solvers import get_solver

_CALLS = 20
"""One frame alone is over in milliseconds: so many calls a round, and fewer for batches"""


class Spread(NamedTuple):
    """A median and how far the measurements lie apart."""

    median: float
    low: float
    """first quartile; of ratios, the lowest"""
    high: float
    """third quartile; of ratios, the highest"""

    @classmethod
    def of(cls, values: Sequence[float] | np.ndarray, *, extremes: bool = False) -> Spread:
        """Median and quartiles, or median and extremes."""
        low, median, high = np.percentile(values, [0, 50, 100] if extremes else [25, 50, 75])
        return cls(float(median), float(low), float(high))


@dataclass(frozen=True, eq=False)
class Contender:
    """Something to be timed."""

    name: str
    run: Callable[[int], object]
    """Called with the number of the round, from 0"""
    frames: int = 1
    """Frames that one call does"""
    calls: int = 1
    """Calls in a row per round: more for what is quick"""


@dataclass(frozen=True, eq=False)
class Timing:
    """What one contender took."""

    name: str
    frames: int
    rounds: list[list[float]] = field(default_factory=list)
    """seconds of every call, per round"""

    @property
    def seconds_per_frame(self) -> Spread:
        """Over all calls of all rounds."""
        return Spread.of(np.concatenate(self.rounds) / self.frames)

    def times_faster_than(self, other: Timing) -> Spread:
        """How many frames this does in the time of one of the other's: the medians' ratio of each round,
        as what slows the machine for a while slows both; with extremes over the rounds."""
        ratios = [
            (np.median(theirs) / other.frames) / (np.median(ours) / self.frames)
            for ours, theirs in zip(self.rounds, other.rounds, strict=True)
        ]
        return Spread.of(ratios, extremes=True)


def interleaved(
    contenders: Sequence[Contender], rounds: int, on_round: Callable[[int], None] = lambda _: None
) -> list[Timing]:
    """Time all contenders once per round: A B C, A B C, ...; a round before the first is not counted.

    `on_round` is called with the number of rounds done. Returns one `Timing` per contender, in order.
    """
    timings = [Timing(c.name, c.frames) for c in contenders]
    for contender in contenders:
        contender.run(0)
    for number in range(rounds):
        for contender, timing in zip(contenders, timings, strict=True):
            clock = [time.perf_counter()]
            for _ in range(contender.calls):
                contender.run(number)
                clock.append(time.perf_counter())
            timing.rounds.append(np.diff(clock).tolist())
        on_round(number + 1)
    return timings


@dataclass(frozen=True, eq=False)
class Hand:
    """The hand that is seen in most frames of an input, and what is needed to fit it."""

    model: HandModel
    detections: Detections
    intrinsics: Intrinsics
    fps: float

    def batch(self, size: int) -> Detections:
        """`size` detections: those that there are, again and again."""
        return self.detections.select(np.arange(size) % len(self.detections))

    def single(self, index: int) -> Track:
        """One frame as a track of its own, as a photo gives."""
        one = replace(self.detections.select(np.array([index])), frame=np.zeros(1, dtype=int))
        return Track(self.model.side, one, frame_count=1, fps=self.fps)

    def fast_quality(self) -> tuple[float, float]:
        """Shares of the fast solver's fits that converged and that it doubts, over all detections."""
        fitter = fitter_of(self.model)
        seen, solution = fitter.solve_pictures(fitter.observe(self.detections, self.intrinsics))
        logits = side_logits(self.detections, self.model.side)
        features = evidence(seen, fitter.chain.points(solution.state), logits)
        factor = crop_spread_factor(self.detections) * lifted_thumb_factor(seen)
        doubted = doubtful(expected_error(features, factor))
        return float(solution.converged.mean()), float(doubted.mean())


def find_hand(source: str, frames: FrameRange | None = None, model: str | None = None) -> Hand:
    """Detect an input's hands and keep the one seen most. Raises HandfitError."""
    media = open_media(source, frames)
    found = detect_frames(media, CaptureOptions(processes=1))
    tracks = link_tracks(found.hands, len(found.numbers))
    track = max(tracks, key=lambda t: len(t.detections))
    return Hand(
        model=load_model(model, track.side),
        detections=track.detections,
        intrinsics=Intrinsics.assumed(media.width, media.height),
        fps=media.fps,
    )


def time_solvers(
    hand: Hand,
    slow: Sequence[str],
    batches: Sequence[int],
    rounds: int,
    on_round: Callable[[int], None] = lambda _: None,
) -> list[Timing]:
    """Time the fast solver alone and in batches, and `slow` solvers by name, in turn.

    In one round all that take one frame take the same, and rounds take frames evenly spread over the
    clip. Batches are of independent frames, each with its own shape. Raises OptionError for a solver that
    does not exist.
    """
    frames = np.linspace(0, len(hand.detections) - 1, rounds).round().astype(int)

    def alone(solver: str) -> Callable[[int], object]:
        solve = get_solver(solver)
        return lambda number: solve(hand.model, hand.single(frames[number]), hand.intrinsics, lambda: None)

    def batch(size: int) -> Callable[[int], object]:
        fitter, detections = fitter_of(hand.model), hand.batch(size)
        return lambda _: fitter.solve_pictures(fitter.observe(detections, hand.intrinsics))

    contenders = [
        *(Contender(name, alone(name)) for name in slow),
        Contender("fast, one frame", alone("fast"), calls=_CALLS),
        *(Contender(f"fast, batch of {n}", batch(n), n, max(1, _CALLS // n)) for n in batches),
    ]
    return interleaved(contenders, rounds, on_round)


def time_pipeline(
    source: str,
    frames: FrameRange | None,
    rounds: int,
    model: str | None = None,
    on_round: Callable[[int], None] = lambda _: None,
) -> list[Timing]:
    """Time reading and detecting an input, and capturing it from the file to the take, in turn.

    Both open the input and the detector anew each time, as a user's run does. Raises HandfitError.
    """

    def detect(_: int) -> int:
        media = open_media(source, frames)
        return len(detect_frames(media, CaptureOptions(processes=1)).numbers)

    def whole(_: int) -> object:
        return capture(source, model=model, frames=frames)

    count = detect(0)
    contenders = Contender("detection alone", detect, count), Contender("whole pipeline", whole, count)
    return interleaved(contenders, rounds, on_round)
