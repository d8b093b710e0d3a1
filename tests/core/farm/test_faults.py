"""Batches that are killed, on machines that vanish, sleep or lose their disk: each result once, and whole.

`HANDFIT_KILLS=30` kills as often as the figures in docs/batch.md were made with.
"""

from __future__ import annotations

import hashlib
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path

import pytest

from handfit_core.errors import OutputError
from handfit_core.farm import folder as folders
from handfit_core.farm import pool as pools
from handfit_core.farm.collect import Report
from handfit_core.farm.folder import Lost
from handfit_core.farm.plan import Plan, Task
from handfit_core.farm.pool import Listener, Pool
from handfit_core.farm.report import Result
from handfit_core.farm.show import ProgressReporter
from tests.core.farm.peers import COMMAND, attempts, content, plan_of

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="processes are looked for in Linux's /proc")

KILLS = int(os.environ.get("HANDFIT_KILLS", "5"))
LIMIT = 60
"""seconds after which what should have ended is taken for hung"""
NAMES = [*(f"slow-{n}" for n in range(8)), "fine", "deep", "half1", "a-crash1"]


@pytest.fixture(autouse=True)
def log(tmp_path, monkeypatch):
    monkeypatch.setenv("PEER_LOG", str(tmp_path / "log"))
    return tmp_path / "log"


@pytest.fixture
def machines(tmp_path) -> Iterator[Callable[..., subprocess.Popen[str]]]:
    """machines(plan, jobs, host="", first="", **environment): a process that works on a plan, with `host` in
    a world of processes and names of its own, as another machine would; `first` is a command before."""
    namespaces = ["unshare", "--mount", "--pid", "--uts", "--mount-proc", "--fork", "--kill-child"]
    if os.getuid():
        namespaces.insert(1, "--map-root-user")
    started = []

    def start(plan: Plan, jobs: int = 2, host: str = "", first: str = "true", **environment: str):
        command = [*COMMAND, "pool", str(plan.path), str(jobs)]
        if host:
            if subprocess.run([*namespaces, "hostname", host], check=False, capture_output=True).returncode:
                pytest.skip("no second machine can be made here: unshare needs root, or user namespaces")
            command = [*namespaces, "sh", "-c", f'hostname {host} && {first} && exec "$@"', "sh", *command]
        log = (tmp_path / f"said-{len(started)}").open("w")
        running = subprocess.Popen(
            command, stderr=log, text=True, start_new_session=True, env={**os.environ, **environment}
        )
        started.append(running)
        return running

    yield start
    for each in started:
        with suppress(ProcessLookupError):
            os.killpg(each.pid, signal.SIGKILL)
        each.wait()


def processes_at(folder: Path) -> list[int]:
    """The processes that were started for a plan in this folder, and those of its tasks."""
    found = []
    for path in Path("/proc").glob("[0-9]*"):
        with suppress(OSError):
            if f"PEER_LOG={folder / 'log'}".encode() in (path / "environ").read_bytes().split(b"\0"):
                found.append(int(path.name))
    return [pid for pid in found if pid != os.getpid()]


def gone(folder: Path) -> bool:
    """Whether none of them is left, soon."""
    deadline = time.monotonic() + LIMIT
    while processes_at(folder):
        if time.monotonic() > deadline:
            return False
        time.sleep(0.05)
    return True


def wait_for(what: Callable[[], object]) -> None:
    deadline = time.monotonic() + LIMIT
    while not what():
        assert time.monotonic() < deadline
        time.sleep(0.01)


def sealings(log: Path) -> Counter[str]:
    return Counter(each["sealed"] for each in attempts(log) if "sealed" in each)


