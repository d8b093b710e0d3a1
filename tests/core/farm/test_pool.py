"""The pool with a program that does its tasks badly: what is tried again, what is told, what stays."""

from __future__ import annotations

import errno
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import Any, ClassVar

import pytest

from handfit_core.errors import OptionError
from handfit_core.farm.collect import state
from handfit_core.farm.folder import TaskFolder, Watch, attempt, files_in
from handfit_core.farm.plan import Plan, Task
from handfit_core.farm.pool import ATTEMPTS, Listener, Pool
from handfit_core.farm.report import Result
from handfit_core.farm.slot import Slot, end_idle
from tests.core.farm.peers import COMMAND, ROOT, attempts, content, plan_of, planned

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="the peer ends as processes do on POSIX")


@pytest.fixture(autouse=True)
def log(tmp_path, monkeypatch):
    """Where the program writes down what it does; nobody waits long for another attempt."""
    monkeypatch.setenv("PEER_LOG", str(tmp_path / "log"))
    monkeypatch.setattr("handfit_core.farm.pool.BACK_OFF", (0.0,))
    return tmp_path / "log"


def assert_gone(*pids: int | None) -> None:
    """No process is left; the system's init may need a moment to let go of one."""
    deadline = time.monotonic() + 10
    while left := [pid for pid in pids if pid and Path(f"/proc/{pid}").exists()]:
        assert time.monotonic() < deadline, left
        time.sleep(0.02)


