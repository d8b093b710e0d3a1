"""Tasks done by the workers of a Dask cluster, on any number of machines.

A Dask task is light: in a thread of the Dask worker it has a pool with one slot do one task of the plan, and
the pool claims, beats, times out and seals in the folder of results as everywhere else. So a task that Dask
runs twice is done once, and what Dask forgets is found again in the folder. Each task brings what it needs of
its plan along: workers read no plan, and the scheduler holds only as many tasks as are about to be begun.

Needs the packages of `handfit-core[farm]`, once it is used.
"""

from __future__ import annotations

import contextlib
import importlib
import json
import os
import queue
import shlex
import sys
import threading
import time
import uuid
import zlib
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Final, Self

from handfit_core.errors import HandfitError, OptionError
from handfit_core.farm.folder import attempt
from handfit_core.farm.plan import Plan, Task
from handfit_core.farm.pool import ATTEMPTS, CURABLE, OF_MACHINE, Listener, Pool, settled, share
from handfit_core.farm.report import Result
from handfit_core.version import __version__

COMMAND_VARIABLE: Final = "HANDFIT_FARM_COMMAND"
"""Names, on a worker's machine, what does tasks there instead of the command of the plan"""
PATIENCE: Final = 300.0
"""seconds that a scheduler that has gone may take to come back"""
ELSEWHERE: Final = 15.0
"""seconds between two looks at a task that somebody else is at"""
_WARM: Final = 60.0
"""seconds that Blender is kept where there is nothing to do, since the next batch may want it"""
_AHEAD: Final = 2
"""Tasks that the scheduler holds for each thread of the workers: one to do and one to go on with. Of more,
Dask would hand out all at once, as each has a name of its own: in no order, and lost with their worker"""
_NAMED: Final = 10_000
"""Tasks up to which each has its clip's name on the dashboard: the scheduler keeps some kB for every name
that it has ever heard"""
_COUNTED: Final = 5.0
"""seconds between two counts of the workers"""
_TOLD: Final = 2.0
"""seconds between two messages about how far a task is"""
_LOOK: Final = 0.2
_CONNECT: Final = 10.0
"""seconds for one attempt to reach the scheduler"""


class SchedulerLost(HandfitError):
    """The scheduler has gone and not come back; what was finished is kept."""


# In the worker


def do_task(packed: bytes, settings: Mapping[str, Any]) -> dict[str, Any]:
    """Do one task; called by a Dask worker. `packed`: `_packed` of it. `settings`: `Cluster.settings`.

    Returns the `worker`, and the `result`, as `asdict` makes it, or as `refused` why this worker can do none.
    """
    from distributed import Reschedule, get_worker

    worker = get_worker()
    order = json.loads(zlib.decompress(packed))
    if order["plan"]["made_by"] != __version__:
        why = (
            f"{worker.address} has version {__version__} of handfit_core, and the plan was made by version "
            f"{order['plan']['made_by']}; use the same version on all machines"
        )
        return {"refused": why, "worker": worker.address}
    plan = Plan.of_content(order["plan"], Path(order["path"]))
    listener = _WorkerListener(worker, settings["topic"])
    try:
        with _warm_pool(worker, settings["command"], settings["here"]) as pool:
            again, retry_failed = settings["again"], settings["retry_failed"]
            (result,) = pool.run(
                plan, plan.tasks[:1], listener, again=again, retry_failed=retry_failed, wait=False
            )
    except _NotWanted:
        raise Reschedule from None
    except OptionError as error:
        return {"refused": f"{worker.address}: {error}", "worker": worker.address}
    except HandfitError as error:  # the disk with the results is not here, as it may be elsewhere
        result = _failed(plan.tasks[0], f"{worker.address}: {error}", type(error).__name__)
    return {"result": asdict(result), "worker": worker.address, "begun": listener.begun}


def _failed(task: Task, error: str, kind: str) -> Result:
    """What came of a task that nobody could even try."""
    result = Result(task.shown, task.name, "failed", id=task.id, error=" ".join(error.split()))
    result.attempts = [attempt(result.error, kind, 0.0)]
    return result


class _NotWanted(Exception):
    """Nobody waits for this task any more, or this worker ends."""


