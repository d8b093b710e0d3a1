import gc
import threading
import time
import weakref
from collections.abc import Callable, Iterable, Iterator
from contextlib import closing
from typing import Any

import numpy as np
import pytest

from handfit_core.errors import InputError
from handfit_core.media.read_ahead import read_ahead
from handfit_core.media.source import Frame


def reader() -> str | None:
    """The name of the read-ahead thread that runs; None where there is none."""
    return next((t.name for t in threading.enumerate() if t.name.startswith("handfit-read-ahead")), None)


class Source:
    """Frames that notice how they are read."""

    def __init__(self, count: int, fails_at: int | None = None) -> None:
        self.count, self.fails_at = count, fails_at
        self.made = 0
        self.alive: list[weakref.ref[Frame]] = []
        self.closed_in = ""

    def frames(self) -> Iterator[Frame]:
        try:
            for number in range(1, self.count + 1):
                if number == self.fails_at:
                    raise InputError(f"frame {number} is damaged")
                frame = Frame(number, number / 25, np.full((2, 2, 3), number % 256, np.uint8))
                self.alive.append(weakref.ref(frame))
                self.made += 1
                yield frame
                del frame
        finally:
            self.closed_in = threading.current_thread().name

    def in_memory(self) -> int:
        return sum(ref() is not None for ref in self.alive)


def for_each(look: Callable[[Any], object], items: Iterable[object]) -> None:
    for item in items:
        look(item)


def settle(source: Source, expected: int) -> None:
    """Wait until so many frames were read, and long enough to see one that should not be."""
    deadline = time.monotonic() + 10
    while source.made < expected and time.monotonic() < deadline:
        time.sleep(0.001)
    time.sleep(0.02)


@pytest.mark.parametrize("depth", [1, 2, 100])
def test_every_frame_once_and_in_order(depth: int) -> None:
    frames = read_ahead(Source(60).frames(), depth)
    assert reader() is None
    assert [f.number for f in frames] == list(range(1, 61))
    assert reader() is None


@pytest.mark.parametrize("depth", [1, 3])
def test_reads_and_keeps_no_more_than_its_depth(depth: int) -> None:
    source = Source(8)
    frames = read_ahead(source.frames(), depth)
    for frame in frames:
        settle(source, min(frame.number + depth, 8))
        assert source.made == min(frame.number + depth, 8)
        gc.collect()
        assert source.in_memory() <= 1 + depth
        del frame
    assert source.in_memory() == 0


def test_decodes_while_the_consumer_works() -> None:
    """Both sides meet between two items: in one thread, neither would ever arrive."""
    both_at_work = threading.Barrier(2)

    def decoding() -> Iterator[int]:
        for number in range(5):
            if number > 0:
                both_at_work.wait(timeout=10)
            yield number

    for number in read_ahead(decoding(), 1):
        if number < 4:
            both_at_work.wait(timeout=10)


def test_an_error_comes_at_its_frame() -> None:
    source = Source(20, fails_at=8)
    seen: list[int] = []
    with pytest.raises(InputError, match="frame 8 is damaged"):
        for_each(lambda frame: seen.append(frame.number), read_ahead(source.frames(), 4))
    assert seen == list(range(1, 8))
    assert reader() is None


def test_stopping_early_ends_the_thread_and_closes_the_source() -> None:
    source = Source(1000)
    with closing(read_ahead(source.frames(), 4)) as frames:
        assert next(frames).number == 1
        name = reader()
    assert reader() is None
    assert source.closed_in == name
    assert source.made <= 1 + 4 + 1


def test_interrupt_while_waiting_for_a_frame() -> None:
    """Ctrl-C goes to the main thread, which waits for the decoder then."""
    import _thread

    def slow() -> Iterator[int]:
        yield 1
        time.sleep(0.05)
        _thread.interrupt_main()
        time.sleep(0.1)
        yield 2

    seen: list[int] = []
    with pytest.raises(KeyboardInterrupt):
        for_each(seen.append, read_ahead(slow(), 1))
    gc.collect()
    assert seen == [1]
    assert reader() is None
