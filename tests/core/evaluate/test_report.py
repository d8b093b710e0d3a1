"""The report as a folder: complete, linked, escaped, its numbers and its hands those of the evaluation."""

from __future__ import annotations

import csv
import json
import math
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import matplotlib
import numpy as np
import pandas as pd
import pytest
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure

from handfit_core.common.skeleton import TIP_KEYPOINTS
from handfit_core.evaluate.report import REPORT_FILES, plots, sheets, write_report
from handfit_core.evaluate.report.tables import (
    comparison_tables,
    experiments_table,
    group_table,
    groups_of,
    main_table,
    others_table,
    verdict,
)
from handfit_core.evaluate.scores import Comparison, Evaluation
from handfit_core.evaluate.summary import pck
from handfit_core.evaluate.views import views_table
from tests.core.evaluate.made import (
    COUNT,
    make_evaluation,
    make_scores,
    with_errors,
    write_picture,
)
from tests.golden import Golden


class Page(HTMLParser):
    """Collects links and text, and fails where tags do not nest."""

    def __init__(self, folder: Path) -> None:
        super().__init__()
        self.open: list[str] = []
        self.seen: set[str] = set()
        self.links: set[str] = set()
        self.text = ""
        self.feed((folder / "index.html").read_text(encoding="utf-8"))
        self.close()
        assert self.open == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.seen.add(tag)
        if tag not in {"meta", "img"}:
            self.open.append(tag)
        self.links |= {value or "" for key, value in attrs if key in ("src", "href")}

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.text += data


def page_of(evaluation: Evaluation) -> Page:
    write_report(evaluation.root / "report", evaluation)
    return Page(evaluation.root / "report")


def read_csv(path: Path) -> list[dict[str, str]]:
    with open(path, newline="", encoding="utf-8") as stream:
        return list(csv.DictReader(stream))


def test_whole_report_is_linked_and_opens_offline(tmp_path: Path) -> None:
    evaluation = make_evaluation(tmp_path, kind="egodexter")
    files = write_report(tmp_path / "report", evaluation)
    assert files[0].name == "index.html"
    assert {f.name for f in files} == set(REPORT_FILES)
    assert set(files) == set((tmp_path / "report").iterdir())
    page = Page(tmp_path / "report")
    assert page.links == set(REPORT_FILES) - {"index.html"}
    assert not page.seen & {"script", "link"}
    assert not {"url(", "@import"} & set(files[0].read_text().split())
    # The same numbers give the same files.
    for file in write_report(tmp_path / "again", evaluation):
        assert file.read_bytes() == (tmp_path / "report" / file.name).read_bytes()


def test_names_are_escaped(tmp_path: Path) -> None:
    evil = "<script>alert('x&y')</script>"
    names = [f"{evil}{i}" for i in range(6)]
    evaluation = make_evaluation(tmp_path, dataset=evil, problems={evil: (evil,)}, names=names)
    page = page_of(evaluation)
    assert "script" not in page.seen
    assert f"{evil}5" in page.text  # its name under a sheet
    assert page.text.count(evil) >= 6
    scores = replace(evaluation.scores[1], title="a | b\n*c* <d>")
    text = main_table(replace(evaluation, scores=(evaluation.scores[0], scores))).markdown()
    assert r"a \| b \*c\* \<d>" in text


def test_problems_are_counted_shown_first_and_listed_whole(tmp_path: Path) -> None:
    problems = {"picture missing": ("one",), "labels cannot be read": tuple(f"Desk/{i}" for i in range(13))}
    text = page_of(make_evaluation(tmp_path, problems=problems)).text
    assert text.index("14 things") < text.index("All methods")
    assert text.index("13 × labels cannot be read") < text.index("1 × picture missing")
    assert "Desk/9" in text
    assert "Desk/10" not in text
    assert "and 3 more" in text
    listed = [tuple(row.values()) for row in read_csv(tmp_path / "report" / "problems.csv")]
    assert listed == [(kind, where) for kind, places in problems.items() for where in places]