class _WorkerListener(Listener):
    """Tells the client how far a task is, and ends it where nobody wants it any more."""

    def __init__(self, worker: Any, topic: str) -> None:
        self._worker, self._topic, self._key = worker, topic, worker.get_current_task()
        self._told = time.monotonic()
        self.begun = False

    def began(self, task: Task) -> None:
        """It is being done."""
        self.begun = True
        self._worker.log_event(self._topic, [task.id, "", 0, 0])

    def progress(self, task: Task, stage: str, done: int, total: int) -> None:
        """So much of it is done."""
        if time.monotonic() > self._told + _TOLD:
            self._told = time.monotonic()
            self._worker.log_event(self._topic, [task.id, stage, done, total])

    def turn(self) -> None:
        """Look whether the task is still wanted."""
        known = self._worker.state.tasks.get(self._key)
        if known is None or known.state == "cancelled" or self._worker.status.name in ("closing", "closed"):
            raise _NotWanted


class _ThreadState:
    """What a thread of the worker keeps from task to task: a pool with one process."""

    def __init__(self, worker: Any) -> None:
        from dask import config
        from distributed.comm import get_address_host
        from distributed.utils import sync

        self._lock = threading.Lock()
        self._pool: Pool | None = None
        self._made_for: Any = None
        self._end: threading.Timer | None = None
        for name, value in config.get("distributed.nanny.pre-spawn-environ").items():
            if worker.nanny and os.environ.get(name) == str(value):
                # Meant for what computes in the worker itself; what it says of memory slows captures down.
                del os.environ[name]
        threads = sync(worker.loop, worker.scheduler.ncores)
        here = get_address_host(worker.address)
        self.share = share(sum(n for address, n in threads.items() if get_address_host(address) == here))

    @contextlib.contextmanager
    def occupied(self, **made_for: Any) -> Iterator[Pool]:
        """The pool that is made for this; it is ended where a task is broken off, or where none follows."""
        with self._lock:
            if self._end is not None:
                self._end.cancel()
            if self._made_for != made_for:
                self._stop()
            if self._pool is None:
                self._pool, self._made_for = Pool(**made_for), made_for
            try:
                yield self._pool
            except BaseException:
                self._stop()
                raise
            self._end = threading.Timer(_WARM, self._end_idle)
            self._end.daemon = True
            self._end.start()

    def _end_idle(self) -> None:
        if self._lock.acquire(blocking=False):  # else a task has just begun
            try:
                self._stop()
            finally:
                self._lock.release()

    def _stop(self) -> None:
        if self._pool is not None:
            self._pool.stop()
            self._pool = None


_thread_states: dict[int, _ThreadState] = {}
"""By thread. Their processes see for themselves when the Dask worker has ended, however it did"""


def _warm_pool(
    worker: Any, command: Sequence[str], here: Mapping[str, Any]
) -> contextlib.AbstractContextManager[Pool]:
    """The pool of this thread, whose process stays for the next task."""
    if (thread_state := _thread_states.get(threading.get_ident())) is None:
        thread_state = _thread_states[threading.get_ident()] = _ThreadState(worker)
    own = os.environ.get(COMMAND_VARIABLE)
    command = tuple(words(own) if own else command)
    processes = here["processes"] or thread_state.share
    return thread_state.occupied(
        **{**here, "command": command, "threads": thread_state.share, "processes": processes}
    )


def words(command: str) -> list[str]:
    """The words of a command, which may be quoted."""
    if sys.platform == "win32":  # where a backslash is part of a path
        return [word.strip('"') for word in shlex.split(command, posix=False)]
    return shlex.split(command)


# In the client


@dataclass
class _Try:
    """A task that is not over."""

    task: Task
    not_before: float = 0.0
    avoid: str = ""
    """The worker that another one shall do better"""
    prefer: str = ""
    """The worker that has already seen somebody else at it"""
    only: frozenset[str] = frozenset()
    """The workers that may have it; empty: all"""
    deaths: int = 0
    """How often Dask has given it up since its workers died"""


