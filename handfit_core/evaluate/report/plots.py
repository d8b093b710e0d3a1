"""The report's plots."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import matplotlib
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from handfit_core.evaluate.metrics import PCK_THRESHOLDS_MM, auc, labelled_points, mean_of_labelled, pck_curve
from handfit_core.evaluate.report.tables import (
    error_metric,
    focus_of,
    methods_of,
    numbers_of,
    sorted_values,
)
from handfit_core.evaluate.scores import Evaluation, Scores
from handfit_core.evaluate.summary import Metric, hand_means, pck
from handfit_core.files import written_whole
from handfit_core.skeleton import FINGERS, KEYPOINT_NAMES

PA_THRESHOLDS_MM: Final = np.linspace(0.0, 50.0, 101)
"""The range of the PA-PCK plot"""
PA_THRESHOLDS_MM.setflags(write=False)

_COLOURS = (
    *("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9"),
    *("#7f3c8d", "#8c6d31", "#b2182b", "#1b7837", "#4d4d4d", "#17becf"),
)
_MARKERS = "osD^vPX<>*hp"
_SETTINGS: dict[Any, Any] = {
    "svg.hashsalt": "handfit",  # fixed ids, so that the same numbers give the same file
    **{"font.size": 10.0, "figure.figsize": (7.5, 4.2), "lines.markersize": 4.5},
    **{"axes.grid": True, "axes.grid.axis": "y", "axes.axisbelow": True, "grid.color": "#e6e6e6"},
    **{"axes.spines.top": False, "axes.spines.right": False},
    **{"legend.loc": "upper left", "legend.frameon": False, "legend.fontsize": 9},
}

Drawn = tuple[Figure, str, str]
"""A figure, its title and its caption"""


def write_plots(folder: Path, evaluation: Evaluation) -> dict[str, tuple[str, str]]:
    """Write every plot that the evaluation has numbers for, as SVG: file -> title and caption. Raises
    OutputError."""
    plots = {}
    with matplotlib.rc_context():
        matplotlib.rcdefaults()  # whatever the user's matplotlibrc says
        matplotlib.rcParams.update(_SETTINGS)
        for file, draw in (
            ("pck.svg", pck_plot),
            ("pck_pa.svg", pa_pck_plot),
            ("per_joint.svg", joint_plot),
            ("per_view.svg", view_plot),
        ):
            if drawn := draw(evaluation):
                figure, title, caption = drawn
                with written_whole(folder / file) as beside:
                    # No date, so that the same numbers give the same file.
                    figure.savefig(beside, format="svg", bbox_inches="tight", metadata={"Date": None})
                plots[file] = title, caption
    return plots


def pck_plot(evaluation: Evaluation) -> Drawn | None:
    """PCK of the centroid-aligned error at 20-50 mm, every method with its AUC, as the paper's figure."""
    misses = {
        "strict": "Points of missed hands count as wrong.",
        "paper": "The paper's protocol: fingertips of detected hands only.",
    }[evaluation.protocol]
    caption = f"Share of labelled points with an error below a threshold, centroids made to meet. {misses}"
    area = numbers_of(evaluation)["auc"]
    curves = [(s, pck(s, evaluation.protocol), float(area[s.method])) for s in evaluation.scores]
    figure = _curves(evaluation, PCK_THRESHOLDS_MM, curves, "EPE, centroids made to meet (mm)")
    return figure and (figure, "PCK 20-50 mm", caption)


def pa_pck_plot(evaluation: Evaluation) -> Drawn | None:
    """PCK of the similarity-aligned error at 0-50 mm; None where there is none."""
    curves = []
    for s in (s for s in evaluation.scores if np.isfinite(s.pa_error).any()):
        labelled = labelled_points(s.labels_3d).sum(axis=1)
        # A similarity needs four points; a hand with fewer could not have been scored either.
        misses = int(labelled[~s.detected & (labelled >= 4)].sum())
        curve = pck_curve(s.pa_error, PA_THRESHOLDS_MM, misses=misses)
        curves.append((s, curve, auc(curve, PA_THRESHOLDS_MM)))
    figure = _curves(evaluation, PA_THRESHOLDS_MM, curves, "PA error, similarity-aligned (mm)")
    caption = (
        "Share of labelled points with an error below a threshold, after the best similarity transform of "
        "each hand. Points of missed hands count as wrong. AUC over 0-50 mm."
    )
    return figure and (figure, "PA-PCK 0-50 mm", caption)


