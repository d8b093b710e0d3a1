"""Reading ahead: the next frames are decoded while the detector works on this one."""

from __future__ import annotations

import queue
import threading
from collections.abc import Generator, Iterable
from dataclasses import dataclass
from typing import Generic, TypeVar

Item = TypeVar("Item")

DEFAULT_DEPTH = 2
"""Frames ahead. Decoding is steady enough that more gain nothing, and each is a whole picture."""


@dataclass(frozen=True)
class _Ended:
    """What the decoder's thread leaves behind its last item."""

    error: BaseException | None


class _Decoder(Generic[Item]):
    """The thread that iterates, and the room it has. Only this thread touches the source."""

    def __init__(self, items: Iterable[Item], depth: int) -> None:
        self._items = items
        self._room = threading.Semaphore(depth)
        self._done: queue.SimpleQueue[tuple[Item] | _Ended] = queue.SimpleQueue()
        self._stop = threading.Event()
        # A daemon: a run that ends while somebody still holds the frames must not wait for a reader.
        self._thread = threading.Thread(target=self._run, name="handfit-read-ahead", daemon=True)

    def start(self) -> None:
        self._thread.start()

    def next(self) -> tuple[Item] | _Ended:
        """The next item, alone in a tuple, once it is there."""
        result = self._done.get()
        self._room.release()
        return result

    def stop(self) -> None:
        """End the thread: it finishes the item it is at, no more."""
        self._stop.set()
        self._room.release()
        if self._thread.ident is not None:  # Ctrl-C may come before it has started
            self._thread.join()

    def _run(self) -> None:
        error: BaseException | None = None
        try:
            source = iter(self._items)
            try:
                while self._may_go_on():
                    # No name may hold the item: it would keep a picture alive while this thread waits.
                    self._done.put((next(source),))
            except StopIteration:
                pass
            finally:
                # Here and not where the garbage collector happens to be: it releases the video file.
                if isinstance(source, Generator):
                    source.close()
        except BaseException as raised:
            error = raised
        self._done.put(_Ended(error))

    def _may_go_on(self) -> bool:
        """Wait for room; whether anybody wants more."""
        self._room.acquire()
        return not self._stop.is_set()


def read_ahead(items: Iterable[Item], depth: int = DEFAULT_DEPTH) -> Generator[Item, None, None]:
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
    decoder = _Decoder(items, depth)
    try:
        decoder.start()
        while not isinstance(result := decoder.next(), _Ended):
            yield result[0]
        if result.error is not None:
            raise result.error
    finally:
        decoder.stop()
