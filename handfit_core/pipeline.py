"""The whole path from pictures to a take, as one readable function."""

from __future__ import annotations

import logging
import os
import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal, TypeVar

import numpy as np

from handfit_core.batch import slices
from handfit_core.detect.detector import DETECTORS, Detected, Quality
from handfit_core.detect.keypoints import DetectedTrack, SideBySide, largest_extent
from handfit_core.detect.opening import settings_of
from handfit_core.detect.sharing import detect_chunks, expected_frames
from handfit_core.detect.tracks import link_and_count
from handfit_core.detection import detect_frames, detect_part
from handfit_core.errors import Cancelled, HandModelError, NoHandFoundError, OptionError
from handfit_core.files import check_writable
from handfit_core.fit_quality import error_is_known, mean_expected_error, mean_relative_error
from handfit_core.geometry.camera import Intrinsics
from handfit_core.hand_model import OPEN_HAND, HandModel, load_model
from handfit_core.hand_model.length import tell_of_odd_shapes
from handfit_core.interchange.opening import RecordedMedia, beside, open_input, read_recording
from handfit_core.interchange.readers import program_of
from handfit_core.interchange.recording import LEAST_POINTS, PosedHand, Recording
from handfit_core.interchange.taking import (
    before_camera,
    detected_in,
    fit_of,
    only_present,
    seen_of,
    tracks_of,
)
from handfit_core.media.exif import known_intrinsics
from handfit_core.media.frame_range import CHUNK_FRAMES, FrameRange
from handfit_core.media.opening import MediaInput, open_media, sequence_numbers
from handfit_core.media.source import Media, Source
from handfit_core.options import CROWD, OPTIONS, CaptureOptions, HandChoice, HandMean, Region
from handfit_core.parts import Part, Parts, chunks_in
from handfit_core.skeleton import FINGERS, NUM_KEYPOINTS, SIDES
from handfit_core.solvers import SOLVERS, ShouldStop, TrackFit, get_solver, never
from handfit_core.take import MOST_HANDS, HandTrack, Take

Chosen = TypeVar("Chosen", DetectedTrack, PosedHand)

Stage = Literal["detect", "fit", "score"]
"""`score` is of evaluations only"""


@dataclass(frozen=True)
class Progress:
    """How far a capture is."""

    stage: Stage
    done: int
    """frames of this stage, over all hands"""
    total: int
    """0 where nobody knows"""


ProgressCallback = Callable[[Progress], None]

log = logging.getLogger("handfit")

NEAREST_FOCAL = 0.05
FARTHEST_FOCAL = 1000.0
"""Times the picture's longer side: a view of 169 degrees, and one of three minutes of arc, as a crop of a
telescope's picture may have"""

NONE_SEEN = (
    "no hand was found; draw a box around one that you see (--region on the command line, Find Hands in "
    "Blender), or try a lower detection threshold, such as 0.3"
)
NONE_IN_REGION = (
    "no hand was found, not in the region that was drawn either; draw the box closer around the hand, or "
    "over all of it, or lay a hand there yourself with Add Hand in Blender"
)

LAST_FITS_SECONDS = 0.3
"""What slow solvers get for what was found when detection was stopped. Others get the time that they need,
since that is a small part of what detecting took."""