def contents(folder: Path) -> dict[str, bytes]:
    return {p.relative_to(folder).as_posix(): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


def sealed(folder: TaskFolder, id: str) -> None:
    """Give a task a result and its seal."""
    claim = Watch().claim(folder, id)
    assert claim is not None
    part = folder.part()
    (part / "result.txt").write_text("of before")
    files = files_in(part, ["result.txt"])
    folder.take_in(part, files)
    folder.seal(id, {"status": "ok"}, files, 1.0)
    part.rmdir()
    claim.release()


@contextmanager
def stopped_by_signals() -> Iterator[None]:
    """Within, SIGTERM is as Ctrl-C, as in a batch (blender_manient/batch/console.py)."""
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


CURED = [
    "fine",
    "a-crash1",
    "a-kill2",
    "an-exit1",
    "half2",
    "memory1",
    "gone1",
    "disk1",
    "a-nonsense",
    "deep",
]


@pytest.mark.parametrize("jobs", [1, 3])
def test_what_another_attempt_cures(tmp_path, log, jobs):
    out = tmp_path / "out"
    plan = plan_of(out, CURED)
    with Pool(COMMAND, jobs=jobs) as pool:
        results = pool.run(plan, plan.tasks)
    assert {r.name: r.status for r in results} == dict.fromkeys(CURED, "ok")
    for task in plan.tasks:
        seal = plan.folder(task).sealed(task.id)
        assert seal is not None
        assert len(seal["files"]) == 2
        for name in seal["files"]:
            assert (out / task.name / name).read_bytes() == content(task.name, name.rpartition(".")[2])
    for result in results:
        often = "".join(c for c in result.name if c.isdigit())
        assert len(result.attempts) == int(often or 0), result.name
    assert sorted(p.name for p in out.iterdir()) == sorted([*CURED, "plans"]), "no part is left"
    assert not list(out.rglob("running.json"))
    assert not list(out.rglob("failed.json"))
    assert_gone(*[a["pid"] for a in attempts(log)])


KEPT_FAILING = {
    "crash": "WorkerDied",
    "kill": "WorkerDied",
    "memory": "MemoryRanOut",
    "gone": "InputGone",
    "disk": "OutputError",
    "liar": "OutputError",
}
"""What it does each time -> the kind of its attempts, of which there are several"""


def test_what_no_attempt_cures_has_failed_with_its_sentences(tmp_path, log):
    out = tmp_path / "out"
    plan = plan_of(out, [*KEPT_FAILING, "input", "bad", "fine"])
    with Pool(COMMAND, jobs=2) as pool:
        results = {r.name: r for r in pool.run(plan, plan.tasks)}
    for name, kind in KEPT_FAILING.items():
        assert results[name].status == "failed"
        assert [a["kind"] for a in results[name].attempts] == [kind] * ATTEMPTS
        assert all(a["error"] for a in results[name].attempts)
    assert [a["kind"] for a in results["input"].attempts] == ["InputError"]
    assert [a["kind"] for a in results["bad"].attempts] == ["ProtocolError"]
    assert results["fine"].status == "ok"
    assert not [p for p in out.iterdir() if p.name.startswith(".")]
    assert not (tmp_path / "outside").exists()
    begun = len(attempts(log))
    with Pool(COMMAND) as pool:
        again = {r.name: r for r in pool.run(plan, [plan.task("input"), plan.task("fine")])}
        assert len(attempts(log)) == begun, "one is done, and the other's fault lies in it"
        (tried,) = pool.run(plan, [plan.task("input")], retry_failed=True)
    assert (again["input"].status, again["fine"].status) == ("failed", "ok")
    assert len(attempts(log)) == begun + 1
    assert tried.status == "failed"


def test_what_a_failed_attempt_has_finished_is_used_if_it_is_still_that(tmp_path, log):
    plan = plan_of(tmp_path / "out", ["half1"])
    (task,) = plan.tasks
    with Pool(COMMAND, attempts=1) as pool:
        (result,) = pool.run(plan, plan.tasks)
        assert (result.status, result.files) == ("failed", ["half1/half1.first"])
        first = plan.folder(task).path / "half1.first"
        whole = first.read_bytes()
        first.write_bytes(whole[::-1])  # as long as it was
        assert plan.folder(task).kept(task.id) == {}
        first.write_bytes(whole)
        (result,) = pool.run(plan, plan.tasks)
    assert result.status == "ok"
    assert [a["finished"] for a in attempts(log)] == [[], ["half1.first"]]


@pytest.mark.parametrize("word", ["hang", "stop"])
def test_the_time_limit_ends_all_that_was_started(tmp_path, log, word):
    plan = plan_of(tmp_path / "out", [word, "fine"])
    with Pool(COMMAND, jobs=2, timeout=3.0) as pool:
        hung, fine = pool.run(plan, plan.tasks)
    assert (hung.status, fine.status) == ("failed", "ok")
    assert hung.attempts[-1]["kind"] == "Timeout"
    assert_gone(*[number for a in attempts(log) for number in (a["pid"], a.get("child"))])


def test_what_a_killed_process_has_started_ends_with_it(tmp_path, log):
    plan = plan_of(tmp_path / "out", ["hang1"])

    class Killer(Listener):
        def turn(self) -> None:
            if len(attempts(log)) == 2:
                with suppress(ProcessLookupError):
                    os.kill(attempts(log)[0]["pid"], signal.SIGKILL)

    with Pool(COMMAND) as pool:
        (result,) = pool.run(plan, plan.tasks, Killer())
    assert result.status == "ok"
    assert [a["kind"] for a in result.attempts] == ["WorkerDied"]
    assert_gone(attempts(log)[0]["pid"], attempts(log)[1]["child"])


def test_memory_that_ran_out_is_tried_again_alone(tmp_path, log):
    plan = plan_of(tmp_path / "out", ["memory1", *(f"slow-{n}" for n in range(4))])

    class Beside(Listener):
        at: ClassVar[set[str]] = set()
        seen: ClassVar[list[set[str]]] = []

        def began(self, task: Task) -> None:
            self.at.add(task.name)
            self.seen.append(set(self.at))

        def ended(self, task: Task, result: Result) -> None:
            assert result.status == "ok"
            self.at.discard(task.name)

    with Pool(COMMAND, jobs=3) as pool:
        results = pool.run(plan, plan.tasks, Beside())
    assert all(result.status == "ok" for result in results)
    assert Beside.seen[-1] == {"memory1"}
    assert len(Beside.seen) == 6


def test_finished_work_stays_where_it_is_done_again_and_fails(tmp_path, log):
    out = tmp_path / "out"
    plan = plan_of(out, ["fine-half"])
    (task,) = plan.tasks
    folder = plan.folder(task)
    sealed(folder, task.id)
    before = contents(folder.path)
    with Pool(COMMAND) as pool:
        (result,) = pool.run(plan, plan.tasks, again=True)
    assert result.status == "failed"
    assert len(attempts(log)) == ATTEMPTS
    assert folder.sealed(task.id)
    assert {name: held for name, held in contents(folder.path).items() if name != "failed.json"} == before
    assert state(plan, task).status == "ok"


@pytest.mark.parametrize("broken", ["seal", "taken in", "noted"])
def test_a_disk_that_is_full_while_results_are_sealed(tmp_path, log, monkeypatch, broken):
    """Two processes have done the work, and nothing of it is done a third time."""
    plan = plan_of(tmp_path / "out", ["fine"])
    (task,) = plan.tasks
    was, left = TaskFolder.aside, [2]

    def aside(self: TaskFolder, text: str) -> Path:
        if broken == "seal" and '"versions"' in text and left[0]:
            left[0] -= 1
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        if broken == "noted" and '"attempts"' in text and '"pending"' in text:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return was(self, text)

    monkeypatch.setattr(TaskFolder, "aside", aside)
    if broken == "taken in":
        replace, moved = Path.replace, []

        def fails_once(self: Path, target: Path) -> Path:
            if Path(target).name == "fine.second" and not moved:
                moved.append(target)
                raise OSError(errno.EDQUOT, os.strerror(errno.EDQUOT))
            return replace(self, target)

        monkeypatch.setattr(Path, "replace", fails_once)
    with Pool(COMMAND) as pool:
        (result,) = pool.run(plan, plan.tasks)
    assert result.status == "ok", result.error
    tries = {"seal": 3, "taken in": 2, "noted": 1}[broken]
    assert len(attempts(log)) == tries
    assert all(a["finished"] == ["fine.first", "fine.second"] for a in attempts(log)[1:])
    assert plan.folder(task).sealed(task.id)
    assert sorted(contents(plan.folder(task).path)) == ["done.json", "fine.first", "fine.second"]


def test_a_program_that_says_done_and_dies_is_heard_to_the_end(tmp_path, log):
    plan = plan_of(tmp_path / "out", [f"last-{n}" for n in range(6)])
    ended = []

    class Counting(Listener):
        def ended(self, task: Task, result: Result) -> None:
            ended.append((task.name, result.status))

    with Pool(COMMAND, jobs=2) as pool:
        pool.run(plan, plan.tasks, Counting())
    assert sorted(ended) == [(task.name, "ok") for task in plan.tasks]
    assert len(attempts(log)) == 6


def test_another_version_is_refused(tmp_path, monkeypatch):
    monkeypatch.setenv("PEER_VERSION", "0.0.1")
    plan = plan_of(tmp_path / "out", ["fine"])
    with Pool(COMMAND) as pool, pytest.raises(OptionError, match="same version on all machines"):
        pool.run(plan, plan.tasks)
    assert not (tmp_path / "out" / "fine").exists()


def test_a_program_that_cannot_start_is_named(tmp_path):
    plan = plan_of(tmp_path / "out", ["fine"])
    command = (sys.executable, "-c", "raise SystemExit('no Blender here')")
    with Pool(command) as pool, pytest.raises(OptionError, match="no Blender here"):
        pool.run(plan, plan.tasks)
    with Pool(("no such program",)) as pool, pytest.raises(OptionError, match="no such program"):
        pool.run(plan, plan.tasks)


def started(tmp_path: Path, script: str) -> tuple[str, ...]:
    """A command of which `script` is run before it does tasks; $n is how many have been started."""
    (tmp_path / "starts").mkdir()
    count = f"n=1; until mkdir {tmp_path}/starts/$n 2>/dev/null; do n=$((n+1)); done"
    return "sh", "-c", f"{count}; {script}", "sh"


def test_processes_that_do_not_start_are_done_without(tmp_path, log):
    plan = plan_of(tmp_path / "out", [f"slow-{n}" for n in range(6)])
    peer = f"exec {' '.join(COMMAND)} slot"
    with Pool(started(tmp_path, f"[ $n = 1 ] || kill -9 $$; {peer}"), jobs=4) as pool:
        results = pool.run(plan, plan.tasks)
    assert {result.status for result in results} == {"ok"}
    assert len({each["pid"] for each in attempts(log)}) == 1
    assert len(list((tmp_path / "starts").iterdir())) > 4, "it is tried again later"


def test_idle_processes_end_together(tmp_path, monkeypatch):
    """Each ends only once all have been told to."""
    monkeypatch.setattr("handfit_core.farm.slot._GRACE", 20.0)
    wait = f"mkdir {tmp_path}/told-$n; until [ $(ls -d {tmp_path}/told-* | wc -l) = 3 ]; do sleep 0.01; done"
    command = started(tmp_path, f"{' '.join(COMMAND)} slot; {wait}; mkdir {tmp_path}/ended-$n")
    slots = [Slot(command) for _ in range(3)]
    while not all(slot.ready for slot in slots):
        for slot in slots:
            slot.events(0.02)
    end_idle(slots)
    assert len(list(tmp_path.glob("ended-*"))) == 3


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize("stage", ["claim", "occupy", "take_in", "seal", "put_back", "turn"])
def test_a_stop_at_any_stage_leaves_no_claim_and_no_part(tmp_path, log, monkeypatch, number, stage):
    plan = plan_of(tmp_path / "out", ["fine", "hang", "an-other"])
    owner = TaskFolder if stage in ("take_in", "seal") else Listener if stage == "turn" else Pool
    was = getattr(owner, stage)

    def stopped(*args: Any, **more: Any) -> Any:
        os.kill(os.getpid(), number)
        try:
            return was(*args, **more)
        finally:
            monkeypatch.setattr(owner, stage, was)

    monkeypatch.setattr(owner, stage, stopped)
    with stopped_by_signals(), pytest.raises(KeyboardInterrupt), Pool(COMMAND, jobs=2) as pool:
        pool.run(plan, plan.tasks)
    out = plan.output
    assert not [p for p in out.iterdir() if p.name.startswith(".")]
    assert not list(out.rglob("running.json"))
    for task in plan.tasks:
        folder = plan.folder(task)
        assert not folder.path.exists() or folder.sealed(task.id)
    assert_gone(*[a["pid"] for a in attempts(log)])
    if stage in ("take_in", "seal", "put_back"):
        assert sum(plan.folder(task).sealed(task.id) is not None for task in plan.tasks) == 1


def test_results_of_another_batch_are_not_replaced_unasked(tmp_path, log):
    """Both were planned before either had anything in the folder."""
    out = tmp_path / "out"
    first, second = plan_of(out, ["fine"]), plan_of(out, ["fine", "other"])
    second = planned(second, tasks=(replace(second.tasks[0], id="0" * 16), second.tasks[1]))
    with Pool(COMMAND) as pool:
        pool.run(first, first.tasks)
        before = contents(out / "fine")
        taken, other = pool.run(second, second.tasks)
        assert (taken.status, other.status) == ("failed", "ok")
        assert "another batch" in taken.error
        assert contents(out / "fine") == before
        (replaced, _) = pool.run(planned(second, overwrite=True), second.tasks)
    assert replaced.status == "ok"
    assert second.folder(second.tasks[0]).sealed("0" * 16)


def given_up(plan: Plan, *kinds: str, host: str = "elsewhere", status: str = "failed") -> None:
    """What another machine writes of the last task of a plan."""
    task = plan.tasks[-1]
    result = Result(task.shown, task.name, status, id=task.id, error="so it was", warnings=["of before"])
    result.attempts = [{**attempt("so it was", kind, n), "host": host} for n, kind in enumerate(kinds)]
    plan.folder(task).fail(task.id, asdict(result), {})


class Meanwhile(Listener):
    """Others do something once the first task is at hand."""

    def __init__(self, do: Callable[[], None]) -> None:
        self.do = do

    def began(self, task: Task) -> None:
        if task.name == "fine":
            self.do()


@pytest.mark.parametrize(
    ("kinds", "tries"),
    [
        (["WorkerDied"] * ATTEMPTS, 0),
        (["Timeout"], 0),
        (["NoHandFoundError"], 0),
        (["WorkerDied"], 2),  # its machine has given it up for a reason that may be its own
        (["WorkerError"], 2),
    ],
)
@pytest.mark.parametrize("retry_failed", [False, True])
def test_what_others_give_up_meanwhile_is_not_tried_as_often_again(tmp_path, log, kinds, tries, retry_failed):
    plan = plan_of(tmp_path / "out", ["fine", "crash"])
    with Pool(COMMAND) as pool:
        fine, crash = pool.run(
            plan, plan.tasks, Meanwhile(partial(given_up, plan, *kinds)), retry_failed=retry_failed
        )
    assert (fine.status, crash.status) == ("ok", "failed")
    assert sum(each["task"] == "crash" for each in attempts(log)) == tries
    assert [each["kind"] for each in crash.attempts] == kinds + ["WorkerDied"] * tries
    assert crash.warnings == ["of before"]
    state_then = state(plan, plan.tasks[-1])
    assert (state_then.attempts, state_then.warnings) == (crash.attempts, crash.warnings)


def test_a_broken_machine_tries_everything_once(tmp_path, log):
    """Another process of it has given the task up already; other machines may do better."""
    plan = plan_of(tmp_path / "out", ["fine", "late"])
    with Pool(COMMAND) as pool:
        _, late = pool.run(
            plan, plan.tasks, Meanwhile(partial(given_up, plan, "WorkerError", host=socket.gethostname()))
        )
    assert (late.status, late.error) == ("failed", "so it was")
    assert [each["task"] for each in attempts(log)] == ["fine"]


@pytest.mark.parametrize("status", ["failed", "pending"])
def test_a_new_run_tries_as_often_as_ever_and_keeps_what_was_said(tmp_path, log, status):
    plan = plan_of(tmp_path / "out", ["crash"])
    given_up(plan, *["WorkerDied"] * ATTEMPTS, status=status)
    with Pool(COMMAND) as pool:
        (result,) = pool.run(plan, plan.tasks)
    assert len(attempts(log)) == ATTEMPTS
    assert len(result.attempts) == 2 * ATTEMPTS


def test_attempts_of_several_processes_count_together(tmp_path, log):
    """One that is stopped between its attempts leaves the rest of them to another that runs already."""
    plan = plan_of(tmp_path / "out", ["fine", "crash"])
    with Pool(COMMAND) as pool:
        _, result = pool.run(
            plan, plan.tasks, Meanwhile(partial(given_up, plan, "WorkerDied", status="pending"))
        )
    assert sum(each["task"] == "crash" for each in attempts(log)) == ATTEMPTS - 1
    assert [each["host"] for each in result.attempts][:2] == ["elsewhere", socket.gethostname()]


def test_several_processes_on_one_plan_do_not_add_up_their_attempts(tmp_path, log):
    plan = plan_of(tmp_path / "out", ["crash"])
    program = (
        "import sys, handfit_core.farm.pool as pool\n"
        "from pathlib import Path\n"
        "from handfit_core.farm.plan import Plan\n"
        "pool.BACK_OFF, pool._ELSEWHERE = (0.0,), 0.0\n"
        "plan = Plan.load(Path(sys.argv[1]))\n"
        "class Waiting(pool.Listener):\n"
        "    def turn(self):\n"
        "        if not hasattr(self, 'begun'):\n"
        "            self.begun = print('ready', flush=True) or input()\n"
        "with pool.Pool(plan.command) as it:\n"
        "    (result,) = it.run(plan, plan.tasks, Waiting())\n"
        "print(result.status, len(result.attempts))\n"
    )
    command = [sys.executable, "-c", program, str(plan.path)]
    several = [
        subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, cwd=ROOT)
        for _ in range(3)
    ]
    for each in several:
        assert each.stdout is not None
        assert each.stdout.readline() == "ready\n"
    assert {each.communicate("\n")[0] for each in several} == {f"failed {ATTEMPTS}\n"}
    assert len(attempts(log)) == ATTEMPTS


