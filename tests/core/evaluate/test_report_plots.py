"""Plots hold the numbers that they claim to."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from handfit_core.evaluate.report import plots
from handfit_core.evaluate.summary import pck
from handfit_core.skeleton import TIP_KEYPOINTS
from tests.core.evaluate.reports import make_evaluation

pytest.importorskip("matplotlib", reason="plots need matplotlib, an extra")


def lines_of(drawn) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    assert drawn is not None
    (axes,) = drawn[0].axes
    return {
        line.get_label().split(" ")[0]: (np.asarray(line.get_xdata()), np.asarray(line.get_ydata()))
        for line in axes.lines
        if not line.get_label().startswith("_")
    }


def test_pck_curves_count_misses_and_legends_tell_the_auc(tmp_path: Path) -> None:
    evaluation = make_evaluation(tmp_path, missed=(0, 1, 2))
    drawn = plots.pck_plot(evaluation, None)
    lines = lines_of(drawn)
    assert list(lines) == ["null-truth", "good", "poor"]
    assert lines["null-truth"][1].min() == 1.0
    assert lines["good"][1].max() == 0.5  # half of the hands were missed
    np.testing.assert_allclose(lines["poor"][1], pck(evaluation.scores[2], "strict"))
    assert drawn is not None
    legend = drawn[0].axes[0].get_legend()
    assert legend is not None
    texts = [text.get_text() for text in legend.get_texts()]
    assert texts[1] == f"good ({evaluation.summaries['good']['auc']:.3f})"


def test_pa_curve_against_counting(tmp_path: Path) -> None:
    evaluation = make_evaluation(tmp_path, missed=(1,))
    x, y = lines_of(plots.pa_pck_plot(evaluation, None))["poor"]
    errors = evaluation.scores[2].pa_error
    at = 20
    assert x[at] == 10.0
    assert y[at] == pytest.approx(np.sum(errors <= 10.0) / errors.size)  # a miss is no hit: NaN <= 10 is not


def test_joint_plot_shows_each_labelled_joint(tmp_path: Path) -> None:
    evaluation = make_evaluation(tmp_path)
    drawn = plots.joint_plot(evaluation, None)
    assert drawn is not None
    (axes,) = drawn[0].axes
    assert len(axes.get_xticks()) == 21
    # Six pieces per method: the wrist and five fingers.
    assert len(axes.lines) == 2 * 6 + 5  # and a rule before each finger
    shown = np.concatenate([np.asarray(line.get_ydata()) for line in axes.lines])
    np.testing.assert_allclose(np.sort(shown)[-1], np.nanmean(evaluation.scores[2].pa_error, axis=0).max())


def test_joint_plot_of_tips_alone_and_of_no_joints(tmp_path: Path) -> None:
    evaluation = make_evaluation(tmp_path)
    others = np.setdiff1d(np.arange(21), TIP_KEYPOINTS)
    tips = []
    for s in evaluation.scores:
        labels, epe = s.labels_3d.copy(), s.epe.copy()
        labels[:, others], epe[:, others] = np.nan, np.nan
        tips.append(replace(s, labels_3d=labels, epe=epe))
    drawn = plots.joint_plot(replace(evaluation, scores=tuple(tips)), None)
    assert drawn is not None
    ticks = [text.get_text() for text in drawn[0].axes[0].get_xticklabels()]
    assert ticks == ["thumb 4", "index 4", "middle 4", "ring 4", "little 4"]
    assert "EPE" in drawn[0].axes[0].get_ylabel()  # five tips alone: similarity would hide too much
    assert plots.joint_plot(make_evaluation(tmp_path, protocol="paper"), None) is None


def test_view_plot_has_the_mean_of_each_view(tmp_path: Path) -> None:
    evaluation = make_evaluation(tmp_path, missed=())
    _, y = lines_of(plots.view_plot(evaluation, None))["poor"]
    errors = evaluation.scores[2].pa_error.mean(axis=1)
    np.testing.assert_allclose(y, [errors[:2].mean(), errors[2:4].mean(), errors[4], errors[5]])
    blind = tuple(replace(s, views=("unknown",) * 6) for s in evaluation.scores)
    assert plots.view_plot(replace(evaluation, scores=blind), None) is None


def test_published_figure_has_the_best_and_the_focus(tmp_path: Path) -> None:
    assert plots.published_pck_plot(make_evaluation(tmp_path), None) is None
    evaluation = make_evaluation(tmp_path, kind="egodexter")
    assert list(lines_of(plots.published_pck_plot(evaluation, None))) == ["good", "poor"]
    assert list(lines_of(plots.published_pck_plot(evaluation, "good"))) == ["good"]


def test_many_methods_have_many_looks(tmp_path: Path) -> None:
    evaluation = make_evaluation(tmp_path)
    many = replace(
        evaluation,
        scores=tuple(replace(evaluation.scores[1], method=f"m{i}") for i in range(24)),
    )
    looks = [plots._style(many, None, s) for s in many.scores]
    assert len({(look.colour, look.dashes, look.width) for look in looks}) == 24


def test_the_users_settings_stay(tmp_path: Path) -> None:
    import matplotlib

    with matplotlib.rc_context({"font.size": 7.0}):
        plots.write_plots(tmp_path, make_evaluation(tmp_path))
        assert matplotlib.rcParams["font.size"] == 7.0
    assert "matplotlib.pyplot" not in sys.modules