def test_files_of_an_earlier_report_go_and_others_stay(tmp_path: Path) -> None:
    folder = tmp_path / "report"
    write_report(folder, make_evaluation(tmp_path, missed=(1,), kind="egodexter"))
    (folder / "my-notes.txt").write_text("mine")
    write_report(folder, make_evaluation(tmp_path, missed=(), problems={}))
    gone = {"missed.jpg", "problems.csv"}
    assert {f.name for f in folder.iterdir()} == set(REPORT_FILES) - gone | {"my-notes.txt"}


def test_headline_and_setup(tmp_path: Path) -> None:
    evaluation = make_evaluation(tmp_path, missed=(1, 2))
    text = page_of(evaluation).text
    assert "6 pictures, 6 labelled hands, 66.7 % of them detected." in text
    assert f"Best of 2 methods: good, PA-MPJPE {np.nanmean(evaluation.scores[1].pa_error):.2f} mm." in text
    setup = json.loads((tmp_path / "report" / "setup.json").read_text())
    assert (setup["setup"], setup["protocol"]) == ({"machine": "a test's"}, "strict")
    assert setup["labelled_hands"] == 6


@pytest.mark.parametrize("protocol", ["strict", "paper"])
def test_nothing_detected_is_a_report_too(tmp_path: Path, protocol) -> None:
    text = page_of(make_evaluation(tmp_path, missed=range(6), protocol=protocol)).text
    assert "0.0 % of them detected. No method has an error to show." in text
    assert (tmp_path / "report" / "missed.jpg").is_file()
    assert not (tmp_path / "report" / "worst.jpg").exists()


def test_papers_protocol_names_its_alignment(tmp_path: Path) -> None:
    text = page_of(make_evaluation(tmp_path, protocol="paper", kind="dexter-object")).text
    assert not (tmp_path / "report" / "per_joint.svg").exists()
    for words in ("true camera and true mean depth given", "No error per joint", "by the same protocol"):
        assert words in text


def test_csv_files_hold_every_number_exactly(tmp_path: Path) -> None:
    evaluation = make_evaluation(tmp_path, missed=(1, 4))
    write_report(tmp_path, evaluation)
    rows = read_csv(tmp_path / "table.csv")
    assert [(row["method"], row["is_baseline"]) for row in rows] == [
        *(("null-truth", "1"), ("good", "0"), ("poor", "0"))
    ]
    assert {(row["dataset"], row["protocol"]) for row in rows} == {("A set", "strict")}
    for row in rows:
        for key, value in evaluation.summaries.loc[row["method"]].items():
            assert row.get(key, "") == (repr(float(value)) if math.isfinite(value) else "")
    assert "pa_mpvpe" not in rows[0]  # no meshes, no column
    hands = read_csv(tmp_path / "per_hand.csv")
    assert len(hands) == 3 * COUNT
    good = [row for row in hands if row["method"] == "good"]
    assert [row["detected"] for row in good] == ["1", "0", "1", "1", "0", "1"]
    assert good[1]["pa_mpjpe"] == good[1]["fit_ms"] == ""
    mean = np.mean([float(row["pa_mpjpe"]) for row in good if row["pa_mpjpe"]])
    assert mean == pytest.approx(evaluation.summaries.loc["good", "pa_mpjpe"])
    assert (good[0]["sample"], good[0]["tag_pose"]) == ("Desk/00000", "open")
    (compared,) = read_csv(tmp_path / "comparisons.csv")
    assert float(compared["difference"]) == evaluation.comparisons[0].difference
    assert (compared["metric"], compared["first"], compared["second"]) == ("epe", "poor", "good")


# Tables


def test_tables(tmp_path: Path, golden: Golden) -> None:
    """The best of a column are bold, but baselines and what shows as equal; the published numbers beside."""
    evaluation = make_evaluation(tmp_path, kind="egodexter")
    truth, good, poor = evaluation.scores
    columns = ["auc", "handedness", "fit_ms", "epe"]
    summaries = evaluation.summaries.rename(index={"good": "paper-b"})
    summaries.loc[["paper-b", "poor"], columns] = [[0.999, 80.0, 3.01, 20.642], [0.9, 90.0, 3.02, math.nan]]
    (compared,) = evaluation.comparisons
    unsure = compared._replace(metric="pa_mpjpe", low=-1.0, high=1.0)
    evaluation = replace(
        evaluation,
        scores=(truth, replace(good, method="paper-b"), poor),
        summaries=summaries,
        comparisons=(compared, unsure),
    )
    makers = (main_table, group_table, experiments_table, others_table)
    tables = [*(make(evaluation) for make in makers), *(t for _, t in comparison_tables(evaluation))]
    golden.check("evaluation.md", "\n".join(table.markdown() for table in tables if table), steps=1)
    assert len([table for table in tables if table]) == 6
    assert experiments_table(make_evaluation(tmp_path)) is None


