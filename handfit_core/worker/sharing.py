"""A clip's stretches, shared between this process and some more."""

from __future__ import annotations

import logging
import sys
import time
from collections.abc import Callable, Mapping
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from typing import Any, Final

from handfit_core.detect.detector import DETECTORS, ChunkedDetector
from handfit_core.detect.networks import usable_threads
from handfit_core.detect.stretches import (
    Stretch,
    stretches_from_arrays,
    stretches_to_arrays,
)
from handfit_core.doors.values import Unfit, shortly, whole
from handfit_core.errors import HandfitError, OptionError, ProtocolError
from handfit_core.media.frame_range import STRETCH
from handfit_core.media.opening import open_media
from handfit_core.media.source import Media
from handfit_core.options import CaptureOptions
from handfit_core.worker.client import Worker
from handfit_core.worker.protocol import pack, unpack
from handfit_core.worker.runner import OnProgress, WorkerError, as_error

log = logging.getLogger("handfit")

MOST: Final = 8
"""Processes that nobody asked for: each decodes a video for itself, and more would do little else"""

ALL: Final = slice(0, None)
"""Every stretch of a clip"""

_PAUSE: Final = 0.02
"""seconds between two looks at the other processes, where this one has nothing to do"""

_GRACE: Final = 1.0
"""seconds that they get to tell what they have, where everything is stopped"""


def shared(
    detector: ChunkedDetector,
    options: CaptureOptions,
    on_progress: Callable[[int], None],
    should_stop: Callable[[], bool],
    part: slice = ALL,
) -> list[Stretch]:
    """All stretches of a clip, or those of a part of them, looked at by as many processes as the options say:
    the same, however many.

    `on_progress` gets the count of the frames that are done. Where it is stopped, what was found from the
    beginning on without a gap is returned. A process that dies is replaced once; after a second time, the
    frames that it was at count as not seen, and are told of.
    """
    return _Shared(detector, options, on_progress, should_stop, part).stretches()


def expected_frames(media: Media, part: slice = ALL) -> int:
    """How many frames are expected in those stretches of a clip; 0: nobody knows."""
    if not media.expected_frames:
        return 0
    end = media.expected_frames if part.stop is None else min(media.expected_frames, part.stop * STRETCH)
    return max(end - part.start * STRETCH, 1)


