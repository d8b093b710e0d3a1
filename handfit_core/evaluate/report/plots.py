"""The report's plots. They need matplotlib, which is an extra: without it a report has none."""

from __future__ import annotations

import importlib.util
import math
from collections.abc import Callable, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from handfit_core.evaluate.metrics import (
    PCK_THRESHOLDS_MM,
    auc,
    labelled_points,
    mean_of_labelled,
    pck_curve,
)
from handfit_core.evaluate.report.focus import (
    error_metric,
    focus_of,
    methods_of,
    value_of,
)
from handfit_core.evaluate.report.groups import sorted_values
from handfit_core.evaluate.report.published import beside_published, has_published
from handfit_core.evaluate.scores import Evaluation, Scores
from handfit_core.evaluate.summary import METRICS, hand_means, pck
from handfit_core.files import written_whole
from handfit_core.skeleton import FINGERS, KEYPOINT_NAMES

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

PA_THRESHOLDS_MM: Final = np.linspace(0.0, 50.0, 101)
"""The range of the PA-PCK plot"""
PA_THRESHOLDS_MM.setflags(write=False)

INSTALL_HINT: Final = (
    "Plots need matplotlib: python -m pip install matplotlib, then run the same command again."
)

_COLOURS = (
    *("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9"),
    *("#7f3c8d", "#8c6d31", "#b2182b", "#1b7837", "#4d4d4d", "#17becf"),
)
_MARKERS = "osD^vPX<>*hp"
_BASELINE_DASHES = ("--", ":", "-.")


@dataclass(frozen=True)
class Plot:
    """A plot that was written."""

    file: str
    """Its name in the report's folder"""
    title: str
    caption: str


@dataclass(frozen=True)
class _Style:
    colour: str
    marker: str
    dashes: Any
    width: float


def can_plot() -> bool:
    """Whether matplotlib is installed."""
    try:
        return importlib.util.find_spec("matplotlib") is not None
    except (ImportError, ValueError):
        return False


def write_plots(folder: Path, evaluation: Evaluation, focus: str | None = None) -> list[Plot]:
    """Write every plot that the evaluation has numbers for, as SVG. Raises OutputError and OptionError."""
    candidates: list[tuple[str, Callable[[Evaluation, str | None], tuple[Figure, str, str] | None]]] = [
        ("pck.svg", pck_plot),
        ("pck_published.svg", published_pck_plot),
        ("pck_pa.svg", pa_pck_plot),
        ("per_joint.svg", joint_plot),
        ("per_view.svg", view_plot),
    ]
    plots = []
    with _settings():
        for file, draw in candidates:
            drawn = draw(evaluation, focus)
            if drawn is None:
                continue
            figure, title, caption = drawn
            with written_whole(folder / file) as beside:
                # No date, so that the same numbers give the same file.
                figure.savefig(beside, format="svg", bbox_inches="tight", metadata={"Date": None})
            plots.append(Plot(file, title, caption))
    return plots


def pck_plot(evaluation: Evaluation, focus: str | None) -> tuple[Figure, str, str] | None:
    """PCK of the centroid-aligned error at 20-50 mm, every method with its AUC, as the paper's figure."""
    misses = {
        "strict": "Points of missed hands count as wrong.",
        "paper": "The paper's protocol: fingertips of detected hands only.",
    }[evaluation.protocol]
    curves = [
        (s, pck(s, evaluation.protocol), value_of(evaluation, s.method, "auc")) for s in evaluation.scores
    ]
    figure = _curves(evaluation, focus, PCK_THRESHOLDS_MM, curves, "EPE, centroids made to meet (mm)")
    caption = f"Share of labelled points with an error below a threshold, centroids made to meet. {misses}"
    return figure and (figure, "PCK 20-50 mm", caption)


