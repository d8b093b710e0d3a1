"""The report as a folder: complete, linked, escaped, its numbers those of the evaluation."""

from __future__ import annotations

import csv
import json
import math
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest

from handfit_core.evaluate.report import REPORT_FILES, write_report
from handfit_core.evaluate.report.tables import (
    EXPERIMENTS,
    MISSING,
    OTHERS_AUC,
    Table,
    comparison_tables,
    experiments_table,
    group_table,
    groups_of,
    main_table,
    others_table,
    verdict,
)
from handfit_core.evaluate.scores import Comparison, Evaluation
from handfit_core.evaluate.summary import METRICS
from tests.core.evaluate.factory import make_scores, with_hands
from tests.core.evaluate.reports import COUNT, make_evaluation


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


def read_csv(path: Path) -> list[dict[str, str]]:
    with open(path, newline="", encoding="utf-8") as stream:
        return list(csv.DictReader(stream))


def column(table: Table, title: str) -> list[tuple[str, bool]]:
    (index,) = [i for i, (name, _) in enumerate(table.titles()) if name.startswith(title)]
    return [row[index] for row in table.rows()]


def test_a_whole_report_is_linked_and_opens_offline(tmp_path: Path) -> None:
    folder = tmp_path / "report"
    files = write_report(folder, make_evaluation(tmp_path, kind="egodexter"))
    assert files[0] == folder / "index.html"
    assert {f.name for f in files} == set(REPORT_FILES)
    assert set(files) == set(folder.iterdir())
    assert all(f.stat().st_size > 0 for f in files)
    page = Page(folder)
    assert page.links == set(REPORT_FILES) - {"index.html"}
    assert not page.seen & {"script", "link"}
    assert not {"url(", "@import"} & set((folder / "index.html").read_text().split())


def test_names_are_escaped(tmp_path: Path) -> None:
    evil = "<script>alert('x&y')</script>"
    evaluation = make_evaluation(
        tmp_path, dataset=evil, problems={evil: (evil,)}, names=[f"{evil}{i}" for i in range(6)]
    )
    write_report(tmp_path / "report", evaluation)
    page = Page(tmp_path / "report")
    assert "script" not in page.seen
    assert f"{evil}5" in page.text  # its name under a sheet
    assert page.text.count(evil) >= 6
    scores = replace(evaluation.scores[1], title="a | b\n*c* <d>")
    text = main_table(replace(evaluation, scores=(evaluation.scores[0], scores))).markdown()
    assert r"a \| b \*c\* \<d>" in text


def test_problems_are_counted_shown_first_and_listed_whole(tmp_path: Path) -> None:
    problems = {"picture missing": ("one",), "labels cannot be read": tuple(f"Desk/{i}" for i in range(13))}
    write_report(tmp_path / "report", make_evaluation(tmp_path, problems=problems))
    text = Page(tmp_path / "report").text
    assert text.index("14 things") < text.index("All methods")
    assert text.index("13 × labels cannot be read") < text.index("1 × picture missing")
    assert "Desk/9" in text
    assert "Desk/10" not in text
    assert "and 3 more" in text
    listed = read_csv(tmp_path / "report" / "problems.csv")
    assert [(row["kind"], row["where"]) for row in listed] == [
        (kind, where) for kind, places in problems.items() for where in places
    ]


def test_what_an_earlier_report_left_does_not_stay(tmp_path: Path) -> None:
    folder = tmp_path / "report"
    write_report(folder, make_evaluation(tmp_path, missed=(1,), kind="egodexter"))
    (folder / "my-notes.txt").write_text("mine")
    write_report(folder, make_evaluation(tmp_path, missed=(), problems={}))
    gone = {"missed.jpg", "problems.csv"}
    assert {f.name for f in folder.iterdir()} == set(REPORT_FILES) - gone | {"my-notes.txt"}


def test_headline_and_setup(tmp_path: Path) -> None:
    evaluation = make_evaluation(tmp_path, missed=(1, 2))
    write_report(tmp_path / "report", evaluation)
    text = Page(tmp_path / "report").text
    assert "6 pictures, 6 labelled hands, 66.7 % of them detected." in text
    assert f"Best of 2 methods: good, PA-MPJPE {np.nanmean(evaluation.scores[1].pa_error):.2f} mm." in text
    setup = json.loads((tmp_path / "report" / "setup.json").read_text())
    assert setup["setup"] == {"machine": "a test's"}
    assert setup["protocol"] == "strict"
    assert setup["labelled_hands"] == 6


