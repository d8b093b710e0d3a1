"""Tables of the report: numbers that read back, bold that is earned, words that match the numbers."""

from __future__ import annotations

import csv
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from handfit_core.evaluate.report.groups import group_table, groups_of
from handfit_core.evaluate.report.layout import MISSING, Table, markdown
from handfit_core.evaluate.report.published import EXPERIMENTS, OTHERS_AUC, experiments_table, others_table
from handfit_core.evaluate.report.tables import (
    main_table,
    markdown_table,
    write_hands_csv,
    write_table_csv,
)
from handfit_core.evaluate.report.verdicts import comparison_tables, verdict
from handfit_core.evaluate.scores import Comparison, Evaluation
from handfit_core.evaluate.summary import METRICS
from tests.core.evaluate.reports import COUNT, make_evaluation


def with_summary(evaluation: Evaluation, **of_method: dict[str, float]) -> Evaluation:
    changed = {
        m: {**values, **of_method.get(m.replace("-", "_"), {})} for m, values in evaluation.summaries.items()
    }
    return replace(evaluation, summaries=changed)


def read_csv(path: Path) -> list[dict[str, str]]:
    with open(path, newline="", encoding="utf-8") as stream:
        return list(csv.DictReader(stream))


def column(table: Table, title: str) -> list[tuple[str, bool]]:
    (index,) = [i for i, c in enumerate(table.columns) if c.title.startswith(title)]
    return [(row[index].text, row[index].is_best) for row in table.rows]


def test_the_csv_holds_every_number_exactly(tmp_path: Path) -> None:
    evaluation = make_evaluation(tmp_path)
    rows = read_csv(write_table_csv(tmp_path / "table.csv", evaluation))
    assert [row["method"] for row in rows] == ["null-truth", "good", "poor"]
    assert [row["is_baseline"] for row in rows] == ["1", "0", "0"]
    assert {row["dataset"] for row in rows} == {"A set"}
    assert {row["protocol"] for row in rows} == {"strict"}
    for row in rows:
        for key, value in evaluation.summaries[row["method"]].items():
            if key in row and math.isfinite(value):
                assert float(row[key]) == value
            else:
                assert row.get(key, "") == ""
    assert "pa_mpvpe" not in rows[0]  # no meshes, no column


def test_per_hand_rows_average_to_the_table(tmp_path: Path) -> None:
    evaluation = make_evaluation(tmp_path, missed=(1, 4))
    rows = read_csv(write_hands_csv(tmp_path / "per_hand.csv", evaluation))
    assert len(rows) == 3 * COUNT
    good = [row for row in rows if row["method"] == "good"]
    assert [row["detected"] for row in good] == ["1", "0", "1", "1", "0", "1"]
    assert good[1]["pa_mpjpe"] == good[1]["fit_ms"] == ""
    mean = np.mean([float(row["pa_mpjpe"]) for row in good if row["pa_mpjpe"]])
    assert mean == pytest.approx(evaluation.summaries["good"]["pa_mpjpe"])
    assert good[0]["sample"] == "Desk/00000"
    assert good[0]["tag_pose"] == "open"


def test_markdown_has_a_row_per_method_and_names_alignments(tmp_path: Path) -> None:
    lines = markdown_table(make_evaluation(tmp_path)).splitlines()
    table = [line for line in lines if line.startswith("|")]
    assert [line.split("|")[1].strip() for line in table[2:]] == [
        *("`null-truth` (baseline)", "`good`", "`poor`")
    ]
    assert "* `null-truth`: the truth (knows the truth)" in lines
    assert len({line.count("|") for line in table}) == 1
    assert "PA-MPJPE, mm ↓" in table[0]
    number = table[0].split("PA-MPJPE, mm ↓ [")[1].split("]")[0]
    assert f"{number}. PA-MPJPE: {METRICS['pa_mpjpe'].alignment}" in lines


def test_markdown_escapes_what_would_break_the_table(tmp_path: Path) -> None:
    evaluation = make_evaluation(tmp_path)
    scores = replace(evaluation.scores[1], title="a | b\n*c* <d>")
    text = markdown_table(replace(evaluation, scores=(evaluation.scores[0], scores)))
    assert r"a \| b \*c\* \<d>" in text


def test_the_best_is_bold_and_never_a_baseline(tmp_path: Path) -> None:
    table = main_table(make_evaluation(tmp_path))
    assert [bold for _, bold in column(table, "PA-MPJPE, mm")] == [False, True, False]
    assert [bold for _, bold in column(table, "AUC 20-50 mm ↑")] == [False, True, False]
    assert column(table, "PA-MPJPE, mm")[0][0] == "0.00"  # though the baseline is exactly right
    assert not any(cell.is_best for cell in table.rows[0])
    assert table.muted == {0}


