"""overview.html, read as a browser reads it: what stands where, where links lead, what names cannot do."""

from __future__ import annotations

import os
from dataclasses import replace
from datetime import UTC, datetime
from html.parser import HTMLParser
from pathlib import Path
from typing import Any
from urllib.parse import unquote_to_bytes, urlsplit

import pytest

from handfit_core.tasks.overview import write_overview
from handfit_core.tasks.record import Attempt, Hand, Result

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


def hand(error: float | None = 0.006, detected: int = 100, side: str = "right", **fields: Any) -> Hand:
    return Hand(side, detected, **{"error_known": True, "mean_expected_error": error, **fields})


def ok(name: str, *hands: Hand, **fields: Any) -> Result:
    files = [f"{name}/{name}{end}" for end in (".take.npz", ".sheet.jpg", ".blend")]
    known = {"seconds": 10.0, "frames": 100, "hands": list(hands or [hand()]), "host": "one", "files": files}
    return Result(f"/footage/{name}.mp4", name, **{"status": "ok", **known, **fields})


def failed(name: str, error: str = "no hand", **fields: Any) -> Result:
    return ok(name, **{"status": "failed", "error": error, "hands": [], "files": [], "frames": 0, **fields})


def made(folder: Path, *results: Result) -> Page:
    write_overview(folder / "overview.html", folder.name, results)
    return Page(folder / "overview.html")


def names(articles: list[str], of: str) -> list[str]:
    """Those of the names which stand in the articles, in their order."""
    return [next(name for name in of.split() if name in text) for text in articles]


def test_sections_and_their_order(tmp_path: Path) -> None:
    """What needs a look comes first, and the worst on top."""
    page = made(
        tmp_path,
        ok("fine", hand(0.004)),
        Result("w.mp4", "waits"),
        ok("fair", hand(0.010)),
        ok("poor", hand(0.013)),
        ok("warned", warnings=["The clip breaks off."]),
        failed("broken"),
        ok("nobody", hand(None, mean_error_of_hand=0.001, error_known=False)),
        ok("worst", hand(0.006), hand(0.030, side="left")),
        ok("missing", hand(0.006, detected=50)),
        ok("unsure", hand(0.006, doubtful=60)),
        ok("handless", hands=[]),
    )
    expected = {
        "failed": "broken",
        "doubtful": "worst unsure poor missing warned handless",
        "unknown": "nobody",
        "good": "fair fine",
        "pending": "waits",
    }
    assert list(page.sections) == list(expected)
    for section, order in expected.items():
        assert names(page.sections[section], order) == order.split(), section


@pytest.mark.parametrize(
    ("result", "said"),
    [
        (ok("a", hand(0.0131)), "right hand in 100 of 100 frames, likely error 13.1 mm (poor)"),
        (
            ok("a", hand(None, 90, side="left", mean_error_of_hand=0.031)),
            "left hand in 90 of 100 frames, error 3.1 % of the hand (fair)",
        ),
        (ok("a", hand(0.0158, 1), frames=1), "1 frame · 10 s · oneright hand, likely error 15.8 mm (fair)"),
        (ok("a", hand(0.006, 1), frames=1), "right hand, likely error 6.0 mm (good)"),
        (ok("a", hand(None, error_known=False)), "100 of 100 frames, likely error not known"),
        (ok("a", warnings=[f"warning {n}" for n in range(40)]), "37 more"),
    ],
)
def test_a_hand_in_words(tmp_path: Path, result: Result, said: str) -> None:
    ((text,),) = made(tmp_path, result).sections.values()
    assert said in text


def test_failures_are_told_with_their_attempts_and_hosts(tmp_path: Path) -> None:
    tried = [
        Attempt(f"died of {what}", "WorkerDied", host, 75.0)
        for what, host in (("hunger", "one"), ("thirst", "two"))
    ]
    page = made(
        tmp_path,
        *(failed("twice", "died of thirst", attempts=tried), failed("once", attempts=tried[:1])),
        ok("retried", attempts=tried[:1]),
    )
    twice, once = sorted(page.sections["failed"], key=len, reverse=True)
    for text in (twice, *page.sections["good"]):
        assert "attempt 1 on one failed after 1 min: died of hunger" in text
    assert "attempt 2 on two failed after 1 min: died of thirst" in twice
    assert "no hand" in once
    assert "attempt" not in once  # which would say the same again


