"""From an opened input to the hands in its frames."""

from __future__ import annotations

import contextlib
import logging
from collections.abc import Callable, Iterable
from dataclasses import replace
from functools import partial

import numpy as np

from handfit_core.capturing.options import CaptureOptions
from handfit_core.common.arrays import check_arrays
from handfit_core.common.errors import Cancelled, InputError
from handfit_core.common.skeleton import SIDES
from handfit_core.detect.chunks import Chunk
from handfit_core.detect.detector import DETECTORS, ChunkedDetector, Detected, Detector
from handfit_core.detect.keypoints import Detections
from handfit_core.detect.matching import overlaps
from handfit_core.detect.regions import detect_frame, detect_region
from handfit_core.detect.sharing import detect_chunks
from handfit_core.fit.solvers import ShouldStop, never
from handfit_core.media.opening import MediaInput, open_media
from handfit_core.media.read_ahead import read_ahead
from handfit_core.media.source import Frame, Media

log = logging.getLogger("handfit")


def detect_frames(
    media: Media,
    options: CaptureOptions,
    on_frame: Callable[[int], None] = lambda _: None,
    should_stop: ShouldStop = never,
) -> Detected:
    """Return the hands of a source's frames.

    `on_frame` is called with the count of frames that are done, whenever it has grown. `should_stop` is asked
    before every frame; the frames before that are returned.

    Raises InputError when no frame could be read, Cancelled when it was stopped before the first.
    """
    options = at_least_two(options)
    clip = None if media.source.kind == "photo" else DETECTORS.get(options.detector).clip
    blamed = partial(DETECTORS.blamed, options.detector)
    if clip is None:
        seen = _one_by_one(media, options, on_frame, should_stop, blamed)
    else:
        told = options.detector_settings(video=True), options.regions
        with blamed(), clip(media, *told) as detector:
            chunks = detect_chunks(
                detector, lambda m: clip(m, *told), options.processes, on_frame, should_stop
            )
            seen = _in_chunks(detector, chunks)
    if not seen.numbers:
        if should_stop():
            raise Cancelled(f"{media.source.name}: stopped before a hand was found")
        raise InputError(f"{media.source.files[0]}: no frame could be read from it")
    for region in options.regions:
        if region.frame is not None and region.frame not in seen.numbers:
            log.warning("the region in frame %d was not looked at: that frame is not used", region.frame)
    with blamed():
        finite = _finite(seen.hands, options.detector)
    return seen if finite.all() else replace(seen, hands=seen.hands.select(finite))


def open_detector(options: CaptureOptions, *, video: bool = False) -> Detector:
    """Open the detector that a capture's options name, for the frames of one clip (`video`) or for stills.

    Raises OptionError where there is no such detector, LandmarkModelError where its model file is missing or
    damaged.
    """
    return DETECTORS.get(options.detector).open(options.detector_settings(video=video))


def at_least_two(options: CaptureOptions) -> CaptureOptions:
    """Return the options with two hands to detect where one is wanted, so that the surest can be chosen."""
    return replace(options, max_hands=2) if options.max_hands == 1 else options


def _one_by_one(
    media: Media,
    options: CaptureOptions,
    on_frame: Callable[[int], None],
    should_stop: ShouldStop,
    blamed: Callable[[], contextlib.AbstractContextManager[None]],
) -> Detected:
    """Detect one frame after another."""
    numbers: list[int] = []
    found: list[Detections] = []
    with contextlib.ExitStack() as opened:
        with blamed():
            detector = opened.enter_context(open_detector(options, video=media.source.kind != "photo"))
        with contextlib.closing(read_ahead(media.frames())) as frames:
            for frame in frames:
                if should_stop():
                    break
                with blamed():
                    found.append(detect_frame(detector, frame, options.regions, first=not numbers))
                numbers.append(frame.number)
                on_frame(len(numbers))
    with blamed():
        return Detected(numbers, Detections.of(found), detector.most_seen, missed=detector.missed)


def _in_chunks(detector: ChunkedDetector, chunks: list[Chunk]) -> Detected:
    hands, cuts = detector.joined(chunks)
    numbers = [number for chunk in chunks for number in chunk.numbers]
    check_arrays(hands, ValueError)
    rows = np.concatenate([[0], hands.frame, [max(0, len(numbers) - 1)]])
    if np.any(np.diff(rows) < 0) or not np.isin(hands.side, range(len(SIDES))).all():
        raise ValueError("frame must not decrease and lie within the clip, and side be 0 or 1")
    # At least twice, since one picture may show what only looks like a hand.
    counts = sorted(count for chunk in chunks for count in chunk.counts)
    return Detected(
        numbers=numbers,
        hands=hands,
        most_seen=counts[-min(2, len(counts))] if counts else 0,
        cuts=tuple(cuts),
        missed=2 * sum(chunk.misses for chunk in chunks) > len(counts),
    )


def find_in_frame(
    source: MediaInput, options: CaptureOptions, known: Iterable[Detections] = ()
) -> tuple[Frame, Detections]:
    """Return the first used frame of a source, and all its hands, the surest first, for a person to choose
    from.

    Those of `regions` come first, found beside the `known` ones; with `only_regions` there are no others.
    Raises what `capture` raises before it fits, but for NoHandFoundError: there may be none.
    """
    media = open_media(source, options.frames, max_megapixels=options.max_megapixels)
    frame = next(media.frames(), None)
    if frame is None or frame.rgb is None:
        raise InputError(f"{media.source.files[0]}: this frame could not be read; choose another one")
    if options.only_regions and not options.regions:
        return frame, Detections.of([[]])
    options = replace(options, max_hands=None)
    with DETECTORS.blamed(options.detector), open_detector(options) as detector:
        found = () if options.only_regions else detector.find(frame.rgb, frame.time)
        shown: list[Detections] = []
        for region in options.regions:
            shown += detect_region(detector, frame.rgb, region, (*known, *shown))
        others = [hand for hand in found if not overlaps(hand, Detections.of([shown]))]
        hands = Detections.of([[*shown, *others]])
        return frame, hands.select(_finite(hands, options.detector))


def _finite(hands: Detections, detector: str) -> np.ndarray:
    """Return (N,) bool: True for hands whose numbers are all finite; a single one that is not would make its
    whole track useless."""
    points = (np.isfinite(each).all(axis=(1, 2)) for each in (hands.keypoints, hands.world))
    finite = np.logical_and.reduce([*points, np.isfinite(hands.score)])
    if not finite.all():
        log.warning(
            "%d hands of the detector %s have numbers that are not finite: left out",
            (~finite).sum(),
            detector,
        )
    return finite
