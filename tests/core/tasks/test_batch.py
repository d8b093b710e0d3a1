"""Whole batches, with captures that take no time, or die, or hang, as their inputs' names say."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import pytest

from handfit_core.common.files import PART
from handfit_core.take import Take
from tests.conftest import ROOT
from tests.core.tasks.fakes import CALLS
from tests.plates import heic, tile

pytest.importorskip("loky")

PATIENCE = 120.0
"""Seconds that a batch may take on a loaded machine"""


class Shop:
    """A folder of inputs, one of results, and the command that makes the one of the other."""

    def __init__(self, folder: Path, names: Sequence[str]) -> None:
        self.inputs, self.output = folder / "in", folder / "out"
        self.inputs.mkdir()
        for name in names:
            (self.inputs / f"{name}.jpg").write_bytes(name.encode())

    def start(self, *words: str, sheet: bool = False, more: Sequence[str] = ()) -> subprocess.Popen[str]:
        command = [sys.executable, "-m", "tests.core.tasks.fakes", *words, "-o", str(self.output)]
        command += ["--separate", *([] if sheet else ["--no-sheet"]), "--", str(self.inputs), *more]
        pipes: dict[str, Any] = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
        return subprocess.Popen(command, cwd=ROOT, text=True, start_new_session=True, **pipes)

    def run(self, *words: str, code: int = 0, **how: Any) -> str:
        """What the batch says; with a code of 2, only why not."""
        child = self.start(*words, **how)
        said, errors = child.communicate(timeout=PATIENCE)
        assert child.returncode == code, errors
        return errors if code == 2 else said

    @property
    def report(self) -> dict[str, dict[str, Any]]:
        entries = json.loads((self.output / "report.json").read_text())["inputs"]
        return {entry["name"]: entry for entry in entries}

    @property
    def statuses(self) -> dict[str, str]:
        return {name: entry["status"] for name, entry in self.report.items()}

    @property
    def calls(self) -> Counter[str]:
        return Counter((self.inputs / CALLS).read_text().split())

    @property
    def takes(self) -> dict[str, bytes]:
        return {path.name: path.read_bytes() for path in sorted(self.output.rglob("*.take.npz"))}

    @property
    def records(self) -> list[str]:
        """Names of the records that are at their place, also while folders beside them come and go."""
        return [
            name
            for folder, _, names in os.walk(self.output)
            for name in names
            if name.endswith(".json") and PART not in folder
        ]

    @property
    def unfinished(self) -> list[str]:
        return [path.name for path in self.output.rglob("*") if path.name.startswith((PART, "."))]


def lines(text: str) -> Iterator[dict[str, Any]]:
    return map(json.loads, text.splitlines())


@pytest.mark.parametrize(
    "jobs",
    [["--jobs", "2"], *(pytest.param(jobs, marks=pytest.mark.slow) for jobs in (["--jobs", "10000"], []))],
)
def test_every_input_once_and_skipped_the_second_time(tmp_path: Path, jobs: list[str]) -> None:
    shop = Shop(tmp_path, ["a", "b", "empty"])
    said = list(lines(shop.run("--progress", "json", *jobs, code=1, sheet=True)))
    assert [(each["event"], each["done"], each["total"]) for each in said] == [
        ("ended", number, 3) for number in (1, 2, 3)
    ]
    assert shop.statuses == {"a": "ok", "b": "ok", "empty": "failed"}
    record = json.loads((shop.output / "a" / "a.json").read_text())
    assert (record["result"]["status"], set(record["files"])) == ("ok", {"a.take.npz", "a.sheet.jpg"})
    assert record["result"] == shop.report["a"]
    assert "no hand was found" in (shop.output / "overview.html").read_text()
    shop.run("--jobs", "1", code=1, sheet=True)
    assert shop.calls == {"a": 1, "b": 1, "empty": 1}, "a failure of an input is not tried again"
    shop.run("--jobs", "1", "--retry-failed", code=1, sheet=True)
    shop.run("--jobs", "1", "--again", code=1, sheet=True)
    assert shop.calls == {"a": 2, "b": 2, "empty": 3}
    assert shop.unfinished == []


def test_what_was_deleted_is_made_again_and_what_was_changed_stays(tmp_path: Path) -> None:
    shop = Shop(tmp_path, ["a", "b"])
    shop.run("--jobs", "1")
    (shop.output / "a" / "a.take.npz").unlink()
    (shop.output / "b" / "b.take.npz").write_bytes(b"mine")
    shop.run("--jobs", "1")
    assert shop.calls == {"a": 2, "b": 1}
    (warning,) = shop.report["b"]["warnings"]
    assert warning.startswith("b.take.npz: changed since")


@pytest.mark.slow
def test_a_task_that_kills_its_process_is_lost_after_three_tries(tmp_path: Path) -> None:
    shop = Shop(tmp_path, ["dies", "slow1", "slow2", "slow3", "b"])
    shop.run("--jobs", "2", code=1)
    assert shop.statuses == {"dies": "failed"} | dict.fromkeys(("slow1", "slow2", "slow3", "b"), "ok")
    assert shop.calls["dies"] == 3
    assert [each["kind"] for each in shop.report["dies"]["attempts"]] == ["WorkerDied"] * 3
    assert "died 3 times" in shop.report["dies"]["error"]
    assert shop.unfinished == []
    shop.run("--jobs", "2", code=1)
    assert shop.calls["dies"] == 6, "another day it may go better"


@pytest.mark.parametrize("name", ["hungry", "broken", "full"])
@pytest.mark.parametrize("jobs", ["1", "2"])
def test_what_fails_is_one_sentence(tmp_path: Path, name: str, jobs: str) -> None:
    shop = Shop(tmp_path, [name, "a"])
    shop.run("--jobs", jobs, code=1)
    assert shop.statuses == {name: "failed", "a": "ok"}
    sentences = {
        "hungry": "memory ran out",
        "broken": "unexpected ZeroDivisionError: division by zero",
        "full": "No space left on device",
    }
    assert sentences[name] in shop.report[name]["error"]
    assert shop.unfinished == []


@pytest.mark.slow
def test_an_input_that_takes_too_long_is_ended_and_the_rest_goes_on(tmp_path: Path) -> None:
    shop = Shop(tmp_path, ["hangs", *(f"slow{number}" for number in range(4))])
    shop.run("--jobs", "2", "--timeout", "8", code=1)
    assert shop.statuses == {"hangs": "failed"} | {f"slow{number}": "ok" for number in range(4)}
    assert "took longer than 8 seconds" in shop.report["hangs"]["error"]
    assert shop.calls["hangs"] == 1
    assert shop.unfinished == []


def test_a_later_failure_is_noted_beside_what_was_made(tmp_path: Path) -> None:
    shop = Shop(tmp_path, ["tires"])
    shop.run("--jobs", "1")
    made = shop.takes
    shop.run("--again", "--timeout", "4", code=1)
    entry = shop.report["tires"]
    assert "took longer than 4 seconds" in entry["error"]
    assert (shop.calls["tires"], entry["files"]) == (2, ["tires/tires.take.npz"])
    assert shop.takes == made


def processes_of(group: int) -> list[int]:
    """The processes of a group that run."""
    found = []
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            state, _, its_group = stat.read_text().rpartition(")")[2].split()[:3]
        except OSError:
            continue
        if int(its_group) == group and state != "Z":
            found.append(int(stat.parent.name))
    return found


def wait_until(done: Any) -> None:
    until = time.monotonic() + PATIENCE
    while not done():
        assert time.monotonic() < until
        time.sleep(0.05)


needs_proc = pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="needs /proc")


@pytest.mark.slow
@needs_proc
@pytest.mark.parametrize("what", ["worker", "leader", "group", signal.SIGINT, signal.SIGTERM])
def test_a_killed_batch_goes_on(tmp_path: Path, what: Any) -> None:
    names = [f"slow{number}" for number in range(5)]
    shop = Shop(tmp_path, names)
    child = shop.start("--jobs", "2")
    wait_until(lambda: len(shop.records) > 1)
    if what == "worker":
        (victim, *_) = sorted(processes_of(child.pid), reverse=True)
        os.kill(victim, signal.SIGKILL)
    elif what == "group":
        os.killpg(child.pid, signal.SIGKILL)
    else:
        os.kill(child.pid, signal.SIGKILL if what == "leader" else what)
    child.communicate(timeout=PATIENCE)
    if what == "worker":
        assert child.returncode == 0
    else:
        assert child.returncode == (-signal.SIGKILL if isinstance(what, str) else 130)
    wait_until(lambda: not processes_of(child.pid))
    if not isinstance(what, str):
        assert shop.unfinished == []
        assert set(shop.statuses.values()) == {"ok", "pending"}
    shop.run("--jobs", "2")
    assert shop.statuses == dict.fromkeys(names, "ok")
    assert shop.unfinished == []
    (tmp_path / "calm").mkdir()
    calm = Shop(tmp_path / "calm", [])
    calm.inputs = shop.inputs
    calm.run("--jobs", "1")
    assert shop.takes == calm.takes


@needs_proc
def test_a_batch_ends_with_who_has_started_it(tmp_path: Path) -> None:
    shop = Shop(tmp_path, ["hangs"])
    words = ["-m", "tests.core.tasks.fakes", str(shop.inputs), "-o", str(shop.output), "--jobs=2"]
    code = (
        "import os, subprocess, sys, time\n"
        f"words = [*{words!r}, '--with-parent']\n"
        "child = subprocess.Popen([sys.executable, *words], stdin=subprocess.PIPE)\n"
        "print(child.pid, flush=True)\n"
        "time.sleep(600)\n"
    )
    parent = subprocess.Popen(
        [sys.executable, "-c", code], cwd=ROOT, stdout=subprocess.PIPE, start_new_session=True
    )
    wait_until(lambda: (shop.inputs / CALLS).exists())
    parent.kill()
    parent.communicate(timeout=PATIENCE)
    wait_until(lambda: not processes_of(parent.pid))


def test_takes_are_copied(tmp_path: Path) -> None:
    shop = Shop(tmp_path, ["a"])
    shop.run("--jobs", "1")
    (take,) = shop.output.rglob("*.take.npz")
    given = take.rename(tmp_path / "b.take.npz")
    shop.run("--jobs", "1", more=[str(given)])
    assert shop.statuses == {"a": "ok", "b": "ok"}
    assert Take.load(shop.output / "b" / "b.take.npz").hands[0].side == "right"


def test_copies_for_blender_stay_until_it_has_shown_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("HANDFIT_CACHE", str(tmp_path))
    plates = tmp_path / "plates"
    plates.mkdir()
    recent, old = ([plates / f"{age}{n}.jpg" for n in range(count)] for age, count in (("b", 120), ("c", 5)))
    for path in (*recent, *old):
        path.touch()
    for path in old:
        os.utime(path, (0, 0))
    shop = Shop(tmp_path, ["a"])
    (shop.inputs / "a.jpg").write_bytes(heic([tile((200, 30, 30))], (64, 64)))
    shop.run("--jobs", "1")
    (copy,) = set(plates.iterdir()) - set(recent)
    assert copy.stat().st_size > 0


def test_flat_and_names_that_differ_in_case_alone(tmp_path: Path) -> None:
    shop = Shop(tmp_path, ["a", "A", "report"])
    shop.run("--jobs", "1", "--flat")
    assert sorted(shop.statuses) == ["A", "a-2", "report-2"]
    assert {path.name for path in shop.output.iterdir()} == {
        *("report.json", "overview.html"),
        *(f"{name}{end}" for name in ("A", "a-2", "report-2") for end in (".json", ".take.npz")),
    }


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--jobs", "0"], "jobs must be a number of at least 1"),
        (["--timeout", "0"], "must be a number above 0"),
        (["--solver", "nosuch"], "nosuch"),
    ],
)
def test_what_cannot_be_meant_is_refused(tmp_path: Path, words: list[str], said: str) -> None:
    shop = Shop(tmp_path, ["a"])
    assert said in shop.run(*words, code=2)
    assert not shop.output.exists()


def test_a_folder_that_cannot_be_written(tmp_path: Path) -> None:
    shop = Shop(tmp_path, ["a"])
    shop.output.write_text("a file")
    assert "cannot write" in shop.run("--jobs", "1", code=2)


def test_dry_run_does_nothing(tmp_path: Path) -> None:
    shop = Shop(tmp_path, ["a", "empty"])
    assert shop.run("--dry-run", "--jobs", "1").splitlines()[-1] == "2 of 2 to do, 1 at a time"
    assert not shop.output.exists()
    shop.run("--jobs", "1", code=1)
    (shop.inputs / "b.jpg").write_bytes(b"new")
    said = shop.run("--dry-run", "--jobs", "1")
    assert [line.split()[0] for line in said.splitlines()] == ["done", "to", "failed", "1"]


def test_processes_of_a_python_that_has_handfit_core_from_the_launcher(tmp_path: Path) -> None:
    """As that of a user's own Python has it, to which the add-on brings nothing else."""
    shop = Shop(tmp_path, ["a", "b"])
    command = [sys.executable, str(ROOT / "handfit_core" / "worker" / "launch.py"), "batch", "--jobs", "2"]
    command += ["--separate", str(shop.inputs), "-o", str(shop.output)]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=PATIENCE)
    assert done.returncode == 1, done.stderr
    errors = [entry["error"] for entry in shop.report.values()]
    assert all("this is a text" in error for error in errors), errors
