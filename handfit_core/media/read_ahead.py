"""Prefetching: the next frames are decoded while the detector works on this one."""

from __future__ import annotations

import queue
import threading
from collections.abc import Generator, Iterable
from typing import TypeVar

from handfit_core.media.settings import MEDIA

Item = TypeVar("Item")


def read_ahead(items: Iterable[Item], depth: int = MEDIA.read_ahead_frames) -> Generator[Item, None, None]:
    """Yield `items` in order while a thread of its own already fetches up to `depth` of the next.

    Meant for `Media.frames()`: decoding leaves Python's lock, so it runs beside the detector. The
    thread starts with the first item. What `items` raises is raised here, in the place of the item
    that it was raised for. Closing the generator (`contextlib.closing`, an exception or Ctrl-C in
    the loop over it) ends the thread before it returns, and closes `items` in that thread.

    At most `depth` items are alive besides the one last yielded. Raises ValueError for a depth below 1.
    """
    if depth < 1:
        raise ValueError(f"read_ahead needs room for at least 1 item, not {depth}")
    return _read_ahead(items, depth)


def _read_ahead(items: Iterable[Item], depth: int) -> Generator[Item, None, None]:
    room, stopped = threading.Semaphore(depth), threading.Event()
    # Items come alone in a tuple, so that they differ from what comes last: an error, or None.
    ready: queue.SimpleQueue[tuple[Item] | BaseException | None] = queue.SimpleQueue()

    def decode() -> None:
        """Only this thread touches the source."""
        error: BaseException | None = None
        try:
            source = iter(items)
            try:
                while room.acquire() and not stopped.is_set():
                    # No name may hold the item: it would keep a picture alive while this thread waits.
                    ready.put((next(source),))
            except StopIteration:
                pass
            finally:
                # Here and not where the garbage collector happens to be: it releases the video file.
                if isinstance(source, Generator):
                    source.close()
        except BaseException as raised:
            error = raised
        ready.put(error)

    # A daemon: a run that ends while somebody still holds the frames must not wait for a reader.
    thread = threading.Thread(target=decode, name="handfit-read-ahead", daemon=True)
    try:
        thread.start()
        while isinstance(result := ready.get(), tuple):
            room.release()
            yield result[0]
        if result is not None:
            raise result
    finally:
        # The thread finishes the item it is at, no more.
        stopped.set()
        room.release()
        if thread.ident is not None:  # Ctrl-C may come before it has started
            thread.join()