def assert_done_once(plan: Plan, log: Path) -> None:
    """Every task is sealed, and was once; its results hold what they must, and nothing else is there."""
    for task in plan.tasks:
        seal = plan.folder(task).sealed(task.id)
        assert seal is not None, task.name
        for name, known in seal["files"].items():
            held = (plan.folder(task).path / name).read_bytes()
            assert held == content(task.name, name.rpartition(".")[2])
            assert known["sha256"] == hashlib.sha256(held).hexdigest()
        there = {p.name for p in plan.folder(task).path.rglob("*") if p.is_file()}
        assert there == {"done.json", *(Path(name).name for name in seal["files"])}
    assert set(sealings(log).values()) <= {1}, "who was killed between a seal and its note is not counted"
    sealed = set()
    for each in attempts(log):
        assert each.get("task", "no task") not in sealed, "what is sealed is not begun"
        sealed.add(each.get("sealed", ""))
    there = {p.name for p in plan.output.iterdir()} - {"report.json", "overview.html"}
    assert there == {"plans", *(task.name for task in plan.tasks)}


def test_killed_at_random_moments_and_started_again(tmp_path, log, machines):
    plan = plan_of(tmp_path / "out", NAMES)
    chance = random.Random(18)
    killed = 0
    for number in range(4 * KILLS):
        running = machines(plan)
        time.sleep(chance.uniform(0.0, 2.0))
        if number % 3 == 2:  # a slot, or what it has started
            slots = [pid for pid in processes_at(tmp_path) if pid != running.pid]
            if slots:
                with suppress(ProcessLookupError):
                    os.kill(chance.choice(slots), signal.SIGKILL)
                    killed += 1
            time.sleep(chance.uniform(0.0, 0.5))
        killed += running.poll() is None
        running.kill()
        if running.wait() == 0 and all(plan.is_sealed(task.id) for task in plan.tasks):
            if killed >= KILLS:
                break
            shutil.rmtree(plan.output)  # once more from the beginning
            log.rename(log.with_name(f"log-{number}"))
            plan.save()
    assert killed >= KILLS
    assert gone(tmp_path)
    assert machines(plan).wait(LIMIT) == 0
    assert_done_once(plan, log)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_supervisor_that_ends_takes_all_with_it(tmp_path, log, machines, number):
    plan = plan_of(tmp_path / "out", ["hang", "fine"])
    running = machines(plan, 2)
    wait_for(lambda: any("child" in each for each in attempts(log)) and sealings(log))
    os.kill(running.pid, number)
    running.wait(LIMIT)
    assert gone(tmp_path)


def test_two_machines_do_nothing_twice(tmp_path, log, machines):
    """Their clocks are a day apart."""
    plan = plan_of(tmp_path / "out", NAMES)
    one = machines(plan, host="one", PEER_CLOCK="-86400")
    two = machines(plan, host="two", PEER_CLOCK="86400")
    assert (one.wait(LIMIT), two.wait(LIMIT)) == (0, 0)
    assert_done_once(plan, log)
    assert {each["host"] for each in attempts(log) if "sealed" in each} == {"one", "two"}
    begun = Counter(each["task"] for each in attempts(log) if "task" in each)
    assert begun == {name: 2 if name[-1] == "1" and name[:4] != "slow" else 1 for name in NAMES}


def test_a_machine_takes_over_what_another_has_left(tmp_path, log, machines):
    plan = plan_of(tmp_path / "out", ["hang1", "slow", "slow-2"])
    one = machines(plan, 1, host="one", PEER_STALE="3")
    wait_for(lambda: attempts(log))
    two = machines(plan, 1, host="two", PEER_STALE="3", PEER_CLOCK="-86400")
    wait_for(lambda: len(sealings(log)) == 2)
    assert attempts(log)[0]["task"] == "hang1"
    os.killpg(one.pid, signal.SIGKILL)
    assert two.wait(LIMIT) == 0
    assert_done_once(plan, log)
    assert {each["host"] for each in attempts(log) if "sealed" in each} == {"two"}
    assert len(attempts(log)) == 8, "four begun, what one has started, and three sealed"


