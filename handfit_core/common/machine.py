"""How many cores and how much memory this process may use, which may be less than the machine has.

Containers, job managers and `taskset` give a process a share; who counts the machine's cores runs too many
things at a time there, and who counts its memory is killed. Standard library only.
"""

from __future__ import annotations

import math
import os
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Final

_OF_OTHERS: Final = 4e9
"""bytes that a system and its programs usually take, where nobody can be asked how much is free"""
_OF_JOB: Final = 1.0e9
"""bytes that a capture may need: 0.3e9 were measured for photos and 0.5e9 for clips of 1080 lines"""


def usable_cores(root: Path = Path("/")) -> int:
    """Return how many cores this process may keep busy, at least 1. `root`: the folder in which /proc and
    /sys are."""
    free = getattr(os, "sched_getaffinity", None)
    cores = len(free(0)) if free else os.cpu_count() or 1
    return max(1, min([cores, *(math.ceil(quota) for quota in _quotas(root))]))


def usable_threads() -> int:
    """Return how many threads may compute at the same time: one a core, or fewer by OMP_NUM_THREADS."""
    limit = os.environ.get("OMP_NUM_THREADS", "")
    cores = usable_cores()
    return max(1, min(cores, int(limit) if limit.isdecimal() else cores))


def free_memory(root: Path = Path("/")) -> float | None:
    """Return how many bytes of memory this process and its children may still take; None where the system
    does not tell."""
    return min([*_free_of_machine(root), *_free_of_groups(root)], default=None)


def usable_jobs() -> int:
    """Return how many captures or exports may run at a time: one a core, as far as memory reaches."""
    memory = free_memory()
    return max(1, usable_cores() if memory is None else min(usable_cores(), int(memory / _OF_JOB)))


def _free_of_machine(root: Path) -> Iterator[float]:
    lines = (line.partition(":") for line in _text(root / "proc" / "meminfo").splitlines())
    told = {name: value.split() for name, _, value in lines}
    if (available := told.get("MemAvailable")) is not None:
        yield float(available[0]) * 1024
    elif sys.platform == "win32":
        yield from _free_of_windows()
    elif sys.platform == "darwin":
        yield max(float(os.sysconf("SC_PHYS_PAGES")) * os.sysconf("SC_PAGE_SIZE") - _OF_OTHERS, 0.0)


def _free_of_windows() -> Iterator[float]:
    import ctypes

    numbers = (ctypes.c_uint64 * 8)()  # MEMORYSTATUSEX: two of 32 bits, then total, available, ...
    ctypes.c_uint32.from_buffer(numbers).value = ctypes.sizeof(numbers)
    if ctypes.WinDLL("kernel32").GlobalMemoryStatusEx(ctypes.byref(numbers)):  # type: ignore[attr-defined]
        yield float(numbers[2])


# Control groups of Linux: what one is allowed, all that it holds share, so each on the way up counts.


def _quotas(root: Path) -> Iterator[float]:
    """Yield the number of cores that each control group of this process allows."""
    for group, is_new in _groups(root, "cpu"):
        if is_new:
            quota, _, period = _text(group / "cpu.max").partition(" ")
        else:
            quota, period = _text(group / "cpu.cfs_quota_us"), _text(group / "cpu.cfs_period_us")
        if (allowed := _number(quota)) is not None and (each := _number(period)):
            yield allowed / each


def _free_of_groups(root: Path) -> Iterator[float]:
    """Yield the bytes of memory that each control group still allows; memory that only caches files counts as
    free, as it is given back when needed."""
    for group, is_new in _groups(root, "memory"):
        limit, used, cache = (
            ("memory.max", "memory.current", "inactive_file")
            if is_new
            else ("memory.limit_in_bytes", "memory.usage_in_bytes", "total_inactive_file")
        )
        allowed, taken = _number(_text(group / limit)), _number(_text(group / used))
        if allowed is None or taken is None:
            continue
        told = dict(line.split()[:2] for line in _text(group / "memory.stat").splitlines() if " " in line)
        yield max(allowed - taken + (_number(told.get(cache, "")) or 0.0), 0.0)


def _groups(root: Path, controller: str) -> Iterator[tuple[Path, bool]]:
    """Yield the folders of this process's control groups up to the topmost, each with True for cgroup v2."""
    mounts = root / "sys" / "fs" / "cgroup"
    for line in _text(root / "proc" / "self" / "cgroup").splitlines():
        _, controllers, path = line.split(":", 2)
        if controllers and controller not in controllers.split(","):
            continue
        mount = mounts / controllers if controllers else mounts
        if controllers and not mount.is_dir():
            mount = mounts / controller
        group = mount / path.lstrip("/")
        while mount in (group, *group.parents):  # seen from inside a container, its own is the topmost
            yield group, not controllers
            group = group.parent


def _number(text: str) -> float | None:
    """Read the number in a cgroup's file; None where it says `max` or -1, or is empty."""
    text = text.strip()
    return float(text) if text.isdecimal() else None


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="ascii", errors="replace")
    except OSError:
        return ""
