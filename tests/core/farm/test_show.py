"""What is told while a batch runs: bars that fit any terminal, lines for programs, the time that is left."""

from __future__ import annotations

import json
import os
import re
import sys

import pytest

from handfit_core.farm.collect import Report
from handfit_core.farm.plan import Plan, Task
from handfit_core.farm.report import Result
from handfit_core.farm.show import ProgressReporter

CLEARED = "\r\x1b[J"


class Clock:
    """A clock that stands still unless it is turned."""

    def __init__(self) -> None:
        self.now = 100.0

    def monotonic(self) -> float:
        return self.now


@pytest.fixture
def clock(monkeypatch):
    clock = Clock()
    monkeypatch.setattr("handfit_core.farm.show.time", clock)
    return clock


def tasks(*names: str, cost: float = 10.0) -> list[Task]:
    return [Task(f"id-{name}", name, f"{name}.mp4", cost=cost) for name in names]


def ok(task: Task) -> Result:
    return Result(task.shown, task.name, "ok", id=task.id)


def seconds_left(reporter: ProgressReporter, clock: Clock, capsys) -> float:
    clock.now += 1.0
    reporter.turn()
    return json.loads(capsys.readouterr().out.splitlines()[-1])["seconds_left"]


def test_time_left_begins_with_the_guess_and_follows_what_is_measured(clock, capsys):
    given = tasks(*"abcdefgh")
    reporter = ProgressReporter(given, "json")
    assert seconds_left(reporter, clock, capsys) == 80, "nothing is known yet"
    for task in given[:2]:
        reporter.began(task)
    assert seconds_left(reporter, clock, capsys) == 40, "two at a time"
    clock.now += 29.0
    for task in given[:2]:
        reporter.ended(task, ok(task))  # each took three times as long as was guessed
    left = seconds_left(reporter, clock, capsys)
    assert 30 * 2.5 < left < 30 * 3.1
    for task in given[2:4]:
        reporter.began(task)
        reporter.progress(task, "detect", 50, 100)
    assert seconds_left(reporter, clock, capsys) < left


def test_sealed_and_failed_tasks_say_nothing_of_how_long_others_take(clock, capsys):
    given = tasks(*"abcdefgh")
    reporter = ProgressReporter(given, "json")
    for task in given[:4]:
        reporter.ended(task, ok(task))  # which never began here
    reporter.began(given[4])
    reporter.ended(given[4], Result("e.mp4", "e", "failed", error="no hand"))
    assert seconds_left(reporter, clock, capsys) == 30


def test_the_longest_at_hand_is_shared_by_nobody(clock, capsys):
    given = [*tasks(*"abcdefg", cost=1.0), *tasks("long", cost=100.0)]
    reporter = ProgressReporter(given, "json")
    for task in given[-4:]:
        reporter.began(task)
    assert seconds_left(reporter, clock, capsys) == 100


def test_lines_for_programs(clock, capsys):
    (task, other) = given = tasks("a", "b")
    for style in ("json", "openjd", "none"):
        reporter = ProgressReporter(given, style)
        reporter.began(task)
        reporter.progress(task, "detect", 50, 100)
        clock.now += 10.0
        reporter.turn()
        reporter.ended(task, ok(task))
        reporter.began(other)
        reporter.ended(other, Result("b.mp4", "b", "failed", error="b.mp4: no hand"))
        reporter.close()
        lines = capsys.readouterr().out.splitlines()
        if style == "json":
            progress, done, failed = map(json.loads, lines)
            assert progress["tasks"] == [
                {"task": "id-a", "name": "a", "stage": "detect", "done": 50, "total": 100}
            ]
            assert 0 < progress["share"] < 0.5
            assert (done["status"], failed["status"]) == ("ok", "failed")
            assert failed["error"] == "b.mp4: no hand"
        elif style == "openjd":
            assert re.fullmatch(r"openjd_progress: \d+\.\d", lines[0])
            assert lines[1] == "openjd_status: a detect 50/100"
            assert lines[-1] == "openjd_fail: b.mp4: no hand"
        else:
            assert not lines


def test_logs_get_a_line_at_least_each_minute(clock, capsys):
    given = tasks("a", "b")
    reporter = ProgressReporter(given)
    reporter.began(given[0])
    for _ in range(600):
        clock.now += 1.0
        reporter.turn()
    assert len(capsys.readouterr().err.splitlines()) >= 10


def test_the_report_says_what_is_running(tmp_path, clock):
    given = tasks("a", "b")
    plan = Plan(tmp_path, tuple(given), {})
    plan.save()
    report = Report([plan])
    reporter = ProgressReporter(given, "none", report)
    reporter.began(given[0])
    reporter.turn()

    def statuses() -> list[str]:
        return [r["status"] for r in json.loads((tmp_path / "report.json").read_text())["inputs"]]

    assert statuses() == ["running", "pending"]
    reporter.interrupted()
    assert statuses() == ["interrupted", "pending"]


@pytest.mark.skipif(sys.platform == "win32", reason="needs pseudoterminals")
@pytest.mark.parametrize(("columns", "rows"), [(200, 50), (80, 24), (40, 6), (12, 3), (0, 0)])
def test_bars_fit_the_terminal_and_leave_nothing(columns, rows, clock, monkeypatch):
    import fcntl
    import pty
    import struct
    import termios

    ours, theirs = pty.openpty()
    fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", rows, columns, 0, 0))
    monkeypatch.setenv("TERM", "xterm")
    given = tasks("a clip", "手のジェスチャー" * 9, "moves\x1b[9Athe cursor", *"defghijk")
    with os.fdopen(theirs, "w", encoding="utf-8") as terminal, os.fdopen(ours, "rb", buffering=0) as screen:
        monkeypatch.setattr("sys.stderr", terminal)
        reporter = ProgressReporter(given)
        for task in given:
            reporter.began(task)
            reporter.progress(task, "detect", 50, 100)
        clock.now += 1.0
        reporter.turn()
        reporter.close()
        terminal.write("end")
        terminal.flush()
        said = b""
        while not said.endswith(b"end"):
            said += screen.read(1 << 10)
    before, drawn, after = said.decode("utf-8").split(CLEARED)
    assert (before, after) == ("", "end"), "nothing is left"
    drawn, up = re.fullmatch(r"(.*)\r(?:\x1b\[(\d+)A)?", drawn, re.DOTALL).groups()
    lines = drawn.split("\r\n")
    assert len(lines) - 1 == int(up or 0), "the cursor goes back to where it was"
    assert len(lines) < (rows or 24)
    assert all(len(text) + len(re.findall(r"[^\x00-\xff]", text)) < (columns or 80) for text in lines)
    assert "\x1b" not in drawn
    if columns >= 40:
        assert "0 of 11 done" in lines[0]