def usable_processes(asked: int | None, frames: int) -> int:
    """How many look at a clip of that many frames (0: nobody knows). Not asked: all cores but one."""
    wanted = min(usable_threads() - 1, MOST) if asked is None else asked
    return max(1, min(wanted, -(-frames // STRETCH)) if frames else wanted)


@dataclass
class _Helper:
    """Another process."""

    worker: Worker
    able: bool = False
    """Whether it has ever started"""
    stretch: int | None = None
    """Which it is at"""
    request: int = 0
    done: int = 0
    """Frames of that"""


class _Shared:
    """All stretches of a clip, of which each process takes the next as soon as it is free."""

    def __init__(
        self,
        detector: ChunkedDetector,
        options: CaptureOptions,
        on_progress: Callable[[int], None],
        should_stop: Callable[[], bool],
        part: slice,
    ) -> None:
        self._detector, self._options = detector, options
        self._on_progress, self._should_stop = on_progress, should_stop
        self._found: dict[int, Stretch] = {}
        self._first = self._next = part.start
        self._end: int | None = part.stop
        """The first stretch behind the part, or, before that, that has less frames than it could have"""
        self._again: list[int] = []
        """Stretches at which a process has died: they are for other ones alone, since this one is to live"""
        self._died: set[int] = set()
        self._told = 0
        self._heard = 0.0
        media = detector.media
        frames = expected_frames(media, part)
        count = usable_processes(options.processes, frames) if media.given is not None else 1
        if count > 1:
            detector.single_threaded()
        self._helpers = [_Helper(Worker(sys.executable, threads=1)) for _ in range(count - 1)]

    def stretches(self) -> list[Stretch]:
        """Look at all of them, or at as many as there is time for; those from the beginning on that follow
        each other."""
        with ExitStack() as opened:
            for helper in self._helpers:
                opened.callback(helper.worker.stop)
            self._start()
            while not self._should_stop():
                if (index := self._taken()) is not None:
                    self._take(index, self._detector.stretch(index, self._look_around, self._should_stop))
                elif self._again or self._busy():
                    self._look_around(0)
                    time.sleep(_PAUSE)
                else:
                    break
            self._stop()
        found = []
        while (index := self._first + len(found)) in self._found:
            found.append(self._found[index])
            if len(found[-1].numbers) < STRETCH:
                break
        return [stretch for stretch in found if stretch.numbers]

    def _start(self) -> None:
        """Have the processes load what they need, while this one is at the first stretch."""
        for helper in list(self._helpers):
            try:
                helper.worker.start()
            except WorkerError as error:
                self._lost(helper, error)

    def _stop(self) -> None:
        """Have those that are still at something give what they have."""
        for helper in self._busy():
            helper.worker.cancel(helper.request)
        end = time.monotonic() + _GRACE
        while self._busy() and time.monotonic() < end:
            for helper in self._busy():
                with suppress(HandfitError):
                    self._hear(helper)
            time.sleep(_PAUSE)

    def _busy(self) -> list[_Helper]:
        return [helper for helper in self._helpers if helper.stretch is not None]

    def _taken(self, *, most: int | None = None) -> int | None:
        """The next stretch that nobody is at; None: there is none, or none below `most`."""
        if self._next in (self._end, most) or (self._end is not None and self._next > self._end):
            return None
        self._next += 1
        return self._next - 1

    def _take(self, index: int, stretch: Stretch) -> None:
        self._found[index] = stretch
        if len(stretch.numbers) < STRETCH:
            self._end = index if self._end is None else min(index, self._end)

    def _look_around(self, done: int) -> None:
        """Hear from the other processes now and then, and give those that are free something to do; `done`:
        frames that this one has looked at in its stretch."""
        if self._helpers and time.monotonic() > self._heard + _PAUSE:
            self._hear_all()
            self._heard = time.monotonic()
        done += sum(len(stretch.numbers) for stretch in self._found.values())
        done += sum(helper.done for helper in self._helpers)
        if done > self._told:
            self._told = done
            self._on_progress(done)

    def _hear_all(self) -> None:
        for helper in list(self._helpers):
            try:
                self._hear(helper)
                if helper.stretch is None:
                    self._occupy(helper)
            except WorkerError as error:
                self._lost(helper, error)
        if not self._helpers:
            for index in self._again:
                self._give_up(index, "no other process could be started")
            self._again = []

    def _occupy(self, helper: _Helper) -> None:
        """Give a process the next stretch, of those that the clip is expected to have. Raises WorkerError."""
        expected = -(-self._detector.media.expected_frames // STRETCH)
        index = self._again.pop() if self._again else self._taken(most=expected or None)
        if index is not None:
            helper.stretch, helper.done = index, 0
            helper.request = helper.worker.submit(
                "stretch",
                input=self._detector.media.given,
                options=self._options.to_message(),
                index=index,
            )

    def _hear(self, helper: _Helper) -> None:
        """Take in what a process has said. Raises WorkerError where it died, and what the stretch raised."""
        if (index := helper.stretch) is None:
            return
        for event in helper.worker.events(helper.request):
            helper.able = True
            if event["event"] == "progress":
                helper.done = event["done"]
            elif event["event"] == "warning":
                log.warning("%s", event["message"])
            elif event["event"] == "error":
                raise as_error(event)
            else:
                helper.stretch, helper.done = None, 0
                self._take(index, of_message(event, self._options.threshold))

    def _lost(self, helper: _Helper, error: HandfitError) -> None:
        """A process has died. One that worked before is replaced once for each stretch."""
        index, helper.stretch, helper.done = helper.stretch, None, 0
        if not helper.able and helper.worker.ready is None:
            log.info("no other process helps with detection: %s", error)
            self._helpers.remove(helper)
        if index is None:
            return
        if index in self._died:
            self._give_up(index, str(error))
        else:
            self._died.add(index)
            self._again.append(index)

    def _give_up(self, index: int, why: str) -> None:
        """Count the frames of a stretch as not seen."""
        media = self._detector.media
        left = max(media.expected_frames - index * STRETCH, 0) if media.expected_frames else STRETCH
        numbers = list(media.numbers(index * STRETCH, min(left, STRETCH)))
        log.warning(
            "frames %d to %d count as not seen: the process that looked at them ended, twice (%s)",
            numbers[0],
            numbers[-1],
            why,
        )
        self._take(index, Stretch(numbers, [()] * len(numbers), [], [], [], None, None))


_open: dict[str, ChunkedDetector] = {}
"""The clip that this process helps with, by what was asked"""


def answer(
    message: Mapping[str, Any], should_stop: Callable[[], bool], on_progress: OnProgress
) -> dict[str, Any]:
    """Look at one stretch for another process: the `done` event of a request `stretch`."""
    given, options = message.get("input"), message.get("options")
    if not isinstance(given, list | str):
        raise OptionError(f"a stretch needs the input of a capture, not {shortly(given)}")
    try:
        index = whole("index", message.get("index"), 0)
    except Unfit as error:
        raise OptionError(f"of a stretch, {error}") from error
    asked = repr((given, options))
    if asked not in _open:
        for detector in _open.values():
            detector.close()
        _open.clear()
        known = CaptureOptions.of_message(options or {})
        media = open_media(given, known.frames, max_megapixels=known.max_megapixels)
        clip = DETECTORS.get(known.detector).clip
        if clip is None:
            raise OptionError(f"the detector {known.detector} does not look at chunks of a clip")
        _open[asked] = clip(media, known)
    detector = _open[asked]
    found = detector.stretch(index, lambda done: on_progress("detect", done, STRETCH), should_stop)
    return to_message(found)


def to_message(stretch: Stretch) -> dict[str, Any]:
    """What was found in a stretch, as JSON can hold it."""
    return {name: pack(array) for name, array in stretches_to_arrays([stretch]).items()}


def of_message(message: Mapping[str, Any], threshold: float) -> Stretch:
    """The inverse of `to_message`. Raises ProtocolError."""
    try:
        arrays = {name: unpack(value) for name, value in message.items() if isinstance(value, dict)}
        (stretch,) = stretches_from_arrays(arrays, threshold)
    except (KeyError, IndexError, TypeError, ValueError) as error:
        raise ProtocolError(f"what came is no stretch of frames: {error}") from error
    return stretch