def capture(
    source: MediaInput,
    hands: HandChoice = "auto",
    model: str | os.PathLike[str] | None = None,
    solver: str = "fast",
    progress: ProgressCallback | None = None,
    *,
    frames: FrameRange | str | None = None,
    max_hands: int | None = None,
    regions: Sequence[Region | Sequence[float | str] | str] = (),
    only_regions: bool = False,
    detector: str = "direct",
    threshold: float = 0.5,
    plain_detection: bool = False,
    quality: Quality = "standard",
    processes: int | None = None,
    landmark_model: str | os.PathLike[str] | None = None,
    smoothing: float = 1.0,
    hand_length: float | None = None,
    intrinsics: Intrinsics | Sequence[float] | None = None,
    lens: Sequence[float] | None = None,
    max_megapixels: float | None = None,
    keypoints: str | os.PathLike[str] | None = None,
    reader: str | None = None,
    person: int | None = None,
    fps: float | None = None,
    picture_size: Sequence[int] | str | None = None,
    hand_mean: HandMean = "auto",
    refit: bool = False,
    should_stop: ShouldStop | None = None,
) -> Take:
    """Find the hands in a photo, image sequence or video and fit a hand model to each.

    source
        A photo; a folder or list of photos; a `name.%04d.png`, `name.####.png` or glob pattern; a video; or a
        file or folder with hands or keypoints of another program (docs/interchange.md).
    progress
        Called with a `Progress` after every frame; an exception raised there ends the capture.
    should_stop
        Asked between frames; once it says True, it must go on saying so. Then what was finished is kept: the
        frames seen so far, or all frames with those hands that were fitted; the others count as not detected.

    The others are the options of `handfit_core.options.OPTIONS`, which has the range and the help of each;
    lengths are in metres here. `model` is the open hand's where None, `intrinsics` what the file tells about
    its lens, or else a view of 53 degrees.

    Raises a `HandfitError` whose message is meant for the user: OptionError, InputError,
    NoHandFoundError, HandModelError, LandmarkModelError; Cancelled when it was stopped before a hand was
    found.
    """
    given = {name: value for name, value in locals().items() if name in OPTIONS}
    return capture_with(source, CaptureOptions(**given), progress, should_stop)


def capture_with(
    source: MediaInput,
    options: CaptureOptions,
    progress: ProgressCallback | None = None,
    should_stop: ShouldStop | None = None,
    parts: Parts | None = None,
) -> Take:
    """`capture`, with options that somebody has put together elsewhere, and perhaps of a clip whose hands
    were found in parts. Raises InputError, too, where these do not fit."""
    solver, hand_length = options.solver, options.hand_length
    solve = get_solver(solver, options.smoothing, hand_length)
    can = SOLVERS.get(solver)
    DETECTORS.get(options.detector)  # before any picture is read, as with the solver
    if options.only_regions and not options.regions:
        raise OptionError("only the hands of regions are to be kept, and there are none: give a region")
    if hand_length is not None and not can.takes_hand_length:
        log.warning("the solver %s takes no notice of the hand's length; the solver fast does", solver)
    stop = should_stop or never
    report = progress or (lambda _: None)
    media, known = _opened(source, options)
    intrinsics = known or Intrinsics.assumed(media.width, media.height)
    recording = _recording(media, options)
    if recording is not None and recording.seen is None:
        if recording.intrinsics and options.intrinsics is None and options.lens is None:
            intrinsics = recording.intrinsics  # the hands lie where that camera has them
        numbers = [int(number) for number in recording.frame_numbers]
        posed = _chosen(options, recording.posed)
        if posed and not options.refit:
            return _posed_take(media, options, intrinsics, recording, posed)
        tracks = [*_chosen(options, tracks_of(recording, intrinsics))]
        for hand in posed:
            model, fit = load_model(options.model, hand.side), fit_of(hand)
            tracks.append(seen_of(model, fit, hand.side, intrinsics, recording.fps, hand.confidence))
    else:

        def on_frame(done: int) -> None:
            report(Progress("detect", done, max(media.expected_frames, done)))

        chunk_source = detect_chunks if parts is None else parts.of(media, options)
        with DETECTORS.blamed(options.detector):
            backend = DETECTORS.get(options.detector)
            calibrated = recording is None and backend.calibrated(settings_of(options))
        seen = (
            detect_frames(media, options, on_frame, stop, chunk_source)
            if recording is None
            else detected_in(recording)
        )
        numbers = seen.numbers
        tracks = [replace(track, calibrated=calibrated) for track in _linked(media, options, seen, stop)]
        del seen
        if known is None:
            extent = largest_extent(d for track in tracks for d in track.detections if d is not None)
            intrinsics = Intrinsics.assumed(media.width, media.height, extent)
    if stop():
        stop = _after(LAST_FITS_SECONDS) if can.slow else never

    total = sum(int(track.detected.sum()) for track in tracks)
    done = 0

    def one_more() -> None:
        nonlocal done
        done += 1
        report(Progress("fit", done, total))

    # A long clip's detections take most of the memory: they are there once, and not kept of hands that are
    # fitted.
    left, waiting = deque(tracks), deque[DetectedTrack]()
    del tracks
    while left:
        waiting.append(_side_by_side(left.popleft()))
    models = {track.side: load_model(options.model, track.side) for track in waiting}
    if hand_length is not None and can.takes_hand_length:
        # Both hands' models have one length.
        tell_of_odd_shapes(next(iter(models.values())), hand_length)
    fitted: list[HandTrack] = []
    while waiting and not (fitted and stop()):
        track = waiting.popleft()
        with SOLVERS.blamed(solver):
            fit = solve(models[track.side], track, intrinsics, one_more, stop)
            told = hand_track(models[track.side], _reached(track, fit), fit, intrinsics)
        fitted.append(
            told
            if track.landmarks is None
            else _as_detected(models[track.side], told, fit, media.fps, intrinsics)
        )
    return replace(
        _without_hands(media, options, intrinsics, numbers),
        model_digests={side: hand_model.digest for side, hand_model in models.items()},
        hands=tuple(fitted),
        program="" if recording is None else program_of(recording),
    )


