"""Where the hands of a capture come from: pictures, or what another program has found in some.

Each source opens with `open_source` and has one method, `find`, which gives a track for each wanted hand.
"""

from __future__ import annotations

import logging
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Final, TypeVar

import numpy as np

from handfit_core.capturing.detection import detect_frames
from handfit_core.capturing.options import CROWD, CaptureOptions
from handfit_core.common.errors import (
    Cancelled,
    HandModelError,
    NoHandFoundError,
    OptionError,
    PictureSizeError,
)
from handfit_core.common.files import shown
from handfit_core.common.skeleton import SIDES, HandChoice
from handfit_core.detect.detector import DETECTORS, Detected
from handfit_core.detect.keypoints import Track, largest_extent
from handfit_core.detect.tracks import link_and_count
from handfit_core.fit.solvers import ShouldStop
from handfit_core.geometry.camera import Intrinsics
from handfit_core.hand_model import load_model
from handfit_core.hand_model.motion import HandMotion
from handfit_core.interchange.opening import (
    RELATIVE,
    RecordedMedia,
    beside,
    is_recording,
    read_recording,
    scaled,
)
from handfit_core.interchange.recording import LEAST_POINTS, Recording
from handfit_core.interchange.taking import (
    before_camera,
    detected_in,
    only_present,
    seen_of,
    tracks_of,
)
from handfit_core.media.exif import known_intrinsics
from handfit_core.media.opening import MediaInput, open_media
from handfit_core.media.settings import MEDIA
from handfit_core.media.source import Media
from handfit_core.take import TAKE_LIMITS

Chosen = TypeVar("Chosen", Track, HandMotion)

log = logging.getLogger("handfit")

NONE_SEEN: Final = (
    "no hand was found; draw a box around one that you see (--region on the command line, Find Hands in "
    "Blender), or try a lower detection threshold, such as 0.3"
)
MISSED: Final = (
    "the picture may show another hand: draw a box around it (--region on the command line, Find Hands in "
    "Blender)"
)
NONE_IN_REGION: Final = (
    "no hand was found, not in the region that was drawn either; draw the box closer around the hand, or "
    "over all of it, or lay a hand there yourself with Add Hand in Blender"
)


@dataclass(frozen=True, eq=False)
class Found:
    """The wanted hands of a source over its T frames."""

    numbers: list[int]
    """The numbers of the source's T frames"""
    intrinsics: Intrinsics
    tracks: list[Track]
    """One track for each hand, over the T frames"""
    fits: list[HandMotion] | None = None
    """The hands as another program has posed them, which are taken as they are; None: the tracks are to be
    fitted"""


@dataclass(frozen=True)
class HandSource:
    """An input in which hands are found, opened."""

    media: Media
    known: Intrinsics | None
    """The camera that took the pictures; None: neither the file nor anybody else tells"""
    options: CaptureOptions
    recording: Recording | None
    """The hands that another program has found; None: hands are detected in the pictures"""

    def find(self, on_frame: Callable[[int], None], should_stop: ShouldStop) -> Found:
        """Find the wanted hands. `on_frame` gets the count of frames that are done; `should_stop` is asked
        before each.

        Raises NoHandFoundError, and Cancelled where it was stopped before a hand was found."""
        raise NotImplementedError


class Pictures(HandSource):
    """A photo, a sequence or a video, in which a detector finds hands."""

    def find(self, on_frame: Callable[[int], None], should_stop: ShouldStop) -> Found:
        """Detect hands in the pictures, and track them."""
        media, options = self.media, self.options
        with DETECTORS.blamed(options.detector):
            calibrated = DETECTORS.get(options.detector).calibrated(options.detector_settings())
        seen = detect_frames(media, options, on_frame, should_stop)
        return _tracked(media, self.known, options, seen, should_stop, calibrated=calibrated)


class Keypoints(HandSource):
    """Pictures in which another program has found the keypoints of hands."""

    recording: Recording

    def find(self, on_frame: Callable[[int], None], should_stop: ShouldStop) -> Found:  # noqa: ARG002
        """Track the hands of the other program."""
        seen = detected_in(self.recording)
        return _tracked(self.media, self.known, self.options, seen, should_stop, calibrated=False)


class Poses(HandSource):
    """Hands that another program has found in space: their poses, or their points."""

    recording: Recording

    def find(self, on_frame: Callable[[int], None], should_stop: ShouldStop) -> Found:  # noqa: ARG002
        """Take poses as they are, unless they are to be fitted again, and track points in space."""
        options, recording = self.options, self.recording
        intrinsics = self.known or Intrinsics.assumed(self.media.width, self.media.height)
        numbers = [int(number) for number in recording.frame_numbers]
        posed = _chosen(options, recording.posed)
        tracks = [
            seen_of(load_model(options.model, hand.side), hand, intrinsics, recording.fps) for hand in posed
        ]
        if posed and not options.refit:
            return Found(numbers, intrinsics, tracks, posed)
        points = _chosen(options, tracks_of(recording, intrinsics))
        return Found(numbers, intrinsics, [*points, *tracks])


