"""Timing several things in turn, so that a busy machine slows all of them alike."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np


@dataclass(frozen=True)
class Spread:
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
            seconds: list[float] = []
            for _ in range(contender.calls):
                started = time.perf_counter()
                contender.run(number)
                seconds.append(time.perf_counter() - started)
            timing.rounds.append(seconds)
        on_round(number + 1)
    return timings
