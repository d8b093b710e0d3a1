"""A plan's tasks as jobs of a farm: which go together, and what comes after what."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from handfit_core.farm.plan import Plan, Task
from handfit_core.farm.pool import MEMORY

MOST_JOBS: Final = 1000
"""An array of SLURM ends there where nobody has set it otherwise, and Open Job Description at 1024 values"""
PATIENCE: Final = 20.0
"""Times the seconds that tasks are guessed to take, before they are ended where nobody says"""


@dataclass(frozen=True)
class Job:
    """Tasks that one machine gets together, and does one after another."""

    name: str
    tasks: str
    """Their numbers, as `Plan.chosen` reads them"""
    level: int
    """Jobs of a level need only those of levels before it"""
    after: tuple[int, ...]
    """The jobs that must be done before, by their places in the list"""
    count: int
    cost: float
    """seconds that they may take; a guess"""


@dataclass(frozen=True)
class Farm:
    """What every job file is made of."""

    plan: Plan
    file: Path
    """The job file"""
    jobs: Sequence[Job]
    timeout: float
    """seconds for each task"""
    places: Sequence[str]
    """What `task --map` is told"""

    @property
    def title(self) -> str:
        """What people see of it in the farm's list."""
        return f"Hands: {self.plan.output.name}"

    @property
    def options(self) -> list[str]:
        """What every `task` is told."""
        return ["--timeout", f"{self.timeout:g}", *(w for place in self.places for w in ("--map", place))]

    @property
    def longest(self) -> float:
        """seconds after which a job is ended: every task may take its time, but not all may hang."""
        most = (min(self.timeout * job.count, self.timeout + PATIENCE * job.cost) for job in self.jobs)
        return math.ceil(max(most, default=0.0)) + 600

    @property
    def memory(self) -> int:
        """MiB that a job may take: twice what a task mostly needs, since some farms end what takes more."""
        return round(2 * MEMORY / 2**20)

    def levels(self) -> list[list[Job]]:
        """The jobs of each level."""
        found: dict[int, list[Job]] = defaultdict(list)
        for job in self.jobs:
            found[job.level].append(job)
        return list(found.values())


def dealt(plan: Plan, most: int = MOST_JOBS) -> list[Job]:
    """The plan's tasks in at most `most` jobs, or one for each level: level by level, the longest first.

    Where tasks must share jobs, neighbours in the plan do, so that all jobs cost about the same.
    """
    members: dict[int, list[tuple[int, Task]]] = defaultdict(list)

    def level(task: Task) -> int:
        return max((level(plan.by_id[id]) + 1 for id in task.needs), default=0)

    for number, task in enumerate(plan.tasks, 1):
        members[level(task)].append((number, task))
    jobs: list[Job] = []
    place: dict[str, int] = {}
    for depth in sorted(members):
        pieces = _pieces(members[depth], max(1, most // len(members)))
        for cost, piece in sorted(((_cost(piece), piece) for piece in pieces), key=lambda pair: -pair[0]):
            more = f" and {len(piece) - 1} more" if len(piece) > 1 else ""
            after = {place[id] for _, task in piece for id in task.needs}
            place |= {task.id: len(jobs) for _, task in piece}
            numbers = _ranges([number for number, _ in piece])
            jobs.append(Job(piece[0][1].name + more, numbers, depth, tuple(sorted(after)), len(piece), cost))
    return jobs


def _cost(tasks: Iterable[tuple[int, Task]]) -> float:
    return sum(task.cost or 1.0 for _, task in tasks)


def _pieces(tasks: Sequence[tuple[int, Task]], most: int) -> Iterable[list[tuple[int, Task]]]:
    """Numbered tasks, cut into at most `most` pieces of about the same cost."""
    if len(tasks) <= most:
        return [[each] for each in tasks]
    found: dict[int, list[tuple[int, Task]]] = defaultdict(list)
    whole, before = _cost(tasks), 0.0
    for number, task in tasks:
        cost = task.cost or 1.0
        found[min(most - 1, int(most * (before + cost / 2) / whole))].append((number, task))
        before += cost
    return found.values()


def _ranges(numbers: Sequence[int]) -> str:
    """As in `#1-4,7`."""
    found: list[list[int]] = []
    for number in numbers:
        if found and number == found[-1][-1] + 1:
            found[-1] = [found[-1][0], number]
        else:
            found.append([number])
    return "#" + ",".join("-".join(map(str, each)) for each in found)
