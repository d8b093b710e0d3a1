"""The report as a folder: complete, linked, escaped, and honest about what it lacks."""

from __future__ import annotations

import json
import logging
import sys
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest

from handfit_core.errors import OptionError
from handfit_core.evaluate.report import REPORT_FILES, write_report
from tests.core.evaluate.reports import make_evaluation

VOID = {"meta", "img", "br", "link", "hr", "input"}
OPTIONAL_PLOTS = {name for name in REPORT_FILES if name.endswith(".svg")}


class Page(HTMLParser):
    """Collects links, ids and text, and fails where tags do not nest."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.seen: set[str] = set()
        self.links: list[str] = []
        self.ids: set[str] = set()
        self.text = ""
        self.bold: list[str] = []
        self.feed(text)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.seen.add(tag)
        if tag not in VOID:
            self.open.append(tag)
        for key, value in attrs:
            if key in ("src", "href"):
                self.links.append(value or "")
            if key == "id":
                self.ids.add(value or "")

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if "style" not in self.open:
            self.text += data
        if "b" in self.open and "td" in self.open:
            self.bold.append(data)


def read_page(folder: Path) -> Page:
    return Page((folder / "index.html").read_text(encoding="utf-8"))


@pytest.fixture
def needs_matplotlib() -> None:
    pytest.importorskip("matplotlib", reason="plots need matplotlib, an extra")


@pytest.fixture
def no_matplotlib(monkeypatch: pytest.MonkeyPatch) -> None:
    for module in [m for m in sys.modules if m.split(".")[0] == "matplotlib"]:
        monkeypatch.delitem(sys.modules, module)
    monkeypatch.setitem(sys.modules, "matplotlib", None)  # an import of it now fails


@pytest.mark.usefixtures("needs_matplotlib")
def test_a_whole_report_and_nothing_else(tmp_path: Path) -> None:
    files = write_report(tmp_path / "report", make_evaluation(tmp_path))
    assert files[0] == tmp_path / "report" / "index.html"
    assert {f.name for f in files} == set(REPORT_FILES) - {"pck_published.svg"}
    assert set(files) == set((tmp_path / "report").iterdir())
    assert all(f.stat().st_size > 0 for f in files)


@pytest.mark.usefixtures("needs_matplotlib")
def test_the_page_is_well_formed_offline_and_links_to_all_files(tmp_path: Path) -> None:
    files = write_report(tmp_path / "report", make_evaluation(tmp_path, kind="egodexter"))
    page = read_page(tmp_path / "report")
    assert "script" not in page.seen
    assert "link" not in page.seen
    for link in page.links:
        assert ":" not in link
        assert not link.startswith("/")
        assert (tmp_path / "report" / link).is_file(), link
    wanted = {f.name for f in files} - {"index.html"}
    assert set(page.links) == wanted
    assert {
        "table",
        "pck",
        "published",
        "comparisons",
        "breakdown",
        "sheets",
        "problems",
        "setup",
    } <= page.ids
    style = (tmp_path / "report" / "index.html").read_text().split("</style>")[0]
    assert "url(" not in style
    assert "@import" not in style


@pytest.mark.usefixtures("no_matplotlib")
def test_without_matplotlib_the_report_stands_but_for_plots(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    with caplog.at_level(logging.WARNING, "handfit"):
        files = write_report(tmp_path / "report", make_evaluation(tmp_path))
    assert {f.name for f in files} == set(REPORT_FILES) - OPTIONAL_PLOTS
    assert "pip install matplotlib" in caplog.text
    page = read_page(tmp_path / "report")
    assert "pip install matplotlib" in page.text
    assert not any(link.endswith(".svg") for link in page.links)


@pytest.mark.usefixtures("no_matplotlib")
def test_names_are_escaped(tmp_path: Path) -> None:
    evil = "<script>alert('x&y')</script>"
    evaluation = make_evaluation(
        tmp_path, dataset=evil, problems={evil: (evil,)}, names=[f"{evil}{i}" for i in range(6)]
    )
    write_report(tmp_path / "report", evaluation)
    page = read_page(tmp_path / "report")
    assert "script" not in page.seen
    assert page.text.count(f"{evil}5") >= 1  # its name under a sheet
    assert page.text.count(evil) >= 6


@pytest.mark.usefixtures("no_matplotlib")
def test_problems_are_counted_shown_first_and_listed_whole(tmp_path: Path) -> None:
    problems = {"picture missing": ("one",), "labels cannot be read": tuple(f"Desk/{i}" for i in range(13))}
    write_report(tmp_path / "report", make_evaluation(tmp_path, problems=problems))
    text = read_page(tmp_path / "report").text
    assert "14 things could not be used" in text
    assert text.index("14 things") < text.index("All methods")
    assert text.index("13 × labels cannot be read") < text.index("1 × picture missing")
    assert "Desk/9" in text
    assert "Desk/10" not in text
    assert "and 3 more" in text
    assert len((tmp_path / "report" / "problems.csv").read_text().splitlines()) == 1 + 14


@pytest.mark.usefixtures("no_matplotlib")
def test_what_an_earlier_report_left_does_not_stay(tmp_path: Path) -> None:
    folder = tmp_path / "report"
    write_report(folder, make_evaluation(tmp_path, missed=(1,)))
    assert (folder / "missed.jpg").is_file()
    (folder / "my-notes.txt").write_text("mine")
    (folder / "pck.svg").write_text("from a run with matplotlib")
    write_report(folder, make_evaluation(tmp_path, missed=(), problems={}))
    assert not (folder / "missed.jpg").exists()
    assert not (folder / "problems.csv").exists()
    assert not (folder / "pck.svg").exists()
    assert (folder / "my-notes.txt").read_text() == "mine"


@pytest.mark.usefixtures("no_matplotlib")
def test_headline_and_setup(tmp_path: Path) -> None:
    evaluation = make_evaluation(tmp_path, missed=(1, 2))
    write_report(tmp_path / "report", evaluation)
    text = read_page(tmp_path / "report").text
    error = np.nanmean(next(s for s in evaluation.scores if s.method == "good").pa_error)
    assert "6 pictures, 6 labelled hands, 66.7 % of them detected." in text
    assert f"Best of 2 methods: good, PA-MPJPE {error:.2f} mm." in text
    setup = json.loads((tmp_path / "report" / "setup.json").read_text())
    assert setup["setup"] == {"machine": "a test's"}
    assert setup["protocol"] == "strict"
    assert setup["labelled_hands"] == 6


@pytest.mark.usefixtures("no_matplotlib")
def test_an_unknown_focus_says_what_there_is_and_writes_nothing(tmp_path: Path) -> None:
    with pytest.raises(OptionError, match=r"'best'.*good, poor"):
        write_report(tmp_path / "report", make_evaluation(tmp_path), focus="best")
    assert not (tmp_path / "report").exists()


@pytest.mark.usefixtures("no_matplotlib")
@pytest.mark.parametrize("protocol", ["strict", "paper"])
def test_nothing_detected_is_a_report_too(tmp_path: Path, protocol) -> None:
    write_report(tmp_path / "report", make_evaluation(tmp_path, missed=range(6), protocol=protocol))
    text = read_page(tmp_path / "report").text
    assert "0.0 % of them detected. No method has an error to show." in text
    assert (tmp_path / "report" / "missed.jpg").is_file()
    assert not (tmp_path / "report" / "worst.jpg").exists()


@pytest.mark.usefixtures("needs_matplotlib")
def test_the_papers_protocol_names_its_alignment_and_has_no_joint_plot(tmp_path: Path) -> None:
    write_report(tmp_path / "report", make_evaluation(tmp_path, protocol="paper", kind="dexter-object"))
    assert not (tmp_path / "report" / "per_joint.svg").exists()
    assert (tmp_path / "report" / "pck_published.svg").is_file()
    text = read_page(tmp_path / "report").text
    assert "true camera and true mean depth given" in text
    assert "No error per joint" in text
    assert "by the same protocol" in text


@pytest.mark.usefixtures("needs_matplotlib")
def test_the_same_numbers_give_the_same_files(tmp_path: Path) -> None:
    evaluation = make_evaluation(tmp_path)
    first = {f.name: f.read_bytes() for f in write_report(tmp_path / "a", evaluation)}
    assert {f.name: f.read_bytes() for f in write_report(tmp_path / "b", evaluation)} == first
