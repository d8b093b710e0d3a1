import gc
import logging
import threading
import time
import weakref
from collections.abc import Callable, Iterable, Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from handfit_core.errors import InputError
from handfit_core.media.opening import open_media
from handfit_core.media.read_ahead import read_ahead
from handfit_core.media.source import Frame
from tests.core.media.test_opening import grey, write


def readers() -> int:
    """Read-ahead threads that run."""
    return sum(t.name.startswith("handfit-read-ahead") for t in threading.enumerate())


class Source:
    """Frames that notice how they are read."""

    def __init__(self, count: int, fails_at: int | None = None) -> None:
        self.count, self.fails_at = count, fails_at
        self.made = 0
        self.alive: list[weakref.ref[Frame]] = []
        self.threads: set[str] = set()
        self.closed_in: str | None = None

    def frames(self) -> Iterator[Frame]:
        try:
            for number in range(1, self.count + 1):
                self.threads.add(threading.current_thread().name)
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


@pytest.mark.parametrize("depth", [1, 2, 7, 100])
def test_every_frame_once_and_in_order(depth: int) -> None:
    source = Source(60)
    seen = [(f.number, int(f.rgb[0, 0, 0])) for f in read_ahead(source.frames(), depth) if f.rgb is not None]
    assert seen == [(n, n) for n in range(1, 61)]
    assert source.threads == {"handfit-read-ahead_0"}
    assert readers() == 0


def test_nothing_to_read() -> None:
    assert list(read_ahead([])) == []
    assert readers() == 0


@pytest.mark.parametrize("depth", [1, 3])
def test_reads_no_further_than_its_depth(depth: int) -> None:
    source = Source(30)
    with closing(read_ahead(source.frames(), depth)) as frames:
        for taken, _frame in enumerate(frames, 1):
            settle(source, taken + depth)
            assert source.made == taken + depth
            if taken == 4:
                break
    assert readers() == 0


def test_only_that_many_frames_are_in_memory() -> None:
    source = Source(8)
    frames = read_ahead(source.frames(), 3)
    for frame in frames:
        settle(source, min(frame.number + 3, 8))
        gc.collect()
        assert source.in_memory() <= 1 + 3
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


def test_error_comes_at_its_frame_and_ends_the_thread() -> None:
    source = Source(20, fails_at=8)
    seen: list[int] = []

    def look(frame: Frame) -> None:
        settle(source, min(frame.number + 4, 7))  # the error is met before frame 5 is looked at
        seen.append(frame.number)

    with pytest.raises(InputError, match="frame 8 is damaged"):
        for_each(look, read_ahead(source.frames(), 4))
    assert seen == list(range(1, 8))
    assert readers() == 0
    assert source.closed_in == "handfit-read-ahead_0"


def test_stopping_early_ends_the_thread_and_closes_the_source() -> None:
    source = Source(1000)
    with closing(read_ahead(source.frames(), 4)) as frames:
        assert next(frames).number == 1
        assert readers() == 1
    assert readers() == 0
    assert source.closed_in == "handfit-read-ahead_0"
    assert source.made <= 1 + 4 + 1
    with pytest.raises(StopIteration):
        next(frames)


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
    assert readers() == 0


def test_no_thread_before_the_first_frame() -> None:
    source = Source(5)
    frames = read_ahead(source.frames())
    time.sleep(0.02)
    assert (readers(), source.made) == (0, 0)
    frames.close()


def test_pictures_and_videos_read_the_same(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    for n in range(1, 9):
        write(tmp_path / "sequence" / f"a.{n:04d}.png", grey(20 * n, 48, 64))
    (tmp_path / "sequence" / "a.0005.png").write_bytes(b"not a picture")
    video = cv2.VideoWriter(str(tmp_path / "clip.mp4"), cv2.VideoWriter.fourcc(*"mp4v"), 25.0, (64, 48))
    for n in range(40):
        video.write(grey(6 * n, 48, 64))
    video.release()
    for source in (tmp_path / "sequence", tmp_path / "clip.mp4"):
        media = open_media(source)
        plain = list(media.frames())
        with caplog.at_level(logging.WARNING):
            ahead = list(read_ahead(media.frames()))
        assert [(f.number, f.time) for f in ahead] == [(f.number, f.time) for f in plain]
        for one, other in zip(plain, ahead, strict=True):
            np.testing.assert_array_equal(one.rgb, other.rgb)
    assert "frame 5 is left empty" in caplog.text
