"""Tasks done by a Dask cluster of this machine, whose workers and scheduler are killed."""

from __future__ import annotations

import json
import os
import random
import shlex
import shutil
import signal
import socket
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import pytest

pytest.importorskip("distributed", reason="needs distributed, of handfit-core[farm]")

import psutil

from handfit_core.__main__ import main
from handfit_core.errors import OptionError
from handfit_core.farm import dask_engine
from handfit_core.farm.dask_engine import Cluster, SchedulerLost
from handfit_core.farm.folder import Watch
from handfit_core.farm.pool import Listener
from tests.core.farm.peers import COMMAND, attempts, content, plan_of, planned

ROOT = Path(__file__).resolve().parents[3]
PATIENCE = 300.0
"""seconds after which a test is stuck, on whatever machine"""

pytestmark = [
    pytest.mark.skipif(sys.platform == "win32", reason="the peer ends as processes do on POSIX"),
    pytest.mark.filterwarnings("ignore"),  # Dask's own
]


@pytest.fixture(autouse=True)
def log(tmp_path, monkeypatch):
    """Where the program that does tasks writes down what it does."""
    monkeypatch.setenv("PEER_LOG", str(tmp_path / "log"))
    monkeypatch.setenv("DASK_DISTRIBUTED__COMM__TIMEOUTS__CONNECT", "10s")
    return tmp_path / "log"


class Machines:
    """A scheduler and workers as processes of their own, as on a network."""

    def __init__(self, folder: Path, protocol: str = "tcp", *words: str) -> None:
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            self.address = f"{protocol}://127.0.0.1:{free.getsockname()[1]}"
        self._folder, self._words, self._all = folder, words, []
        self.workers: list[subprocess.Popen[bytes]] = []
        self.start_scheduler()

    def start(self, *words: str, **variables: str) -> subprocess.Popen[bytes]:
        environment = {**os.environ, "PYTHONPATH": str(ROOT), **variables}
        with (self._folder / f"{len(self._all)}.txt").open("wb") as said:
            process = subprocess.Popen(
                [sys.executable, "-m", f"distributed.cli.dask_{words[0]}", *words[1:], *self._words],
                stdout=said,
                stderr=said,
                env=environment,
                cwd=self._folder,
            )
        self._all.append(process)
        return process

    def start_scheduler(self, **variables: str) -> None:
        host, _, port = self.address.rpartition(":")
        words = ("--host", host, "--port", port, "--no-dashboard")
        self.scheduler = self.start("scheduler", *words, **variables)

    def start_worker(self, *, nanny: bool = False, **variables: str) -> None:
        nannied = "--nanny" if nanny else "--no-nanny"
        words = (self.address, "--nthreads", "1", "--no-dashboard", nannied, "--memory-limit", "0")
        self.workers.append(self.start("worker", *words, "--host", "127.0.0.1", **variables))

    def end(self) -> None:
        for process in reversed(self._all):
            process.kill()
            process.wait()


@pytest.fixture
def machines(tmp_path) -> Iterator[Machines]:
    folder = tmp_path / "machines"
    folder.mkdir()
    found = Machines(folder)
    yield found
    found.end()


class Told(Listener):
    """Keeps what it was told, and does something at every look."""

    def __init__(self, look: Callable[[], None] = lambda: None) -> None:
        self.turn = look  # type: ignore[method-assign]
        self.begun: list[str] = []
        self.over: list[str] = []

    def began(self, task) -> None:
        self.begun.append(task.name)

    def ended(self, task, result) -> None:  # noqa: ARG002
        self.over.append(task.name)


def whole(plan) -> bool:
    """Every result is there, once, and nothing else."""
    for task in plan.tasks:
        seal = plan.folder(task).sealed(task.id)
        assert seal is not None, task.name
        folder = plan.output / task.name
        for which in ("first", "second"):
            assert (folder / f"{task.name}.{which}").read_bytes() == content(task.name, which)
        assert sorted(p.name for p in folder.iterdir()) == sorted([*seal["files"], "done.json"])
    names = {task.name for task in plan.tasks} | {"plans", "report.json", "overview.html"}
    return {p.name for p in plan.output.iterdir()} <= names


def wait_until(holds: Callable[[], bool]) -> None:
    until = time.monotonic() + PATIENCE
    while not holds():
        assert time.monotonic() < until
        time.sleep(0.05)


def runs(pid: int) -> bool:
    """Whether there is such a process, and it has not ended without anybody having asked how."""
    try:
        return psutil.Process(pid).status() != psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return False