def _linked(media: Media, options: CaptureOptions, seen: Detected, stop: ShouldStop) -> list[DetectedTrack]:
    """The hands that are wanted, each followed over the clip. Raises NoHandFoundError, and Cancelled where it
    was stopped before one was found."""
    hands, most = options.hands, options.most_hands(clip=media.source.kind != "photo")
    holes = sorted({*_holes(seen.numbers), *(row - 1 for row in seen.cuts)})
    try:
        tracks, count = link_and_count(
            seen.frames,
            hands,
            min(MOST_HANDS, max(most or MOST_HANDS, len(options.regions))),
            _rate(media, seen.numbers),
            tuple(holes),
            only_shown=options.only_regions,
        )
    except NoHandFoundError as error:
        if stop():
            raise Cancelled(f"{media.source.name}: stopped before a hand was found") from None
        there = any(hand.shown or not options.only_regions for hands in seen.frames for hand in hands)
        seen_none = NONE_IN_REGION if options.regions else NONE_SEEN
        raise NoHandFoundError(f"{media.source.name}: {error if there else seen_none}") from None
    if not options.only_regions:
        _tell_of_others(hands, len(tracks), count if hands in SIDES else max(count, seen.most_seen))
    if most is None and len(tracks) > CROWD and not options.only_regions:
        log.warning(
            "%d hands are captured, and building so many takes long: --max-hands %d keeps the surest",
            len(tracks),
            CROWD,
        )
    return list(tracks)


def _recording(media: Media, options: CaptureOptions) -> Recording | None:
    """What another program has found in the input, where the input is that or `keypoints` names it: hands
    that are in the wanted frames, before the camera. Raises NoHandFoundError where none is."""
    name, kept = media.source.name, isinstance(media, RecordedMedia)
    if options.keypoints is not None:
        if kept:
            raise OptionError(
                f"{name}: this input holds no pictures, so that no other keypoints belong to it; give the "
                "pictures as the input, or leave --keypoints out"
            )
        told = replace(options, picture_size=options.picture_size or (media.width, media.height))
        recording = beside(media, read_recording(options.keypoints, told))
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
    """Those of the wanted sides, as many as are wanted. Raises NoHandFoundError where none is left, and
    OptionError for more than a take holds."""
    kept = [hand for hand in hands if options.hands not in SIDES or hand.side == options.hands]
    if hands and not kept:
        raise NoHandFoundError(f"there is no {options.hands} hand in this input; take hands 'auto'")
    kept = kept[: options.max_hands]
    if len(kept) > MOST_HANDS:
        raise OptionError(
            f"there are {len(kept)} hands in this input, and a take holds at most {MOST_HANDS}: keep the "
            "first ones with --max-hands, or one person's with --person"
        )
    return list(kept)


