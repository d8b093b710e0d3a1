"""The report's plots."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import matplotlib
import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from handfit_core.common.files import written_whole
from handfit_core.common.skeleton import FINGERS, KEYPOINT_NAMES
from handfit_core.evaluate.metrics import PCK_THRESHOLDS_MM, auc, labelled_points, mean_of_labelled, pck_curve
from handfit_core.evaluate.report.tables import (
    error_metric,
    focus_of,
    methods_of,
)
from handfit_core.evaluate.scores import Evaluation, Scores
from handfit_core.evaluate.summary import pck

PA_THRESHOLDS_MM: Final = np.linspace(0.0, 50.0, 101)
"""The range of the PA-PCK plot"""
PA_THRESHOLDS_MM.setflags(write=False)

_SETTINGS: dict[Any, Any] = {
    "svg.hashsalt": "handfit",  # fixed ids, so that the same numbers give the same file
    **{"axes.grid": True, "axes.grid.axis": "y", "axes.axisbelow": True, "grid.color": "#e6e6e6"},
    **{"axes.spines.top": False, "axes.spines.right": False, "legend.frameon": False},
}

Drawn = tuple[Figure, str, str]
"""A figure, its title and its caption"""
Line = tuple[Scores, np.ndarray, np.ndarray, str]
"""A method with its x and y, and what the legend says of it"""


def write_plots(folder: Path, evaluation: Evaluation) -> dict[str, tuple[str, str]]:
    """Write every plot that the evaluation has numbers for, as SVG: file -> title and caption. Raises
    OutputError."""
    drawn = {}
    # Whatever the user's matplotlibrc says.
    with matplotlib.rc_context():
        matplotlib.rcdefaults()
        matplotlib.rcParams.update(_SETTINGS)
        for file, draw in (("pck.svg", pck_plot), ("pck_pa.svg", pa_pck_plot), ("per_joint.svg", joint_plot)):
            if made := draw(evaluation):
                figure, *drawn[file] = made
                with written_whole(folder / file) as beside:
                    # No date, so that the same numbers give the same file.
                    figure.savefig(beside, format="svg", bbox_inches="tight", metadata={"Date": None})
    return drawn


def pck_plot(evaluation: Evaluation) -> Drawn | None:
    """PCK of the centroid-aligned error at 20-50 mm, every method with its AUC, as the paper's figure."""
    misses = {
        "strict": "Points of missed hands count as wrong.",
        "paper": "The paper's protocol: fingertips of detected hands only.",
    }[evaluation.protocol]
    curves = [(s, pck(s, evaluation.protocol)) for s in evaluation.scores]
    figure = _curves(evaluation, PCK_THRESHOLDS_MM, curves, "EPE, centroids made to meet (mm)")
    caption = f"Share of labelled points with an error below a threshold, centroids made to meet. {misses}"
    return figure and (figure, "PCK 20-50 mm", caption)


def pa_pck_plot(evaluation: Evaluation) -> Drawn | None:
    """PCK of the similarity-aligned error at 0-50 mm; None where there is none."""
    curves = []
    for s in (s for s in evaluation.scores if np.isfinite(s.pa_error).any()):
        labelled = labelled_points(s.labels_3d).sum(axis=1)
        # A similarity needs four points; a hand with fewer could not have been scored either.
        misses = int(labelled[~s.detected & (labelled >= 4)].sum())
        curves.append((s, pck_curve(s.pa_error, PA_THRESHOLDS_MM, misses=misses)))
    figure = _curves(evaluation, PA_THRESHOLDS_MM, curves, "PA error, similarity-aligned (mm)")
    caption = (
        "Share of labelled points with an error below a threshold, after the best similarity transform of "
        "each hand. Points of missed hands count as wrong. AUC over 0-50 mm."
    )
    return figure and (figure, "PA-PCK 0-50 mm", caption)


def _curves(
    evaluation: Evaluation, thresholds: np.ndarray, curves: Sequence[tuple[Scores, np.ndarray]], label: str
) -> Figure | None:
    lines: list[Line] = [
        (s, thresholds, curve, f"{s.method} ({auc(curve, thresholds):.3f})")
        for s, curve in curves
        if np.isfinite(curve).any()
    ]
    limits = {"xlim": (thresholds[0], thresholds[-1]), "ylim": (0.0, 1.01)}
    axes = {"xlabel": label, "ylabel": "share of correct points", **limits}
    return _figure(evaluation, lines, axes, 7.5, title="method (AUC)") if lines else None


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
    joints = [joint for finger in fingers for joint in (-1, *known.intersection(finger))][1:]
    ticks = {i: KEYPOINT_NAMES[joint].replace("_", " ") for i, joint in enumerate(joints) if joint >= 0}
    places = np.arange(len(joints))
    lines = [(s, places, means[s.method].reindex(joints).to_numpy(), s.method) for s in methods]
    caption = (
        f"Mean error of each point over detected hands; {metric.alignment.split(';')[0]}. From the palm "
        "outwards, 4 is the fingertip. Baselines are left out."
    )
    error = {"ylabel": f"mean {'PA error' if metric.key == 'pa_mpjpe' else 'EPE'} ({metric.unit})"}
    figure = _figure(evaluation, lines, error, 9.0, marker="o")
    figure.axes[0].set_xticks(list(ticks), list(ticks.values()), rotation=60, ha="right")
    return figure, "Error per joint", caption


def _figure(
    evaluation: Evaluation,
    lines: Sequence[Line],
    axes: dict[str, Any],
    width: float,
    title: str | None = None,
    **style: Any,
) -> Figure:
    """Lines with the same look for a method in every plot. Errors begin at 0, and a legend stands beside the
    plot: within, it would hide some curve."""
    figure = Figure(figsize=(width, 4.2))
    drawn = figure.add_subplot(**axes)
    judged = [s.method for s in evaluation.scores if not s.is_baseline]
    for s, x, y, label in lines:
        look: dict[str, Any] = {"color": "#888888", "linestyle": "--", "linewidth": 1.2}
        if not s.is_baseline:
            i, chosen = judged.index(s.method), focus_of(evaluation)
            look = {"color": f"C{i}", "linestyle": ("-", "--", ":")[i // 10 % 3], "linewidth": 1.3}
            look |= {"linewidth": 2.6} if chosen and chosen.method == s.method else {}
        drawn.plot(x, y, label=label, **look | style)
    drawn.set_ylim(bottom=0.0)
    drawn.legend(title=title, bbox_to_anchor=(1.02, 1.0), borderaxespad=0.0, loc="upper left")
    return figure