def test_a_plan_is_done_once_the_longest_first(machines, tmp_path, log):
    plan = plan_of(tmp_path / "out", ["input", "a-crash1", *(f"clip-{i}" for i in range(20))])
    plan = planned(plan, tasks=tuple(replace(t, cost=float(i)) for i, t in enumerate(plan.tasks)))
    machines.start_worker()
    machines.start_worker()
    told = Told()
    with Cluster(scheduler=machines.address) as cluster:
        results = cluster.run(plan, plan.tasks, told)
        assert {r.name: r.status for r in results} == {t.name: "ok" for t in plan.tasks} | {"input": "failed"}
        assert [r.name for r in results] == [t.name for t in plan.tasks]
        assert sorted(told.begun) == sorted(told.over) == sorted(t.name for t in plan.tasks)
        assert Counter(each["task"] for each in attempts(log)) == Counter(told.over + ["a-crash1"])
        begun = [each["task"] for each in attempts(log)]
        assert begun.index("input") > 16, "the longest come first"
        before, told = len(attempts(log)), Told()
        assert cluster.run(plan, plan.tasks, told) == results
        assert len(attempts(log)) == before, "what is sealed, or failed for its own reasons, is not tried"
        assert not told.begun
        cluster.run(plan, plan.tasks[1:3], again=True)
        assert len(attempts(log)) == before + 2
    assert not whole(planned(plan, tasks=plan.tasks[1:])), "only what failed is there, too"
    assert {p.name for p in (tmp_path / "out").iterdir()} == {"plans", *(t.name for t in plan.tasks)}


def test_workers_die_and_every_result_is_there_once(machines, tmp_path, log):
    chance = random.Random(18)
    plan = plan_of(tmp_path / "out", [f"slow-clip-{i}" for i in range(24)])
    struck: list[int] = []

    def strike() -> None:
        """Kill a worker in the midst of something, at ten moments, and start another in its place."""
        begun = len(attempts(log))
        if len(struck) < 10 and begun > (struck[-1] if struck else 0) and chance.random() < 0.7:
            struck.append(begun)
            victim = machines.workers.pop(chance.randrange(2))
            victim.send_signal(signal.SIGKILL)
            victim.wait()
            machines.start_worker()

    machines.start_worker()
    machines.start_worker()
    told = Told(strike)
    with Cluster(scheduler=machines.address) as cluster:
        results = cluster.run(plan, plan.tasks, told)
    assert len(struck) == 10
    assert [r.status for r in results] == ["ok"] * 24
    assert sorted(told.over) == sorted(t.name for t in plan.tasks)
    assert whole(plan)
    assert len(attempts(log)) > 24, "some were begun again"


def test_a_scheduler_that_dies_and_comes_back(machines, tmp_path, log):
    plan = plan_of(tmp_path / "out", [f"slow-clip-{i}" for i in range(10)])
    moments = [3]

    def strike() -> None:
        if moments and len(attempts(log)) > moments[0]:
            moments.pop()
            machines.scheduler.kill()
            machines.scheduler.wait()
            for worker in machines.workers:  # most end with it, but Dask does not promise that
                worker.terminate()
                worker.wait(PATIENCE)
            machines.start_scheduler()
            machines.start_worker()
            machines.start_worker()

    machines.start_worker()
    machines.start_worker()
    told = Told(strike)
    with Cluster(scheduler=machines.address) as cluster:
        results = cluster.run(plan, plan.tasks, told)
    assert not moments
    assert [r.status for r in results] == ["ok"] * 10
    assert sorted(told.over) == sorted(t.name for t in plan.tasks)
    assert whole(plan)


def test_a_scheduler_that_does_not_come_back(machines, tmp_path, log, monkeypatch, capsys):
    monkeypatch.setattr(dask_engine, "PATIENCE", 1.0)
    plan = plan_of(tmp_path / "out", ["fine", *(f"hang-{i}" for i in range(2))])
    plan = planned(plan, tasks=tuple(replace(t, cost=5.0 - i) for i, t in enumerate(plan.tasks)))
    machines.start_worker()
    begun = lambda: sum("attempt" in each for each in attempts(log))  # noqa: E731
    with Cluster(scheduler=machines.address) as cluster, pytest.raises(SchedulerLost, match="is kept"):
        cluster.run(plan, plan.tasks, Told(lambda: machines.scheduler.kill() if begun() > 1 else None))
    pids = [each[k] for each in attempts(log) for k in ("pid", "child") if k in each]
    wait_until(lambda: not any(map(runs, pids)))
    assert plan.folder(plan.tasks[0]).sealed(plan.tasks[0].id)