def test_what_is_no_group() -> None:
    """A tag with one value, or with more than a table holds."""
    many = make_scores(24, tags=[{"frame": str(i), "set": "one"} for i in range(24)])
    assert groups_of(many).empty


@pytest.mark.parametrize(
    ("difference", "low", "high", "units", "words"),
    [
        (-0.36, -0.5, -0.2, 194, "a is 0.36 mm better than b (0.20 to 0.50)"),
        (0.36, 0.2, 0.5, 194, "a is 0.36 mm worse than b (0.20 to 0.50)"),
        (0.1, -0.1, 0.3, 194, "no difference shown (−0.10 to 0.30)"),
        (0.36, 0.2, 0.5, 3, "only 3 stills or clips, so the interval is too narrow"),
        (0.36, math.nan, math.nan, 1, "no interval: only one still or clip"),
        (math.nan, math.nan, math.nan, 0, "no hand has a result of both"),
    ],
)
def test_verdicts(difference: float, low: float, high: float, units: int, words: str) -> None:
    assert words in verdict(Comparison("pa_mpjpe", "a", "b", difference, low, high, units, units))


# Plots


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
    _, shown = lines_of(plots.joint_plot(evaluation))["poor"]
    # One point after the other, the line interrupted before each finger.
    assert np.flatnonzero(np.isnan(shown)).tolist() == [1, 6, 11, 16, 21]
    means = np.nanmean(evaluation.scores[2].pa_error, axis=0)
    np.testing.assert_allclose(shown[~np.isnan(shown)], means, atol=1e-12)
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


def test_the_users_settings_stay(tmp_path: Path) -> None:
    with matplotlib.rc_context({"font.size": 7.0}):
        plots.write_plots(tmp_path, make_evaluation(tmp_path))
        assert matplotlib.rcParams["font.size"] == 7.0


# Picture sheets


def of_errors(folder: Path, errors: list[float], **overrides) -> Evaluation:
    """An evaluation of one method whose hands have these PA errors in mm."""
    overrides.setdefault("picture", (write_picture(folder / "p.png"),) * len(errors))
    return replace(make_evaluation(folder), scores=(with_errors(errors, **overrides),), comparisons=())


def names_on(folder: Path, evaluation: Evaluation) -> dict[str, list[str]]:
    written = sheets.write_sheets(folder, evaluation)
    assert all((folder / sheet.file).stat().st_size > 1000 for sheet in written)
    return {sheet.file: [f"{sample} {text}" for sample, _, text in sheet.hands] for sheet in written}


def test_worst_best_and_missed(tmp_path: Path) -> None:
    found = np.array([True, True, False, True, True])
    names = names_on(tmp_path, of_errors(tmp_path, [5.0, 1.0, np.nan, 3.0, 9.0], detected=found))
    assert names == {
        "worst.jpg": ["00004 PA-MPJPE 9.00 mm", "00000 PA-MPJPE 5.00 mm"],
        "best.jpg": ["00001 PA-MPJPE 1.00 mm", "00003 PA-MPJPE 3.00 mm"],
        "missed.jpg": ["00002 not detected"],
    }


def test_no_more_than_a_sheet_holds(tmp_path: Path) -> None:
    detected = np.arange(60) % 2 == 0
    errors = np.where(detected, np.arange(60.0), np.nan)
    names = names_on(tmp_path, of_errors(tmp_path, list(errors), detected=detected))
    numbers = {file: [int(name.split()[0]) for name in all_] for file, all_ in names.items()}
    assert numbers["worst.jpg"] == list(range(58, 34, -2))
    assert numbers["best.jpg"] == list(range(0, 24, 2))
    assert len(numbers["missed.jpg"]) == 12
    assert {numbers["missed.jpg"][0], numbers["missed.jpg"][-1]} == {1, 59}


