"""Prefetching: the next frames are decoded while the detector works on this one."""

from __future__ import annotations

from collections import deque
from collections.abc import Generator, Iterable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any, TypeVar

from handfit_core.media.settings import MEDIA

Item = TypeVar("Item")


def read_ahead(items: Iterable[Item], depth: int = MEDIA.read_ahead_frames) -> Generator[Item, None, None]:
    """Yield `items` in order while a thread of its own already fetches up to `depth` of the next, at least 1.

    Meant for `Media.frames()`: decoding leaves Python's lock, so it runs beside the detector. The
    thread starts with the first item. What `items` raises is raised here, in the place of the item
    that it was raised for. Closing the generator (`contextlib.closing`, an exception or Ctrl-C in
    the loop over it) ends the thread before it returns, and closes `items` in that thread.

    At most `depth` items are alive besides the one last yielded.
    """
    source, end = iter(items), object()
    thread = ThreadPoolExecutor(1, "handfit-read-ahead")
    waiting: deque[Future[Any]] = deque()
    try:
        waiting.extend(thread.submit(next, source, end) for _ in range(depth))
        while (item := waiting.popleft().result()) is not end:
            waiting.append(thread.submit(next, source, end))
            yield item
    finally:
        for future in waiting:
            future.cancel()
        if isinstance(source, Generator):  # it releases the video file
            thread.submit(source.close)
        thread.shutdown()