class Cluster:
    """Does tasks with the workers of a Dask cluster; takes the place of a `Pool`."""

    def __init__(
        self,
        *,
        scheduler: str | None = None,
        cluster: str | None = None,
        jobs: int = 1,
        tls: str | None = None,
        command: Sequence[str] | None = None,
        timeout: float | None = None,
        debug: bool = False,
        python: str | None = None,
        processes: int | None = None,
    ) -> None:
        """`scheduler`: the address of one that runs; or else `cluster`: what starts `jobs` workers, such as
        slurm. `tls`: CA,CERT,KEY, files. `command`: does tasks instead of the plan's. The others as for a
        `Pool`. Raises OptionError where Dask is missing, or no scheduler answers."""
        self._address, self._command = scheduler, command
        self._here = {"timeout": timeout, "debug": debug, "python": python, "processes": processes}
        self._security = _security(tls)
        self._cluster: Any = _started(cluster, jobs, self._security) if cluster else None
        self._topic = f"handfit-{uuid.uuid4().hex}"
        self._news: queue.SimpleQueue[Any] = queue.SimpleQueue()
        try:
            self._client = self._connected()
        except (OSError, TypeError, ValueError) as error:  # also what is no address, or needs certificates
            raise OptionError(
                f"no Dask scheduler answers at {scheduler} ({' '.join(str(error).split())}); start one with "
                "'dask scheduler', and workers with 'dask worker', or give its address"
            ) from error

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._client.close()
        if self._cluster is not None:
            self._cluster.close()

    def run(
        self,
        plan: Plan,
        tasks: Sequence[Task],
        listener: Listener | None = None,
        *,
        again: bool = False,
        retry_failed: bool = False,
    ) -> list[Result]:
        """As `Pool.run`. Raises OptionError where no worker can do any, and SchedulerLost."""
        return _Run(self, plan, tasks, listener or Listener(), again, retry_failed).results()

    # What a run does with it

    @property
    def client(self) -> Any:
        """Dask's own, connected at present or not."""
        return self._client

    def settings(self, plan: Plan, **settings: Any) -> dict[str, Any]:
        """What workers are told beside the task."""
        command = list(self._command or plan.command)
        return {**settings, "command": command, "topic": self._topic, "here": self._here}

    def hear(self, what: Any) -> None:
        """Put something among the news; called from Dask's threads."""
        self._news.put(what)

    def news(self) -> list[Any]:
        """What has come; waits a moment where nothing has."""
        found = []
        with contextlib.suppress(queue.Empty):
            found.append(self._news.get(timeout=_LOOK))
            while True:
                found.append(self._news.get_nowait())
        return found

    def subscribe(self) -> None:
        """Have the workers' messages come, also from a scheduler that has come back."""
        self._client.subscribe_topic(self._topic, lambda event: self.hear(event[1]))

    def wait_for_scheduler(self, listener: Listener) -> None:
        """Return once the scheduler has come back. Raises SchedulerLost."""
        _say(f"the Dask scheduler has gone; waiting for it for up to {PATIENCE:g} seconds")
        until = time.monotonic() + PATIENCE
        while self._client.status != "running":
            if time.monotonic() > until or self._cluster is not None:
                raise SchedulerLost(
                    f"the Dask scheduler at {self._address or 'this machine'} has gone and not come back; "
                    "what was finished is kept: start it and its workers, and run the same command again"
                )
            listener.turn()
            time.sleep(_LOOK)
            if self._client.status == "closed":
                with contextlib.suppress(OSError):
                    self._client = self._connected()
        self.subscribe()
        _say("the Dask scheduler has come back")

    def _connected(self) -> Any:
        from distributed import Client

        client = Client(self._cluster or self._address, security=self._security, timeout=_CONNECT)
        self._client = client
        self.subscribe()
        return client


