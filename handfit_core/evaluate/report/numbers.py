"""Numbers as text, with as many digits as they are worth."""

from __future__ import annotations

import math

from handfit_core.evaluate.report.layout import MISSING
from handfit_core.evaluate.summary import Metric

_DIGITS = {"": 3, "%": 1, "ms": 1}


def digits_of(metric: Metric) -> int:
    """Digits behind the point: three for shares, one for per cent and milliseconds, else two."""
    return _DIGITS.get(metric.unit, 2)


def text_of(value: float, metric: Metric) -> str:
    """The value without its unit; a dash where there is none."""
    if not math.isfinite(value):
        return MISSING
    text = f"{value:.{digits_of(metric)}f}"
    return text.replace("-", "−") if float(text) else text.lstrip("-")


def with_unit(value: float, metric: Metric) -> str:
    """The value with its unit, as in `8.99 mm`."""
    text = text_of(value, metric)
    return f"{text} {metric.unit}" if metric.unit and text != MISSING else text


def count(number: int, thing: str, things: str | None = None) -> str:
    """`1 picture`, `2 pictures`."""
    return f"{number} {thing if number == 1 else things or thing + 's'}"
