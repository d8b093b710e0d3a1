"""From an opened input to the hands in its frames."""

from __future__ import annotations

import contextlib
import logging
from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from handfit_core.detect.detector import DETECTORS, ChunkedDetector, Detected
from handfit_core.detect.keypoints import HandDetection
from handfit_core.detect.looks import same_hand
from handfit_core.detect.opening import open_detector
from handfit_core.detect.regions import looked_at, shown_in
from handfit_core.detect.sharing import shared
from handfit_core.detect.stretches import Stretch
from handfit_core.errors import Cancelled, InputError, OptionError
from handfit_core.media.opening import MediaInput, open_media
from handfit_core.media.read_ahead import read_ahead
from handfit_core.media.source import Frame, Media
from handfit_core.options import CaptureOptions
from handfit_core.solvers import ShouldStop, never

log = logging.getLogger("handfit")

LookedAt = Callable[[ChunkedDetector, CaptureOptions, Callable[[int], None], ShouldStop], list[Stretch]]
"""Has the stretches of a clip looked at, and gives those from the beginning on; as `worker.sharing.shared`"""


def detect_frames(
    media: Media,
    options: CaptureOptions,
    on_frame: Callable[[int], None] = lambda _: None,
    should_stop: ShouldStop = never,
    looked_at: LookedAt = shared,
) -> Detected:
    """The hands of a source's frames; detectors that look at stretches of a clip get these from `looked_at`.

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
        with blamed(), clip(media, options) as detector:
            seen = _in_stretches(detector, looked_at(detector, options, on_frame, should_stop))
    if not seen.numbers:
        if should_stop():
            raise Cancelled(f"{media.source.name}: stopped before a hand was found")
        raise InputError(f"{media.source.files[0]}: no frame could be read from it")
    for region in options.regions:
        if region.frame is not None and region.frame not in seen.numbers:
            log.warning("the region in frame %d was not looked at: that frame is not used", region.frame)
    with blamed():
        return replace(seen, frames=_finite(seen.frames, options.detector))


def detect_part(
    media: Media,
    options: CaptureOptions,
    part: slice,
    on_frame: Callable[[int], None],
    should_stop: ShouldStop,
) -> list[Stretch]:
    """What is found in those stretches of a clip, fewer where it ends before; `on_frame` as `detect_frames`
    has it.

    Raises OptionError for what has no parts, Cancelled where it was stopped before all was looked at.
    """
    if media.source.kind == "photo":
        raise OptionError(f"{media.source.name}: a photo has no parts; capture it")
    clip = DETECTORS.get(options.detector).clip
    if clip is None:
        raise OptionError(
            f"the detector {options.detector} looks at a clip from its beginning to its end, so that no part "
            "of it stands for itself; capture the whole clip, or take the detector direct"
        )
    options = at_least_two(options)
    with DETECTORS.blamed(options.detector), clip(media, options) as detector:
        stretches = shared(detector, options, on_frame, should_stop, part)
    if should_stop():
        raise Cancelled(f"{media.source.name}: stopped before all frames of the part were looked at")
    return stretches


def at_least_two(options: CaptureOptions) -> CaptureOptions:
    """Two hands are looked for even where one is wanted, so that the surest can be chosen."""
    return replace(options, max_hands=2) if options.max_hands == 1 else options


def _one_by_one(
    media: Media,
    options: CaptureOptions,
    on_frame: Callable[[int], None],
    should_stop: ShouldStop,
    blamed: Callable[[], contextlib.AbstractContextManager[None]],
) -> Detected:
    """What a detector finds in one frame after another."""
    numbers: list[int] = []
    found: list[tuple[HandDetection, ...]] = []
    with contextlib.ExitStack() as opened:
        with blamed():
            detector = opened.enter_context(open_detector(options, video=media.source.kind != "photo"))
        with contextlib.closing(read_ahead(media.frames())) as frames:
            for frame in frames:
                if should_stop():
                    break
                with blamed():
                    found.append(looked_at(detector, frame, options.regions, first=not numbers))
                numbers.append(frame.number)
                on_frame(len(numbers))
    return Detected(numbers, found, detector.most_seen)


def _in_stretches(detector: ChunkedDetector, stretches: list[Stretch]) -> Detected:
    """What is found in a clip, whoever looked at its stretches."""
    frames, cuts = detector.joined(stretches)
    # At least twice, since one picture may show what only looks like a hand.
    counts = sorted(count for stretch in stretches for count in stretch.counts)
    return Detected(
        numbers=[number for stretch in stretches for number in stretch.numbers],
        frames=frames,
        most_seen=counts[-min(2, len(counts))] if counts else 0,
        cuts=tuple(cuts),
    )


def find_in_frame(source: MediaInput, options: CaptureOptions) -> tuple[Frame, tuple[HandDetection, ...]]:
    """The first used frame of a source, and all its hands, the surest first: what somebody can choose from.

    Hands of `regions` are among them; with `only_regions` they are all, and without regions none is looked
    for. Raises what `capture` raises before it fits, but for NoHandFoundError: there may be none.
    """
    media = open_media(source, options.frames, max_megapixels=options.max_megapixels)
    frame = next(media.frames(), None)
    if frame is None or frame.rgb is None:
        raise InputError(f"{media.source.files[0]}: this frame could not be read; choose another one")
    if options.only_regions and not options.regions:
        return frame, ()
    options = replace(options, max_hands=None)
    with DETECTORS.blamed(options.detector), open_detector(options) as detector:
        found = () if options.only_regions else detector.find(frame.rgb, frame.time)
        shown = [hand for region in options.regions for hand in shown_in(detector, frame.rgb, region)]
        others = [hand for hand in found if not any(same_hand(hand, other) for other in shown)]
        (hands,) = _finite([(*shown, *others)], options.detector)
    return frame, hands


def _finite(found: list[tuple[HandDetection, ...]], detector: str) -> list[tuple[HandDetection, ...]]:
    """Without the hands that are no hands to anybody after the detector: one of them would take its whole
    track with it. Raises ValueError for arrays of another shape."""
    kept = [
        tuple(h for h in hands if np.isfinite(np.append((h.keypoints, h.world), h.score)).all())
        for hands in found
    ]
    dropped = sum(map(len, found)) - sum(map(len, kept))
    if dropped:
        log.warning(
            "%d hands of the detector %s have numbers that are not finite: left out", dropped, detector
        )
    return kept
