"""Checks of values out of a file or from another process: each must be of its kind and within its range, or
is named.

All raise `Unfit`, whose text is a sentence that its callers put behind the file's or the message's name.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable
from typing import Any, Final, TypeVar

T = TypeVar("T")

LONGEST_PATH: Final = 32_767
"""The most characters of a path on any system (Windows'); Linux's are shorter"""

LARGEST_WHOLE: Final = 2**62
"""The bound below which whole numbers can be subtracted from each other in 64 bits"""


class Unfit(ValueError):
    """A value is not as it must be; the message says which it is, what it must be, and what it is."""


def number(name: str, value: Any, least: float = -math.inf, most: float = math.inf) -> float:
    """Return a value that is a finite number from `least` to `most`. JSON's whole numbers have no limit, and
    true is none."""
    real = isinstance(value, int | float) and not isinstance(value, bool)
    # Before math looks at it, which cannot hold all whole numbers.
    if real and -sys.float_info.max <= value <= sys.float_info.max and least <= value <= most:
        return float(value)
    raise Unfit(f"{name} must be a finite number{_between(least, most)}, not {shortly(value)}")


def whole(name: str, value: Any, least: int = -LARGEST_WHOLE, most: int = LARGEST_WHOLE) -> int:
    """Return a value that is a whole number from `least` to `most`."""
    if isinstance(value, int) and not isinstance(value, bool) and least <= value <= most:
        return value
    raise Unfit(f"{name} must be a whole number{_between(least, most)}, not {shortly(value)}")


def text(name: str, value: Any, longest: int, errors: str = "strict") -> str:
    """Return a value that is a text of at most `longest` characters that UTF-8 can hold, without NUL, which
    ends texts elsewhere."""
    if isinstance(value, str) and len(value) <= longest and "\0" not in value:
        try:
            value.encode("utf-8", errors)
        except UnicodeEncodeError:
            pass
        else:
            return value
    raise Unfit(f"{name} must be a text of at most {longest} characters, not {shortly(value)}")


def path(name: str, value: Any) -> str:
    """Return a value that is a path, also one that Linux has and UTF-8 does not."""
    return text(name, value, LONGEST_PATH, "surrogateescape")


def flag(name: str, value: Any) -> bool:
    """Return a value that is true or false."""
    if isinstance(value, bool):
        return value
    raise Unfit(f"{name} must be true or false, not {shortly(value)}")


def listed(name: str, value: Any, kind: Callable[[str, Any], T]) -> tuple[T, ...]:
    """Return a list as a tuple, after the check `kind` of each entry."""
    if isinstance(value, list | tuple):
        return tuple(kind(name, each) for each in value)
    raise Unfit(f"{name} must be a list, not {shortly(value)}")


def any_text(name: str, value: Any) -> str:
    """Return a value that is a text of any length, also of characters that UTF-8 does not have, as names of
    files may be."""
    if isinstance(value, str):
        return value
    raise Unfit(f"{name} must be a text, not {shortly(value)}")


def list_of(kind: Callable[[str, Any], T]) -> Callable[[str, Any], list[T]]:
    """Make the check of a list from the check of its entries."""
    return lambda name, value: list(listed(name, value, kind))


def dict_of(kind: Callable[[str, Any], T]) -> Callable[[str, Any], dict[str, T]]:
    """Make the check of a JSON object from the check of its values."""

    def read(name: str, value: Any) -> dict[str, T]:
        if isinstance(value, dict):
            return {key: kind(f"{name} of {shortly(key)}", each) for key, each in value.items()}
        raise Unfit(f"{name} must be an object, not {shortly(value)}")

    return read


def or_none(kind: Callable[[str, Any], T]) -> Callable[[str, Any], T | None]:
    """Make a check that takes None as well from a check."""
    return lambda name, value: None if value is None else kind(name, value)


def one_of(*choices: str) -> Callable[[str, Any], Any]:
    """Make the check of a text that must be one of the choices."""

    def read(name: str, value: Any) -> Any:
        if isinstance(value, str) and value in choices:
            return value
        raise Unfit(f"{name} must be {' or '.join(choices)}, not {shortly(value)}")

    return read


def shortly(value: Any) -> str:
    """Return a value as a sentence shows it, whatever it is: without the whole of a long text or list."""
    if isinstance(value, str | bytes):
        value = value[:60]
    elif isinstance(value, list | tuple | dict):
        return f"a {type(value).__name__} of {len(value)}"
    elif isinstance(value, int) and abs(value) > LARGEST_WHOLE:
        return "a number that is too large"
    shown = repr(value)
    return shown if len(shown) <= 60 else f"{shown[:60]}..."


def _between(least: float, most: float) -> str:
    if abs(least) in (math.inf, LARGEST_WHOLE) and abs(most) in (math.inf, LARGEST_WHOLE):
        return ""
    if most in (math.inf, LARGEST_WHOLE):
        return f" of at least {least:g}"
    return f" from {least:g} to {most:g}"
