"""Tasks done by several processes of this machine at the same time, each task once and whole.

Whoever runs a pool is a light process that never touches a picture: it claims, gives signs of life, ends what
takes too long, tries again what may go better, and seals. It can be killed at any moment, and so can the
processes that it has started: what was sealed stays, and everything else is begun anew by the next one.
"""

from __future__ import annotations

import contextlib
import heapq
import itertools
import platform
import shutil
import signal
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import partial
from pathlib import Path, PurePosixPath
from typing import Any, Final, Self

from handfit_core.errors import HandfitError, OptionError
from handfit_core.farm.folder import Claim, Files, Lost, Watch, attempt, kind_of, lies_within, parts_in
from handfit_core.farm.plan import Plan, Task
from handfit_core.farm.report import Result
from handfit_core.farm.slot import Slot, end_idle
from handfit_core.files import shown, why
from handfit_core.machine import free_memory, usable_cores
from handfit_core.worker.process import wait_for_killed
from handfit_core.worker.runner import Event

ATTEMPTS: Final = 3
"""How often a task is tried where it may go better another time"""
BACK_OFF: Final = (1.0, 5.0)
"""seconds before the second and the third attempt"""
AWAY: Final = 600.0
"""seconds that a folder of results which has gone is waited for"""
CURABLE: Final = ("WorkerDied", "MemoryRanOut", "OutputError", "Lost", "InputGone")
"""Kinds of errors that another attempt may cure: a process killed, no memory, a disk that is full or away"""
FINAL: Final = ("InputError", "NoHandFoundError", "TakeError")
"""Kinds that follow from a task's input, which its id stands for: not tried again unasked"""
OF_MACHINE: Final = ("OptionError", "HandModelError", "LandmarkModelError", "WorkerError", "OutputRefused")
"""Kinds that another machine may cure, which has what this one lacks: files, a Python, permissions"""
_ALIKE: Final = (*FINAL, "Timeout", "PartFailed")
"""Kinds that are to be expected on other machines, too, as long as nobody asks anew"""
MEMORY: Final = 1.0e9
"""bytes that a task may need: 0.3e9 were measured for photos and 0.5e9 for clips of 1080 lines"""
_LOOK: Final = (0.02, 0.2)
"""seconds between two looks at all processes, at least and at most; in between"""
_SHARE: Final = 0.01
"""of the time that the youngest task is at hand: so little may looks cost, and being late"""
_ELSEWHERE: Final = 2.0
"""seconds between two looks at a task that somebody else is at, where there are few"""
_FEW: Final = 100
_DEATH: Final = 5.0
"""seconds that killed processes get to disappear"""
_RENEWED: Final = 200
"""Tasks after which a process is replaced, since what it has leaked goes with it"""


def is_final(result: Result) -> bool:
    """Whether a task has failed for a reason that lies in it."""
    return result.status == "failed" and last_kind(result) in FINAL


def last_kind(result: Result) -> str:
    """What kind of error ended the last attempt, if any."""
    return str(result.attempts[-1].get("kind")) if result.attempts else ""


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


