"""Computing the parts of one thing side by side in threads."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Generator, Sequence
from concurrent.futures import ThreadPoolExecutor
from itertools import islice
from typing import TypeVar

from handfit_core.common.machine import usable_cores

Item = TypeVar("Item")
Result = TypeVar("Result")


def usable_threads() -> int:
    """Return how many threads may compute at the same time: one a core, or fewer by OMP_NUM_THREADS."""
    limit = os.environ.get("OMP_NUM_THREADS", "")
    cores = usable_cores()
    return max(1, min(cores, int(limit) if limit.isdecimal() else cores))


def in_threads(function: Callable[[Item], Result], items: Sequence[Item]) -> Generator[Result, None, None]:
    """Yield function(item) for each item, in order, computed by as many threads as are usable."""
    threads = min(usable_threads(), len(items))
    if threads < 2:
        yield from map(function, items)
        return
    with ThreadPoolExecutor(threads, "handfit-parts") as pool:
        yield from in_pool(pool, function, items, 2 * threads)


def in_pool(
    pool: ThreadPoolExecutor, function: Callable[[Item], Result], items: Sequence[Item], ahead: int
) -> Generator[Result, None, None]:
    """Yield function(item) for each item, in order, computed by the threads of a pool, `ahead` of them at a
    time. Closing the generator cancels what has not begun."""
    waiting = iter(items)
    futures = deque(pool.submit(function, item) for item in islice(waiting, ahead))
    try:
        while futures:
            yield futures.popleft().result()
            futures.extend(pool.submit(function, item) for item in islice(waiting, 1))
    finally:
        for future in futures:
            future.cancel()
