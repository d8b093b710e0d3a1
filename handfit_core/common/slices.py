"""Work in steps, so that a window stays alive: generators that yield between steps and return a result."""

from __future__ import annotations

import time
from collections.abc import Callable, Generator
from typing import Any, Final, TypeVar

_T = TypeVar("_T")
_Value = TypeVar("_Value")

SLICE: Final = 0.008
"""seconds after which a slice of work ends, when its last step is over"""


def slice_clock(seconds: float = SLICE) -> Callable[[], bool]:
    """Start a clock for a slice of so many seconds; the returned function tells whether the slice is over."""
    until = time.perf_counter() + seconds
    return lambda: time.perf_counter() > until


def run_to_completion(steps: Generator[Any, None, _T]) -> _T:
    """Exhaust a generator of steps; returns its result."""
    while True:
        try:
            next(steps)
        except StopIteration as stop:
            return stop.value


def map_yields(steps: Generator[Any, None, _T], value: Callable[[], _Value]) -> Generator[_Value, None, _T]:
    """Yield `value()` after each of the steps instead of what they yield; returns their result."""
    while True:
        try:
            next(steps)
        except StopIteration as stop:
            return stop.value
        yield value()