def _as_detected(
    model: HandModel, told: HandTrack, fit: TrackFit, fps: float, intrinsics: Intrinsics
) -> HandTrack:
    """A hand that was fitted to points elsewhere on it, with those that the detector would see: with these it
    can be fitted again."""
    seen = seen_of(model, fit, told.side, intrinsics, fps, told.score)
    rows = [d if there else None for d, there in zip(seen.detections, told.detected, strict=True)]
    clean = hand_track(model, replace(seen, detections=tuple(rows)), fit, intrinsics)
    return replace(clean, reprojection_error=told.reprojection_error, overlapped=told.overlapped)


def _posed_take(
    media: Media,
    options: CaptureOptions,
    intrinsics: Intrinsics,
    recording: Recording,
    posed: Sequence[PosedHand],
) -> Take:
    """The take of hands that another program has posed."""
    digests, hands = {}, []
    for hand in posed:
        model, fit = load_model(options.model, hand.side), fit_of(hand)
        digests[hand.side] = model.digest
        track = seen_of(model, fit, hand.side, intrinsics, recording.fps, hand.confidence)
        hands.append(hand_track(model, track, fit, intrinsics))
    numbers = [int(number) for number in recording.frame_numbers]
    return replace(
        _without_hands(media, options, intrinsics, numbers),
        solver=recording.format,
        model_digests=digests,
        hands=tuple(hands),
        program=program_of(recording),
    )


def bare_take(source: MediaInput, options: CaptureOptions) -> Take:
    """A take of that source in which nobody has looked for hands: its frames, size and camera. Raises what
    `capture` raises before it looks at the pictures."""
    media, known = _opened(source, options)
    intrinsics = known or Intrinsics.assumed(media.width, media.height)
    files = [Path(file) for file in media.source.files]
    numbers = sequence_numbers(files) if media.source.kind == "sequence" else None
    wanted = options.frames if isinstance(options.frames, FrameRange) else FrameRange()
    used = numbers or wanted.within(*media.first_and_last)
    return _without_hands(media, options, intrinsics, list(used))


def _opened(source: MediaInput, options: CaptureOptions) -> tuple[Media, Intrinsics | None]:
    """The input and the camera that took it, None where nobody tells. Raises InputError and OptionError, and
    HandModelError for a model of neither side: before the long part, which a wrong path should not cost."""
    media = open_input(source, options)
    intrinsics = options.intrinsics
    if options.lens is not None:
        focal, x, y = options.lens
        intrinsics = Intrinsics(focal * media.width, focal * media.width, x * media.width, y * media.height)
    if intrinsics is not None:
        _check_camera(intrinsics, media)
    if options.model is not None:
        _check_some_side(options.model)
    known = media.recording.intrinsics if isinstance(media, RecordedMedia) else known_intrinsics(media)
    return media, intrinsics or known


def _without_hands(media: Media, options: CaptureOptions, intrinsics: Intrinsics, numbers: list[int]) -> Take:
    return Take(
        source=_read_part(media.source, len(numbers)),
        fps=media.fps,
        frame_numbers=np.array(numbers, dtype=np.int64),
        width=media.width,
        height=media.height,
        intrinsics=intrinsics,
        solver=options.solver,
        model=OPEN_HAND if options.model is None else _absolute(options.model),
        model_digests={},
        hands=(),
    )


def capture_to_file(
    source: MediaInput,
    output: str | os.PathLike[str],
    options: CaptureOptions,
    progress: ProgressCallback | None = None,
    should_stop: ShouldStop | None = None,
    *,
    compact: bool = False,
    bare: bool = False,
    parts: Parts | None = None,
) -> dict[str, Any]:
    """Capture and write the take (`compact` as in `Take.save`), or `bare_take`'s; what is to be told of it,
    fit for JSON.

    Raises what `capture` raises, and OutputError: before the capture, if it can be known then.
    """
    check_writable(output, _named(source, options, () if parts is None else parts.files))
    started = time.perf_counter()
    take = bare_take(source, options) if bare else capture_with(source, options, progress, should_stop, parts)
    path = take.save(output, compact=compact)
    return {
        "output": str(path),
        "frames": len(take.frame_numbers),
        "seconds": round(time.perf_counter() - started, 3),
        "hands": hand_summaries(take),
    }


