"""The report's tables: one for all methods, by group, of paired comparisons, and of published numbers on
EgoDexter and Dexter+Object beside ours, as text for people."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import pandas as pd

from handfit_core.common.skeleton import NUM_KEYPOINTS, TIP_KEYPOINTS
from handfit_core.evaluate.metrics import labelled_points
from handfit_core.evaluate.scores import Comparison, Evaluation, Scores
from handfit_core.evaluate.summary import METRICS, Metric, hand_means, tags_of

MISSING = "–"
"""What stands where there is no number"""
MAX_VALUES = 20
"""A tag with more values than that is a name or a number, not a group"""
VIEWS = ("palm", "back", "edge", "unknown")

_INNER_POINTS = sorted(set(range(NUM_KEYPOINTS)) - set(TIP_KEYPOINTS))
_DIGITS = {"": 3, "%": 1, "ms": 1}
_PAPER_ALIGNMENTS = {
    "epe": "as the paper's code: fingertips; true camera and true mean depth given, centroids made to meet; "
    "the mean of each 'joint', then over 'joints'; misses are left out",
    "auc": "of the same errors' PCK, averaged over 'joints'; misses are left out",
}


@dataclass(frozen=True, eq=False)
class Table:
    """Cells as unescaped text, and what is shown with them."""

    cells: pd.DataFrame
    """Text, under the columns' titles"""
    words: int = 1
    """Columns on the left that hold words; all others hold numbers"""
    best: pd.DataFrame | None = None
    """bool, of the same shape: cells to show bold; None for no such cell"""
    notes: tuple[str, ...] = ()
    """One for each column of numbers, or none"""
    names: tuple[tuple[str, str], ...] = ()
    """Names of methods and what they are, told below"""

    def rows(self) -> list[list[tuple[str, bool]]]:
        """Each row's cells, and whether they are bold."""
        bold = np.zeros(self.cells.shape, dtype=bool) if self.best is None else self.best.to_numpy()
        return [list(zip(*row, strict=True)) for row in zip(self.cells.to_numpy(), bold, strict=True)]

    def titles(self) -> list[tuple[str, int]]:
        """Each column's title and the number of its footnote, 0 for none."""
        first = self.words if self.notes else len(self.cells.columns)
        return [(str(name), max(0, i - first + 1)) for i, name in enumerate(self.cells)]

    def markdown(self) -> str:
        """The table in GitHub's Markdown, names and footnotes as lists below."""
        lines = [
            [_escaped(title) + (f" [{note}]" if note else "") for title, note in self.titles()],
            ["---" if i < self.words else "---:" for i in range(self.cells.shape[1])],
            *([f"**{_escaped(text)}**" if bold else _escaped(text) for text, bold in r] for r in self.rows()),
        ]
        text = "".join(f"| {' | '.join(line)} |\n" for line in lines)
        if self.names:
            text += "\n" + "".join(f"* {_escaped(who)}: {_escaped(what)}\n" for who, what in self.names)
        if self.notes:
            text += "\n" + "".join(f"{i}. {_escaped(note)}\n" for i, note in enumerate(self.notes, 1))
        return text


def _escaped(text: str) -> str:
    """Names of files and tags may hold what Markdown takes for markup."""
    text = " ".join(text.split())
    for character in "\\|<*_`[":
        text = text.replace(character, "\\" + character)
    return text


def text_of(value: float, metric: Metric, *, with_unit: bool = False) -> str:
    """The value with as many digits as it is worth, as in `8.99` or `8.99 mm`; a dash where there is none."""
    if not math.isfinite(value):
        return MISSING
    text = f"{value:.{_DIGITS.get(metric.unit, 2)}f}"
    text = text.replace("-", "−") if float(text) else text.lstrip("-")
    return f"{text} {metric.unit}" if with_unit and metric.unit else text


def count(number: int, thing: str) -> str:
    """`1 picture`, `2 pictures`."""
    return f"{number} {thing}{'' if number == 1 else 's'}"


def methods_of(evaluation: Evaluation) -> tuple[Scores, ...]:
    """All methods but the null baselines, in the order asked for."""
    return tuple(s for s in evaluation.scores if not s.is_baseline)