def published_pck_plot(evaluation: Evaluation, focus: str | None) -> tuple[Figure, str, str] | None:
    """Our best and our default, to stand beside others' published AUC; None on other data sets."""
    if not has_published(evaluation):
        return None
    chosen = beside_published(evaluation, focus)
    curves = [(s, pck(s, evaluation.protocol), value_of(evaluation, s.method, "auc")) for s in chosen]
    figure = _curves(evaluation, focus, PCK_THRESHOLDS_MM, curves, "EPE, centroids made to meet (mm)")
    caption = (
        "Our best method, and the one in focus where that is another. Others published the area under "
        "their curve, not the curve: the table has them."
    )
    return figure and (figure, "Against published results", caption)


def pa_pck_plot(evaluation: Evaluation, focus: str | None) -> tuple[Figure, str, str] | None:
    """PCK of the similarity-aligned error at 0-50 mm; None where there is none."""
    curves = []
    for s in evaluation.scores:
        labelled = labelled_points(s.labels_3d).sum(axis=1)
        # A similarity needs four points; a hand with fewer could not have been scored either.
        misses = int(labelled[~s.detected & (labelled >= 4)].sum())
        if np.isfinite(s.pa_error).any():
            curve = pck_curve(s.pa_error, PA_THRESHOLDS_MM, misses=misses)
            curves.append((s, curve, auc(curve, PA_THRESHOLDS_MM)))
    figure = _curves(evaluation, focus, PA_THRESHOLDS_MM, curves, "PA error, similarity-aligned (mm)")
    caption = (
        "Share of labelled points with an error below a threshold, after the best similarity transform of "
        "each hand. Points of missed hands count as wrong. AUC over 0-50 mm."
    )
    return figure and (figure, "PA-PCK 0-50 mm", caption)


def joint_plot(evaluation: Evaluation, focus: str | None) -> tuple[Figure, str, str] | None:
    """Mean error of each of the 21 points; None under the paper's protocol, where "joints" mix."""
    methods = methods_of(evaluation)
    if evaluation.protocol == "paper" or not methods:
        return None
    metric = METRICS[error_metric(evaluation)]
    means = {s.method: mean_of_labelled(_errors(s, metric.key), axis=0) for s in methods}
    known = np.any([np.isfinite(m) for m in means.values()], axis=0)
    if not known.any():
        return None
    figure, axes = _figure(9.0)
    joints = np.flatnonzero(known)
    place = {int(joint): i for i, joint in enumerate(joints)}
    fingers = [[0], *(list(range(1 + 4 * i, 5 + 4 * i)) for i in range(len(FINGERS)))]
    for s in methods:
        style = _style(evaluation, focus, s)
        for i, finger in enumerate(fingers):
            shown = [joint for joint in finger if joint in place]
            axes.plot(
                [place[joint] for joint in shown],
                means[s.method][shown],
                color=style.colour,
                marker=style.marker,
                markersize=4.5,
                linewidth=style.width,
                label=s.method if i == 0 else None,
                clip_on=False,
            )
    for finger in fingers[1:]:
        starts = [place[joint] for joint in finger if joint in place]
        if starts and starts[0] > 0 and len(joints) > len(FINGERS) + 1:
            axes.axvline(starts[0] - 0.5, color="#dddddd", linewidth=0.8)
    axes.set_xticks(
        range(len(joints)), [KEYPOINT_NAMES[j].replace("_", " ") for j in joints], rotation=60, ha="right"
    )
    axes.set_xlim(-0.5, len(joints) - 0.5)
    axes.set_ylim(bottom=0.0)
    axes.set_ylabel(f"mean {_short(metric.key)} ({metric.unit})")
    _legend(axes)
    caption = (
        f"Mean error of each point over detected hands; {metric.alignment.split(';')[0]}. From the palm "
        "outwards, 4 is the fingertip. Baselines are left out."
    )
    return figure, "Error per joint", caption


