import threading
import time
import weakref
from collections.abc import Iterator
from contextlib import closing

import numpy as np
import pytest

from handfit_core.common.errors import InputError
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


@pytest.mark.parametrize("depth", [1, 100])
def test_every_frame_once_and_in_order(depth):
    frames = read_ahead(Source(60).frames(), depth)
    assert reader() is None
    assert [f.number for f in frames] == list(range(1, 61))
    assert reader() is None


@pytest.mark.parametrize("depth", [1, 3])
def test_reads_and_keeps_no_more_than_its_depth(depth):
    """And reads them while the consumer works."""
    source = Source(6)
    for frame in read_ahead(source.frames(), depth):
        deadline = time.monotonic() + 60
        while source.made < min(frame.number + depth, 6) and time.monotonic() < deadline:
            time.sleep(0.001)
        time.sleep(0.01)  # long enough to see one that should not be read
        assert source.made == min(frame.number + depth, 6)
        assert sum(ref() is not None for ref in source.alive) <= 1 + depth
        del frame


def test_an_error_comes_at_its_frame():
    source = Source(20, fails_at=8)
    seen: list[int] = []
    with pytest.raises(InputError, match="frame 8 is damaged"):
        seen.extend(frame.number for frame in read_ahead(source.frames(), 4))
    assert seen == list(range(1, 8))
    assert reader() is None


def test_stopping_early_ends_the_thread_and_closes_the_source():
    source = Source(1000)
    with closing(read_ahead(source.frames(), 4)) as frames:
        assert next(frames).number == 1
        name = reader()
    assert reader() is None
    assert source.closed_in == name
    assert source.made <= 1 + 4 + 1


def test_interrupt_while_waiting_for_a_frame():
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
        seen.extend(read_ahead(slow(), 1))
    assert seen == [1]
    assert reader() is None
