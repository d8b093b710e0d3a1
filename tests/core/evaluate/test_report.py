"""The report as a folder: linked, escaped, its numbers those of the evaluation."""

from __future__ import annotations

import csv
import math
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pandas as pd

from handfit_core.evaluate.report import as_text, main_table, tag_table, write_report
from handfit_core.evaluate.scores import Evaluation
from handfit_core.evaluate.views import views_table
from tests.core.evaluate.made import COUNT, make_evaluation, make_scores
from tests.golden import Golden


class Page(HTMLParser):
    """Collects tags, links and text."""

    def __init__(self, folder: Path, evaluation: Evaluation) -> None:
        super().__init__()
        self.tags: set[str] = set()
        self.links: set[str] = set()
        self.text = ""
        self.files = write_report(folder, evaluation)
        self.feed(self.files[0].read_text(encoding="utf-8"))

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.add(tag)
        self.links |= {value or "" for key, value in attrs if key in ("src", "href")}

    def handle_data(self, data: str) -> None:
        self.text += data


def read_csv(path: Path) -> list[dict[str, str]]:
    with open(path, newline="", encoding="utf-8") as stream:
        return list(csv.DictReader(stream))


def test_the_page_links_all_tables_and_escapes_names(tmp_path: Path) -> None:
    evil = "<script>alert('x&y')</script>" + 60 * "x"
    tags = [{evil: "b" if i else evil} for i in range(COUNT)]
    evaluation = make_evaluation(dataset=evil, problems={evil: (evil,)})
    scores = tuple(replace(s, hands=s.hands.assign(tags=tags)) for s in evaluation.scores)
    page = Page(tmp_path, replace(evaluation, scores=scores))
    assert {file.name for file in page.files} == page.links | {"index.html"}
    assert set(page.files) == set(tmp_path.iterdir())
    assert not page.tags & {"script", "link", "img"}
    assert page.text.count(evil) >= 5  # title, heading, problem, tag and its value
    assert "Labelled hands: 6." in page.text


def test_nothing_detected_is_a_report_too(tmp_path: Path) -> None:
    for protocol in ("strict", "paper"):
        missed = make_scores(3, detected=np.zeros(3, dtype=bool))
        summaries = pd.DataFrame({"made": {"detection_rate": 0.0, "epe": math.nan}}).T
        evaluation = make_evaluation(protocol=protocol, scores=(missed,), summaries=summaries, comparisons=())
        assert "0.0" in Page(tmp_path / protocol, evaluation).text


def test_csv_files_hold_every_number_exactly(tmp_path: Path) -> None:
    evaluation = make_evaluation()
    write_report(tmp_path, evaluation)
    rows = read_csv(tmp_path / "table.csv")
    assert [row["method"] for row in rows] == ["null-truth", "good", "poor"]
    for row in rows:
        for key, value in evaluation.summaries.loc[row["method"]].items():
            assert row.get(key, "") == (repr(float(value)) if math.isfinite(value) else "")
    assert "pa_mpvpe" not in rows[0]  # no meshes, no column
    hands = read_csv(tmp_path / "per_hand.csv")
    assert len(hands) == 3 * COUNT
    good = [row for row in hands if row["method"] == "good"]
    assert good[1]["pa_mpjpe"] == good[1]["fit_ms"] == ""  # missed
    mean = np.mean([float(row["pa_mpjpe"]) for row in good if row["pa_mpjpe"]])
    assert math.isclose(mean, evaluation.summaries.loc["good", "pa_mpjpe"])
    assert (good[0]["sample"], good[0]["tag_pose"]) == ("Desk/00000", "open")
    (compared,) = read_csv(tmp_path / "comparisons.csv")
    assert float(compared["difference"]) == evaluation.comparisons[0].difference
    assert read_csv(tmp_path / "problems.csv") == [{"kind": "picture cannot be read", "where": "Desk/00007"}]


def test_tables(golden: Golden) -> None:
    evaluation = make_evaluation()
    summaries = evaluation.summaries.copy()
    columns = ["auc", "handedness", "fit_ms", "epe"]
    summaries.loc[["good", "poor"], columns] = [[0.999, 80.0, 3.01, 20.642], [0.9, 90.0, 3.02, math.nan]]
    evaluation = replace(evaluation, summaries=summaries)
    compared = pd.DataFrame(evaluation.comparisons).round(2)
    tables = as_text(main_table(evaluation)), as_text(tag_table(evaluation)), compared
    golden.check("evaluation.txt", "\n\n".join(t.to_string(index=False) for t in tables) + "\n", steps=1)


def test_what_is_no_group() -> None:
    """A tag with one value, or with more than a table holds."""
    many = make_scores(24, tags=[{"frame": str(i), "set": "one"} for i in range(24)])
    assert tag_table(make_evaluation(scores=(many,))).empty


def test_table_of_evaluated_pairs() -> None:
    """Means and largest values of each level and group; strangers only count."""
    levels = [("nothing", "near", 1.0), ("nothing", "far", 3.0), ("cameras", "near", 0.5)]
    rows = [
        {"told": told, "group": group, "belongs": True, "verdict": "good", "offset": offset}
        for told, group, offset in levels
    ]
    rows.append(rows[0] | {"belongs": False, "verdict": "failed", "offset": 50.0})
    numbers = [line.split() for line in views_table(pd.DataFrame(rows)).splitlines()]
    assert ["offset", "mean", "1.0", "3.0", "0.5", "2.0", "0.5"] in numbers
    assert ["max", "1.0", "3.0", "0.5", "3.0", "0.5"] in numbers
    assert ["nothing", "False", "1", "0"] in numbers