def focus_of(evaluation: Evaluation) -> Scores | None:
    """The method whose hands the sheets show: the last; None where there is none."""
    return next(reversed(methods_of(evaluation)), None)


def error_metric(evaluation: Evaluation) -> Metric:
    """PA-MPJPE where it was measured on hands with more than fingertips labelled, else EPE.

    A similarity that is free to fit five tips hides most of what is wrong with them.
    """
    measured = any(np.isfinite(s.pa_error).any() for s in methods_of(evaluation))
    inner = any(labelled_points(s.labels_3d)[:, _INNER_POINTS].any() for s in evaluation.scores[:1])
    return METRICS["pa_mpjpe" if measured and inner else "epe"]


def numbers_of(evaluation: Evaluation) -> pd.DataFrame:
    """The summaries: a row for each method, baselines first; a column for each of METRICS, NaN for none."""
    methods = [s.method for s in evaluation.scores]
    return evaluation.summaries.reindex(index=methods, columns=list(METRICS))


def best_method(evaluation: Evaluation, metric: Metric) -> Scores | None:
    """The method with the best value, baselines aside; the first of equals, None where none has one."""
    methods = {s.method: s for s in methods_of(evaluation)}
    values = numbers_of(evaluation).loc[list(methods), metric.key].dropna()
    if values.empty:
        return None
    return methods[str(values.idxmin() if metric.lower_is_better else values.idxmax())]


def metrics_shown(evaluation: Evaluation) -> list[Metric]:
    """The metrics that at least one method has a value of, in the order of display.

    Under the paper's protocol their alignment tells what the paper's code does.
    """
    shown = [METRICS[str(key)] for key in numbers_of(evaluation).dropna(axis="columns", how="all")]
    if evaluation.protocol == "paper":
        shown = [replace(m, alignment=_PAPER_ALIGNMENTS.get(m.key, m.alignment)) for m in shown]
    return shown


def main_table(evaluation: Evaluation) -> Table:
    """One row per method, baselines marked; one column per metric, with its alignment as a footnote.

    The best method of a column is bold. Baselines know the truth and never are.
    """
    metrics, numbers = metrics_shown(evaluation), numbers_of(evaluation)
    judged = [s.method for s in methods_of(evaluation)]
    cells = {"Method": [s.method + (" (baseline)" if s.is_baseline else "") for s in evaluation.scores]}
    best: dict[str, object] = {"Method": False}
    for metric in metrics:
        title = f"{metric.title}{metric.unit and ', ' + metric.unit} {'↓' if metric.lower_is_better else '↑'}"
        cells[title] = [text_of(value, metric) for value in numbers[metric.key]]
        best[title] = _best(numbers.loc[judged, metric.key], metric).reindex(numbers.index, fill_value=False)
    return Table(
        pd.DataFrame(cells),
        best=pd.DataFrame(best, index=numbers.index),
        notes=tuple(f"{metric.title}: {metric.alignment}" for metric in metrics),
        names=tuple(
            (s.method, s.title + (" (knows the truth)" if s.is_baseline else ""))
            for s in evaluation.scores
            if s.title != s.method
        ),
    )


def _best(values: pd.Series, metric: Metric) -> pd.Series:
    """(N,) bool: the values that show as the best one does; none where fewer than two show differently."""
    known = values.dropna()
    texts = values.map(lambda value: text_of(value, metric))
    if texts[known.index].nunique() < 2:
        return pd.Series(False, index=values.index)
    return texts == texts[known.idxmin() if metric.lower_is_better else known.idxmax()]


def groups_of(scores: Scores) -> pd.DataFrame:
    """(N, groups) what each hand's picture is: its view, and every tag with 2 to MAX_VALUES values."""
    tags = tags_of(scores).fillna("").rename(columns={"view": "view (tag)"})
    groups = scores.hands[["view"]].join(tags)
    return groups.loc[:, groups.nunique().between(2, MAX_VALUES)]


def sorted_values(values: pd.Series) -> list[str]:
    """Every value once: views in their own order, everything else by name."""
    return sorted(set(values), key=lambda v: (VIEWS.index(v) if v in VIEWS else -1, v))


