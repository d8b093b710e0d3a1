"""A child process that does tasks, one after another, and stays warm in between.

It is started with the command of a plan and the word `slot`, says `ready`, and takes a JSON line for each
task. It answers in JSON lines: `progress`, `file` for each result that is finished, `warning`, and last
`done` or `error`. With whatever it starts it is a group of processes of its own, which is ended as a whole.
"""

from __future__ import annotations

import os
import time
from collections.abc import Collection, Mapping, Sequence
from typing import Any, Final

from handfit_core.errors import OptionError
from handfit_core.version import __version__
from handfit_core.worker.client import ending, ran_out_of_memory
from handfit_core.worker.process import SAME_GROUP, ChildProcess, out_of_memory_kills
from handfit_core.worker.protocol import encode
from handfit_core.worker.runner import THREAD_VARIABLES, Event

COMMAND: Final = "slot"
"""What follows the command of a plan"""
START_LIMIT: Final = 180.0
"""seconds until it must be ready; Blender with many add-ons from a network disk needs some"""
_GRACE: Final = 3.0
"""seconds that idle ones get to end"""


class Slot:
    """One such process. Nothing blocks; `events` has to be called again and again."""

    def __init__(self, command: Sequence[str], *, threads: int | None = None, debug: bool = False) -> None:
        """Start it. `threads`: how many the numeric libraries use in it at most. Raises OptionError where
        there is no such program."""
        environment = {**os.environ, SAME_GROUP: "1"}
        if threads is not None:
            environment |= dict.fromkeys(THREAD_VARIABLES, str(threads))
        try:
            self._child = ChildProcess([*command, COMMAND], environment, echo=debug)
        except OSError as error:
            raise OptionError(
                f"'{command[0]}', which does the tasks of this plan, cannot be started "
                f"({error.strerror or error}); make a plan on this machine, or name its program"
            ) from error
        self._started = time.monotonic()
        self._kills_before = out_of_memory_kills()
        self.ready = False
        self.done = 0
        """Tasks that it has answered for"""

    @property
    def pid(self) -> int:
        """Its process's id, and its group's."""
        return self._child.pid

    def send(self, **request: Any) -> None:
        """Give it a task."""
        self._kills_before = out_of_memory_kills()
        self._child.send(encode(request))

    def events(self, wait: float = 0.0) -> list[Event]:
        """What it has said since the last call; waits for it up to `wait` seconds. A process that has died,
        or is none of ours, says `error` last, with the type WorkerDied, MemoryRanOut or OptionError."""
        child = self._child
        if wait:
            child.wait_for_io(wait)
        child.exchange()
        ended = child.ended()
        found = []
        for message in child.received():
            if self.ready:
                found.append(message)
            elif message.get("event") == "ready":
                self.ready = True
                if message.get("version") != __version__:
                    return [_error("OptionError", _other_version(message))]
            elif message.get("event") == "error":
                return [message]
        if ended:
            found.append(self._death())
        elif not self.ready and time.monotonic() > self._started + START_LIMIT:
            found.append(_error("WorkerDied", f"the process did not start within {START_LIMIT:g} seconds"))
        return found

    def _death(self) -> Event:
        child = self._child
        if ran_out_of_memory(child, self._kills_before):
            return _error(
                "MemoryRanOut",
                f"memory ran out, and the process ended {ending(child.exit_code or 0)}; run fewer at a time "
                "(--jobs), or capture fewer frames, or smaller pictures",
            )
        lines = [line.strip() for line in child.stderr_tail().splitlines() if line.strip()]
        said = f", last saying: {lines[-1][:300]}" if lines else ""
        if not self.ready:
            return _error("WorkerDied", f"the process that does tasks ended at once{said}; try --debug")
        return _error("WorkerDied", f"the process ended {ending(child.exit_code or 0)}{said}")

    def kill(self) -> None:
        """End it at once, with whatever it has started."""
        self._child.kill()


def end_idle(slots: Collection[Slot]) -> None:
    """Let idle ones end, all at the same time."""
    for slot in slots:
        slot._child.close_stdin()
    until = time.monotonic() + _GRACE
    for slot in slots:
        slot._child.stop(until - time.monotonic())


def _error(kind: str, message: str) -> Event:
    return {"event": "error", "type": kind, "message": message}


def _other_version(message: Mapping[str, Any]) -> str:
    return (
        f"this plan is for version {__version__}, and the program that does its tasks is version "
        f"{message.get('version')}; use the same version on all machines"
    )
