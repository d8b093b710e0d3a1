"""Picture sheets: the right hands, drawn where they are."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from handfit_core.evaluate.report import sheets
from handfit_core.evaluate.report.sheets import crop_box, write_sheets
from handfit_core.media.opening import read_picture
from tests.core.evaluate.factory import make_scores
from tests.core.evaluate.reports import COUNT, make_evaluation, write_picture

SIDE, GAP, LEGEND = sheets._SIDE, sheets._GAP, sheets._LEGEND


def with_errors(folder: Path, errors: list[float], **overrides):
    """An evaluation of one method whose hands have these PA errors in mm."""
    n = len(errors)
    overrides.setdefault("pictures", (write_picture(folder / "p.png"),) * n)
    scores = make_scores(n, pa_error=np.repeat(np.array(errors)[:, None], 21, axis=1), **overrides)
    return replace(make_evaluation(folder), scores=(scores,), comparisons=())


def names(written: list[sheets.Sheet]) -> dict[str, list[str]]:
    return {sheet.file: [hand.sample for hand in sheet.hands] for sheet in written}


def first_cell(path: Path) -> np.ndarray:
    rgb, _ = read_picture(path)
    return rgb[LEGEND + GAP : LEGEND + GAP + SIDE, GAP : GAP + SIDE]


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
    assert written[0].hands[0].text == "PA-MPJPE 9.00 mm"
    assert written[2].hands[0].text == "not detected"
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
    evaluation = with_errors(tmp_path, errors, clips=("wave",) * n, times=np.arange(n) / 25.0)
    worst = names(write_sheets(tmp_path, evaluation))["worst.jpg"]
    assert worst[0] == "00000"
    assert {"00013", "00026", "00039"} <= set(worst)


def test_labels_and_predictions_are_drawn_where_they_are(tmp_path: Path) -> None:
    label = np.full((1, 21, 2), np.nan)
    label[0, [0, 5]] = [[100.0, 100.0], [200.0, 100.0]]
    prediction = np.full((1, 21, 2), np.nan)
    prediction[0, [0, 5]] = [[100.0, 200.0], [200.0, 200.0]]
    evaluation = with_errors(tmp_path, [5.0], labels_2d=label, points_2d=prediction)
    write_sheets(tmp_path, evaluation)
    cell = first_cell(tmp_path / "worst.jpg").astype(int)
    x, y, side = crop_box(label[0], prediction[0], 640, 480)
    scale = SIDE / side
    # The middle of each bone, in pixels of the cell.
    middle = round((150 - x) * scale - 0.5)
    for row, colour in ((100, sheets._LABEL), (200, sheets._PREDICTION)):
        at = cell[round((row - y) * scale - 0.5), middle]
        assert np.abs(at - colour).max() < 80, (row, at)
    assert np.abs(cell[round((150 - y) * scale), middle] - 200).max() < 20  # between them, the picture


def test_a_picture_that_is_gone_leaves_a_grey_cell(tmp_path: Path) -> None:
    pictures = (tmp_path / "gone.png", write_picture(tmp_path / "p.png"))
    (tmp_path / "broken.png").write_bytes(b"no picture")
    written = write_sheets(tmp_path, with_errors(tmp_path, [9.0, 1.0], pictures=pictures))
    assert [sheet.file for sheet in written] == ["worst.jpg", "best.jpg"]
    assert np.abs(first_cell(tmp_path / "worst.jpg")[20].astype(int) - sheets._NOTHING).max() < 10
    broken = with_errors(tmp_path, [9.0], pictures=(tmp_path / "broken.png",))
    write_sheets(tmp_path, broken)
    assert np.abs(first_cell(tmp_path / "worst.jpg")[20].astype(int) - sheets._NOTHING).max() < 10


def test_points_that_are_missing_or_absurd_do_no_harm(tmp_path: Path) -> None:
    labels, points = np.full((2, 21, 2), np.nan), np.full((2, 21, 2), 1e12)
    points[1] = np.nan
    points[0, 3] = np.inf
    assert write_sheets(tmp_path, with_errors(tmp_path, [9.0, 1.0], labels_2d=labels, points_2d=points))


@pytest.mark.parametrize("seed", range(5))
def test_crops_hold_the_hand_and_stay_in_the_picture_where_they_can(seed: int) -> None:
    rng = np.random.default_rng(seed)
    centre, size = rng.uniform([80, 80], [560, 400]), rng.uniform(20, 120)
    label = centre + rng.uniform(-size / 2, size / 2, (21, 2))
    x, y, side = crop_box(label, label + rng.normal(scale=3.0, size=(21, 2)), 640, 480)
    assert (label >= [x, y]).all()
    assert (label <= [x + side, y + side]).all()
    assert x >= 0
    assert y >= 0
    assert x + side <= 640
    assert y + side <= 480


def test_a_lost_prediction_does_not_shrink_the_hand() -> None:
    label = np.array([[300.0, 200.0], [340.0, 240.0]])
    near = crop_box(label, label + 5.0, 640, 480)[2]
    lost = crop_box(label, label + 100_000.0, 640, 480)[2]
    assert near < 80
    assert lost < 3 * near
    assert crop_box(np.full((21, 2), np.nan), np.full((21, 2), np.nan), 640, 480) == (0, -80, 640)


def test_the_focus_is_drawn(tmp_path: Path) -> None:
    evaluation = make_evaluation(tmp_path, missed=())
    by_default = write_sheets(tmp_path, evaluation)
    assert "of poor" in by_default[0].caption
    assert "of good" in write_sheets(tmp_path, evaluation, "good")[0].caption
    assert len(by_default[0].hands) + len(by_default[1].hands) == COUNT


def test_names_beyond_ascii_and_long_ones_fit(tmp_path: Path) -> None:
    samples = ("Küche/" + "x" * 300, "手/00001")
    write_sheets(tmp_path, with_errors(tmp_path, [9.0, 1.0], samples=samples))
    rgb = cv2.imread(str(tmp_path / "worst.jpg"))
    assert rgb is not None
    assert rgb[LEGEND + GAP + SIDE :, -GAP:].max() < 60  # nothing runs over the edge