def open_source(source: MediaInput, options: CaptureOptions) -> HandSource:
    """Open the input of a capture. Raises InputError, NoHandFoundError, OptionError and HandModelError."""
    media, known = opened(source, options)
    recording = _recording(media, options)
    if recording is None:
        return Pictures(media, known, options, None)
    if recording.intrinsics and options.intrinsics is None and options.lens is None:
        known = recording.intrinsics  # the hands lie where that camera has them
    return (Poses if recording.seen is None else Keypoints)(media, known, options, recording)


def opened(source: MediaInput, options: CaptureOptions) -> tuple[Media, Intrinsics | None]:
    """Return the opened input and the camera that took it, None where nobody tells. Raises InputError and
    OptionError, and HandModelError for a model of neither side: before the long part, which a wrong path
    should not cost."""
    media = open_input(source, options)
    intrinsics = options.camera(media.width, media.height)
    if options.model is not None:
        _check_some_side(options.model)
    known = media.recording.intrinsics if isinstance(media, RecordedMedia) else known_intrinsics(media)
    return media, intrinsics or known


def open_input(source: MediaInput, options: CaptureOptions) -> Media:
    """Open pictures, as `open_media` does, or a recording. Raises InputError, and PictureSizeError for a
    recording that needs to be told the size of its pictures: with another one, the camera would be wrong."""
    if not is_recording(source):
        return open_media(source, options.frames, max_megapixels=options.max_megapixels)
    path = source if isinstance(source, str | os.PathLike) else source[0]
    recording = _countable(read_recording(path, options.read_options()))
    if recording.size == RELATIVE and options.picture_size is not None:
        recording = scaled(recording, *options.picture_size)
    elif recording.size == RELATIVE or (recording.seen is not None and recording.size is None):
        raise PictureSizeError(
            f"{shown(path)}: it does not tell the size of its pictures; give --picture-size WIDTHxHEIGHT "
            "(Width and Height of the source in Blender), or the pictures as the input and this file as "
            "--keypoints"
        )
    return RecordedMedia(recording, os.fspath(path), options.frames)


def _countable(recording: Recording) -> Recording:
    """Return a recording whose frames have numbers that Blender's can have, as `open_media` has it of
    pictures."""
    numbers = recording.frame_numbers
    if 0 <= numbers[0] <= numbers[-1] <= MEDIA.max_frame_number:
        return recording
    said = f"its frames' numbers, up to {numbers[-1]}, are none of Blender's: they are counted from 1"
    counted = np.arange(1, len(numbers) + 1)
    return replace(recording, frame_numbers=counted, assumed=(*recording.assumed, said))


def _check_some_side(model: str | os.PathLike[str]) -> None:
    """Raise HandModelError if `model` is good for neither side. One side alone is fine as long as no
    hand of the other turns up."""
    errors: list[HandModelError] = []
    for side in SIDES:
        try:
            load_model(model, side)
        except HandModelError as error:
            errors.append(error)
    if len(errors) == len(SIDES):
        raise errors[-1]


def _recording(media: Media, options: CaptureOptions) -> Recording | None:
    """Return what another program has found in the input, where the input is its file or `keypoints` names
    that: hands that are in the wanted frames, before the camera. Raises NoHandFoundError where none is."""
    name, kept = media.source.name, isinstance(media, RecordedMedia)
    if options.keypoints is not None:
        if kept:
            raise OptionError(
                f"{name}: this input holds no pictures, so that no other keypoints belong to it; give the "
                "pictures as the input, or leave --keypoints out"
            )
        told = replace(options, picture_size=options.picture_size or (media.width, media.height))
        recording = beside(media, read_recording(options.keypoints, told.read_options()))
    elif isinstance(media, RecordedMedia):
        if options.regions:
            raise OptionError(
                f"{name}: this input holds no pictures, in whose regions a hand could be found; leave "
                "--region out"
            )
        recording = media.in_range()
    else:
        return None
    numbers = recording.frame_numbers
    recording = only_present(recording)
    if not (recording.points or recording.posed or (recording.seen is not None and len(recording.seen))):
        raise NoHandFoundError(
            f"{name}: no hand, of which {LEAST_POINTS} points or more are known, is in frames {numbers[0]} "
            f"to {numbers[-1]}; choose other frames (--frames), or leave the choice out"
        )
    cameras = options.intrinsics, options.lens, recording.intrinsics
    recording = before_camera(recording, placed=not kept or any(camera is not None for camera in cameras))
    for phrase in recording.assumed:
        log.warning("%s: %s", name, phrase)
    return recording


