"""The main table, one row a method, for people (Markdown, HTML) and for programs (CSV)."""

from __future__ import annotations

import csv
import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from handfit_core.evaluate.report.focus import methods_of, value_of
from handfit_core.evaluate.report.layout import Cell, Column, Table, markdown, name
from handfit_core.evaluate.report.numbers import text_of
from handfit_core.evaluate.scores import Evaluation
from handfit_core.evaluate.summary import HAND_METRICS, METRICS, Metric, hand_means
from handfit_core.files import written_whole

_PAPER_ALIGNMENTS = {
    "epe": "as the paper's code: fingertips; true camera and true mean depth given, centroids made to meet; "
    "the mean of each 'joint', then over 'joints'; misses are left out",
    "auc": "of the same errors' PCK, averaged over 'joints'; misses are left out",
}


def metrics_shown(evaluation: Evaluation) -> list[Metric]:
    """The metrics that at least one method has a value of, in the order of display.

    Under the paper's protocol their alignment tells what the paper's code does.
    """
    shown = [
        metric
        for metric in METRICS.values()
        if any(math.isfinite(value_of(evaluation, s.method, metric.key)) for s in evaluation.scores)
    ]
    if evaluation.protocol == "paper":
        shown = [replace(m, alignment=_PAPER_ALIGNMENTS.get(m.key, m.alignment)) for m in shown]
    return shown


def best_methods(evaluation: Evaluation, metric: Metric) -> frozenset[str]:
    """The methods whose value, as shown, is the best of a column.

    Baselines know the truth and are never among them. Empty where fewer than two methods have a value
    or all have the same: then nothing is best.
    """
    values = {
        s.method: value
        for s in methods_of(evaluation)
        if math.isfinite(value := value_of(evaluation, s.method, metric.key))
    }
    texts = {method: text_of(value, metric) for method, value in values.items()}
    if len(set(texts.values())) < 2:
        return frozenset()
    best = (min if metric.lower_is_better else max)(values, key=values.__getitem__)
    return frozenset(method for method, text in texts.items() if text == texts[best])


def main_table(evaluation: Evaluation) -> Table:
    """One row per method, baselines marked; one column per metric, with its alignment as a footnote."""
    metrics = metrics_shown(evaluation)
    best = {metric.key: best_methods(evaluation, metric) for metric in metrics}
    columns = [Column("Method", is_number=False)]
    for i, metric in enumerate(metrics, 1):
        unit = f", {metric.unit}" if metric.unit else ""
        arrow = "↓" if metric.lower_is_better else "↑"
        columns.append(Column(f"{metric.title}{unit} {arrow}", note=i))
    rows = []
    for scores in evaluation.scores:
        cells = [name(scores.method, "(baseline)" if scores.is_baseline else "")]
        for metric in metrics:
            text = text_of(value_of(evaluation, scores.method, metric.key), metric)
            cells.append(Cell(text, is_best=scores.method in best[metric.key]))
        rows.append(tuple(cells))
    return Table(
        columns=tuple(columns),
        rows=tuple(rows),
        notes=tuple(f"{metric.title}: {metric.alignment}" for metric in metrics),
        names=tuple(
            (s.method, s.title + (" (knows the truth)" if s.is_baseline else ""))
            for s in evaluation.scores
            if s.title != s.method
        ),
        muted=frozenset(i for i, s in enumerate(evaluation.scores) if s.is_baseline),
    )


def markdown_table(evaluation: Evaluation) -> str:
    """The main table in Markdown, with the alignments below it; the best method of a column is bold."""
    return markdown(main_table(evaluation))


def write_table_csv(path: Path, evaluation: Evaluation) -> Path:
    """The main table's numbers in full precision, in METRICS's units; empty where there is none.

    Raises OutputError.
    """
    keys = [metric.key for metric in metrics_shown(evaluation)]
    header = ["dataset", "kind", "protocol", "method", "title", "is_baseline", *keys]
    rows = (
        [
            *(evaluation.dataset, evaluation.kind, evaluation.protocol),
            *(s.method, s.title, int(s.is_baseline)),
            *(number(value_of(evaluation, s.method, key)) for key in keys),
        ]
        for s in evaluation.scores
    )
    return write_csv(path, header, rows)


def write_hands_csv(path: Path, evaluation: Evaluation) -> Path:
    """One row per method and labelled hand, with that hand's mean errors, for plots of one's own.

    Raises OutputError.
    """
    tags = sorted({tag for s in evaluation.scores[:1] for row in s.tags for tag in row})
    header = ["method", "sample", "hand", "clip", "time", "view", "detected", *HAND_METRICS]
    header += ["detect_ms", "fit_ms", *(f"tag_{tag}" for tag in tags)]
    return write_csv(path, header, _hand_rows(evaluation, tags))


def _hand_rows(evaluation: Evaluation, tags: Sequence[str]) -> Iterator[list[object]]:
    for s in evaluation.scores:
        errors = [hand_means(s, metric) for metric in HAND_METRICS]
        for i, sample in enumerate(s.samples):
            yield [
                *(s.method, sample, int(s.hands[i]), s.clips[i] or "", number(s.times[i])),
                *(s.views[i], int(s.detected[i])),
                *(number(error[i]) for error in errors),
                *(number(s.detect_ms[i]), number(s.fit_ms[i])),
                *(s.tags[i].get(tag, "") for tag in tags),
            ]


def write_csv(path: Path, header: Sequence[str], rows: Iterable[Sequence[object]]) -> Path:
    """Write a CSV file in UTF-8. Raises OutputError."""
    with written_whole(path) as beside, open(beside, "w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream)
        writer.writerow(header)
        writer.writerows(rows)
    return path


def number(value: float | np.floating) -> str:
    """All digits of a number; empty where there is none."""
    return repr(float(value)) if math.isfinite(value) else ""