@pytest.mark.parametrize("which", ["plan", "slot"])
def test_another_version_is_told_and_not_tried_again(machines, tmp_path, log, which):
    plan = plan_of(tmp_path / "out", ["a", "b"])
    if which == "plan":
        plan = planned(plan, made_by="0.0.1")
    machines.start_worker(**({"PEER_VERSION": "0.0.1"} if which == "slot" else {}))
    said = r"version 0\.0\.1.*use the same version on all machines"
    with Cluster(scheduler=machines.address) as cluster, pytest.raises(OptionError, match=said):
        cluster.run(plan, plan.tasks)
    assert not attempts(log)


def test_a_worker_of_another_version_is_left_out(machines, tmp_path, log, capfd):
    """And where all others die, those that come in their place have their tasks."""
    plan = plan_of(tmp_path / "out", [f"slow-clip-{i}" for i in range(6)])
    machines.start_worker(PEER_VERSION="0.0.1")
    killed: list[int] = []

    def strike() -> None:
        if not killed and len(attempts(log)) > 2:
            killed.append(machines.workers[1].pid)
            machines.workers[1].kill()
            machines.workers[1].wait()
            machines.start_worker()

    with Cluster(scheduler=machines.address) as cluster:
        cluster.client.wait_for_workers(1)
        (unfit,) = cluster.client.nthreads()
        machines.start_worker()
        cluster.client.wait_for_workers(2)
        results = cluster.run(plan, plan.tasks, Told(strike))
    assert killed
    assert [r.status for r in results] == ["ok"] * 6
    assert whole(plan)
    said = [line for line in capfd.readouterr().err.splitlines() if "go on without this one" in line]
    assert len(said) == 1
    assert said[0].startswith(unfit)
    assert "version 0.0.1" in said[0]


def test_machines_without_the_package(machines, tmp_path):
    """Of workers, Dask takes those for dead; a scheduler is told of."""
    plan = plan_of(tmp_path / "out", ["a", "b"])
    machines.start_worker(PYTHONPATH="")
    machines.start_worker()
    with Cluster(scheduler=machines.address) as cluster:
        assert [r.status for r in cluster.run(plan, plan.tasks)] == ["ok", "ok"]
    machines.scheduler.kill()
    machines.scheduler.wait()
    machines.start_scheduler(PYTHONPATH="")
    machines.start_worker()
    said = r"scheduler cannot load handfit_core; .*pip install"
    with Cluster(scheduler=machines.address) as cluster, pytest.raises(OptionError, match=said):
        cluster.run(plan, plan.tasks, again=True)


def test_what_somebody_else_is_at_waits(machines, tmp_path, log, monkeypatch):
    monkeypatch.setattr(dask_engine, "ELSEWHERE", 0.3)
    plan = plan_of(tmp_path / "out", ["a", "b", "c"])
    claim = Watch().claim(plan.folder(plan.tasks[0]), plan.tasks[0].id)
    assert claim is not None
    told = Told()
    left = iter(range(4))

    def leave() -> None:
        if len(told.over) == 2 and next(left, None) is None:
            claim.release()

    told.turn = leave
    machines.start_worker()
    with Cluster(scheduler=machines.address) as cluster:
        results = cluster.run(plan, plan.tasks, told)
    assert [r.status for r in results] == ["ok"] * 3
    assert told.over[-1] == "a"
    assert whole(plan)


def test_what_fails_on_one_machine_is_tried_on_another(machines, tmp_path, log):
    """There, the program that does tasks always crashes."""
    plan = plan_of(tmp_path / "out", [f"clip-{i}" for i in range(6)])
    crashing = 'import os, sys; print(\'{"event": "ready", "version": "%s"}\', flush=True); '
    crashing += "sys.stdin.readline(); os.abort()"
    from handfit_core.version import __version__

    code = shlex.join([sys.executable, "-c", crashing % __version__])
    machines.start_worker(HANDFIT_FARM_COMMAND=code)
    machines.start_worker()
    with Cluster(scheduler=machines.address) as cluster:
        results = cluster.run(plan, plan.tasks)
    assert [r.status for r in results] == ["ok"] * 6
    assert whole(plan)