def _named(
    source: MediaInput, options: CaptureOptions, others: Sequence[str | os.PathLike[str]] = ()
) -> list[str | os.PathLike[str]]:
    """The files that a capture is told to read, before which are videos and which patterns is known."""
    given = [source] if isinstance(source, str | os.PathLike) else list(source)
    return [*given, *others, *(each for each in (options.keypoints, options.model) if each)]


def detect_to_file(
    source: MediaInput,
    output: str | os.PathLike[str],
    options: CaptureOptions,
    part: FrameRange | None = None,
    progress: ProgressCallback | None = None,
    should_stop: ShouldStop | None = None,
) -> dict[str, Any]:
    """Find the hands in a part of a clip and write it for `Parts`; what is to be told of it, fit for JSON.

    `part` is a range of frame numbers, of which each chunk belongs to the part in which its first frame lies
    (None: all), and `options` those of the capture of the whole clip, its `frames` included.

    Raises what `capture` raises before it fits, but for NoHandFoundError, and OutputError.
    """
    check_writable(output, _named(source, options))
    started = time.perf_counter()
    media = open_media(source, options.frames, max_megapixels=options.max_megapixels)
    rows = chunks_in(media, part)
    expected = expected_frames(media, rows)
    report = progress or (lambda _: None)

    def on_frame(done: int) -> None:
        report(Progress("detect", done, max(expected, done)))

    found = detect_part(media, options, rows, on_frame, should_stop or never)
    path = Part.found(media, options, rows, found).save(output)
    numbers = [number for chunk in found for number in chunk.numbers]
    if not numbers:
        log.warning(
            "no stretch of %d frames begins in frames %s: this part is empty", CHUNK_FRAMES, part or "-"
        )
    return {
        "output": str(path),
        "frames": len(numbers),
        "first": numbers[0] if numbers else None,
        "last": numbers[-1] if numbers else None,
        "seconds": round(time.perf_counter() - started, 3),
    }


def _side_by_side(track: DetectedTrack) -> DetectedTrack:
    return replace(track, detections=SideBySide(track.detections))


def _tell_of_others(hands: HandChoice, captured: int, seen: int) -> None:
    """Warn where there were more hands than are captured."""
    if seen <= captured:
        return
    named = f"{seen} {hands} hands" if hands in SIDES else f"{seen} hands"
    kept = "the surest was" if captured == 1 else f"the {captured} surest were"
    others = "draw boxes around others (--region, or Find Hands in Blender), or allow more (--max-hands)"
    advice = others if hands == "auto" else "take hands 'auto' to capture others"
    log.warning("%s were seen, and %s captured: %s", named, kept, advice)


def _after(seconds: float) -> ShouldStop:
    end = time.monotonic() + seconds
    return lambda: time.monotonic() > end


def _reached(track: DetectedTrack, fit: TrackFit) -> DetectedTrack:
    """The track without the detections that a stopped solver did not come to."""
    if fit.present[track.detected].all():
        return track
    kept = [d if there else None for d, there in zip(track.detections, fit.present, strict=True)]
    return replace(track, detections=tuple(kept))


def _read_part(source: Source, count: int) -> Source:
    """A sequence's source has the pictures that were read, and no more."""
    return replace(source, files=source.files[:count]) if source.kind == "sequence" else source


def _rate(media: Media, numbers: list[int]) -> float:
    """Used frames per second: of a source of which every fourth frame is used, a quarter of its own."""
    return media.fps / float(np.median(np.diff(numbers))) if len(numbers) > 1 else media.fps


def _holes(numbers: list[int]) -> tuple[int, ...]:
    """Rows of used frames after which the source lacks some."""
    steps = np.diff(numbers)
    return tuple(np.flatnonzero(steps > np.median(steps)).tolist()) if len(steps) else ()