def test_a_machine_that_slept_destroys_nothing(tmp_path, log, machines):
    """Another one has done its task meanwhile."""
    plan = plan_of(tmp_path / "out", ["slow"])
    (task,) = plan.tasks
    one = machines(plan, 1, host="one", PEER_STALE="1")
    wait_for(lambda: attempts(log))
    inside = [pid for pid in processes_at(tmp_path) if pid != one.pid]
    (supervisor,) = (
        pid for pid in inside if b"pool" in Path(f"/proc/{pid}/cmdline").read_bytes().split(b"\0")
    )
    os.kill(supervisor, signal.SIGSTOP)
    two = machines(plan, 1, host="two", PEER_STALE="1")
    assert two.wait(LIMIT) == 0
    before = plan.folder(task).done.read_bytes()
    os.kill(supervisor, signal.SIGCONT)
    assert one.wait(LIMIT) == 0
    assert plan.folder(task).done.read_bytes() == before
    assert_done_once(plan, log)
    assert sealings(log) == {"slow": 1}


def test_the_same_batch_twice_at_once(tmp_path, log, machines):
    plan = plan_of(tmp_path / "out", NAMES)
    several = [machines(plan, 1) for _ in range(3)]
    assert [each.wait(LIMIT) for each in several] == [0, 0, 0]
    assert_done_once(plan, log)


def test_two_batches_at_once_in_one_folder(tmp_path, log, machines):
    first, second = plan_of(tmp_path / "out", NAMES[:6]), plan_of(tmp_path / "out", NAMES[6:])
    both = machines(first, 1), machines(second, 1)
    assert [each.wait(LIMIT) for each in both] == [0, 0]
    report = Report([first])
    report.look()
    assert {r.name: r.status for r in report.results} == dict.fromkeys(NAMES, "ok")


def test_a_disk_that_is_full_and_has_room_again(tmp_path, log, machines):
    """In steps: each run does as much as there is room for, and says of the rest why not."""
    plan = plan_of(tmp_path / "out", [*NAMES[:4], *NAMES[8:]])
    kept = tmp_path / "kept"
    kept.mkdir()
    for size in (24, 96, 4000):
        mount = f"mount -t tmpfs -o size={size}k tmpfs {plan.output} && cp -a {kept}/. {plan.output}"
        command = f"{sys.executable} {COMMAND[1]} pool {plan.path} 2"
        keep = f"code=$?; rm -rf {kept}/*; cp -a {plan.output}/. {kept}; exit $code"
        first = f"{{ cp -a {plan.output}/plans {kept}; {mount}; {command}; {keep}; }}"
        code = machines(plan, 2, host="one", first=first).wait(LIMIT)
        assert (code == 0) == (size == 4000)
        assert not [p for p in kept.iterdir() if p.name.startswith(".")]
        shown = Report([Plan(kept, plan.tasks, {})])
        shown.look()
        assert all(r.status in ("ok", "pending") or "No space" in r.error for r in shown.results)
    shutil.copytree(kept, plan.output, dirs_exist_ok=True)
    assert_done_once(plan, log)


def test_an_output_that_cannot_be_written_is_told_and_nothing_is_begun(tmp_path, log, machines):
    plan = plan_of(tmp_path / "out", ["fine", "slow"])
    out = plan.output
    first = f"mount --bind {out} {out} && mount -o remount,ro,bind {out}"
    assert machines(plan, 1, host="one", first=first).wait(LIMIT) == 2
    assert "Read-only file system" in (tmp_path / "said-0").read_text()
    assert not attempts(log)
    assert [p.name for p in out.iterdir()] == ["plans"]


class Away(Listener):
    """Takes the folder of results away while a task is at hand, and brings it back later."""

    def __init__(self, plan: Plan, log: Path, turns: int) -> None:
        self.plan, self.log, self.turns, self.beneath = plan, log, turns, []
        self.place = plan.output.with_name("elsewhere")

    def turn(self) -> None:
        if self.turns and attempts(self.log) and self.plan.output.exists():
            self.plan.output.rename(self.place)
        elif self.place.exists():
            self.beneath += [self.plan.output.exists()]
            self.turns -= 1
            if not self.turns:
                self.place.rename(self.plan.output)