def test_higher_is_bold_where_higher_is_better_and_equals_are_not(tmp_path: Path) -> None:
    evaluation = with_summary(
        make_evaluation(tmp_path),
        good={"handedness": 80.0, "fit_ms": 3.01, "epe": 5.0},
        poor={"handedness": 90.0, "fit_ms": 3.02, "epe": math.nan},
    )
    table = main_table(evaluation)
    assert [bold for _, bold in column(table, "Side right")] == [False, False, True]
    assert [bold for _, bold in column(table, "Fit")] == [False, False, False]  # both are shown as 3.0
    assert column(table, "EPE, mm") == [("0.00", False), ("5.00", False), (MISSING, False)]


def test_groups_leave_out_what_is_no_group(tmp_path: Path) -> None:
    scores = make_evaluation(tmp_path).scores[1]
    assert list(groups_of(scores)) == ["view", "pose", "frame"]
    many = replace(scores, tags=tuple({"frame": str(i), "set": "one"} for i in range(COUNT)))
    assert list(groups_of(many)) == ["view", "frame"]
    names = make_evaluation(tmp_path).scores[1].samples * 4
    wide = replace(
        scores, samples=names, views=("palm",) * 24, tags=tuple({"frame": str(i)} for i in range(24))
    )
    assert groups_of(wide) == {}


def test_group_means_and_rates_are_of_the_group(tmp_path: Path) -> None:
    evaluation = make_evaluation(tmp_path, missed=(1,))
    table = group_table(evaluation)
    assert table is not None
    assert [c.title for c in table.columns] == [
        "Group",
        "Value",
        "Hands",
        "Detected, %",
        "good, mm",
        "poor, mm",
    ]
    rows = {(row[0].text, row[1].text): [cell.text for cell in row[2:]] for row in table.rows}
    poor = evaluation.scores[2].pa_error
    fists = np.mean([poor[3].mean(), poor[5].mean()])  # 1 was missed
    assert rows["pose", "fist"][:2] == ["3", "66.7"]
    assert rows["pose", "fist"][3] == f"{fists:.2f}"
    assert rows["pose", "open"][1] == "100.0"
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
    assert words in verdict(Comparison("a", "b", "pa_mpjpe", difference, low, high, hands, units))


def test_comparisons_show_interval_and_verdict(tmp_path: Path) -> None:
    evaluation = make_evaluation(tmp_path)
    (unsure,) = [replace(c, metric="pa_mpjpe", low=-1.0, high=1.0) for c in evaluation.comparisons]
    tables = comparison_tables(replace(evaluation, comparisons=(*evaluation.comparisons, unsure)))
    assert [metric.key for metric, _ in tables] == ["pa_mpjpe", "epe"]  # the error in front comes first
    assert tables[0][1].rows[0][0].text.startswith("poor and good: no difference shown")
    (row,) = tables[1][1].rows
    assert "poor is" in row[0].text
    assert "worse than good" in row[0].text
    assert row[1].text == f"{evaluation.comparisons[0].difference:.2f}"
    assert comparison_tables(replace(evaluation, comparisons=())) == []


def test_published_numbers_are_the_papers(tmp_path: Path) -> None:
    by_name = {e.solver: e.results for e in EXPERIMENTS}
    assert list(by_name) == [f"paper-{letter}" for letter in "abcdefgh"]
    assert by_name["paper-h"] == {"egodexter": (42.833, 0.492), "dexter-object": (24.574, 0.784)}
    assert OTHERS_AUC["dexter-object"]["Zhou 2020"] == 0.948
    assert OTHERS_AUC["egodexter"]["Zhou 2020"] == 0.811
    assert experiments_table(make_evaluation(tmp_path)) is None
    assert others_table(make_evaluation(tmp_path)) is None


def test_published_numbers_stand_beside_ours(tmp_path: Path) -> None:
    evaluation = make_evaluation(tmp_path, kind="egodexter", protocol="paper")
    ours = replace(evaluation.scores[1], method="paper-b")
    evaluation = replace(
        evaluation,
        scores=(ours, evaluation.scores[2]),
        summaries={**evaluation.summaries, "paper-b": {"epe": 20.642, "auc": 0.999}},
    )
    table = experiments_table(evaluation)
    assert table is not None
    a, b = [[cell.text for cell in row] for row in table.rows][:2]
    assert a[3:] == ["17.72", MISSING, MISSING, "0.883", MISSING, MISSING]
    assert b[3:] == ["19.64", "20.64", "1.00", "0.859", "0.999", "0.140"]
    others = others_table(evaluation)
    assert others is not None
    values = [float(row[1].text) for row in others.rows]
    assert values == sorted(values, reverse=True)
    assert [row[0].text for row in others.rows if row[0].is_best] == ["paper-b, here", "poor, here"]
    assert "`paper-b`" in markdown(table)
