"""Who does the tasks: this process, processes of this machine (loky), or the workers of a Dask cluster."""

from __future__ import annotations

import contextlib
import importlib
import os
import platform
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

from handfit_core.common.errors import HandfitError, OptionError
from handfit_core.common.machine import usable_cores
from handfit_core.common.version import __version__
from handfit_core.tasks.capture import Settings, note_failure, run_task
from handfit_core.tasks.record import Attempt, Record, Result
from handfit_core.tasks.report import result_of
from handfit_core.tasks.task import Task
from handfit_core.worker.events import THREAD_VARIABLES

_CONNECT: Final = 10.0
"""Seconds within which a scheduler must answer"""
CHECK: Final = "handfit-core"
"""The name under which Dask has the check of its workers"""
_PYTHON: Final = platform.python_version()
_LEAKED: Final = {"LOKY_MAX_MEMORY_LEAK_SIZE": "1e9"}
"""Bytes beyond which loky replaces a process between two tasks; a first clip alone leaves 0.3e9"""


class SchedulerGone(HandfitError):
    """The Dask scheduler has gone."""

    def __init__(self) -> None:
        super().__init__(
            "the Dask scheduler has gone; what was finished is kept: start it and its workers, and give the "
            "same command again"
        )


class ProcessDied(Exception):
    """A process that did a task has died."""


class Workers:
    """Captures one task after another in this process; what is made of it has others do that."""

    tries = 1
    """How often a task is tried at most whose process dies"""
    room = 1
    """How many tasks may be handed out at a time"""
    are_others = False
    """True if other processes do the tasks, for which this one only waits"""
    death = "the process that captured it died"
    """The sentence about a task whose process has died"""
    run: Callable[[Task, Path, Settings], Result] = staticmethod(run_task)
    """The function that does a task"""

    def __init__(self, output: Path, settings: Settings) -> None:
        """`output`: the folder of all results."""
        self.output, self.settings = output, settings

    def submit(self, task: Task) -> Future[Result]:
        """Have a task done. Raises BrokenExecutor where a process has died."""
        future = Future[Result]()
        try:
            future.set_result(self.run(task, self.output, self.settings))
        except MemoryError as error:
            future.set_exception(error)
        return future

    def told(self, task: Task) -> Result | None:
        """Return what a process has noted of a task before it died; None where it has noted nothing."""
        record = Record.read(task.record(self.output))
        if record is not None and record.key == task.key and record.run == self.settings.run:
            return result_of(task, record)
        return None

    def lost(self, task: Task, tried: Sequence[Attempt]) -> Result:
        """Give up a task whose process has died each time, and note it."""
        *before, last = tried
        times = f" {len(tried)} times" if before else ""
        sentence = f"{task.shown}: {last.error}{times}; the input is damaged, or needs more memory"
        tried = [*before, replace(last, error=sentence)]
        return note_failure(task, self.output, self.settings, tried)

    def renew(self) -> None:
        """Start new processes once one has died."""

    def close(self) -> None:
        """End whatever runs."""


