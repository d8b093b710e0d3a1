"""overview.html, read as a browser reads it: what stands where, where links lead, what names cannot do."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from datetime import UTC, datetime
from html.parser import HTMLParser
from pathlib import Path
from typing import Any
from urllib.parse import unquote_to_bytes, urlsplit

import pytest

from handfit_core.errors import OutputError
from handfit_core.tasks.overview import section_of, write_overview

VOID = {"meta", "input", "img", "br", "li", "th", "td"}
"""Without an end of their own here"""


class Page(HTMLParser):
    """What is on a page: its articles with their texts by section, links, pictures, and every tag."""

    def __init__(self, path: Path) -> None:
        super().__init__(convert_charrefs=True)
        self.tags: list[str] = []
        self.attributes: list[tuple[str, str | None]] = []
        self.links: list[str] = []
        self.pictures: list[dict[str, str | None]] = []
        self.sections: dict[str, list[str]] = {}
        self.head = ""
        self._open: list[str] = []
        self._section = ""
        self._in_article = False
        self.feed(path.read_text(encoding="utf-8"))
        self.close()
        assert self._open == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.attributes += attrs
        given = dict(attrs)
        if tag == "section":
            self._section = given["id"] or ""
            self.sections[self._section] = []
        if tag == "article":
            self.sections[self._section].append("")
            self._in_article = True
        if tag == "a":
            self.links.append(given["href"] or "")
        if tag == "img":
            self.pictures.append(given)
        if tag not in VOID:
            self._open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        if tag not in VOID:
            assert self._open.pop() == tag
        if tag == "article":
            self._in_article = False

    def handle_data(self, data: str) -> None:
        if {"style", "script"} & set(self._open):
            return
        if self._in_article:
            self.sections[self._section][-1] += data
        elif not self._section:
            self.head += f" {data}"

    @property
    def files(self) -> list[str]:
        """Where links and pictures lead, but for those on the page itself."""
        found = [link for link in self.links if not link.startswith("#")]
        return found + [picture["src"] or "" for picture in self.pictures]


def hand(error: float | None = 0.006, detected: int = 100, **fields: Any) -> dict[str, Any]:
    return {"side": "right", "detected": detected, "mean_expected_error": error} | fields


def ok(name: str, *hands: dict[str, Any], **fields: Any) -> dict[str, Any]:
    return {
        "name": name,
        "input": f"/footage/{name}.mp4",
        "status": "ok",
        "seconds": 10.0,
        "frames": 100,
        "hands": list(hands or [hand()]),
        "host": "one",
        "files": [f"{name}/{name}{end}" for end in (".take.npz", ".sheet.jpg", ".blend")],
        "warnings": [],
    } | fields


def failed(name: str, error: str = "no hand", **fields: Any) -> dict[str, Any]:
    return ok(name, status="failed", error=error, hands=[], files=[], frames=0) | fields


def made(folder: Path, *entries: dict[str, Any]) -> Page:
    write_overview(folder / "overview.html", folder.name, entries)
    return Page(folder / "overview.html")


def names(articles: list[str], of: str) -> list[str]:
    """Those of the names which stand in the articles, in their order."""
    return [next(name for name in of.split() if name in text) for text in articles]


def test_what_needs_a_look_comes_first_and_the_worst_on_top(tmp_path: Path) -> None:
    page = made(
        tmp_path,
        ok("fine", hand(0.004)),
        {"name": "waits", "input": "w.mp4", "status": "pending"},
        ok("fair", hand(0.010)),
        ok("poor", hand(0.013)),
        ok("warned", warnings=["The clip breaks off."]),
        failed("broken"),
        ok("worst", hand(0.006), hand(0.030, side="left")),
        ok("missing", hand(0.006, detected=50)),
        ok("unsure", hand(0.006, doubtful=60)),
        ok("handless", hands=[]),
    )
    assert list(page.sections) == ["failed", "doubtful", "good", "pending"]
    expected = {
        "failed": "broken",
        "doubtful": "worst unsure poor missing warned handless",
        "good": "fair fine",
        "pending": "waits",
    }
    for section, order in expected.items():
        assert sorted(names(page.sections[section], order)) == sorted(order.split()), section
    assert names(page.sections["doubtful"], expected["doubtful"]) == expected["doubtful"].split()
    assert names(page.sections["good"], "fair fine") == ["fair", "fine"]


def test_every_hand_is_told_with_its_error_in_words(tmp_path: Path) -> None:
    hands = hand(0.0131), hand(None, 90, side="left", mean_error_of_hand=0.031), hand(None, mean_error=1)
    page = made(tmp_path, ok("a", *hands))
    (text,) = page.sections["doubtful"]
    assert "right hand in 100 of 100 frames, likely error 13.1 mm (poor)" in text
    assert "left hand in 90 of 100 frames, error 3.1 % of the hand (fair)" in text
    (text,) = made(tmp_path, ok("photo", hand(0.0158, 1), frames=1)).sections["good"]
    assert "right hand, likely error 15.8 mm (fair)" in text
    (text,) = made(tmp_path, ok("photo", hand(0.006, 1), frames=1)).sections["good"]
    assert "right hand, likely error 6.0 mm (good)" in text
    assert "1 frame ·" in text


def test_what_nobody_knows_is_called_neither_good_nor_poor(tmp_path: Path) -> None:
    unknown = hand(None, mean_error_of_hand=0.001, error_known=False)
    page = made(tmp_path, ok("known"), ok("missing", unknown | {"detected": 10}), ok("unknown", unknown))
    assert {name: len(found) for name, found in page.sections.items()} == {
        "doubtful": 1,
        "unknown": 1,
        "good": 1,
    }
    assert "right hand in 100 of 100 frames, likely error not known" in page.sections["unknown"][0]
    assert "3" in page.head


def test_failures_are_told_with_their_attempts_and_hosts(tmp_path: Path) -> None:
    tried = [
        {"error": f"died of {what}", "kind": "WorkerError", "host": host, "seconds": 75.0, "at": ""}
        for what, host in (("hunger", "one"), ("thirst", "two"))
    ]
    page = made(
        tmp_path, failed("twice", "died of thirst", attempts=tried), failed("once", attempts=tried[:1])
    )
    twice, once = sorted(page.sections["failed"], key=len, reverse=True)
    assert "attempt 1 on one failed after 1 min: died of hunger" in twice
    assert "attempt 2 on two failed after 1 min: died of thirst" in twice
    assert "no hand" in once
    assert "attempt" not in once  # which would say the same again
    # What failed before it went well, too.
    (text,) = made(tmp_path, ok("retried", attempts=tried[:1])).sections["good"]
    assert "attempt 1 on one failed after 1 min: died of hunger" in text


def test_on_top_stands_how_far_it_is(tmp_path: Path) -> None:
    entries = [ok(f"a{n}", seconds=20.0) for n in range(3)] + [ok("b", host="two", seconds=100.0)]
    waiting = [{"name": f"w{n}", "input": "w.mp4", "status": "pending"} for n in range(1500)]
    at = datetime(2026, 5, 4, 3, 2, tzinfo=UTC)
    write_overview(
        tmp_path / "overview.html", tmp_path.name, [*entries, failed("c", host="two"), *waiting], at=at
    )
    page = Page(tmp_path / "overview.html")
    head = " ".join(page.head.split())
    assert tmp_path.name in head
    assert "2026-05-04 03:02 UTC" in head
    assert "1 failed 4 good 1 500 waiting" in head
    assert "400 frames in 3 min, 2.5 a second." in head
    assert "1 500 left, about 16 h 40 min of work by the mean" in head
    assert {"#failed", "#good", "#pending"} == {link for link in page.links if link.startswith("#")}


def test_links_lead_to_the_files_whatever_they_are_called(tmp_path: Path) -> None:
    wild = (
        *("plain", "with space", "100%25", "a#b?c&d=e", 'quote"', "it's", "<b>bold<b>", "手 ملف कार्य"),
        *(
            "javascript:alert(1)",
            "back\\slash",
            "\udcff\udc80",
            "line\nbreak",
            "x" * 200,
            "..dots..",
            "\U0001f91a",
        ),
    )
    entries = []
    for name in wild:
        (tmp_path / name).mkdir()
        entries.append(ok(name))
        for file in entries[-1]["files"]:
            (tmp_path / file).touch()
    (tmp_path / "report.json").touch()
    page = made(tmp_path, *entries)
    assert len(page.pictures) == len(wild)
    assert len(page.files) == 1 + 4 * len(wild)  # a sheet is shown, and leads to itself
    for link in page.files:
        parts = urlsplit(link)
        assert not any((parts.scheme, parts.netloc, parts.query, parts.fragment)), link
        assert (tmp_path / os.fsdecode(unquote_to_bytes(parts.path))).is_file()
    assert {picture["loading"] for picture in page.pictures} == {"lazy"}


HOSTILE = (
    *("<script>alert(1)</script>", '"><img src=x onerror=alert(1)>', "'onmouseover='alert(1)", "%s{0}{x!r}"),
    *(
        "</article></main>",
        "</style><script>",
        "<!--",
        "]]>",
        "&lt;&#60;",
        "\0\x07\x1b[31m\ud800",
        "\u202egpj.exe",
    ),
    "//evil/x",
)


@pytest.mark.parametrize("text", HOSTILE)
def test_no_text_becomes_part_of_the_page(text: str, tmp_path: Path) -> None:
    def entry(said: str) -> list[dict[str, Any]]:
        attempts = [{"error": said, "host": said, "seconds": 1.0}] * 5
        told = {"input": said, "host": said, "attempts": attempts, "warnings": [said] * 5}
        files = [said, f"{said}/{said}.sheet.jpg"]
        return [
            ok(said, hand(0.05, side=said), files=files, **told),
            failed(said, said, **told),
            {"name": said, "status": "pending", "error": said, **told},
        ]

    harmless, page = made(tmp_path, *entry("harmless")), made(tmp_path, *entry(text))
    assert page.tags == harmless.tags
    assert [name for name, _ in page.attributes] == [name for name, _ in harmless.attributes]
    shown = "".join("".join(articles) for articles in page.sections.values())
    plain = text.translate({0: "\ufffd", 7: "\ufffd", 0x1B: "\ufffd", 0xD800: "\ufffd"})
    assert shown.replace("\ufffd", "").count(plain.replace("\ufffd", "")) >= 8
    for link in page.files:
        assert link.startswith("./") or link == "report.json"


def test_the_page_needs_nothing_from_elsewhere(tmp_path: Path) -> None:
    write_overview(tmp_path / "overview.html", "title", [ok("a"), failed("b")])
    text = (tmp_path / "overview.html").read_text(encoding="utf-8")
    assert "http" not in text
    assert "url(" not in text
    assert "@import" not in text
    page = Page(tmp_path / "overview.html")
    assert not {"link", "iframe", "object", "base"} & set(page.tags)


ODD: list[Callable[[dict[str, Any]], Any]] = [
    lambda entry: entry.clear(),
    lambda entry: entry.update(hands=None, files=None, warnings=None, attempts=3),
    lambda entry: entry.update(hands=[None, {}, {"side": 4, "detected": "x", "mean_expected_error": "y"}]),
    lambda entry: entry.update(seconds=float("nan"), frames=float("inf")),
    lambda entry: entry.update(name=7, input=None, files=[3, None], warnings=[{"a": 1}], attempts=["?"]),
    lambda entry: entry.update(status="unheard of"),
    lambda entry: entry.update(frames=0),
]


@pytest.mark.parametrize("change", ODD)
def test_entries_that_another_version_wrote_end_in_a_page(
    change: Callable[[dict[str, Any]], Any], tmp_path: Path
) -> None:
    entry = ok("odd")
    change(entry)
    page = made(tmp_path, entry, ok("fine"))
    assert sum(map(len, page.sections.values())) == 2
    assert any("fine" in text for text in page.sections["good"])


def test_an_empty_batch_says_so(tmp_path: Path) -> None:
    page = made(tmp_path)
    assert "There is nothing in this batch." in page.head
    assert page.sections == {}


def test_much_is_folded_away_and_ten_thousand_entries_stay_small(tmp_path: Path) -> None:
    (text,) = made(tmp_path, ok("a", warnings=[f"warning {n}" for n in range(40)])).sections["doubtful"]
    assert "37 more" in text
    made(tmp_path, *[ok(f"clip_{n:05d}") for n in range(10_000)])
    assert (tmp_path / "overview.html").stat().st_size < 10_000_000


def test_it_is_written_whole_or_not_at_all(tmp_path: Path) -> None:
    (tmp_path / "overview.html").mkdir()
    with pytest.raises(OutputError):
        write_overview(tmp_path / "overview.html", "title", [ok("a")])
    assert [path.name for path in tmp_path.iterdir()] == ["overview.html"]


def test_entries_of_a_report_are_understood(tmp_path: Path) -> None:
    """As they come out of the file, and not only as they were made."""
    entries = json.loads(json.dumps([ok("a"), failed("b")]))
    assert [section_of(entry) for entry in entries] == ["good", "failed"]
    assert len(made(tmp_path, *entries).sections) == 2