def view_plot(evaluation: Evaluation, focus: str | None) -> tuple[Figure, str, str] | None:
    """Mean error by how the camera sees the palm; None where no view is known."""
    methods = methods_of(evaluation)
    if not methods or set(methods[0].views) <= {"unknown"}:
        return None
    metric = METRICS[error_metric(evaluation)]
    views = sorted_values(methods[0].views)
    members = [np.array([v == view for v in methods[0].views]) for view in views]
    figure, axes = _figure(max(5.5, 1.5 + 2.0 * len(views)))
    reach = min(0.3, 0.05 * (len(methods) - 1))
    offsets = np.linspace(-reach, reach, len(methods))
    for s, offset in zip(methods, offsets, strict=True):
        style = _style(evaluation, focus, s)
        errors = hand_means(s, metric.key)
        axes.plot(
            np.arange(len(views)) + offset,
            [float(mean_of_labelled(errors[member])) for member in members],
            color=style.colour,
            marker=style.marker,
            markersize=7,
            linestyle="none",
            label=s.method,
        )
    for i in range(1, len(views)):
        axes.axvline(i - 0.5, color="#dddddd", linewidth=0.8)
    labels = [f"{view}\n{int(m.sum())} hands" for view, m in zip(views, members, strict=True)]
    axes.set_xticks(range(len(views)), labels)
    axes.set_xlim(-0.5, len(views) - 0.5)
    axes.set_ylim(bottom=0.0)
    axes.set_ylabel(f"mean {_short(metric.key)} ({metric.unit})")
    _legend(axes)
    caption = (
        f"Mean over detected hands; {metric.alignment.split(';')[0]}. The camera sees the palm, the back of "
        "the hand, or its edge (the palm's plane within 30 degrees of the line of sight)."
    )
    return figure, "Error per view", caption


def _curves(
    evaluation: Evaluation,
    focus: str | None,
    thresholds: np.ndarray,
    curves: Sequence[tuple[Scores, np.ndarray, float]],
    label: str,
) -> Figure | None:
    curves = [curve for curve in curves if np.isfinite(curve[1]).any()]
    if not curves:
        return None
    figure, axes = _figure(7.5)
    for s, curve, area in curves:
        style = _style(evaluation, focus, s)
        text = f"{s.method} ({area:.3f})" if math.isfinite(area) else s.method
        axes.plot(
            thresholds, curve, color=style.colour, linestyle=style.dashes, linewidth=style.width, label=text
        )
    axes.set_xlim(thresholds[0], thresholds[-1])
    axes.set_ylim(0.0, 1.01)
    axes.set_xlabel(label)
    axes.set_ylabel("share of correct points")
    _legend(axes, "method (AUC)")
    return figure


def _errors(scores: Scores, metric: str) -> np.ndarray:
    return scores.pa_error if metric == "pa_mpjpe" else scores.epe


def _short(metric: str) -> str:
    return "PA error" if metric == "pa_mpjpe" else "EPE"


def _style(evaluation: Evaluation, focus: str | None, scores: Scores) -> _Style:
    """The same look for a method in every plot."""
    group = [s.method for s in evaluation.scores if s.is_baseline == scores.is_baseline]
    i = group.index(scores.method)
    if scores.is_baseline:
        return _Style("#888888", "", _BASELINE_DASHES[i % len(_BASELINE_DASHES)], 1.2)
    shown = focus_of(evaluation, focus)
    is_focus = shown is not None and shown.method == scores.method
    dashes = "-" if i < len(_COLOURS) else (0, (5, 1.5))
    marker = _MARKERS[i % len(_MARKERS)]
    return _Style(_COLOURS[i % len(_COLOURS)], marker, dashes, 2.6 if is_focus else 1.3)


def _figure(width: float) -> tuple[Figure, Axes]:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, 4.2))
    axes = figure.add_subplot()
    axes.grid(axis="y", color="#e6e6e6", linewidth=0.8)
    axes.set_axisbelow(True)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    return figure, axes


def _legend(axes: Axes, title: str | None = None) -> None:
    """A legend beside the plot: within, it would hide some curve."""
    axes.legend(
        title=title,
        fontsize=9,
        frameon=False,
        loc="upper left",
        bbox_to_anchor=(1.02, 1.0),
        borderaxespad=0.0,
    )


@contextmanager
def _settings():
    """Our settings for the time of drawing, whatever the user's matplotlibrc says."""
    import matplotlib

    with matplotlib.rc_context():
        matplotlib.rcdefaults()
        # Fixed ids, so that the same numbers give the same file.
        matplotlib.rcParams.update({"svg.hashsalt": "handfit", "font.size": 10.0})
        yield