def joint_plot(evaluation: Evaluation) -> Drawn | None:
    """Mean error of each of the 21 points; None under the paper's protocol, where "joints" mix."""
    methods, metric = methods_of(evaluation), error_metric(evaluation)
    if evaluation.protocol == "paper" or not methods:
        return None
    errors = {s.method: s.pa_error if metric.key == "pa_mpjpe" else s.epe for s in methods}
    means = pd.DataFrame({name: mean_of_labelled(values, axis=0) for name, values in errors.items()})
    known = means.index[means.notna().any(axis="columns")]
    if known.empty:
        return None
    # An empty place, -1, stands between the fingers and interrupts the lines.
    fingers = [[0], *(list(range(1 + 4 * i, 5 + 4 * i)) for i in range(len(FINGERS)))]
    places = [joint for finger in fingers for joint in (-1, *known.intersection(finger))][1:]
    names = {i: KEYPOINT_NAMES[joint].replace("_", " ") for i, joint in enumerate(places) if joint >= 0}
    figure = Figure(figsize=(9.0, 4.2))
    axes = _error_axes(figure, metric, len(places))
    for s in methods:
        axes.plot(means[s.method].reindex(places).to_numpy(), label=s.method, **_style(evaluation, s))
    axes.set_xticks(list(names), list(names.values()), rotation=60, ha="right")
    _finish(axes)
    caption = (
        f"Mean error of each point over detected hands; {metric.alignment.split(';')[0]}. From the palm "
        "outwards, 4 is the fingertip. Baselines are left out."
    )
    return figure, "Error per joint", caption


def view_plot(evaluation: Evaluation) -> Drawn | None:
    """Mean error by how the camera sees the palm; None where no view is known."""
    methods, metric = methods_of(evaluation), error_metric(evaluation)
    if not methods or set(methods[0].hands["view"]) <= {"unknown"}:
        return None
    seen = methods[0].hands["view"]
    views = sorted_values(seen)
    figure = Figure(figsize=(max(5.5, 1.5 + 2.0 * len(views)), 4.2))
    axes = _error_axes(figure, metric, len(views))
    reach = min(0.3, 0.05 * (len(methods) - 1))
    for s, offset in zip(methods, np.linspace(-reach, reach, len(methods)), strict=True):
        means = pd.Series(hand_means(s, metric.key)).groupby(seen).mean()[views]
        style = _style(evaluation, s, linestyle="none", markersize=7)
        axes.plot(np.arange(len(views)) + offset, means, label=s.method, **style)
    axes.set_xticks(range(len(views)), [f"{view}\n{(seen == view).sum()} hands" for view in views])
    _finish(axes)
    caption = (
        f"Mean over detected hands; {metric.alignment.split(';')[0]}. The camera sees the palm, the back of "
        "the hand, or its edge (the palm's plane within 30 degrees of the line of sight)."
    )
    return figure, "Error per view", caption


def _curves(
    evaluation: Evaluation,
    thresholds: np.ndarray,
    curves: Sequence[tuple[Scores, np.ndarray, float]],
    label: str,
) -> Figure | None:
    curves = [curve for curve in curves if np.isfinite(curve[1]).any()]
    if not curves:
        return None
    figure = Figure()
    axes = figure.add_subplot(xlabel=label, ylabel="share of correct points")
    for s, curve, area in curves:
        text = f"{s.method} ({area:.3f})" if math.isfinite(area) else s.method
        axes.plot(thresholds, curve, label=text, **_style(evaluation, s, marker=""))
    axes.set(xlim=(thresholds[0], thresholds[-1]), ylim=(0.0, 1.01))
    _finish(axes, "method (AUC)")
    return figure


def _error_axes(figure: Figure, metric: Metric, places: int) -> Axes:
    name = "PA error" if metric.key == "pa_mpjpe" else "EPE"
    return figure.add_subplot(xlim=(-0.5, places - 0.5), ylabel=f"mean {name} ({metric.unit})")


def _finish(axes: Axes, title: str | None = None) -> None:
    """Errors begin at 0, and a legend stands beside the plot: within, it would hide some curve."""
    axes.set_ylim(bottom=0.0)
    axes.legend(title=title, bbox_to_anchor=(1.02, 1.0), borderaxespad=0.0)


def _style(evaluation: Evaluation, scores: Scores, **other: Any) -> dict[str, Any]:
    """The same look for a method in every plot, but for what is asked to be `other`."""
    group = [s.method for s in evaluation.scores if s.is_baseline == scores.is_baseline]
    i = group.index(scores.method)
    if scores.is_baseline:
        return {"color": "#888888", "linestyle": ("--", ":", "-.")[i % 3], "linewidth": 1.2, **other}
    shown = focus_of(evaluation)
    return {
        "color": _COLOURS[i % len(_COLOURS)],
        "marker": _MARKERS[i % len(_MARKERS)],
        "linestyle": "-" if i < len(_COLOURS) else (0, (5, 1.5)),
        "linewidth": 2.6 if shown and shown.method == scores.method else 1.3,
        **other,
    }
