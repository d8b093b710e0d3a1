"""Tasks done by several processes of this machine at the same time, each task once and whole.

Whoever runs a pool is a light process that never touches a picture: it claims, gives signs of life, ends what
takes too long, tries again what may go better, and seals. It can be killed at any moment, and so can the
processes that it has started: what was sealed stays, and everything else is begun anew by the next one.
"""

from __future__ import annotations

import contextlib
import shutil
import signal
import socket
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Final, Self

from handfit_core.errors import HandfitError, OptionError, OutputError
from handfit_core.farm.folder import Claim, Files, Lost, Watch, attempt
from handfit_core.farm.plan import Plan, Task
from handfit_core.farm.report import Result
from handfit_core.farm.slot import Slot
from handfit_core.machine import free_memory, usable_cores
from handfit_core.worker.runner import Event

ATTEMPTS: Final = 3
"""How often a task is tried where it may go better another time"""
BACK_OFF: Final = (1.0, 5.0)
"""seconds before the second and the third attempt"""
CURABLE: Final = ("WorkerDied", "MemoryRanOut", "OutputError", "Lost", "InputGone")
"""Kinds of errors that another attempt may cure: a process killed, no memory, a disk that is full or away"""
FINAL: Final = ("InputError", "NoHandFoundError", "OptionError", "HandModelError", "TakeError")
"""Kinds that follow from a task's input and options, which its id stands for: not tried again unasked"""
MEMORY: Final = 1.0e9
"""bytes that a task may need"""
_LOOK: Final = 0.02
"""seconds between two looks at all processes"""
_ELSEWHERE: Final = 2.0
"""seconds between two looks at a task that somebody else is at"""
_RENEWED: Final = 200
"""Tasks after which a process is replaced, since what it has leaked goes with it"""


def is_final(result: Result) -> bool:
    """Whether a task has failed for a reason that lies in it."""
    return result.status == "failed" and bool(result.attempts) and result.attempts[-1]["kind"] in FINAL


def usable_jobs() -> int:
    """How many tasks may run at a time where nobody says: one a core, as far as memory reaches."""
    memory = free_memory()
    return max(1, usable_cores() if memory is None else min(usable_cores(), int(memory / MEMORY)))