def test_again_goes_on_with_nothing_of_earlier_runs(tmp_path, log):
    plan = plan_of(tmp_path / "out", ["half2"])
    with Pool(COMMAND, attempts=1) as pool:
        pool.run(plan, plan.tasks)
    with Pool(COMMAND) as pool:
        (result,) = pool.run(plan, plan.tasks, again=True)
    assert result.status == "ok"
    assert [each["finished"] for each in attempts(log)] == [[], [], ["half2.first"]]


@pytest.mark.parametrize("kept", [True, False])
def test_what_earlier_attempts_have_said_stays(tmp_path, log, kept):
    """Warnings belong to what is kept; where all is made anew, so are they."""
    plan = plan_of(tmp_path / "out", ["half1" if kept else "crash1"])
    (task,) = plan.tasks
    with Pool(COMMAND, attempts=1) as pool:
        (failed,) = pool.run(plan, plan.tasks)
        failed.warnings = ["a hand was left out"]
        known = plan.folder(task).failures(task.id)
        assert known is not None
        plan.folder(task).fail(task.id, asdict(failed), known["files"])
        (result,) = pool.run(plan, plan.tasks)
    assert result.status == "ok"
    assert result.warnings == (["a hand was left out"] if kept else [])
    assert result.attempts == failed.attempts
    assert state(plan, task) == result
