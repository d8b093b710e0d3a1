"""Work in steps: generators that yield between steps and return a result."""

from __future__ import annotations

from collections.abc import Callable, Generator
from typing import Any, TypeVar

_T = TypeVar("_T")
_Said = TypeVar("_Said")


def result_of(steps: Generator[Any, None, _T]) -> _T:
    """Take all steps at once; returns what they return, and raises what they raise."""
    while True:
        try:
            next(steps)
        except StopIteration as stop:
            return stop.value


def retold(steps: Generator[Any, None, _T], tell: Callable[[], _Said]) -> Generator[_Said, None, _T]:
    """The same steps, but after each of them `tell()` is yielded instead; returns what they return."""
    while True:
        try:
            next(steps)
        except StopIteration as stop:
            return stop.value
        yield tell()