class _Run:
    """One call of `Cluster.run`."""

    def __init__(
        self,
        cluster: Cluster,
        plan: Plan,
        tasks: Sequence[Task],
        listener: Listener,
        again: bool,
        retry_failed: bool,
    ) -> None:
        self._cluster, self._plan, self._tasks, self._listener = cluster, plan, tasks, listener
        self._again, self._retry_failed = again, retry_failed
        self._settings = cluster.settings(plan, again=again, retry_failed=retry_failed)
        self._open = deque(_Try(task) for task in sorted(tasks, key=lambda task: -task.cost))
        self._later: list[_Try] = []
        self._ids = {task.id for task in tasks}
        self._at: dict[Any, _Try] = {}
        """By future"""
        self._begun: set[str] = set()
        self._results: dict[str, Result] = {}
        self._workers: Mapping[str, int] = {}
        """Threads by address"""
        self._unfit: set[str] = set()
        """Workers that can do no task of this plan"""
        self._counted = -_COUNTED
        self._alone = False

    def results(self) -> list[Result]:
        """Do them."""
        while self._open or self._later or self._at:
            self._listener.turn()
            if self._cluster.client.status != "running":
                self._cluster.wait_for_scheduler(self._listener)
            self._submit_some()
            ended = []
            for what in self._cluster.news():
                if isinstance(what, list | tuple):
                    self._progress(*what)
                elif what in self._at:
                    ended.append(what)
            self._take(ended)
        return [self._results[task.id] for task in self._tasks]

    def _submit_some(self) -> None:
        """Give the scheduler what it may hold."""
        now = time.monotonic()
        if not self._workers or now > self._counted + _COUNTED:
            self._count()
        due = [this for this in self._later if this.not_before <= now and not self._waits(this)]
        self._later = [this for this in self._later if this not in due]
        self._open.extendleft(due)
        most = _AHEAD * sum(self._workers.values())
        while self._open and len(self._at) < most:
            this = self._open.popleft()
            known = settled(self._plan, this.task, again=self._again, retry_failed=self._retry_failed)
            if known is not None:
                self._end(this, known)
                self._listener.turn()
            elif self._waits(this):
                self._later.append(this)
            else:
                self._submit(this)

    def _waits(self, this: _Try) -> bool:
        """Whether parts of its clip are not done yet."""
        return any(id in self._ids and id not in self._results for id in this.task.needs)

    def _count(self) -> None:
        with contextlib.suppress(OSError):
            threads = self._cluster.client.nthreads()
            self._workers = {worker: n for worker, n in threads.items() if worker not in self._unfit}
        self._counted = time.monotonic()
        for future, this in list(self._at.items()):
            if this.only and this.only.isdisjoint(self._workers):  # Dask would wait for them to come back
                del self._at[future]
                future.cancel()
                self._open.appendleft(this)
        if not self._workers and not self._alone:
            _say("there is no Dask worker; start some with 'dask worker', where handfit-core is installed")
        self._alone = not self._workers

    def _submit(self, this: _Try) -> None:
        task = this.task
        for id in task.needs:
            if (part := self._results.get(id)) is not None and part.status != "ok":
                self._give_up(this, f"{task.shown}: {part.error}", "PartFailed")
                return
        others = [worker for worker in self._workers if worker != this.avoid]
        chosen = [this.prefer] if this.prefer in self._workers else others if this.avoid else []
        if self._unfit:  # idle ones would steal what only should be elsewhere
            chosen = chosen or list(self._workers)
            this.only = frozenset(chosen)
        name = task.name if len(self._tasks) <= _NAMED else "task"
        future = self._cluster.client.submit(
            do_task,
            _packed(self._plan, task),
            self._settings,
            key=f"{name}-{uuid.uuid4().hex}",
            pure=False,
            retries=ATTEMPTS - 1,
            priority=task.cost,
            workers=chosen or None,
            allow_other_workers=bool(chosen) and not this.only,
        )
        self._at[future] = this
        future.add_done_callback(self._cluster.hear)

    def _progress(self, id: str, stage: str, done: int, total: int) -> None:
        """A worker is at a task."""
        if id in self._results or (task := self._plan.by_id.get(id)) is None:
            return
        if id not in self._begun:
            self._begun.add(id)
            self._listener.began(task)
        if stage:
            self._listener.progress(task, stage, done, total)

    def _take(self, ended: Sequence[Any]) -> None:
        """Take in what has become of tasks that Dask is done with."""
        good = [future for future in ended if future.status == "finished"]
        answers: Sequence[Any] = []
        try:
            answers = self._cluster.client.gather(good)
        except Exception:  # its worker or the scheduler has died since: the folder knows what is done
            good = []
        for future in ended:
            if (this := self._at.pop(future, None)) is None:  # another answer has had it begun anew
                continue
            if future in good:
                self._answered(this, answers[good.index(future)])
            elif future.status == "error":
                self._broken(this, future.exception())
            else:  # the scheduler has gone, and maybe come back already
                self._cluster.subscribe()
                self._open.appendleft(this)

    def _answered(self, this: _Try, answer: Mapping[str, Any]) -> None:
        if "refused" in answer:
            self._leave_out(answer["worker"], answer["refused"])
            self._open.appendleft(this)
            return
        result = Result.of_entry(answer["result"])
        if answer["begun"]:
            self._progress(this.task.id, "", 0, 0)
        kind = result.attempts[-1]["kind"] if result.status == "failed" and result.attempts else ""
        if result.status == "running":
            self._again_later(this, prefer=answer["worker"])
        elif kind in (*CURABLE, *OF_MACHINE) and not this.avoid and len(self._workers) > 1:
            this.avoid = answer["worker"]
            self._open.appendleft(this)
        else:
            self._end(this, result)

    def _leave_out(self, worker: str, why: str) -> None:
        """Do without a worker that can do no task. Raises OptionError where it was the last one."""
        is_new = worker not in self._unfit
        self._unfit.add(worker)
        self._count()
        if not self._workers:
            raise OptionError(why)
        if is_new:
            _say(f"{why}. The other workers go on without this one")

    def _again_later(self, this: _Try, prefer: str = "") -> None:
        this.not_before, this.prefer = time.monotonic() + ELSEWHERE, prefer
        self._later.append(this)

    def _broken(self, this: _Try, error: Any) -> None:
        """Dask has given a task up: workers died of it or beside it, or it broke in a way nobody foresaw."""
        from distributed import KilledWorker

        if "deserialization of the task graph" in str(error):
            raise OptionError(
                "the Dask scheduler cannot load handfit_core; install the same version there, too: "
                'pip install "handfit-core[farm]"'
            )
        died = isinstance(error, KilledWorker)
        this.deaths += 1
        if died and this.deaths < ATTEMPTS:
            self._open.appendleft(this)
            return
        if died:
            sentence = (
                f"{this.deaths * (error.allowed_failures + 1)} Dask workers ended while they were at it, the "
                f"last one {error.last_worker.address}; look into their logs, and try again"
            )
        else:
            sentence = f"Dask could not have it done: {type(error).__name__}: {error}"
        self._give_up(this, sentence, "WorkerDied" if died else type(error).__name__)

    def _give_up(self, this: _Try, error: str, kind: str) -> None:
        """No worker has an answer: note it where they would have."""
        result = _failed(this.task, error, kind)
        with contextlib.suppress(HandfitError):
            self._plan.folder(this.task).fail(this.task.id, asdict(result), {})
        self._end(this, result)

    def _end(self, this: _Try, result: Result) -> None:
        self._results[this.task.id] = result
        self._listener.ended(this.task, result)