def group_table(evaluation: Evaluation) -> Table | None:
    """Hands, detection rate and each method's mean error by group; None where there is no group.

    The error is `error_metric`, averaged over the detected hands of the group.
    """
    methods, metric = methods_of(evaluation), error_metric(evaluation)
    if not methods or (groups := groups_of(methods[0])).empty:
        return None
    # All methods mostly share one detector, and one column then says it.
    detectors = list({s.detected.tobytes(): s for s in reversed(methods)}.values())[::-1]
    rates = pd.DataFrame(
        {"Detected, %" + f" ({d.method})" * (len(detectors) > 1): 100.0 * d.detected for d in detectors}
    )
    errors = pd.DataFrame({f"{s.method}, {metric.unit}": hand_means(s, metric.key) for s in methods})
    cells, best = [], []
    for group, values in groups.items():
        of_group = [frame.groupby(values).mean().loc[sorted_values(values)] for frame in (rates, errors)]
        hands = values.value_counts()[of_group[0].index]
        columns = {"Group": group, "Value": [value or "not said" for value in hands.index]}
        columns |= {"Hands": hands.astype(str).tolist()}
        for means, unit in zip(of_group, (METRICS["detection_rate"], metric), strict=True):
            columns |= {str(name): [text_of(value, unit) for value in means[name]] for name in means}
        cells.append(pd.DataFrame(columns))
        best.append(of_group[1].apply(_best, axis="columns", metric=metric))
    whole = pd.concat(cells, ignore_index=True)
    bold = pd.concat(best, ignore_index=True).reindex(columns=whole.columns, fill_value=False)
    return Table(whole, words=2, best=bold)


def verdict(comparison: Comparison) -> str:
    """`a is 0.36 mm better than b (0.20 to 0.50)`, or that no difference is shown, and on how few units."""
    c, metric = comparison, METRICS[comparison.metric]
    if c.hands == 0:
        return "no hand has a result of both"
    if not (math.isfinite(c.low) and math.isfinite(c.high)):
        return "no interval: only one still or clip has results of both"
    # With fewer stills and clips, a bootstrap interval is too narrow.
    few = f"; only {c.units} stills or clips, so the interval is too narrow" if c.units < 10 else ""
    if not c.is_significant:
        return f"no difference shown ({_interval(c.low, c.high, metric)}{few})"
    better = "better" if (c.difference < 0.0) == metric.lower_is_better else "worse"
    interval = _interval(min(abs(c.low), abs(c.high)), max(abs(c.low), abs(c.high)), metric)
    amount = text_of(abs(c.difference), metric, with_unit=True)
    return f"{c.first} is {amount} {better} than {c.second} ({interval}{few})"


def _interval(low: float, high: float, metric: Metric) -> str:
    return f"{text_of(low, metric)} to {text_of(high, metric)}" if math.isfinite(low + high) else MISSING


def comparison_tables(evaluation: Evaluation) -> list[tuple[Metric, Table]]:
    """Every comparison with its verdict, one table for each metric; `error_metric`'s first."""
    first = error_metric(evaluation).key
    tables: dict[str, list[dict[str, str]]] = {}
    for c in sorted(evaluation.comparisons, key=lambda c: c.metric != first):
        metric = METRICS[c.metric]
        tables.setdefault(c.metric, []).append(
            {
                "Verdict": ("" if c.is_significant else f"{c.first} and {c.second}: ") + verdict(c),
                f"Difference, {metric.unit}": text_of(c.difference, metric),
                "95 % interval": _interval(c.low, c.high, metric),
                "Hands": str(c.hands),
                "Stills and clips": str(c.units),
            }
        )
    return [(METRICS[key], Table(pd.DataFrame(rows))) for key, rows in tables.items()]


SOURCE: Final = "arXiv 2506.11133"
"""Whence the published numbers are, "Monocular 3D Hand Pose Estimation with Implicit Camera Alignment": its
experiments A-H, and the results of others that it lists. Nobody ran them again here."""