def test_on_top_stands_how_far_it_is(tmp_path: Path) -> None:
    results = [ok(f"a{n}", seconds=20.0) for n in range(3)] + [ok("b", host="two", seconds=100.0)]
    results += [failed("c", host="two"), *(Result("w.mp4", f"w{n}") for n in range(1500))]
    at = datetime(2026, 5, 4, 3, 2, tzinfo=UTC)
    write_overview(tmp_path / "overview.html", tmp_path.name, results, at=at)
    page = Page(tmp_path / "overview.html")
    head = " ".join(page.head.split())
    for said in (
        *(tmp_path.name, "2026-05-04 03:02 UTC", "1 failed 4 good 1 500 waiting"),
        *("400 frames in 3 min, 2.5 a second.", "1 500 left, about 16 h 40 min of work by the mean"),
    ):
        assert said in head
    assert {"#failed", "#good", "#pending"} == {link for link in page.links if link.startswith("#")}
    assert "There is nothing in this batch." in made(tmp_path).head


def test_links_lead_to_the_files_whatever_they_are_called(tmp_path: Path) -> None:
    wild = ["plain", "with space", "100%25", "a#b?c&d=e", "it's \"", "<b>bold<b>", "手 ملف कार्य", "x" * 200]
    wild += ["javascript:alert(1)", "back\\slash", "\udcff\udc80", "line\nbreak", "..dots..", "\U0001f91a"]
    results = [ok(name) for name in wild]
    for result in results:
        (tmp_path / result.name).mkdir()
        for file in result.files:
            (tmp_path / file).touch()
    (tmp_path / "report.json").touch()
    page = made(tmp_path, *results)
    assert len(page.files) == 1 + 4 * len(wild)  # a sheet is shown, and leads to itself
    for link in page.files:
        parts = urlsplit(link)
        assert not any((parts.scheme, parts.netloc, parts.query, parts.fragment)), link
        assert (tmp_path / os.fsdecode(unquote_to_bytes(parts.path))).is_file()
    assert [picture["loading"] for picture in page.pictures] == ["lazy"] * len(wild)


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
    def entries(said: str) -> list[Result]:
        attempts = [Attempt(said, "WorkerDied", said, 1.0)] * 5
        told = {"host": said, "attempts": attempts, "warnings": [said] * 5}
        files = [said, f"{said}/{said}.sheet.jpg"]
        found = [ok(said, hand(0.05, side=said), files=files, **told), failed(said, said, **told)]
        return [replace(each, input=said) for each in [*found, Result(said, said, error=said, **told)]]

    harmless, page = made(tmp_path, *entries("harmless")), made(tmp_path, *entries(text))
    assert page.tags == harmless.tags
    assert [name for name, _ in page.attributes] == [name for name, _ in harmless.attributes]
    shown = "".join("".join(articles) for articles in page.sections.values())
    plain = text.translate({0: "\ufffd", 7: "\ufffd", 0x1B: "\ufffd", 0xD800: "\ufffd"})
    assert shown.replace("\ufffd", "").count(plain.replace("\ufffd", "")) >= 8
    for link in page.files:
        assert link.startswith("./") or link == "report.json"


def test_the_page_is_small_and_needs_nothing_from_elsewhere(tmp_path: Path) -> None:
    page = made(tmp_path, *[ok(f"clip_{n:05d}") for n in range(10_000)], failed("b"))
    text = (tmp_path / "overview.html").read_text(encoding="utf-8")
    assert len(text) < 10_000_000
    assert not [word for word in ("http", "url(", "@import") if word in text]
    assert not {"link", "iframe", "object", "base"} & set(page.tags)