def test_neighbours_in_a_clip_do_not_fill_a_sheet(tmp_path: Path) -> None:
    errors = [100.0 - i for i in range(40)]  # at 25 fps; the clip's first second is worst
    evaluation = of_errors(tmp_path, errors, clip=("wave",) * 40, time=np.arange(40) / 25.0)
    worst = [int(name.split()[0]) for name in names_on(tmp_path, evaluation)["worst.jpg"]]
    assert worst[0] == 0
    assert {13, 25, 38} <= set(worst)


@pytest.mark.parametrize("content", [None, b"no picture"])
def test_picture_that_is_gone_or_broken_leaves_a_grey_cell(tmp_path: Path, content: bytes | None) -> None:
    if content:
        (tmp_path / "broken.png").write_bytes(content)
    scores = with_errors([9.0], picture=(tmp_path / "broken.png",))
    axes = Figure().subplots()
    sheets.draw_hand(axes, scores, 0)
    assert axes.get_facecolor()[:3] == to_rgb(sheets.NOTHING)
    assert axes.texts[0].get_text() == "picture cannot be read"


def test_labels_and_predictions_are_drawn_where_they_are(tmp_path: Path) -> None:
    label = np.full((1, 21, 2), np.nan)
    label[0, [0, 5]] = [[100.0, 100.0], [200.0, 100.0]]
    picture = (write_picture(tmp_path / "p.png"),)
    scores = with_errors([5.0], picture=picture, labels_2d=label, points_2d=label + [0.0, 100.0])
    axes = Figure().subplots()
    sheets.draw_hand(axes, scores, 0)
    for line, colour, y in zip(axes.lines, (sheets.LABEL, sheets.PREDICTION), (100.0, 200.0), strict=True):
        drawn = np.asarray(line.get_xydata())
        assert line.get_color() == colour
        assert [200.0, y] in drawn.tolist()
        assert [100.0, y] in drawn.tolist()


def test_missing_or_absurd_points_and_names_of_all_kinds_do_no_harm(tmp_path: Path) -> None:
    labels, points = np.full((2, 21, 2), np.nan), np.full((2, 21, 2), 1e12)
    points[1] = np.nan
    points[0, 3] = np.inf
    samples = ("Küche/$" + "x" * 300, "手/00001")
    evaluation = of_errors(tmp_path, [9.0, 1.0], labels_2d=labels, points_2d=points, sample=samples)
    assert list(names_on(tmp_path, evaluation)) == ["worst.jpg", "best.jpg"]


def test_crops_hold_the_hand_and_not_a_lost_prediction() -> None:
    label = np.array([[300.0, 200.0], [340.0, 240.0]])
    near, lost = (sheets.crop_box(label, label + off, 640, 480) for off in (5.0, 100_000.0))
    for low, high in (near, lost):
        assert (label >= low).all()
        assert (label <= high).all()
    assert (near[1] >= label + 5.0).all()
    assert np.ptp(near, axis=0).max() < 80
    assert np.ptp(lost, axis=0).max() < 3 * 80
    nothing = np.full((21, 2), np.nan)
    low, high = sheets.crop_box(nothing, nothing, 640, 480)
    assert (low <= 0).all()
    assert (high >= [640, 480]).all()


def test_table_of_evaluated_pairs():
    """Means and largest values of each level and group; strangers only count."""
    levels = [("nothing", "near", 1.0), ("nothing", "far", 3.0), ("cameras", "near", 0.5)]
    rows = [
        {"told": told, "group": group, "belongs": True, "verdict": "good", "offset": offset}
        for told, group, offset in levels
    ]
    rows[1]["verdict"] = "doubtful"
    rows.append(rows[0] | {"belongs": False, "verdict": "good", "offset": 50.0})
    lines = views_table(pd.DataFrame(rows)).splitlines()
    assert "| nothing | far | 1 | 1 | 0 | 3.00 (3.00) |" in lines
    assert "| nothing | all | 2 | 1 | 0 | 2.00 (3.00) |" in lines
    assert "| cameras | all | 1 | 0 | 0 | 0.50 (0.50) |" in lines
    assert lines[-1].startswith("Of 1 pairs that do not belong together 1 were taken for good and 0")
