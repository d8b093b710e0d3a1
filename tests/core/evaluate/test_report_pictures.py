"""Plots and picture sheets hold the numbers and the hands that they claim to."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import matplotlib
import numpy as np
import pytest
from matplotlib.colors import to_rgb

from handfit_core.evaluate.report import plots, sheets
from handfit_core.evaluate.report.sheets import Sheet, crop_box, write_sheets
from handfit_core.evaluate.summary import pck
from handfit_core.media.pictures import read_picture
from handfit_core.skeleton import TIP_KEYPOINTS
from tests.core.evaluate.factory import make_scores, with_hands
from tests.core.evaluate.reports import make_evaluation, write_picture

LEFT, TOP, SIDE = sheets.GAP, sheets.LEGEND + sheets.CAPTION, sheets.CELL


def lines_of(drawn: plots.Drawn | None) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    assert drawn is not None
    (axes,) = drawn[0].axes
    return {
        str(line.get_label()).split(" ")[0]: (np.asarray(line.get_xdata()), np.asarray(line.get_ydata()))
        for line in axes.lines
    }


def test_pck_curves_count_misses_and_legends_tell_the_auc(tmp_path: Path) -> None:
    evaluation = make_evaluation(tmp_path, missed=(0, 1, 2))
    drawn = plots.pck_plot(evaluation)
    lines = lines_of(drawn)
    assert list(lines) == ["null-truth", "good", "poor"]
    assert lines["null-truth"][1].min() == 1.0
    assert lines["good"][1].max() == 0.5  # half of the hands were missed
    np.testing.assert_allclose(lines["poor"][1], pck(evaluation.scores[2], "strict"))
    assert drawn is not None
    legend = drawn[0].axes[0].get_legend()
    assert legend is not None
    assert legend.get_texts()[1].get_text() == f"good ({evaluation.summaries.loc['good', 'auc']:.3f})"
    x, y = lines_of(plots.pa_pck_plot(evaluation))["poor"]
    errors = evaluation.scores[2].pa_error
    assert x[20] == 10.0
    assert y[20] == pytest.approx(np.sum(errors <= 10.0) / errors.size)  # a miss is no hit: NaN <= 10 is not


def test_joint_plot_shows_each_labelled_joint(tmp_path: Path) -> None:
    evaluation = make_evaluation(tmp_path)
    drawn = plots.joint_plot(evaluation)
    assert drawn is not None
    assert len(drawn[0].axes[0].get_xticks()) == 21
    _, shown = lines_of(drawn)["poor"]
    # One point after the other, the line interrupted before each finger.
    assert np.flatnonzero(np.isnan(shown)).tolist() == [1, 6, 11, 16, 21]
    np.testing.assert_allclose(
        shown[~np.isnan(shown)], np.nanmean(evaluation.scores[2].pa_error, axis=0), atol=1e-12
    )
    others = np.setdiff1d(np.arange(21), TIP_KEYPOINTS)
    tips = []
    for s in evaluation.scores:
        labels, epe = s.labels_3d.copy(), s.epe.copy()
        labels[:, others], epe[:, others] = np.nan, np.nan
        tips.append(replace(s, labels_3d=labels, epe=epe))
    drawn = plots.joint_plot(replace(evaluation, scores=tuple(tips)))
    assert drawn is not None
    ticks = [text.get_text() for text in drawn[0].axes[0].get_xticklabels()]
    assert ticks == ["thumb 4", "index 4", "middle 4", "ring 4", "little 4"]
    assert "EPE" in drawn[0].axes[0].get_ylabel()  # five tips alone: similarity would hide too much
    assert plots.joint_plot(make_evaluation(tmp_path, protocol="paper")) is None


def test_view_plot_has_the_mean_of_each_view(tmp_path: Path) -> None:
    evaluation = make_evaluation(tmp_path, missed=())
    _, y = lines_of(plots.view_plot(evaluation))["poor"]
    errors = evaluation.scores[2].pa_error.mean(axis=1)
    np.testing.assert_allclose(y, [errors[:2].mean(), errors[2:4].mean(), errors[4], errors[5]])
    blind = tuple(with_hands(s, view="unknown") for s in evaluation.scores)
    assert plots.view_plot(replace(evaluation, scores=blind)) is None


def test_the_users_settings_stay(tmp_path: Path) -> None:
    with matplotlib.rc_context({"font.size": 7.0}):
        plots.write_plots(tmp_path, make_evaluation(tmp_path))
        assert matplotlib.rcParams["font.size"] == 7.0
    assert "matplotlib.pyplot" not in sys.modules


def with_errors(folder: Path, errors: list[float], **overrides):
    """An evaluation of one method whose hands have these PA errors in mm."""
    n = len(errors)
    overrides.setdefault("picture", (write_picture(folder / "p.png"),) * n)
    scores = make_scores(n, pa_error=np.repeat(np.array(errors)[:, None], 21, axis=1), **overrides)
    return replace(make_evaluation(folder), scores=(scores,), comparisons=())


def names(written: list[Sheet]) -> dict[str, list[str]]:
    return {sheet.file: [sample for sample, _, _ in sheet.hands] for sheet in written}


def first_cell(path: Path) -> np.ndarray:
    rgb, _ = read_picture(path)
    return rgb[TOP : TOP + SIDE, LEFT : LEFT + SIDE].astype(int)


def test_worst_best_and_missed(tmp_path: Path) -> None:
    evaluation = with_errors(
        tmp_path, [5.0, 1.0, np.nan, 3.0, 9.0], detected=np.array([True, True, False, True, True])
    )
    written = write_sheets(tmp_path, evaluation)
    assert names(written) == {
        "worst.jpg": ["00004", "00000"],
        "best.jpg": ["00001", "00003"],
        "missed.jpg": ["00002"],
    }
    assert [sheet.hands[0][2] for sheet in written[::2]] == ["PA-MPJPE 9.00 mm", "not detected"]
    for sheet in written:
        rgb, _ = read_picture(tmp_path / sheet.file)
        assert rgb.shape == (sheet.height, sheet.width, 3)


def test_no_more_than_a_sheet_holds(tmp_path: Path) -> None:
    detected = np.arange(60) % 2 == 0
    errors = np.where(detected, np.arange(60.0), np.nan)
    written = names(write_sheets(tmp_path, with_errors(tmp_path, list(errors), detected=detected)))
    assert written["worst.jpg"] == [f"{i:05}" for i in range(58, 34, -2)]
    assert written["best.jpg"] == [f"{i:05}" for i in range(0, 24, 2)]
    assert len(written["missed.jpg"]) == 12
    assert {written["missed.jpg"][0], written["missed.jpg"][-1]} == {"00001", "00059"}


def test_neighbours_in_a_clip_do_not_fill_a_sheet(tmp_path: Path) -> None:
    n = 40  # at 25 fps; the clip's first second is worst
    errors = [100.0 - i for i in range(n)]
    evaluation = with_errors(tmp_path, errors, clip=("wave",) * n, time=np.arange(n) / 25.0)
    worst = names(write_sheets(tmp_path, evaluation))["worst.jpg"]
    assert worst[0] == "00000"
    assert {"00013", "00025", "00038"} <= set(worst)


def test_labels_and_predictions_are_drawn_where_they_are(tmp_path: Path) -> None:
    label = np.full((1, 21, 2), np.nan)
    label[0, [0, 5]] = [[100.0, 100.0], [200.0, 100.0]]
    prediction = label + [0.0, 100.0]
    write_sheets(tmp_path, with_errors(tmp_path, [5.0], labels_2d=label, points_2d=prediction))
    cell = first_cell(tmp_path / "worst.jpg")
    x, y, side = crop_box(label[0], prediction[0], 640, 480)
    # The middle of each bone, in pixels of the cell, and of the picture between them.
    middle = round((150 - x) * SIDE / side - 0.5)
    drawn = (
        (100, to_rgb(sheets.LABEL)),
        (200, to_rgb(sheets.PREDICTION)),
        (150, [200 / 255] * 3),
    )
    for row, colour in drawn:
        at = cell[round((row - y) * SIDE / side - 0.5), middle]
        assert np.abs(at - 255 * np.array(colour)).max() < 80, (row, at)


@pytest.mark.parametrize("content", [None, b"no picture"])
def test_a_picture_that_is_gone_or_broken_leaves_a_grey_cell(tmp_path: Path, content: bytes | None) -> None:
    if content:
        (tmp_path / "broken.png").write_bytes(content)
    write_sheets(tmp_path, with_errors(tmp_path, [9.0], picture=(tmp_path / "broken.png",)))
    cell = first_cell(tmp_path / "worst.jpg")
    assert np.abs(cell[20, 20:-20] - 255 * np.array(to_rgb(sheets.NOTHING))).max() < 10


def test_points_that_are_missing_or_absurd_and_names_of_all_kinds_do_no_harm(tmp_path: Path) -> None:
    labels, points = np.full((2, 21, 2), np.nan), np.full((2, 21, 2), 1e12)
    points[1] = np.nan
    points[0, 3] = np.inf
    samples = ("Küche/$" + "x" * 300, "手/00001")
    evaluation = with_errors(tmp_path, [9.0, 1.0], labels_2d=labels, points_2d=points, sample=samples)
    write_sheets(tmp_path, evaluation)
    rgb, _ = read_picture(tmp_path / "worst.jpg")
    assert rgb[:TOP, -LEFT:].max() < 60  # nothing runs over the edge


@pytest.mark.parametrize("seed", range(5))
def test_crops_hold_the_hand_and_stay_in_the_picture_where_they_can(seed: int) -> None:
    rng = np.random.default_rng(seed)
    centre, size = rng.uniform([80, 80], [560, 400]), rng.uniform(20, 120)
    label = centre + rng.uniform(-size / 2, size / 2, (21, 2))
    x, y, side = crop_box(label, label + rng.normal(scale=3.0, size=(21, 2)), 640, 480)
    assert (label >= [x, y]).all()
    assert (label <= [x + side, y + side]).all()
    assert 0 <= x <= 640 - side
    assert 0 <= y <= 480 - side


def test_a_lost_prediction_does_not_shrink_the_hand() -> None:
    label = np.array([[300.0, 200.0], [340.0, 240.0]])
    near = crop_box(label, label + 5.0, 640, 480)[2]
    lost = crop_box(label, label + 100_000.0, 640, 480)[2]
    assert near < 80
    assert lost < 3 * near
    nothing = np.full((21, 2), np.nan)
    x, y, side = crop_box(nothing, nothing, 640, 480)
    assert x <= 0 <= 640 <= x + side
    assert y <= 0 <= 480 <= y + side