def share(jobs: int) -> int | None:
    """How many cores each of so many tasks at a time may use; None where one has all, and its own choice."""
    return max(1, usable_cores() // jobs) if jobs > 1 else None


class Listener:
    """Who wants to know how it goes; this one does not."""

    def began(self, task: Task) -> None:
        """A task is being done."""

    def progress(self, task: Task, stage: str, done: int, total: int) -> None:
        """So much of it is done."""

    def ended(self, task: Task, result: Result) -> None:
        """It is over: `result.status` is ok or failed, or running where somebody else is at it."""

    def turn(self) -> None:
        """Now and then, whatever happens."""


@dataclass
class _Try:
    """A task that is not over."""

    task: Task
    not_before: float = 0.0
    alone: bool = False
    """Whether nothing else may run beside it"""
    attempts: list[dict[str, Any]] = field(default_factory=list)
    """Those of this run"""


@dataclass
class _Running:
    """A task that a slot is at."""

    this: _Try
    claim: Claim
    part: Path
    began: float
    files: dict[str, Any] = field(default_factory=dict)
    warnings: list[str] = field(default_factory=list)


class Pool:
    """Does tasks with at most `jobs` processes at a time; they stay warm from one `run` to the next."""

    def __init__(
        self,
        command: Sequence[str],
        *,
        jobs: int = 1,
        timeout: float | None = None,
        attempts: int = ATTEMPTS,
        debug: bool = False,
        **here: Any,
    ) -> None:
        """`command` starts a slot (slot.py). `timeout`: seconds that a task may take. `here`: what slots are
        told beside a task, since it is this machine's affair."""
        self._command, self._jobs, self._here = tuple(command), jobs, {**here, "debug": debug}
        self._debug = debug
        self.timeout, self.attempts = timeout, attempts
        self._failed_starts = 0
        self._slots: dict[Slot, _Running | None] = {}
        self._watch = Watch()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def stop(self) -> None:
        """End all processes; tasks at hand are left to others."""
        for slot, running in self._slots.items():
            if running is None:
                slot.end()
                continue
            slot.kill()
            with _undisturbed():
                self.put_back(running)
        self._slots.clear()

    def run(
        self,
        plan: Plan,
        tasks: Sequence[Task],
        listener: Listener | None = None,
        *,
        again: bool = False,
        retry_failed: bool = False,
        wait: bool = True,
    ) -> list[Result]:
        """Do the tasks of a plan that are not sealed, the longest first; what came of each, in their order.

        `again`: also those that are sealed. `retry_failed`: also those that failed for reasons that lie in
        them. `wait`: for tasks that somebody else is at; else their status is `running`. Raises OptionError
        where no process can be started that does them, and KeyboardInterrupt where it is raised; tasks at
        hand are then left to others.
        """
        run = _Run(self, plan, tasks, listener or Listener(), wait=wait)
        run.again, run.retry_failed = again, retry_failed or again
        return run.results()

    # What a run does with slots

    def free_slot(self) -> Slot | None:
        """One that is ready and idle; starts another where there may be more. Raises OptionError."""
        idle = [slot for slot, running in self._slots.items() if running is None]
        ready = [slot for slot in idle if slot.ready]
        if not ready and not idle and len(self._slots) < self._jobs:
            self._slots[Slot(self._command, debug=self._debug)] = None
        return ready[0] if ready else None

    def occupy(self, slot: Slot, plan: Plan, running: _Running) -> None:
        """Give a slot its task."""
        task, folder = running.this.task, plan.folder(running.this.task)
        known = folder.failures(task.id) or {}
        self._slots[slot] = running
        slot.send(
            request="task",
            task=asdict(task),
            options=dict(plan.options),
            folder=str(running.part),
            parts=[str(plan.part_file(id)) for id in task.needs],
            finished={name: str(folder.path / name) for name in known.get("files", {})},
            **self._here,
        )

    def news(self) -> Iterator[tuple[Slot, _Running | None, Event]]:
        """What all slots have said; waits a moment where none has."""
        heard = False
        for slot, running in list(self._slots.items()):
            for event in slot.events():
                heard = True
                yield slot, running, event
        if not heard:
            time.sleep(_LOOK)

    def overdue(self) -> list[tuple[Slot, _Running]]:
        """Slots that are at a task for too long."""
        if self.timeout is None:
            return []
        end = time.monotonic() - self.timeout
        return [(slot, r) for slot, r in self._slots.items() if r is not None and r.began < end]

    @property
    def running(self) -> list[_Running]:
        """The tasks at hand."""
        return [running for running in self._slots.values() if running is not None]

    def release(self, slot: Slot) -> None:
        """A slot is free again, or has done enough."""
        slot.done += 1
        self._slots[slot] = None
        if slot.done >= _RENEWED:
            del self._slots[slot]
            slot.end()

    def drop(self, slot: Slot) -> None:
        """End a slot at once, with all that it started."""
        self._slots.pop(slot, None)
        slot.kill()

    def lost(self, slot: Slot, event: Event) -> None:
        """A slot has died without a task. Raises OptionError where another one would, too."""
        self.drop(slot)
        self._failed_starts = 0 if slot.ready else self._failed_starts + 1
        if event.get("type") == "OptionError" or self._failed_starts >= ATTEMPTS:
            raise OptionError(str(event.get("message")))

    def slot_of(self, running: _Running) -> Slot:
        """Which slot is at it."""
        return next(slot for slot, other in self._slots.items() if other is running)

    def claim(self, plan: Plan, task: Task) -> Claim | None:
        """Take a task; None where somebody is at it. Raises OutputError."""
        if not plan.path.is_file():  # the disk was taken away: nothing may be written where it was
            raise OutputError(f"{plan.path}: the plan is gone, and with it the folder of results")
        return self._watch.claim(plan.folder(task), task.id)

    @staticmethod
    def put_back(running: _Running) -> None:
        """Leave a task to others."""
        if not running.claim.folder.flat:
            shutil.rmtree(running.part, ignore_errors=True)
        running.claim.release()


class _Run:
    """One call of `Pool.run`."""

    again = retry_failed = False

    def __init__(
        self, pool: Pool, plan: Plan, tasks: Sequence[Task], listener: Listener, *, wait: bool
    ) -> None:
        self._pool, self._plan, self._listener = pool, plan, listener
        self._tasks, self._wait = tasks, wait
        self._results: dict[str, Result] = {}
        self._open = [_Try(task) for task in sorted(tasks, key=lambda task: -task.cost)]

    def results(self) -> list[Result]:
        """Do them."""
        while self._open or self._pool.running:
            self._listener.turn()
            self._begin_some()
            for slot, running, event in self._pool.news():
                self._take(slot, running, event)
            for slot, running in self._pool.overdue():
                self._pool.drop(slot)
                self._failed(
                    running,
                    f"the capture took longer than {self._pool.timeout:g} seconds and was stopped; allow it "
                    "more time, or give it fewer frames",
                    "Timeout",
                )
            for running in self._pool.running:
                self._beat(running)
        return [self._results[task.id] for task in self._tasks]

    def _begin_some(self) -> None:
        """Give free slots something to do."""
        while (this := self._next()) is not None:
            if self._settled(this) or self._waits(this):
                continue
            slot = self._pool.free_slot()
            if slot is None:
                return
            self._begin(this, slot)

    def _next(self) -> _Try | None:
        now, at_hand = time.monotonic(), self._pool.running
        if any(running.this.alone for running in at_hand):
            return None
        for this in self._open:
            if this.not_before <= now and not (this.alone and at_hand):
                return this
        return None

    def _settled(self, this: _Try) -> bool:
        """Whether a task needs no slot: it is sealed, or cannot even be tried."""
        task = this.task
        if result := settled(self._plan, task, again=self.again, retry_failed=self.retry_failed):
            self._end(this, result)
        elif task.error:
            self._listener.began(task)
            self._missed(this, task.error, "InputError", 0.0, {}, None)
        return result is not None or bool(task.error)

    def _waits(self, this: _Try) -> bool:
        """Whether a task cannot be begun, since parts of its clip are not done; it has failed with them."""
        for id in this.task.needs:
            result = self._results.get(id)
            if result is not None and result.status == "failed":
                self._missed(this, f"{this.task.shown}: {result.error}", "PartFailed", 0.0, {}, None)
                return True
            if result is None and not self._plan.is_sealed(id):
                self._not_ours(this, "parts of the clip are not done yet")
                return True
        return False

    def _begin(self, this: _Try, slot: Slot) -> None:
        folder = self._plan.folder(this.task)
        claim = None
        try:
            claim = self._pool.claim(self._plan, this.task)
            if claim is None:
                self._not_ours(this)
                return
            if not folder.flat:
                folder.remove_parts()
            part = folder.part()
        except HandfitError as error:
            if claim is not None:
                claim.release()
            self._missed(this, str(error), "OutputError", 0.0, {}, None)
            return
        self._open.remove(this)
        self._pool.occupy(slot, self._plan, _Running(this, claim, part, time.monotonic()))
        self._listener.began(this.task)

    def _not_ours(self, this: _Try, why: str = "another process is at it") -> None:
        """Somebody else is at it, or at what it needs: see again later."""
        this.not_before = time.monotonic() + _ELSEWHERE
        others = [each for each in self._open if each.not_before <= time.monotonic()]
        if not self._wait and not others and not self._pool.running:
            result = Result(this.task.shown, this.task.name, status="running")
            result.error = why
            self._end(this, result)

    def _take(self, slot: Slot, running: _Running | None, event: Event) -> None:
        """Take in what a slot has said."""
        kind = event.get("event")
        if running is None:
            if kind == "error":
                self._pool.lost(slot, event)
            return
        if kind == "progress":
            self._listener.progress(running.this.task, event["stage"], event["done"], event["total"])
        elif kind == "file":
            running.files[event["name"]] = {"size": event["size"], "sha256": event["sha256"]}
        elif kind == "warning":
            running.warnings.append(str(event["message"]))
        elif kind == "done":
            self._pool.release(slot)
            self._seal(running, Result.of_entry(event["result"]))
        elif kind == "error":
            if "result" in event:
                self._pool.release(slot)
            else:
                self._pool.drop(slot)
            self._failed(running, str(event.get("message")), str(event.get("type")), event.get("result"))

    def _beat(self, running: _Running) -> None:
        try:
            running.claim.beat()
        except Lost as error:
            self._pool.drop(self._pool.slot_of(running))
            self._failed(running, str(error), "Lost")

    def _seal(self, running: _Running, result: Result) -> None:
        """Put the results in their place and seal them."""
        task, folder = running.this.task, self._plan.folder(running.this.task)
        seconds = time.monotonic() - running.began
        result.status, result.id, result.seconds = "ok", task.id, round(seconds, 3)
        result.attempts, result.host = running.this.attempts, socket.gethostname()
        result.files = [folder.relative(name) for name in running.files]
        try:
            with _undisturbed():
                running.claim.check()
                folder.unseal()
                folder.take_in(running.part, running.files)
                folder.seal(task.id, asdict(result), running.files, seconds)
                for part in task.needs:
                    self._plan.folder(self._plan.by_id[part]).discard(part)
                self._pool.put_back(running)
        except HandfitError as error:
            self._failed(running, str(error), type(error).__name__, asdict(result))
            return
        self._end(running.this, result)

    def _failed(self, running: _Running, error: str, kind: str, entry: dict[str, Any] | None = None) -> None:
        """An attempt has failed: what is whole is kept, and it is tried again or given up."""
        this, folder = running.this, self._plan.folder(running.this.task)
        result = Result.of_entry(entry) if entry else Result(this.task.shown, this.task.name)
        result.warnings = result.warnings or running.warnings
        files: Files = running.files
        kept = (folder.failures(this.task.id) or {}).get("files", {})
        try:
            with _undisturbed():
                running.claim.check()
                if files:
                    folder.take_in(running.part, files)
        except HandfitError:
            files = {}
        seconds = time.monotonic() - running.began
        self._missed(this, error, kind, seconds, {**kept, **files}, result)
        self._pool.put_back(running)

    def _missed(
        self, this: _Try, error: str, kind: str, seconds: float, files: Files, result: Result | None
    ) -> None:
        """Note an attempt; try again later, or give up."""
        result = result or Result(this.task.shown, this.task.name)
        result.error, result.id = " ".join(error.split()), this.task.id
        this.attempts.append(attempt(result.error, kind, seconds))
        result.attempts, result.host = this.attempts, socket.gethostname()
        if kind in CURABLE and len(this.attempts) < self._pool.attempts:
            this.not_before = time.monotonic() + BACK_OFF[min(len(this.attempts), len(BACK_OFF)) - 1]
            this.alone = this.alone or kind == "MemoryRanOut"
            if this not in self._open:
                self._open.append(this)
            if files:
                self._note(this, result, files)
            return
        result.status, result.seconds = "failed", round(seconds, 3)
        result.files = [self._plan.folder(this.task).relative(name) for name in files]
        self._note(this, result, files)
        self._end(this, result)

    def _note(self, this: _Try, result: Result, files: Files) -> None:
        """Write down what is known of a task that failed, if that can be."""
        folder = self._plan.folder(this.task)
        with contextlib.suppress(HandfitError):
            if self._plan.path.is_file():
                folder.fail(this.task.id, asdict(result), files)

    def _end(self, this: _Try, result: Result) -> None:
        if this in self._open:
            self._open.remove(this)
        self._results[this.task.id] = result
        if this.task.of:
            for other in self._open:
                if other.task.id == this.task.of:
                    other.not_before = 0.0
        self._listener.ended(this.task, result)


def settled(plan: Plan, task: Task, *, again: bool, retry_failed: bool) -> Result | None:
    """What came of a task that need not be done: it is sealed, the clip is done of which it is a part, or it
    failed for a reason that lies in it. None: it is still to be done."""
    folder = plan.folder(task)
    if not again and (seal := folder.sealed(task.id)) is not None:
        return Result.of_entry(seal["result"])
    if not (again or retry_failed) and (known := folder.failures(task.id)) is not None:
        result = Result.of_entry(known["result"])
        if is_final(result):
            return result
    if task.of and not again and plan.is_sealed(task.of):
        return Result(task.shown, task.name, "ok", id=task.id)
    return None


@contextlib.contextmanager
def _undisturbed() -> Iterator[None]:
    """Within, Ctrl-C and SIGTERM wait: results would be in their place, and not sealed."""
    waiting: list[tuple[int, Any]] = []
    before: dict[int, Callable[[int, Any], Any]] = {}
    with contextlib.suppress(ValueError):  # not the main thread, which alone gets signals
        for number in (signal.SIGINT, signal.SIGTERM):
            handler = signal.signal(number, lambda n, frame: waiting.append((n, frame)))
            if callable(handler):
                before[number] = handler
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        for number, frame in waiting:
            if number in before:
                before[number](number, frame)