def test_parts_come_before_their_clip(machines, tmp_path, log):
    plan = plan_of(tmp_path / "out", ["good", "one", "two", "bad", "input", "fine"])
    good, one, two, bad, failing, fine = plan.tasks
    plan = planned(
        plan,
        tasks=(
            replace(good, cost=9.0, needs=(one.id, two.id)),
            replace(one, of=good.id),
            replace(two, of=good.id),
            replace(bad, cost=8.0, needs=(failing.id, fine.id)),
            replace(failing, of=bad.id),
            replace(fine, of=bad.id),
        ),
    )
    machines.start_worker()
    with Cluster(scheduler=machines.address) as cluster:
        results = cluster.run(plan, plan.tasks)
    assert [r.status for r in results] == ["ok", "ok", "ok", "failed", "failed", "ok"]
    assert results[3].attempts[-1]["kind"] == "PartFailed"
    begun = [each["task"] for each in attempts(log)]
    assert sorted(begun) == ["fine", "good", "input", "one", "two"]
    assert begun.index("good") > max(begun.index("one"), begun.index("two"))


def test_blender_goes_where_nothing_is_to_do(machines, tmp_path, log):
    plan = plan_of(tmp_path / "out", ["a", "b"])
    machines.start_worker()
    with Cluster(scheduler=machines.address) as cluster:
        cluster.client.wait_for_workers(1)
        cluster.run(plan, plan.tasks[:1])
        cluster.client.run(lambda: setattr(dask_engine, "_WARM", 0.2))
        cluster.run(plan, plan.tasks[1:])
        kept, *others = {each["pid"] for each in attempts(log)}
        assert not others, "one process did both"
        wait_until(lambda: not runs(kept))
        assert machines.workers[0].poll() is None
        cluster.run(plan, plan.tasks[:1], again=True)
    assert len(attempts(log)) == 3


OF_DASK = ("_NUM_THREADS", "MALLOC_TRIM_THRESHOLD_")


def test_what_dask_thinks_of_for_itself_is_not_ours(machines):
    machines.start_worker(nanny=True)
    with Cluster(scheduler=machines.address) as cluster:

        def look() -> tuple[object, object, list[str]]:
            from distributed import get_worker

            before = os.environ.get("OMP_NUM_THREADS")
            thread_state = dask_engine._ThreadState(get_worker())
            return before, thread_state.share, [name for name in os.environ if name.endswith(OF_DASK)]

        before, share, after = cluster.client.submit(look, pure=False).result()
    own = {name for name in os.environ if name.endswith(OF_DASK)}
    assert before == "1"
    assert share is None, "one worker has the whole machine"
    assert set(after) <= own


def run_work(plan, *words: str) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-m", "handfit_core", "work", str(plan.path), *words],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        cwd=ROOT,
    )


def test_the_command_and_its_exit_codes(machines, tmp_path, capsys):
    plan = planned(plan_of(tmp_path / "out", ["a", "input"]), command=("no such program",))
    machines.start_worker()
    work = ["work", str(plan.path), "--scheduler", machines.address]
    assert main(work) == 2
    assert "cannot be started" in capsys.readouterr().err
    assert main([*work, "--command", shlex.join(COMMAND)]) == 1
    assert "[2/2]" in capsys.readouterr().out
    entries = json.loads((tmp_path / "out" / "report.json").read_text())["inputs"]
    assert [entry["status"] for entry in entries] == ["ok", "failed"]
    assert main(["work", str(plan.path), "--scheduler", machines.address, "--tls", "a,b"]) == 2
    assert "three files are needed" in capsys.readouterr().err
    assert main(["work", str(tmp_path / "nothing"), "--cluster", "local"]) == 2
    assert main(["work", str(plan.path), "--cluster", "abacus"]) == 2
    assert "choose from local, " in capsys.readouterr().err


@pytest.mark.skipif(shutil.which("openssl") is None, reason="needs openssl, which makes certificates")
def test_with_certificates_and_without(tmp_path, monkeypatch, capsys):
    cert, key = tmp_path / "cert.pem", tmp_path / "key.pem"
    words = "req -x509 -newkey rsa:2048 -nodes -days 1 -subj /CN=handfit".split()
    subprocess.run(["openssl", *words, "-keyout", key, "-out", cert], check=True, capture_output=True)
    (tmp_path / "machines").mkdir()
    tls = [f"--tls-{what}={file}" for what, file in (("ca-file", cert), ("cert", cert), ("key", key))]
    found = Machines(tmp_path / "machines", "tls", *tls)
    try:
        found.start_worker()
        plan = plan_of(tmp_path / "out", ["a"])
        work = ["work", str(plan.path), "--scheduler", found.address]
        assert main([*work, "--tls", f"{cert},{cert},{key}"]) == 0
        assert "[1/1] ok" in capsys.readouterr().out
        monkeypatch.setattr(dask_engine, "_CONNECT", 0.5)
        for address in (found.address, found.address.replace("tls", "tcp")):
            assert main([*work[:-1], address]) == 2, "who has no certificate stays outside"
    finally:
        found.end()