def _packed(plan: Plan, task: Task) -> bytes:
    """One task and what it needs of its plan; the pictures of a long sequence have names that are alike."""
    tasks = (task, *(plan.by_id[id] for id in (task.of, *task.needs) if id))
    content = {"plan": replace(plan, tasks=tasks).content(), "path": str(plan.path)}
    return zlib.compress(json.dumps(content).encode())


def _security(tls: str | None) -> Any:
    """What makes connections safe; None: as Dask's own configuration says. Raises OptionError."""
    _check_installed("distributed")
    if tls is None:
        return None
    from distributed import Security

    files = [str(Path(name).expanduser().absolute()) for name in tls.split(",")]
    if len(files) != 3 or not all(Path(file).is_file() for file in files):
        raise OptionError(f"--tls {tls}: three files are needed: those of the authority, certificate and key")
    ca, cert, key = files
    roles = {
        f"tls_{role}_{what}": file
        for role in ("client", "scheduler", "worker")
        for what, file in (("cert", cert), ("key", key))
    }
    return Security(tls_ca_file=ca, require_encryption=True, **roles)


def _started(kind: str, jobs: int, security: Any) -> Any:
    """A cluster of so many workers, each of which does one task at a time. Raises OptionError."""
    from dask import config
    from distributed import LocalCluster

    if kind == "local":
        return LocalCluster(
            n_workers=jobs, threads_per_worker=1, **({"security": security} if security else {})
        )
    _check_installed("dask_jobqueue")
    jobqueue = importlib.import_module("dask_jobqueue")
    kinds = {name.removesuffix("Cluster").lower(): name for name in dir(jobqueue) if name.endswith("Cluster")}
    kinds = {kind: name for kind, name in kinds.items() if kind not in ("job", "queue", "jobqueue", "")}
    if kind not in kinds:
        raise OptionError(f"--cluster {kind}: choose from local, {', '.join(sorted(kinds))}")
    own = {"cores": 1, "processes": 1, "memory": "4 GB"}
    given = {
        name: value for name, value in own.items() if config.get(f"jobqueue.{kind}.{name}", None) is None
    }
    try:
        cluster = getattr(jobqueue, kinds[kind])(security=security, **given)
        cluster.adapt(minimum_jobs=jobs, maximum_jobs=jobs)  # which also starts others where jobs have ended
    except Exception as error:  # whatever its configuration may be
        raise OptionError(f"--cluster {kind}: {' '.join(str(error).split())}") from error
    return cluster


def _check_installed(package: str) -> None:
    try:
        importlib.import_module(package)
    except ImportError as error:
        raise OptionError(
            f"this Python ({sys.executable}) has no {package}: install it there with "
            "'pip install \"handfit-core[farm]\"', or name another Python with --python"
        ) from error


def _say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)