class LocalProcesses(Workers):
    """Has processes of this machine do tasks, as many as there is room for, each with its share of the
    cores."""

    tries = 3
    are_others = True

    def __init__(self, output: Path, settings: Settings, jobs: int) -> None:
        """Prepare `jobs` processes. Raises OptionError where loky is missing."""
        super().__init__(output, settings)
        _check_installed("loky", "--jobs 1")
        self.room = jobs
        self._executor: Any = None

    def submit(self, task: Task) -> Future[Result]:
        """Have one of the processes do a task. Raises BrokenExecutor where one has died."""
        if self._executor is None:
            from loky import ProcessPoolExecutor, process_executor
            from loky.backend import get_context

            process_executor.kill_process_tree = _kill
            theirs, self._ours = get_context().Pipe(duplex=False)
            code = _SET_UP.format(folder=str(Path(__file__).resolve().parents[1]))
            threads = str(max(1, usable_cores() // self.room))
            self._executor = ProcessPoolExecutor(
                self.room,
                initializer=exec,
                initargs=(code, {"parent": theirs}),
                env=dict.fromkeys(THREAD_VARIABLES, threads) | _LEAKED,
            )
        return self._executor.submit(self.run, task, self.output, self.settings)

    def renew(self) -> None:
        """End the processes; the next task starts others."""
        self.close()

    def close(self) -> None:
        """End the processes."""
        if self._executor is not None:
            self._executor.shutdown(kill_workers=True)
            self._executor = None


_SET_UP: Final = """
import runpy, sys
if "handfit_core" not in sys.modules:
    launch = runpy.run_path({folder!r} + "/worker/launch.py")
    launch["import_package"]("handfit_core", {folder!r})
from handfit_core.tasks.workers import set_up
set_up(parent)
"""
"""What a new process does first. It has to find handfit_core as this one has found it, which may be by the
launcher; no function of ours can be sent there before"""


def set_up(parent: Any) -> None:
    """Make a process ready for tasks: who has started it ends it, and not the terminal."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    end_after(parent.recv)


def end_after(wait: Callable[[], object]) -> None:
    """Have this process end itself, as SIGTERM would, once a call returns, such as one that reads from a pipe
    of which the parent has the other end."""

    def end() -> None:
        with contextlib.suppress(EOFError, OSError):
            wait()
        os.kill(os.getpid(), signal.SIGTERM)

    threading.Thread(target=end, daemon=True).start()


def _kill(process: Any, **_: Any) -> None:
    """End a process at once. Loky's own way needs psutil or pgrep, and waits for ever where neither is there;
    captures start no processes that it would have to find."""
    with contextlib.suppress(OSError):
        os.kill(process.pid, getattr(signal, "SIGKILL", signal.SIGTERM))
    process.join()


class DaskWorkers(Workers):
    """Has the workers of a Dask cluster do tasks; the scheduler tries a task again whose worker has died."""

    tries = 2
    """How often a task is tried; the scheduler tries by itself, and blames what waited at a worker that died,
    too; alone nothing does"""
    room = 10_000
    """How many tasks are handed out at a time: more than there are threads, as the scheduler knows best who
    is free"""
    are_others = True

    def __init__(self, output: Path, settings: Settings, address: str, jobs: int) -> None:
        """Connect to the scheduler of that address; `local`: to one of this machine, with `jobs` workers.
        Raises OptionError where Dask is missing, no scheduler answers, or workers are of another version."""
        super().__init__(output, settings)
        _check_installed("distributed", "--jobs")
        from dask import config
        from distributed import Client, LocalCluster

        self._cluster: Any = None
        try:
            if address == "local":
                self.tries = 3
                with config.set({"distributed.scheduler.allowed-failures": 0}):
                    self._cluster = LocalCluster(
                        n_workers=jobs, threads_per_worker=1, dashboard_address="127.0.0.1:0"
                    )
            self._client = Client(self._cluster or address, timeout=_CONNECT)
        except (OSError, TypeError, ValueError) as error:  # also what is no address, or needs certificates
            raise OptionError(
                f"no Dask scheduler answers at {address} ({' '.join(str(error).split())}); start one with "
                "'dask scheduler', and workers with 'dask worker', or give its address"
            ) from error
        print(f"Dask's dashboard: {self._client.dashboard_link}", file=sys.stderr, flush=True)
        try:
            self._check_workers()
        except BaseException:
            self.close()
            raise

    def _check_workers(self) -> None:
        """Have all workers checked, and those that join later."""
        from distributed import WorkerPlugin

        from handfit_core.tasks.dask_check import SameVersions

        if not self._client.nthreads():
            print("no worker is there yet: start one with 'dask worker'", file=sys.stderr, flush=True)
        try:
            self._client.register_plugin(WorkerPlugin(), CHECK)  # in place of what a killed batch has left
            self._client.wait_for_workers(1)
            self._client.register_plugin(SameVersions(__version__, _PYTHON), CHECK)
        except OptionError:
            raise
        except Exception as error:  # whatever another version may lack
            raise OptionError(
                f"the workers of the Dask cluster have no handfit_core of version {__version__} ({error}); "
                "install it there"
            ) from error

    def submit(self, task: Task) -> Future[Result]:
        """Have the cluster do a task. Its future holds what the worker raised."""
        future = Future[Result]()

        def pass_on(theirs: Any) -> None:
            try:
                future.set_result(theirs.result())
            except BaseException as error:
                future.set_exception(error)

        # Dask's own executor forgets a task whose worker dies with its result: it never ends there. The other
        # tries are where memory ran out.
        theirs = self._client.submit(self.run, task, self.output, self.settings, pure=False, retries=2)
        theirs.add_done_callback(pass_on)
        return future

    def close(self) -> None:
        """Leave the cluster, and end one that was started here."""
        with contextlib.suppress(Exception):  # the scheduler has gone
            self._client.unregister_worker_plugin(CHECK)
        self._client.close()
        if self._cluster is not None:
            self._cluster.close()


_waking: Callable[[], None] | None = None
"""The function that an interruption calls, instead of ending what the main thread is at; see
`interrupted_by_waking`"""


@contextlib.contextmanager
def interrupted_by_waking(wake: Callable[[], None]) -> Iterator[None]:
    """Have an interruption within `terminated_as_interrupted` call a function that is safe in signal
    handlers. A KeyboardInterrupt in the midst of loky's own work may leave it waiting for ever."""
    global _waking
    _waking = wake
    try:
        yield
    finally:
        _waking = None


@contextlib.contextmanager
def terminated_as_interrupted() -> Iterator[None]:
    """Within, SIGTERM acts as Ctrl-C, once."""

    def interrupt(_number: int, _frame: object) -> None:
        for each in before:  # a second one would end what the first one has begun to tidy up
            signal.signal(each, signal.SIG_IGN)
        if _waking is None:
            raise KeyboardInterrupt
        _waking()

    before = {each: signal.signal(each, interrupt) for each in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for each, handler in before.items():
            signal.signal(each, handler)


def _check_installed(package: str, instead: str) -> None:
    try:
        importlib.import_module(package)
    except ImportError as error:
        raise OptionError(
            f"this Python ({sys.executable}) has no {package}: install it with 'pip install {package}', or "
            f"use {instead}"
        ) from error
