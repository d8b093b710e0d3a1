"""A clip's chunks, shared between threads that each have networks and a reader of their own."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import nullcontext
from itertools import pairwise
from queue import SimpleQueue
from threading import Event
from typing import Final

from handfit_core.common.machine import usable_threads
from handfit_core.detect.detector import InChunks, Part
from handfit_core.media.opening import open_media
from handfit_core.media.settings import MEDIA
from handfit_core.media.source import Media

MAX_THREADS: Final = 8
"""Most threads unless more are asked for: each decodes the video for itself, and more would do little else"""
MAX_RUN: Final = 4
"""Most chunks that a thread detects one after another: a run is longer than most encoders' distance between
two pictures that are decoded without others, and short enough that little is lost where a clip is stopped"""


def detect_chunks(
    detector: InChunks[Part],
    another: Callable[[Media], InChunks[Part]],
    threads: int | None,
    on_progress: Callable[[int], None],
    should_stop: Callable[[], bool],
) -> list[Part]:
    """Detect all chunks of a clip in so many threads, by default as many as `thread_count` says. `another`
    makes a detector for a further thread, of the clip opened once more. The number of threads changes no
    result.

    `on_progress` gets the count of the frames that are done. Where it is stopped, the chunks before the first
    gap are returned.
    """
    media = detector.media
    count = 1 if media.given is None else thread_count(threads, media.expected_frames)
    if count > 1:
        return _in_threads(count, detector, another, on_progress, should_stop)
    found: list[Part] = []
    done = itertools.count(1)
    for index in itertools.count():
        found.append(detector.chunk(index, lambda _: on_progress(next(done)), should_stop))
        if len(found[-1].numbers) < detector.media.chunk_frames:
            break
    return [chunk for chunk in found if chunk.numbers]


def _in_threads(
    count: int,
    detector: InChunks[Part],
    another: Callable[[Media], InChunks[Part]],
    on_progress: Callable[[int], None],
    should_stop: Callable[[], bool],
) -> list[Part]:
    runs = _runs(-(-detector.media.expected_frames // detector.media.chunk_frames), count)
    found: dict[int, Part] = {}
    ends: list[int] = []
    """Indices of chunks that are shorter than others, as the clip ends in them"""
    stopped = Event()
    events: SimpleQueue[Future[None] | None] = SimpleQueue()
    """None for each frame that is done, and each thread's future once it has ended"""

    def work(number: int) -> None:
        with nullcontext(detector) if number == 0 else another(_reopened(detector.media)) as own:
            own.single_threaded()
            # More would only wait for each other.
            own.media.limit_threads(max(1, usable_threads() // count))
            for index in itertools.chain.from_iterable(runs):
                if stopped.is_set() or any(index > end for end in ends):
                    return
                found[index] = own.chunk(index, lambda _: events.put(None), stopped.is_set)
                if len(found[index].numbers) < detector.media.chunk_frames:
                    ends.append(index)

    with ThreadPoolExecutor(count, "handfit-detect") as pool:
        running, done = set[Future[None]](), 0
        try:
            for number in range(count):
                running.add(future := pool.submit(work, number))
                future.add_done_callback(events.put)
            while running:
                event = events.get()
                if event is None:
                    done += 1
                    on_progress(done)
                else:
                    running.remove(event)
                    event.result()
                if should_stop():
                    stopped.set()
        finally:
            stopped.set()
    chunks: list[Part] = []
    while (chunk := found.get(len(chunks))) is not None:
        chunks.append(chunk)
        if len(chunk.numbers) < detector.media.chunk_frames:
            break
    return [chunk for chunk in chunks if chunk.numbers]


def _runs(chunks: int, threads: int) -> Iterator[Iterable[int]]:
    """Deal the indices of so many chunks (0: unknown) out in runs, each of which one thread takes. The last
    run has no end, as a header may name too few frames."""
    if not chunks:
        return zip(itertools.count())  # runs of one
    firsts: list[int] = []
    left = range(chunks)
    while left:
        length = min(MAX_RUN, -(-len(left) // threads))
        firsts += left[: threads * length : length]
        left = left[threads * length :]
    return iter([*itertools.starmap(range, pairwise(firsts)), itertools.count(firsts[-1])])


def _reopened(media: Media) -> Media:
    assert media.given is not None
    return open_media(media.given, media.wanted.frames, max_megapixels=media.wanted.max_megapixels)


def thread_count(asked: int | None, frames: int) -> int:
    """Return how many threads detect a clip of that many frames (0: unknown): as many as asked for, or one a
    core, but no more than there are chunks."""
    wanted = min(usable_threads(), MAX_THREADS) if asked is None else asked
    return max(1, min(wanted, -(-frames // MEDIA.chunk_frames)) if frames else wanted)
