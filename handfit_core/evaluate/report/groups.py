"""Errors by what is known of a picture: the view of the palm, and the data set's tags."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from handfit_core.evaluate.metrics import mean_of_labelled
from handfit_core.evaluate.report.focus import error_metric, methods_of
from handfit_core.evaluate.report.layout import Cell, Column, Table, name, words
from handfit_core.evaluate.report.numbers import text_of
from handfit_core.evaluate.scores import Evaluation, Scores
from handfit_core.evaluate.summary import METRICS, hand_means

MAX_VALUES = 20
"""A tag with more values than that is a name or a number, not a group"""

VIEWS = ("palm", "back", "edge", "unknown")


def groups_of(scores: Scores) -> dict[str, tuple[str, ...]]:
    """Group name -> (N,) value of each hand, for `view` and every tag with 2 to MAX_VALUES values."""
    keys = dict.fromkeys(key for row in scores.tags for key in row)
    groups = {"view": scores.views}
    groups |= {
        ("view (tag)" if key == "view" else key): tuple(row.get(key, "") for row in scores.tags)
        for key in keys
    }
    return {key: values for key, values in groups.items() if 2 <= len(set(values)) <= MAX_VALUES}


def sorted_values(values: Sequence[str]) -> list[str]:
    """Every value once: views in their own order, everything else by name."""
    return sorted(set(values), key=lambda v: (VIEWS.index(v) if v in VIEWS else -1, v))


def group_table(evaluation: Evaluation) -> Table | None:
    """Hands, detection rate and each method's mean error by group; None where there is no group.

    The error is `error_metric`, averaged over the detected hands of the group.
    """
    methods = methods_of(evaluation)
    groups = groups_of(evaluation.scores[0]) if evaluation.scores else {}
    if not methods or not groups:
        return None
    metric = METRICS[error_metric(evaluation)]
    rate = METRICS["detection_rate"]
    # All methods mostly share one detector, and one column then says it.
    detectors = list({s.detected.tobytes(): s for s in reversed(methods)}.values())[::-1]
    errors = [hand_means(s, metric.key) for s in methods]
    columns = [Column("Group", is_number=False), Column("Value", is_number=False), Column("Hands")]
    columns += [Column("Detected, %" + (f" ({d.method})" if len(detectors) > 1 else "")) for d in detectors]
    columns += [Column(f"{s.method}, {metric.unit}") for s in methods]
    rows = []
    for group, values in groups.items():
        for value in sorted_values(values):
            member = np.array([v == value for v in values])
            means = [float(mean_of_labelled(error[member])) for error in errors]
            texts = [text_of(mean, metric) for mean in means]
            known = [mean for mean in means if not np.isnan(mean)]
            best = text_of(min(known), metric) if len(set(texts)) > 1 and known else None
            rows.append(
                (
                    *(name(group), words(value or "not said"), Cell(str(int(member.sum())))),
                    *(Cell(text_of(100.0 * float(d.detected[member].mean()), rate)) for d in detectors),
                    *(Cell(text, is_best=text == best) for text in texts),
                )
            )
    return Table(tuple(columns), tuple(rows))
