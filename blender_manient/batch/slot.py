"""The process that does tasks: it holds Blender and a worker that captures, and stays warm between them.

handfit_core/farm/slot.py tells what is said; docs/batch.md, who starts it.
"""

from __future__ import annotations

import contextlib
import json
import os
import signal
import sys
import time
import traceback
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, BinaryIO

from handfit_core.errors import HandfitError
from handfit_core.farm.folder import kind_of
from handfit_core.farm.plan import Task
from handfit_core.farm.report import Result
from handfit_core.version import __version__
from handfit_core.worker.client import Advice
from handfit_core.worker.process import SAME_GROUP, end_with_parent
from handfit_core.worker.protocol import encode
from handfit_core.worker.runner import Runner

from .. import shared_worker
from .exit_codes import EXIT_OK
from .host import Host
from .one_input import Work, fit
from .order import Order


def serve(host: Host) -> int:
    """Do tasks until stdin ends. Returns the exit code."""
    requests, events = _own_streams()
    # Where nobody looks, the next event finds out that nobody hears it any more.
    end_with_parent(os.getppid(), _end_group)
    with _TaskServer(host, events) as server:
        server.say("ready", version=__version__, pid=os.getpid())
        while line := requests.readline():
            server.do(json.loads(line))
    return EXIT_OK


@dataclass
class _TaskServer:
    """What stays from task to task: the worker, and what the options mean."""

    host: Host
    events: BinaryIO
    runner: Runner | None = None
    made_for: Any = None
    orders: dict[str, Order] = field(default_factory=dict)

    def __enter__(self) -> _TaskServer:
        return self

    def __exit__(self, *_: object) -> None:
        if self.runner is not None:
            self.runner.__exit__()

    def say(self, kind: str, /, **fields: Any) -> None:
        """Tell who gave the task; where nobody hears it any more, this process has no reason to go on."""
        try:
            self.events.write(encode({"event": kind, **fields}))
            self.events.flush()
        except OSError:
            _end_group()

    def do(self, request: Mapping[str, Any]) -> None:
        """Do one task; whatever goes wrong is told."""
        task = Task.of_entry(request["task"])
        result = Result(task.shown, task.name, id=task.id)
        started = time.perf_counter()
        try:
            finished = {name: Path(path) for name, path in request["finished"].items()}
            parts = [Path(path) for path in request["parts"]]
            named, folder = request["files"], Path(request["folder"])
            work = Work(task, self._order(request), folder, finished, parts, named, self.say)
            fit(work, result, self._runner(request), keep_addons=self.host.keep_addons)
        except Exception as error:
            kind, message = kind_of(error), " ".join(str(error).split())
            if not isinstance(error, HandfitError):
                message = f"unexpected {kind}: {message} (see --debug)"
            if request["debug"]:
                traceback.print_exc()
            result.seconds = round(time.perf_counter() - started, 3)
            self.say("error", type=kind, message=message, result=asdict(result))
        else:
            result.seconds = round(time.perf_counter() - started, 3)
            self.say("done", result=asdict(result))

    def _order(self, request: Mapping[str, Any]) -> Order:
        known = json.dumps(request["options"], sort_keys=True)
        if known not in self.orders:
            here = {name: request.get(name) for name in ("debug", "python", "processes")}
            self.orders = {known: Order.of_plan(request["options"], **here)}
        return self.orders[known]

    def _runner(self, request: Mapping[str, Any]) -> Runner:
        """The worker, which starts with the first capture and again after a crash."""
        made_for = request["python"] or self.host.python, request["threads"], request["debug"]
        if self.runner is None or made_for != self.made_for:
            if self.runner is not None:
                self.runner.stop()
            self.runner, self.made_for = make_worker(self.host, *made_for), made_for
        return self.runner


def make_worker(host: Host, python: str | None, threads: int | None, debug: bool) -> Runner:
    """A worker for batches."""
    where = host.python_is_chosen
    advice = Advice(where, crash=f"try again with --debug, or choose another Python {where}")
    return shared_worker.configured_worker(python or host.python, threads, debug, advice)


def _own_streams() -> tuple[BinaryIO, BinaryIO]:
    """stdin, and stdout for the events alone: what Blender and its exporters print goes to stderr."""
    sys.stdout.flush()
    events = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    return os.fdopen(os.dup(0), "rb"), events


def _end_group() -> None:
    """End this process and what it has started, if they are a group of their own; a script that starts
    Blender may lead it."""
    if hasattr(os, "killpg") and os.environ.get(SAME_GROUP):
        with contextlib.suppress(OSError):
            os.killpg(0, signal.SIGKILL)
    os._exit(1)