@pytest.mark.parametrize("protocol", ["strict", "paper"])
def test_nothing_detected_is_a_report_too(tmp_path: Path, protocol) -> None:
    write_report(tmp_path / "report", make_evaluation(tmp_path, missed=range(6), protocol=protocol))
    assert "0.0 % of them detected. No method has an error to show." in Page(tmp_path / "report").text
    assert (tmp_path / "report" / "missed.jpg").is_file()
    assert not (tmp_path / "report" / "worst.jpg").exists()


def test_the_papers_protocol_names_its_alignment_and_has_no_joint_plot(tmp_path: Path) -> None:
    write_report(tmp_path / "report", make_evaluation(tmp_path, protocol="paper", kind="dexter-object"))
    assert not (tmp_path / "report" / "per_joint.svg").exists()
    text = Page(tmp_path / "report").text
    for words in ("true camera and true mean depth given", "No error per joint", "by the same protocol"):
        assert words in text


def test_the_same_numbers_give_the_same_files(tmp_path: Path) -> None:
    evaluation = make_evaluation(tmp_path)
    first = {f.name: f.read_bytes() for f in write_report(tmp_path / "a", evaluation)}
    assert {f.name: f.read_bytes() for f in write_report(tmp_path / "b", evaluation)} == first


def test_the_csv_files_hold_every_number_exactly(tmp_path: Path) -> None:
    evaluation = make_evaluation(tmp_path, missed=(1, 4))
    write_report(tmp_path, evaluation)
    rows = read_csv(tmp_path / "table.csv")
    assert [row["method"] for row in rows] == ["null-truth", "good", "poor"]
    assert [row["is_baseline"] for row in rows] == ["1", "0", "0"]
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


def test_the_main_table_names_alignments_and_marks_the_best(tmp_path: Path) -> None:
    table = main_table(make_evaluation(tmp_path))
    assert [name for name, _ in column(table, "Method")] == ["null-truth (baseline)", "good", "poor"]
    # The baseline is exactly right, and bold it is not.
    assert column(table, "PA-MPJPE, mm")[0] == ("0.00", False)
    for title in ("PA-MPJPE, mm ↓", "AUC 20-50 mm ↑"):
        assert [bold for _, bold in column(table, title)] == [False, True, False]
    lines = table.markdown().splitlines()
    assert len({line.count("|") for line in lines if line.startswith("|")}) == 1
    number = lines[0].split("PA-MPJPE, mm ↓ [")[1].split("]")[0]
    assert f"{number}. PA-MPJPE: {METRICS['pa_mpjpe'].alignment}" in lines
    assert "* null-truth: the truth (knows the truth)" in lines


def test_higher_is_bold_where_higher_is_better_and_equals_are_not(tmp_path: Path) -> None:
    evaluation = make_evaluation(tmp_path)
    planted = {
        "good": {"handedness": 80.0, "fit_ms": 3.01, "epe": 5.0},
        "poor": {"handedness": 90.0, "fit_ms": 3.02, "epe": math.nan},
    }
    summaries = evaluation.summaries.copy()
    for name, values in planted.items():
        summaries.loc[name, list(values)] = list(values.values())
    table = main_table(replace(evaluation, summaries=summaries))
    assert [bold for _, bold in column(table, "Side right")] == [False, False, True]
    assert [bold for _, bold in column(table, "Fit")] == [False, False, False]  # both are shown as 3.0
    assert column(table, "EPE, mm") == [("0.00", False), ("5.00", False), (MISSING, False)]


def test_groups_leave_out_what_is_no_group(tmp_path: Path) -> None:
    scores = make_evaluation(tmp_path).scores[1]
    assert list(groups_of(scores)) == ["view", "pose", "frame"]
    one = with_hands(scores, tags=[{"frame": str(i), "set": "one"} for i in range(COUNT)])
    assert list(groups_of(one)) == ["view", "frame"]
    many = make_scores(24, tags=[{"frame": str(i)} for i in range(24)])
    assert groups_of(many).empty