@dataclass(eq=False)
class _Try:
    """A task that is not over."""

    task: Task
    elsewhere: bool = False
    """Whether somebody else was at it"""
    alone: bool = False
    """Whether nothing else may run beside it"""
    attempts: list[dict[str, Any]] = field(default_factory=list)
    """All that are known of, also those of earlier runs and of other processes"""
    before: list[dict[str, Any]] | None = None
    """Those that were made before this run; None: nobody has looked"""
    made: set[str] = field(default_factory=set)
    """The results that attempts of this run have left"""

    def since(self, attempts: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
        """Which of these were made since this run began; those that lost the task do not count."""
        before = self.before or ()
        return [each for each in attempts if each.get("kind") != "Lost" and each not in before]


@dataclass(eq=False)
class _Running:
    """A task that a slot is at."""

    this: _Try
    claim: Claim
    part: Path
    began: float
    kept: Mapping[str, Path] = field(default_factory=dict)
    """The results of earlier attempts that it may go on with"""
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
        self._command, self.jobs, self._here = tuple(command), jobs, {**here, "debug": debug}
        self._debug = debug
        self.timeout, self.attempts = timeout, attempts
        self._failed_starts, self._room = 0, jobs
        self._slots: dict[Slot, _Running | None] = {}
        self._watch = Watch()
        self._remains: list[Path] = []
        """Parts that could not be taken away while a process that was killed still wrote"""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def stop(self) -> None:
        """End all processes; tasks at hand are left to others."""
        with _signals_held():
            for slot, running in self._slots.items():
                if running is not None:
                    slot.kill()
                    self.put_back(running)
            end_idle([slot for slot, running in self._slots.items() if running is None])
            self._slots.clear()
            self.clear_up()

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
        where no process can be started that does them, Lost where the folder of results has gone and
        does not come back, and KeyboardInterrupt where it is raised; tasks at hand are then left to others.
        """
        run = _Run(self, plan, tasks, listener or Listener(), wait=wait)
        run.again, run.retry_failed = again, retry_failed or again
        return run.results()

    # What a run does with slots

    @property
    def has_room(self) -> bool:
        """Whether a process is idle, or another one may be started."""
        return len(self._slots) < self._room or None in self._slots.values()

    def free_slot(self, wanted: int) -> Slot | None:
        """One that is ready and idle; starts another where `wanted` are more than are idle, and there may be
        more. Raises OptionError."""
        idle = [slot for slot, running in self._slots.items() if running is None]
        if len(idle) < wanted and len(self._slots) < self._room:
            slot = Slot(self._command, threads=self._here.get("threads"), debug=self._debug)
            self._slots[slot] = None
        return next((slot for slot in idle if slot.ready), None)

    def occupy(self, slot: Slot, plan: Plan, running: _Running, processes: int | None) -> None:
        """Give a slot its task, for so many processes where nobody has said how many."""
        task = running.this.task
        self._slots[slot] = running
        slot.send(
            request="task",
            task=asdict(task),
            options=dict(plan.options),
            files=plan.files,
            folder=str(running.part),
            parts=[str(plan.part_file(id)) for id in task.needs],
            finished={name: str(path) for name, path in running.kept.items()},
            **{**self._here, "processes": self._here.get("processes") or processes},
        )

    def news(self) -> Iterator[tuple[Slot, _Running | None, Event]]:
        """What all slots have said; waits a moment where none has."""
        heard = False
        for slot in list(self._slots):
            for event in slot.events():
                heard = True
                if slot in self._slots:  # what it said before may have been its last
                    yield slot, self._slots[slot], event
        if not heard:
            now, (least, most) = time.monotonic(), _LOOK
            youngest = min((now - running.began for running in self.running), default=0.0)
            time.sleep(min(max(least, _SHARE * youngest), most))

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
        """A slot is free again, or has done enough. Another one may start where some did not before."""
        self._failed_starts, self._room = 0, min(self._room + 1, self.jobs)
        slot.done += 1
        self._slots[slot] = None
        if slot.done >= _RENEWED:
            del self._slots[slot]
            end_idle([slot])

    def drop(self, slot: Slot) -> None:
        """End a slot at once, with all that it started."""
        self._slots.pop(slot, None)
        slot.kill()

    def lost(self, slot: Slot, event: Event) -> None:
        """A slot has died without a task. Where it did not even start, those that did go on without it, as
        memory may be short. Raises OptionError where none does."""
        self.drop(slot)
        self._failed_starts = 0 if slot.ready else self._failed_starts + 1
        if self._failed_starts:
            self._room = max(1, len(self._slots))
        none_starts = self._failed_starts >= ATTEMPTS and not self._slots
        if event.get("type") == "OptionError" or none_starts:
            raise OptionError(str(event.get("message")))

    def slot_of(self, running: _Running) -> Slot:
        """Which slot is at it."""
        return next(slot for slot, other in self._slots.items() if other is running)

    def claim(self, plan: Plan, task: Task) -> Claim | None:
        """Take a task; None where somebody is at it. Raises OutputError."""
        return self._watch.claim(plan.folder(task), task.id)

    def put_back(self, running: _Running) -> None:
        """Leave a task to others."""
        if not running.claim.folder.flat:
            shutil.rmtree(running.part, ignore_errors=True)
            if running.part.exists():
                self._remains.append(running.part)
        running.claim.release()

    def clear_up(self) -> None:
        """Take away what could not be before, once those who were killed are gone."""
        wait_for_killed(_DEATH)
        for part in self._remains:
            shutil.rmtree(part, ignore_errors=True)
        self._remains.clear()


class _Run:
    """One call of `Pool.run`."""

    again = retry_failed = False

    def __init__(
        self, pool: Pool, plan: Plan, tasks: Sequence[Task], listener: Listener, *, wait: bool
    ) -> None:
        self._pool, self._plan, self._listener = pool, plan, listener
        self._tasks, self._wait = tasks, wait
        self._ids = {task.id for task in tasks}
        self._results: dict[str, Result] = {}
        self._left = sum(task.cost for task in tasks)
        """Costs of what is not over"""
        self._open: deque[_Try] = deque()
        """What may be begun now"""
        self._alone: list[_Try] = []
        """What may be once nothing else is left"""
        self._later: list[tuple[float, int, _Try]] = []
        """What may be from a time on, as a heap"""
        self._count = itertools.count()
        self._left_behind: list[str] = []
        """Parts that lay there at first"""
        self._away_since: float | None = None

    def results(self) -> list[Result]:
        """Do them."""
        with _signals_held() as look:
            self._settle(look)
            while self._open or self._alone or self._later or self._pool.running:
                look()
                self._listener.turn()
                self._begin_some()
                for slot, running, event in self._pool.news():
                    self._take(slot, running, event)
                for slot, running in self._pool.overdue():
                    self._pool.drop(slot)
                    self._failed(
                        running,
                        f"the capture took longer than {self._pool.timeout:g} seconds and was stopped; allow "
                        "it more time, or give it fewer frames",
                        "Timeout",
                    )
                for running in self._pool.running:
                    self._beat(running)
            self._pool.clear_up()
        return [self._results[task.id] for task in self._tasks]

    def _settle(self, look: Callable[[], None]) -> None:
        """Sort out what need not be done; what is left lies open, the longest first."""
        if len(self._tasks) > 1:  # who does one of many does not look at all; its claim tells
            self._left_behind = parts_in(self._plan.output)
        for task in sorted(self._tasks, key=lambda task: -task.cost):
            look()
            this = _Try(task)
            if not self._settled(this):
                self._open.append(this)
            elif self._has_parts(task):
                with contextlib.suppress(HandfitError):
                    if (claim := self._pool.claim(self._plan, task)) is not None:
                        claim.folder.remove_parts()
                        claim.release()

    def _has_parts(self, task: Task) -> bool:
        beginning = self._plan.folder(task).parts
        return any(name.startswith(beginning) for name in self._left_behind)

    def _begin_some(self) -> None:
        """Give free slots something to do."""
        while self._pool.has_room and (this := self._next()) is not None:
            if (this.elsewhere and self._settled(this)) or self._waits(this):
                continue
            this.elsewhere = False
            slot = self._pool.free_slot(len(self._open) + 1)
            if slot is None or self._is_away():
                self._open.appendleft(this)
                return
            self._begin(this, slot)

    def _next(self) -> _Try | None:
        at_hand = self._pool.running
        if any(running.this.alone for running in at_hand):
            return None
        while self._later and self._later[0][0] <= time.monotonic():
            this = heapq.heappop(self._later)[2]
            if this.elsewhere:
                self._open.append(this)
            elif this.alone:
                self._alone.append(this)
            else:
                self._open.appendleft(this)
        if self._open:
            return self._open.popleft()
        return self._alone.pop() if self._alone and not at_hand else None

    def _put_off(self, this: _Try, seconds: float) -> None:
        heapq.heappush(self._later, (time.monotonic() + seconds, next(self._count), this))

    def _is_away(self) -> bool:
        """Whether the folder of results has gone: its disk may come back, and nothing may be written where it
        was. Raises Lost after some time."""
        if self._plan.path.is_file():
            self._away_since = None
            return False
        self._away_since = self._away_since or time.monotonic()
        if time.monotonic() - self._away_since > AWAY:
            raise Lost(
                f"{shown(self._plan.path)}: the plan is gone, and with it the folder of results; what was "
                "finished lies where the folder is: bring it back, and start the batch again"
            )
        return True

    def _settled(self, this: _Try) -> bool:
        """Whether a task needs no slot: it is sealed, or cannot even be tried."""
        task = this.task
        result = settled(self._plan, task, again=self.again, retry_failed=self.retry_failed)
        if result := result or self._given_up_since(this):
            self._end(this, result)
        elif task.error:
            self._listener.began(task)
            self._missed(this, task.error, "InputError", 0.0, {}, None)
        return result is not None or bool(task.error)

    def _given_up_since(self, this: _Try) -> Result | None:
        """Take in what is written of attempts at a task; what came of it where another process has given it
        up since this run began. Where that may be its machine's fault, another one tries it, too."""
        result = self._written(this.task)
        this.attempts = [*result.attempts, *(a for a in this.attempts if a not in result.attempts)]
        if this.before is None:
            this.before = list(this.attempts)
        if result.status != "failed" or not (new := this.since(result.attempts)):
            return None
        tried_here = any(each.get("host") == platform.node() for each in new)
        alike = tried_here or new[-1].get("kind") in _ALIKE or len(new) >= self._pool.attempts
        return result if alike else None

    def _written(self, task: Task) -> Result:
        """What is written of attempts at a task that failed."""
        known = self._plan.folder(task).failures(task.id)
        return Result.of_entry(known["result"]) if known else Result(task.shown, task.name)

    def _waits(self, this: _Try) -> bool:
        """Whether a task cannot be begun, since parts of its clip are not done; it has failed with them."""
        for id in this.task.needs:
            result = self._results.get(id) or self._given_up(id)
            if result is not None and result.status == "failed":
                self._missed(this, f"{this.task.shown}: {result.error}", "PartFailed", 0.0, {}, None)
                return True
            if result is None and not self._plan.is_sealed(id):
                self._not_ours(this, "parts of the clip are not done yet")
                return True
        return False

    def _given_up(self, id: str) -> Result | None:
        """What others say of a task that is none of this run, where they have tried it in vain."""
        folder = self._plan.folder(self._plan.by_id[id])
        if id in self._ids or (known := folder.failures(id)) is None or folder.worked_on:
            return None
        result = Result.of_entry(known["result"])
        return result if result.status == "failed" else None

    def _begin(self, this: _Try, slot: Slot) -> None:
        task, folder = this.task, self._plan.folder(this.task)
        claim = None
        try:
            claim = self._pool.claim(self._plan, task)
            if claim is None:
                self._not_ours(this)
                return
            if claim.inherited or self._has_parts(task):
                folder.remove_parts()
            if self._settled(this):  # by another one, since we looked
                claim.release()
                return
            if not (folder.flat or self._plan.overwrite or folder.owner in (None, task.id)):
                claim.release()
                result = Result(task.shown, task.name, "failed", id=task.id)
                result.error = (
                    f"{shown(folder.path)} has got results of another batch since this one was planned; "
                    "start this one again, and its results get another name"
                )
                result.attempts = [attempt(result.error, "NameTaken", 0.0)]
                self._end(this, result)
                return
            kept = folder.kept(task.id) if this.attempts else {}
            if self.again:
                kept = {name: path for name, path in kept.items() if name in this.made}
            part = folder.part()
        except HandfitError as error:
            if claim is not None:
                claim.release()
            self._missed(this, str(error), kind_of(error), 0.0, {}, None)
            return
        running = _Running(this, claim, part, time.monotonic(), kept)
        self._pool.occupy(slot, self._plan, running, self._share(task))
        self._listener.began(task)

    def _share(self, task: Task) -> int | None:
        """How many threads may detect a clip's hands: of all cores its share of the work that is left, since
        a long clip would be alone in the end. None: its own choice, where nothing runs beside."""
        if self._pool.jobs == 1:
            return None
        return max(1, round(usable_cores() * min(task.cost / max(self._left, 1e-9), 1.0)))

    def _not_ours(self, this: _Try, why: str = "another process is at it") -> None:
        """Somebody else is at it, or at what it needs: see again later."""
        others = self._open or self._alone or self._pool.running
        if self._wait or others or not all(each.elsewhere for *_, each in self._later):
            this.elsewhere = True
            self._put_off(this, _ELSEWHERE * max(1.0, len(self._later) / _FEW))
            return
        result = Result(this.task.shown, this.task.name, "running", id=this.task.id, attempts=this.attempts)
        result.error = why
        self._end(this, result)

    def _take(self, slot: Slot, running: _Running | None, event: Event) -> None:
        """Take in what a slot has said."""
        if running is None:
            if event.get("event") == "error":
                self._pool.lost(slot, event)
            return
        try:
            act = self._understood(slot, running, event)
        except (KeyError, TypeError, ValueError, AttributeError):
            self._pool.drop(slot)
            error = "the process that does tasks said what nobody understands; try --debug"
            self._failed(running, error, "ProtocolError")
        else:
            act()

    def _understood(self, slot: Slot, running: _Running, event: Event) -> Callable[[], None]:
        """What to do about an event of a slot that has a task. Raises KeyError, TypeError, ValueError or
        AttributeError where it does not say what it must."""
        kind = event.get("event")
        if kind == "progress":
            done, total = int(event["done"]), int(event["total"])
            return partial(self._listener.progress, running.this.task, str(event["stage"]), done, total)
        if kind == "file":
            if not lies_within(event["name"]):
                raise ValueError
            known = {"size": int(event["size"]), "sha256": str(event["sha256"])}
            return partial(running.files.__setitem__, str(PurePosixPath(event["name"])), known)
        if kind == "warning":
            return partial(running.warnings.append, str(event["message"]))
        if kind == "done":
            return partial(self._seal, slot, running, Result.of_entry(event["result"]))
        if kind == "error":
            entry = event.get("result")
            (self._pool.release if entry else self._pool.drop)(slot)
            result = Result.of_entry(entry) if entry else None
            return partial(self._failed, running, str(event.get("message")), str(event.get("type")), result)
        return lambda: None

    def _beat(self, running: _Running) -> None:
        try:
            running.claim.beat()
        except Lost as error:
            self._pool.drop(self._pool.slot_of(running))
            self._failed(running, str(error), "Lost")

    def _seal(self, slot: Slot, running: _Running, result: Result) -> None:
        """Put the results in their place and seal them."""
        task, folder = running.this.task, self._plan.folder(running.this.task)
        seconds = time.monotonic() - running.began
        result.status, result.id, result.seconds = "ok", task.id, round(seconds, 3)
        result.attempts, result.host = running.this.attempts, platform.node()
        result.files = [folder.relative(name) for name in running.files]
        if running.kept:
            _warn_first(result, self._written(task).warnings)
        self._pool.release(slot)
        try:
            running.claim.check()
            seal = None if self.again else folder.sealed(task.id)
            if seal is not None:  # by another one, who had taken it over; it stays as it is
                result = Result.of_entry(seal["result"])
            else:
                folder.take_in(running.part, running.files)
                folder.seal(task.id, asdict(result), running.files, seconds)
            for part in task.needs:
                self._plan.folder(self._plan.by_id[part]).discard(part)
        except OSError as error:
            self._failed(running, f"{shown(folder.path)}: {why(error)}", "Lost", result)
        except HandfitError as error:
            self._failed(running, str(error), kind_of(error), result)
        else:
            self._pool.put_back(running)
            self._end(running.this, result)

    def _failed(self, running: _Running, error: str, kind: str, result: Result | None = None) -> None:
        """An attempt has failed: what is whole is kept, and it is tried again or given up."""
        this, folder = running.this, self._plan.folder(running.this.task)
        seconds = time.monotonic() - running.began
        if kind == "Lost":
            this.attempts.append(attempt(error, kind, seconds))
            self._pool.put_back(running)
            self._not_ours(this)
            return
        result = result or Result(this.task.shown, this.task.name)
        result.warnings = result.warnings or running.warnings
        files: Files = {}
        with contextlib.suppress(HandfitError, OSError):
            running.claim.check()
            if running.files and not folder.done.exists():  # finished work stays as it is
                folder.take_in(running.part, running.files)
                files = running.files
                this.made.update(files)
        self._missed(this, error, kind, seconds, files, result)
        self._pool.put_back(running)

    def _missed(
        self, this: _Try, error: str, kind: str, seconds: float, files: Files, result: Result | None
    ) -> None:
        """Note an attempt; try again later, or give up."""
        result = result or Result(this.task.shown, this.task.name)
        result.error, result.id = " ".join(error.split()), this.task.id
        known = self._plan.folder(this.task).failures(this.task.id) or {}
        files = {**known.get("files", {}), **files}
        _warn_first(result, self._written(this.task).warnings)
        this.attempts.append(attempt(result.error, kind, seconds))
        result.attempts, result.host = this.attempts, platform.node()
        tried = len(this.since(this.attempts))
        if kind in CURABLE and tried < self._pool.attempts:
            result.status = "pending"
            this.alone = this.alone or kind == "MemoryRanOut"
            self._put_off(this, BACK_OFF[min(tried, len(BACK_OFF)) - 1])
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
        self._results[this.task.id] = result
        self._left -= this.task.cost
        for place, (_, number, other) in enumerate(self._later if this.task.of else ()):
            if other.task.id == this.task.of:  # it may be done now
                self._later[place] = 0.0, number, other
                heapq.heapify(self._later)
                break
        self._listener.ended(this.task, result)


def _warn_first(result: Result, warnings: Sequence[str]) -> None:
    """Add the warnings of earlier attempts, each once."""
    result.warnings = list(dict.fromkeys([*warnings, *result.warnings]))


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
def _signals_held() -> Iterator[Callable[[], None]]:
    """Within, Ctrl-C and SIGTERM wait until what is yielded is called, so that nobody leaves a claim behind,
    or results without their seal; a second one does not."""
    waiting: list[tuple[int, Any]] = []
    before: dict[int, Callable[[int, Any], Any]] = {}

    def hold(number: int, frame: Any) -> None:
        if waiting:
            before[number](number, frame)
        waiting.append((number, frame))

    def look() -> None:
        if waiting:
            number, frame = waiting.pop()
            before[number](number, frame)

    with contextlib.suppress(ValueError):  # not the main thread, which alone gets signals
        for number in (signal.SIGINT, signal.SIGTERM):
            if callable(handler := signal.getsignal(number)):
                signal.signal(number, hold)
                before[number] = handler
    try:
        yield look
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        look()