def _chosen(options: CaptureOptions, hands: Sequence[Chosen]) -> list[Chosen]:
    """Return those hands that are of the wanted sides, as many as are wanted. Raises NoHandFoundError where
    none is left, and OptionError for more than a take holds."""
    kept = [hand for hand in hands if options.hands not in SIDES or hand.side == options.hands]
    if hands and not kept:
        raise NoHandFoundError(f"there is no {options.hands} hand in this input; take hands 'auto'")
    kept = kept[: options.max_hands]
    if len(kept) > TAKE_LIMITS.max_hands:
        raise OptionError(
            f"there are {len(kept)} hands in this input, and a take holds at most {TAKE_LIMITS.max_hands}: "
            "keep the first ones with --max-hands, or one person's with --person"
        )
    return list(kept)


def _tracked(
    media: Media,
    known: Intrinsics | None,
    options: CaptureOptions,
    seen: Detected,
    stop: ShouldStop,
    *,
    calibrated: bool,
) -> Found:
    """Link detections to tracks, and find the camera that they tell where nobody else does. A measured lens'
    distortion is taken out of them first: all that follows knows a pinhole camera."""
    if (lens := options.measured_lens(media.width, media.height)) is not None:
        seen = replace(seen, hands=seen.hands.moved(lens.undistorted))
    tracks = [replace(track, calibrated=calibrated) for track in _linked(media, options, seen, stop)]
    if known is None:
        extents = np.concatenate([track.detections.extent for track in tracks])
        known = Intrinsics.assumed(media.width, media.height, largest_extent(extents))
    return Found(seen.numbers, known, tracks)


def _linked(media: Media, options: CaptureOptions, seen: Detected, stop: ShouldStop) -> list[Track]:
    """Return the wanted hands, each tracked over the clip. Raises NoHandFoundError, and Cancelled where
    detection was stopped before one was found."""
    hands, most = options.hands, options.most_hands(clip=media.source.kind != "photo")
    steps = np.diff(seen.numbers)
    skipped = np.flatnonzero(steps > np.median(steps)).tolist() if len(steps) else ()
    holes = sorted({*skipped, *(row - 1 for row in seen.cuts)})
    try:
        tracks, count = link_and_count(
            seen.hands,
            len(seen.numbers),
            hands,
            min(TAKE_LIMITS.max_hands, max(most or TAKE_LIMITS.max_hands, len(options.regions))),
            _rate(media, seen.numbers),
            tuple(holes),
            cuts=seen.cuts,
            only_shown=options.only_regions,
        )
    except NoHandFoundError as error:
        if stop():
            raise Cancelled(f"{media.source.name}: stopped before a hand was found") from None
        there = len(seen.hands) and (seen.hands.shown.any() or not options.only_regions)
        seen_none = NONE_IN_REGION if options.regions else NONE_SEEN
        raise NoHandFoundError(f"{media.source.name}: {error if there else seen_none}") from None
    if not options.only_regions:
        _tell_of_others(hands, len(tracks), count if hands in SIDES else max(count, seen.most_seen))
        if seen.missed and not options.regions and hands not in SIDES and len(tracks) != most:
            log.warning(MISSED, extra={"offer": "find_hands"})
    if most is None and len(tracks) > CROWD and not options.only_regions:
        log.warning(
            "%d hands are captured, and building so many takes long: --max-hands %d keeps the surest",
            len(tracks),
            CROWD,
        )
    return list(tracks)


def _tell_of_others(hands: HandChoice, captured: int, seen: int) -> None:
    """Warn where there were more hands than are captured."""
    if seen <= captured:
        return
    named = f"{seen} {hands} hands" if hands in SIDES else f"{seen} hands"
    kept = "the surest was" if captured == 1 else f"the {captured} surest were"
    others = "draw boxes around others (--region, or Find Hands in Blender), or allow more (--max-hands)"
    advice = others if hands == "auto" else "take hands 'auto' to capture others"
    log.warning("%s were seen, and %s captured: %s", named, kept, advice, extra={"offer": "find_hands"})


def _rate(media: Media, numbers: list[int]) -> float:
    """Return the used frames per second: for a source of which every fourth frame is used, a quarter of its
    own rate."""
    return media.fps / float(np.median(np.diff(numbers))) if len(numbers) > 1 else media.fps
