"""A clip's stretches, shared between threads that each have networks and a reader of their own."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import nullcontext
from queue import SimpleQueue
from threading import Event
from typing import Final

from handfit_core.detect.detector import DETECTORS, ChunkedDetector
from handfit_core.detect.networks import usable_threads
from handfit_core.detect.stretches import Stretch
from handfit_core.media.frame_range import STRETCH
from handfit_core.media.opening import open_media
from handfit_core.media.source import Media
from handfit_core.options import CaptureOptions

MOST: Final = 8
"""Threads that nobody asked for: each decodes a video for itself, and more would do little else"""

ALL: Final = slice(0, None)
"""Every stretch of a clip"""


def shared(
    detector: ChunkedDetector,
    options: CaptureOptions,
    on_progress: Callable[[int], None],
    should_stop: Callable[[], bool],
    part: slice = ALL,
) -> list[Stretch]:
    """All stretches of a clip, or those of a part of them, looked at in as many threads as the options say:
    the same, however many.

    `on_progress` gets the count of the frames that are done. Where it is stopped, what was found from the
    beginning on without a gap is returned.
    """
    media, frames = detector.media, expected_frames(detector.media, part)
    count = 1 if media.given is None else usable_count(options.processes, frames)
    if count > 1:
        return _in_threads(count, detector, options, on_progress, should_stop, part)
    found: list[Stretch] = []
    done = itertools.count(1)
    for index in itertools.count(part.start) if part.stop is None else range(part.start, part.stop):
        found.append(detector.stretch(index, lambda _: on_progress(next(done)), should_stop))
        if len(found[-1].numbers) < STRETCH:
            break
    return [stretch for stretch in found if stretch.numbers]


def _in_threads(
    count: int,
    detector: ChunkedDetector,
    options: CaptureOptions,
    on_progress: Callable[[int], None],
    should_stop: Callable[[], bool],
    part: slice,
) -> list[Stretch]:
    indices = itertools.count(part.start)
    found: dict[int, Stretch] = {}
    ended = Event()
    """Set where the clip's end was seen, or somebody stops"""
    stopped = Event()
    news: SimpleQueue[Future[None] | None] = SimpleQueue()
    """None for each frame that is done, and each thread's future once it has ended"""

    def work(number: int) -> None:
        with nullcontext(detector) if number == 0 else _another(detector, options) as own:
            own.single_threaded()
            while not ended.is_set():
                index = next(indices)
                if part.stop is not None and index >= part.stop:
                    return
                found[index] = own.stretch(index, lambda _: news.put(None), stopped.is_set)
                if len(found[index].numbers) < STRETCH:
                    ended.set()

    with ThreadPoolExecutor(count, "handfit-detect") as pool:
        running, done = {pool.submit(work, number) for number in range(count)}, 0
        for future in running:
            future.add_done_callback(news.put)
        try:
            while running:
                said = news.get()
                if said is None:
                    done += 1
                    on_progress(done)
                else:
                    running.remove(said)
                    said.result()
                if should_stop():
                    stopped.set()
                    ended.set()
        finally:
            stopped.set()
            ended.set()
    whole: list[Stretch] = []
    while (stretch := found.get(part.start + len(whole))) is not None:
        whole.append(stretch)
        if len(stretch.numbers) < STRETCH:
            break
    return [stretch for stretch in whole if stretch.numbers]


def _another(detector: ChunkedDetector, options: CaptureOptions) -> ChunkedDetector:
    """What looks at the same clip, in another thread."""
    clip, media = DETECTORS.get(options.detector).clip, detector.media
    assert clip is not None
    assert media.given is not None
    return clip(open_media(media.given, options.frames, max_megapixels=options.max_megapixels), options)


def expected_frames(media: Media, part: slice = ALL) -> int:
    """How many frames are expected in those stretches of a clip; 0: nobody knows."""
    if not media.expected_frames:
        return 0
    end = media.expected_frames if part.stop is None else min(media.expected_frames, part.stop * STRETCH)
    return max(end - part.start * STRETCH, 1)


def usable_count(asked: int | None, frames: int) -> int:
    """How many threads look at a clip of that many frames (0: nobody knows). Not asked: one a core."""
    wanted = min(usable_threads(), MOST) if asked is None else asked
    return max(1, min(wanted, -(-frames // STRETCH)) if frames else wanted)