def test_a_disk_that_is_lost_and_comes_back(tmp_path, log, monkeypatch):
    monkeypatch.setattr(pools, "BACK_OFF", (0.0,))
    monkeypatch.setattr(pools, "_ELSEWHERE", 0.05)
    plan = plan_of(tmp_path / "out", ["slow", "slow-2", "slow-3"])
    away = Away(plan, log, 100)
    with Pool(COMMAND, jobs=2) as pool:
        results = pool.run(plan, plan.tasks, away)
    assert len(away.beneath) == 100
    assert not any(away.beneath), "nothing is written where its disk was"
    assert [r.status for r in results] == ["ok"] * 3, [r.error for r in results]
    for task in plan.tasks:
        assert plan.is_sealed(task.id)
    assert not [p for p in plan.output.iterdir() if p.name.startswith(".")]


def test_a_disk_that_stays_away_ends_the_batch_with_a_sentence(tmp_path, log, monkeypatch):
    monkeypatch.setattr(pools, "BACK_OFF", (0.0,))
    monkeypatch.setattr(pools, "AWAY", 0.5)
    plan = plan_of(tmp_path / "out", ["slow", "slow-2"])
    report = Report([plan])
    shown = ProgressReporter(list(plan.tasks), "none", report)

    class Gone(Listener):
        def turn(self) -> None:
            if attempts(log) and plan.output.exists():
                plan.output.rename(plan.output.with_name("elsewhere"))
            shown.turn()

    with pytest.raises(Lost, match="bring it back"), Pool(COMMAND) as pool:
        pool.run(plan, plan.tasks, Gone())
    with pytest.raises(OutputError, match="the folder of results is gone"):
        report.write()
    assert not plan.output.exists()


def test_ten_thousand_that_are_done_are_read_once_each(tmp_path, monkeypatch):
    """And written of now and then: nothing is done for each pair of them."""
    plan = plan_of(tmp_path / "out", [f"t{number}" for number in range(2000)])
    for task in plan.tasks:
        folder = plan.folder(task)
        folder.path.mkdir()
        seal = {"format": "manient-task", "version": 1, "id": task.id, "files": {}, "host": "", "seconds": 1}
        folder.done.write_text(
            json.dumps({**seal, "result": {"input": "", "name": task.name, "status": "ok"}})
        )
    counts: Counter[str] = Counter()

    def counted(owner: object, name: str) -> None:
        was = getattr(owner, name)

        def call(*args, **more):
            counts[name] += 1
            return was(*args, **more)

        monkeypatch.setattr(owner, name, call)

    counted(folders, "_read")
    counted(folders.os, "scandir")
    counted(Report, "write")
    report = Report([plan])
    report.look()
    assert counts["_read"] <= len(plan.tasks)
    shown = ProgressReporter(list(plan.tasks), "none", report)
    with Pool(("never started",), jobs=4) as pool:
        results = pool.run(plan, plan.tasks, shown)
    assert all(result.status == "ok" for result in results)
    assert counts["_read"] <= 2 * len(plan.tasks)
    assert counts["scandir"] <= 3
    assert [asdict(r)["name"] for r in report.results] == [task.name for task in plan.tasks]


def test_tasks_of_others_are_looked_at_seldom(tmp_path, log, monkeypatch):
    """However many of them there are, and however long they take."""
    monkeypatch.setattr(pools, "_ELSEWHERE", 0.2)
    names = [f"t{number}" for number in range(300)]
    plan = plan_of(tmp_path / "out", [*names, "slow"])
    for task in plan.tasks[:-1]:
        assert folders.Watch().claim(plan.folder(task), task.id)
    looks: Counter[str] = Counter()
    was = folders.Watch.claim

    def claim(self, folder, id):
        looks[folder.name] += 1
        return was(self, folder, id)

    monkeypatch.setattr(folders.Watch, "claim", claim)

    class Until(Listener):
        def ended(self, task: Task, result: Result) -> None:
            raise InterruptedError(task.name, result.status)

    with pytest.raises(InterruptedError, match=r"slow.*ok"), Pool(COMMAND, jobs=2) as pool:
        pool.run(plan, plan.tasks, Until())
    assert looks["slow"] == 1
    assert len(looks) == 301, "each was looked at"
