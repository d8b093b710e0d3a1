"""Paired comparisons in words."""

from __future__ import annotations

import math
from pathlib import Path

from handfit_core.evaluate.report.focus import error_metric
from handfit_core.evaluate.report.layout import MISSING, Cell, Column, Table, words
from handfit_core.evaluate.report.numbers import digits_of, text_of, with_unit
from handfit_core.evaluate.report.tables import number, write_csv
from handfit_core.evaluate.scores import Comparison, Evaluation
from handfit_core.evaluate.summary import METRICS, Metric

FEW_UNITS = 10
"""With fewer stills and clips than that, a bootstrap interval is too narrow"""


def verdict(comparison: Comparison) -> str:
    """`a is 0.36 mm better than b (0.20 to 0.50)`, or that no difference is shown, and on how few units."""
    c, metric = comparison, METRICS[comparison.metric]
    if c.hands == 0:
        return "no hand has a result of both"
    if not (math.isfinite(c.low) and math.isfinite(c.high)):
        return "no interval: only one still or clip has results of both"
    few = f"; only {c.units} stills or clips, so the interval is too narrow" if c.units < FEW_UNITS else ""
    if not c.is_significant:
        return f"no difference shown ({_interval(c.low, c.high, digits_of(metric))}{few})"
    is_better = (c.difference < 0.0) == metric.lower_is_better
    low, high = sorted((abs(c.low), abs(c.high)))
    amount = with_unit(abs(c.difference), metric)
    return (
        f"{c.first} is {amount} {'better' if is_better else 'worse'} than {c.second} "
        f"({_interval(low, high, digits_of(metric))}{few})"
    )


def comparison_tables(evaluation: Evaluation) -> list[tuple[Metric, Table]]:
    """Every comparison with its verdict, one table for each metric; `error_metric`'s first."""
    first = error_metric(evaluation)
    keys = sorted(dict.fromkeys(c.metric for c in evaluation.comparisons), key=lambda key: key != first)
    return [(METRICS[key], _table(evaluation, METRICS[key])) for key in keys]


def _table(evaluation: Evaluation, metric: Metric) -> Table:
    columns = (
        *(Column("Verdict", is_number=False), Column(f"Difference, {metric.unit}")),
        *(Column("95 % interval"), Column("Hands"), Column("Stills and clips")),
    )
    rows = []
    for c in evaluation.comparisons:
        if c.metric != metric.key:
            continue
        known = math.isfinite(c.low) and math.isfinite(c.high)
        interval = _interval(c.low, c.high, digits_of(metric)) if known else MISSING
        pair = "" if c.is_significant else f"{c.first} and {c.second}: "
        rows.append(
            (
                *(words(pair + verdict(c)), Cell(text_of(c.difference, metric)), Cell(interval)),
                *(Cell(str(c.hands)), Cell(str(c.units))),
            )
        )
    return Table(columns, tuple(rows))


def write_comparisons_csv(path: Path, evaluation: Evaluation) -> Path:
    """Every comparison in full precision, differences in METRICS's units. Raises OutputError."""
    header = ("metric", "first", "second", "difference", "low", "high", "hands", "units", "is_significant")
    rows = (
        (
            *(c.metric, c.first, c.second, number(c.difference), number(c.low), number(c.high)),
            *(c.hands, c.units, int(c.is_significant)),
        )
        for c in evaluation.comparisons
    )
    return write_csv(path, header, rows)


def _interval(low: float, high: float, digits: int) -> str:
    return f"{low:.{digits}f} to {high:.{digits}f}".replace("-", "−")