def test_group_means_and_rates_are_of_the_group(tmp_path: Path) -> None:
    evaluation = make_evaluation(tmp_path, missed=(1,))
    table = group_table(evaluation)
    assert table is not None
    assert [t for t, _ in table.titles()] == [
        *("Group", "Value", "Hands", "Detected, %", "good, mm", "poor, mm")
    ]
    rows = {(row[0][0], row[1][0]): row[2:] for row in table.rows()}
    poor = evaluation.scores[2].pa_error
    fists = np.mean([poor[3].mean(), poor[5].mean()])  # 1 was missed
    assert [text for text, _ in rows["pose", "fist"][:2]] == ["3", "66.7"]
    assert rows["pose", "fist"][2][1]
    assert rows["pose", "fist"][3] == (f"{fists:.2f}", False)
    assert rows["pose", "open"][1][0] == "100.0"
    assert [value for group, value in rows if group == "view"] == ["palm", "back", "edge", "unknown"]


@pytest.mark.parametrize(
    ("difference", "low", "high", "hands", "units", "words"),
    [
        (-0.36, -0.5, -0.2, 194, 194, "a is 0.36 mm better than b (0.20 to 0.50)"),
        (0.36, 0.2, 0.5, 194, 194, "a is 0.36 mm worse than b (0.20 to 0.50)"),
        (0.1, -0.1, 0.3, 194, 194, "no difference shown (−0.10 to 0.30)"),
        (0.36, 0.2, 0.5, 90, 3, "only 3 stills or clips, so the interval is too narrow"),
        (0.36, math.nan, math.nan, 90, 1, "no interval: only one still or clip"),
        (math.nan, math.nan, math.nan, 0, 0, "no hand has a result of both"),
    ],
)
def test_verdicts(difference: float, low: float, high: float, hands: int, units: int, words: str) -> None:
    assert words in verdict(Comparison("pa_mpjpe", "a", "b", difference, low, high, hands, units))


def test_comparisons_show_interval_and_verdict(tmp_path: Path) -> None:
    evaluation = make_evaluation(tmp_path)
    (unsure,) = [c._replace(metric="pa_mpjpe", low=-1.0, high=1.0) for c in evaluation.comparisons]
    tables = comparison_tables(replace(evaluation, comparisons=(*evaluation.comparisons, unsure)))
    assert [metric.key for metric, _ in tables] == ["pa_mpjpe", "epe"]  # the error in front comes first
    assert tables[0][1].rows()[0][0][0].startswith("poor and good: no difference shown")
    (((words, _), (difference, _), *_),) = tables[1][1].rows()
    assert "worse than good" in words
    assert difference == f"{evaluation.comparisons[0].difference:.2f}"


def published_evaluation(folder: Path) -> Evaluation:
    evaluation = make_evaluation(folder, kind="egodexter", protocol="paper")
    ours = replace(evaluation.scores[1], method="paper-b")
    summaries = evaluation.summaries.copy()
    summaries.loc["paper-b", ["epe", "auc"]] = 20.642, 0.999
    return replace(evaluation, scores=(ours, evaluation.scores[2]), summaries=summaries)


def test_published_numbers_stand_beside_ours(tmp_path: Path) -> None:
    assert EXPERIMENTS.loc["paper-h"].tolist()[3:] == [42.833, 0.492, 24.574, 0.784]
    assert [OTHERS_AUC[kind]["Zhou 2020"] for kind in ("dexter-object", "egodexter")] == [0.948, 0.811]
    evaluation = published_evaluation(tmp_path)
    table, others = experiments_table(evaluation), others_table(evaluation)
    assert table is not None
    assert others is not None
    a, b = [[text for text, _ in row] for row in table.rows()[:2]]
    assert a[3:] == ["17.72", MISSING, MISSING, "0.883", MISSING, MISSING]
    assert b[3:] == ["19.64", "20.64", "1.00", "0.859", "0.999", "0.140"]
    values = [float(text) for text, _ in column(others, "AUC")]
    assert values == sorted(values, reverse=True)
    assert [text for text, bold in column(others, "Method") if bold] == ["paper-b, here", "poor, here"]
    assert experiments_table(make_evaluation(tmp_path)) is None
    assert others_table(make_evaluation(tmp_path)) is None