def hand_track(model: HandModel, track: DetectedTrack, fit: TrackFit, intrinsics: Intrinsics) -> HandTrack:
    """What a take keeps of one fitted track: the parameters and what follows from them."""
    # A hand of hours has its arrays once here, and no list of its detections.
    count, seen, present = len(track.detections), track.detected, fit.present
    points, world, second, joints_3d = (np.full((count, NUM_KEYPOINTS, 3), np.nan) for _ in range(4))
    score, right_side = np.full(count, np.nan), np.full(count, np.nan)
    other_side, overlapped = np.zeros(count, dtype=bool), np.zeros((count, NUM_KEYPOINTS), dtype=bool)
    for row in np.flatnonzero(seen).tolist():
        d = track.detections[row]
        assert d is not None
        points[row], world[row], score[row], other_side[row] = (
            d.keypoints,
            d.world,
            d.score,
            d.side != track.side,
        )
        if d.keypoints_2020 is not None:
            second[row] = d.keypoints_2020
        if d.right_side is not None:
            right_side[row] = d.right_side
        if d.overlapped is not None:
            overlapped[row] = d.overlapped
    expected = fit.expected_error
    if expected is None and not track.calibrated:
        expected = np.full((count, len(FINGERS)), np.nan)
    keypoints_2d = points[..., :2]
    there, error = np.flatnonzero(present), np.full(count, np.nan)
    for rows in (there[part] for part in slices(len(there))):
        posed = fit.global_orient[rows], fit.hand_pose[rows], fit.transl[rows]
        joints_3d[rows] = model.keypoints(fit.betas, *posed)
        distance = np.linalg.norm(intrinsics.project(joints_3d[rows]) - keypoints_2d[rows], axis=-1)
        error[rows] = distance.mean(axis=-1)
    return HandTrack(
        side=track.side,
        betas=fit.betas,
        global_orient=fit.global_orient,
        hand_pose=fit.hand_pose,
        transl=fit.transl,
        joints_3d=joints_3d,
        keypoints_2d=keypoints_2d,
        reprojection_error=error,
        detected=seen,
        score=score,
        filled=present & ~seen,
        doubtful=fit.doubtful,
        expected_error=expected,
        keypoints_depth=points[..., 2],
        world_landmarks=world,
        keypoints_2020=second if np.isfinite(second).any() else None,
        right_side=right_side,
        other_side=other_side,
        overlapped=overlapped if overlapped.any() else None,
    )


def hand_summaries(take: Take) -> list[dict[str, Any]]:
    """What is to be told of each hand: side, frames found, filled and doubtful, mean error in pixels and as a
    share of the hand's length, and the one that is expected, metres (None where they have no value), and
    whether anybody can tell that one."""
    return [
        {
            "side": track.side,
            "frames": int(track.detected.sum()),
            "filled": 0 if track.filled is None else int(track.filled.sum()),
            "doubtful": 0 if track.doubtful is None else int(track.doubtful.sum()),
            "mean_reprojection_error_px": _mean(track.reprojection_error[track.detected]),
            "mean_error_of_hand": mean_relative_error(track, take.intrinsics),
            "mean_expected_error": mean_expected_error(track),
            "error_known": error_is_known(track),
        }
        for track in take.hands
    ]


def _mean(values: np.ndarray) -> float | None:
    """What JSON can hold, too."""
    with np.errstate(over="ignore"):
        mean = float(values.mean()) if len(values) else np.nan
    return mean if np.isfinite(mean) else None


def _check_camera(intrinsics: Intrinsics, media: Media) -> None:
    """Raise OptionError for a camera that cannot have taken those pictures."""
    longer = max(media.width, media.height)
    low, high = NEAREST_FOCAL * longer, FARTHEST_FOCAL * longer
    if not all(low <= focal <= high for focal in (intrinsics.fx, intrinsics.fy)):
        raise OptionError(
            f"the camera's focal length must lie between {low:g} and {high:g} pixels for a picture of "
            f"{media.width}x{media.height}; got fx={intrinsics.fx:g}, fy={intrinsics.fy:g}"
        )


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


def _absolute(model: str | os.PathLike[str]) -> str:
    text = os.fspath(model)
    return text if text == OPEN_HAND else str(Path(text).expanduser().resolve())