EXPERIMENTS: Final = pd.DataFrame(
    [
        ("paper-a", "L-BFGS", "MSE + tips", 17.724, 0.883, 13.985, 0.946),
        ("paper-b", "L-BFGS", "MSE", 19.642, 0.859, 14.859, 0.943),
        ("paper-c", "L-BFGS", "Geman-McClure + tips", 17.729, 0.883, 13.980, 0.946),
        ("paper-d", "L-BFGS", "Geman-McClure", 19.648, 0.859, 14.878, 0.942),
        ("paper-e", "L-BFGS", "Huber + tips", 17.864, 0.882, 13.978, 0.946),
        ("paper-f", "L-BFGS", "Huber", 19.963, 0.855, 15.279, 0.939),
        ("paper-g", "BFGS", "MSE + tips", 17.787, 0.883, 13.975, 0.946),
        ("paper-h", "L-BFGS", "MSE, then anatomical + 2D MSE", 42.833, 0.492, 24.574, 0.784),
    ],
    columns=[
        *("Solver", "Optimiser", "Loss"),
        *("egodexter epe", "egodexter auc", "dexter-object epe", "dexter-object auc"),
    ],
).set_index("Solver", drop=False)
"""The paper's experiments A-H by our names: for each kind of data set EPE in mm and AUC of PCK 20-50 mm"""

OTHERS_AUC: Final[Mapping[str, dict[str, float]]] = {
    "dexter-object": {
        "Zhou 2020": 0.948,
        "DetNet+BMC (other alignment)": 0.948,
        "DetNet+LM+AIK (other alignment)": 0.940,
        "Xiang": 0.912,
        "Zhang": 0.825,
        "Drosakis": 0.764,
        "Boukhayma": 0.763,
        "Iqbal": 0.672,
        "Baek": 0.650,
        "Zimmermann": 0.573,
        "Spurr": 0.511,
        "Mueller": 0.482,
    },
    "egodexter": {
        "DetNet+LM+AIK (other alignment)": 0.937,
        "DetNet+BMC (other alignment)": 0.918,
        "Zhou 2020": 0.811,
        "Boukhayma": 0.674,
        "Drosakis": 0.563,
        "Iqbal": 0.543,
    },
}
"""kind of data set -> method -> AUC of PCK 20-50 mm, as published; curves are not"""


def has_published(evaluation: Evaluation) -> bool:
    """Whether there are published numbers on this data set."""
    return evaluation.kind in OTHERS_AUC


def experiments_table(evaluation: Evaluation) -> Table | None:
    """The paper's A-H beside our runs of the same solvers; None on other data sets."""
    if not has_published(evaluation):
        return None
    cells = EXPERIMENTS[["Solver", "Optimiser", "Loss"]].copy()
    here = numbers_of(evaluation).reindex(EXPERIMENTS.index)
    for key, title, unit in (("epe", "EPE", ", mm"), ("auc", "AUC", "")):
        published = EXPERIMENTS[f"{evaluation.kind} {key}"]
        difference = f"{title}, difference{unit}"
        columns = (f"{title} published{unit}", published), (f"{title} here{unit}", here[key])
        for name, values in (*columns, (difference, here[key] - published)):
            cells[name] = [text_of(value, METRICS[key]) for value in values]
    return Table(cells, words=3)


def others_table(evaluation: Evaluation) -> Table | None:
    """AUC of others' methods and of our best and last, best first, ours bold; None on other data sets."""
    if not has_published(evaluation):
        return None
    chosen = {s.method for s in (best_method(evaluation, METRICS["auc"]), focus_of(evaluation)) if s}
    ours = numbers_of(evaluation).loc[sorted(chosen), "auc"].rename("{}, here".format)
    as_published = {"paper-a, as published": EXPERIMENTS.loc["paper-a", f"{evaluation.kind} auc"]}
    ranked = pd.concat([pd.Series(OTHERS_AUC[evaluation.kind] | as_published), ours])
    ranked = ranked.dropna().sort_values(ascending=False, kind="stable")
    texts = [text_of(value, METRICS["auc"]) for value in ranked]
    cells = pd.DataFrame({"Method": ranked.index, "AUC 20-50 mm": texts})
    return Table(cells, best=pd.DataFrame(dict.fromkeys(cells, ranked.index.isin(ours.index))))


def published_note(evaluation: Evaluation) -> str:
    """What a reader of the published numbers should know."""
    if evaluation.protocol == "paper":
        return f"Published numbers: {SOURCE}. Ours are measured by the same protocol, faults included."
    return (
        f"Published numbers: {SOURCE}, by the paper's protocol. Ours are by the strict one, which counts "
        "misses, so the two do not compare; run again with --protocol paper to compare them."
    )