def test_nobody_answers(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(dask_engine, "_CONNECT", 0.5)
    plan = plan_of(tmp_path / "out", ["a"])
    assert main(["work", str(plan.path), "--scheduler", "tcp://127.0.0.1:1"]) == 2
    assert "no Dask scheduler answers at tcp://127.0.0.1:1" in capsys.readouterr().err
    assert main(["work", str(plan.path), "--scheduler", "carrier-pigeon://1"]) == 2
    monkeypatch.setitem(sys.modules, "distributed", None)
    assert main(["work", str(plan.path), "--scheduler", "tcp://127.0.0.1:1"]) == 2
    assert 'pip install "handfit-core[farm]"' in capsys.readouterr().err


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_stopped_workers_leave_what_they_are_at(machines, tmp_path, log, number):
    plan = plan_of(tmp_path / "out", ["hang"])
    machines.start_worker()
    client = run_work(plan, "--scheduler", machines.address)
    wait_until(lambda: any("child" in each for each in attempts(log)))
    client.send_signal(number)
    client.communicate(timeout=PATIENCE)
    assert client.returncode == 130
    pids = [each[k] for each in attempts(log) for k in ("pid", "child") if k in each]
    wait_until(lambda: not any(map(runs, pids)))
    wait_until(lambda: not (tmp_path / "out" / "hang").exists())
    assert machines.workers[0].poll() is None, "the worker is ready for the next plan"


def test_a_client_ends_with_who_started_it(machines, tmp_path, log):
    plan = plan_of(tmp_path / "out", ["hang"])
    machines.start_worker()
    work = [sys.executable, "-m", "handfit_core", "work", str(plan.path), "--scheduler", machines.address]
    starting = f"import os, subprocess; subprocess.run({work!r} + [f'--parent={{os.getpid()}}'])"
    parent = subprocess.Popen([sys.executable, "-c", starting], cwd=ROOT)
    wait_until(lambda: any("child" in each for each in attempts(log)))
    (client,) = psutil.Process(parent.pid).children()
    parent.kill()
    parent.wait()
    wait_until(lambda: not runs(client.pid))
    pids = [each[k] for each in attempts(log) for k in ("pid", "child") if k in each]
    wait_until(lambda: not any(map(runs, pids)))
    wait_until(lambda: not (tmp_path / "out" / "hang").exists())


SBATCH = """#!{python}
import subprocess, sys
with open(sys.argv[-1] + ".said", "w") as said:
    job = subprocess.Popen(["bash", sys.argv[-1]], stdout=said, stderr=said, start_new_session=True)
print("Submitted batch job", job.pid)
"""
SCANCEL = """#!{python}
import os, signal, sys
for job in sys.argv[1:]:
    os.killpg(int(job), signal.SIGKILL)
"""


@pytest.mark.parametrize("kind", ["local", "slurm"])
def test_a_cluster_of_its_own(tmp_path, log, monkeypatch, kind):
    """slurm's commands are stood in for by two that start and end jobs on this machine."""
    pytest.importorskip("dask_jobqueue", reason="needs dask-jobqueue, of handfit-core[farm]")
    for name, text in (("sbatch", SBATCH), ("scancel", SCANCEL)):
        (tmp_path / name).write_text(text.format(python=sys.executable))
        (tmp_path / name).chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}:{os.environ['PATH']}")
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    monkeypatch.setenv("DASK_JOBQUEUE__SLURM__INTERFACE", "lo")
    plan = plan_of(tmp_path / "out", [f"clip-{i}" for i in range(6)])
    done = run_work(plan, "--cluster", kind, "--jobs", "2")
    said, errors = done.communicate(timeout=PATIENCE)
    assert done.returncode == 0, errors
    assert "[6/6] ok" in said
    assert whole(plan)
    wait_until(lambda: not any(runs(each["pid"]) for each in attempts(log)))
