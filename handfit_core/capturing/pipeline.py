"""The whole path from pictures to a take, as one readable page."""

from __future__ import annotations

import logging
import os
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import count
from pathlib import Path
from typing import Any, Literal

import numpy as np

from handfit_core.capturing.fitting import fit_hands
from handfit_core.capturing.options import VIEW_OPTIONS, CaptureOptions
from handfit_core.capturing.sources import open_source, opened
from handfit_core.capturing.views.joining import alone, joined
from handfit_core.capturing.views.readings import ViewTake
from handfit_core.capturing.views.rig_file import Rig, read_rig, write_rig
from handfit_core.common.errors import Cancelled, HandfitError, NoHandFoundError, OptionError
from handfit_core.common.files import check_writable, shown
from handfit_core.detect.body import BodyTrack
from handfit_core.detect.detector import DETECTORS
from handfit_core.detect.landmark_model import body_model_path
from handfit_core.fit.solvers import SOLVERS, ShouldStop, get_solver, never
from handfit_core.geometry.camera import Intrinsics
from handfit_core.hand_model import OPEN_HAND
from handfit_core.interchange.readers import program_of
from handfit_core.media.copies import write_copy
from handfit_core.media.frame_range import FrameRange
from handfit_core.media.opening import MediaInput, sequence_numbers
from handfit_core.media.source import Media
from handfit_core.take import HandTrack, Take
from handfit_core.take.fit_quality import (
    error_is_known,
    finite_mean,
    mean_expected_error,
    mean_relative_error,
)

log = logging.getLogger("handfit")

Stage = Literal["detect", "fit", "arms", "join", "score", "lens"]
"""Step of a capture or of related work: `join` is of two views, `score` of evaluations, and `lens` of a lens
that is measured"""


@dataclass(frozen=True)
class Progress:
    """How far a capture has come."""

    stage: Stage
    done: int
    """Number of frames done in this stage, over all hands; in `join`, of steps"""
    total: int
    """Number of frames or steps of the whole stage; 0 where nobody knows"""
    view: int = 0
    """Number of the view, 0 or 1, that `detect` and `fit` work on"""


ProgressCallback = Callable[[Progress], None]


def capture(
    source: MediaInput,
    options: CaptureOptions | None = None,
    progress: ProgressCallback | None = None,
    should_stop: ShouldStop | None = None,
    **given: Any,
) -> Take:
    """Find the hands in a photo, image sequence or video and fit a hand model to each.

    source
        A photo; a folder or list of photos; a `name.%04d.png`, `name.####.png` or glob pattern; a video; or a
        file or folder with hands or keypoints of another program (docs/interchange.md).
    options
        A `CaptureOptions`, or its fields by their names, as in `capture("clip.mp4", quality="draft")`.
        `handfit_core.capturing.options.OPTIONS` has the range and the help of each; lengths are in metres
        here. `model` is the open hand's where None, `intrinsics` what the file tells about its lens, or else
        a view of 53 degrees.
    progress
        Called with a `Progress` after every frame; an exception raised there ends the capture.
    should_stop
        Asked between frames; once it says True, it must go on saying so. Then what was finished is kept: the
        frames seen so far, or all frames with those hands that were fitted; the others count as not detected.

    Raises a `HandfitError` whose message is meant for the user: OptionError, InputError, NoHandFoundError,
    HandModelError, LandmarkModelError; Cancelled when it was stopped before a hand was found. Raises
    TypeError for an option that does not exist, and for both `options` and names.
    """
    if options is None:
        options = CaptureOptions(**given)
    elif given or not isinstance(options, CaptureOptions):
        raise TypeError("give either a CaptureOptions, or options by their names, as in hands='left'")
    stop, report = should_stop or never, progress or (lambda _: None)
    check_options(options)
    import scipy.linalg  # noqa: F401  Only a BLAS that is loaded already can be limited.
    from threadpoolctl import threadpool_limits

    # More threads only wait for each other where matrices are as small as a hand's.
    with threadpool_limits(1, user_api="blas"):
        if options.view is not None:
            return _capture_both(source, options, report, stop)
        return _captured(source, options, report, stop).take


def _captured(
    source: MediaInput, options: CaptureOptions, report: ProgressCallback, stop: ShouldStop
) -> ViewTake:
    """Capture one view."""
    origin = open_source(source, options)
    media, recording = origin.media, origin.recording
    found = origin.find(lambda done: report(Progress("detect", done, max(media.expected_frames, done))), stop)
    bodies: tuple[BodyTrack, ...] = ()
    if options.arms and not stop():
        from handfit_core.capturing.arms import with_bodies  # which a capture without arms does not load

        total = len(found.numbers)
        found, bodies = with_bodies(
            found, media, options, lambda done: report(Progress("arms", done, total)), stop
        )
    hands, digests = fit_hands(
        found, options, media.fps, lambda done, total: report(Progress("fit", done, total)), stop
    )
    take = _without_hands(media, options, found.intrinsics, found.numbers)
    if recording is not None:
        take = replace(take, program=program_of(recording))
        if found.fits is not None:
            take = replace(take, solver=recording.format)
    take = replace(take, hands=hands, model_digests=digests)
    if options.arms and not stop():
        from handfit_core.capturing.arms import with_arms

        take = with_arms(take, bodies)
    return ViewTake(take, lens_known=origin.known is not None)


def _capture_both(
    source: MediaInput, options: CaptureOptions, report: ProgressCallback, stop: ShouldStop
) -> Take:
    """Capture two views of the same hands, one after the other, and join them to one take."""
    assert options.view is not None
    _check_views(source, options.view)
    if options.solver != CaptureOptions.solver:
        raise OptionError(f"two views are fitted by the solver {CaptureOptions.solver}, not {options.solver}")
    first = replace(options, **dict.fromkeys(VIEW_OPTIONS), arms=False)
    # What is told of the first clip's pictures does not hold for the second one's.
    second = replace(
        first, frames=None, regions=(), only_regions=False, intrinsics=None, lens=options.view_lens
    )
    rig = None
    media = [opened(given, each)[0] for given, each in ((source, first), (options.view, second))]
    if options.cameras is not None:
        names, sizes = [clip.source.name for clip in media], [(clip.width, clip.height) for clip in media]
        rig = read_rig(options.cameras, names, sizes)
        first = replace(first, intrinsics=None, lens=rig.lenses[0])
        second = replace(second, lens=rig.lenses[1])
    views: list[ViewTake | None] = []
    missing: list[HandfitError] = []
    for view, (given, each) in enumerate(((source, first), (options.view, second))):
        try:
            views.append(_captured(given, each, partial(_report_of, report, view), stop))
        except (NoHandFoundError, Cancelled) as error:
            missing.append(error)
            views.append(None)
    take = _joined(views, missing, options, rig, report, stop)
    if options.arms and not stop():
        take = add_arms(take, report, stop, max_megapixels=options.max_megapixels)
    return take


def _report_of(report: ProgressCallback, view: int, progress: Progress) -> None:
    report(replace(progress, view=view))


def _joined(
    views: Sequence[ViewTake | None],
    missing: Sequence[HandfitError],
    options: CaptureOptions,
    rig: Rig | None,
    report: ProgressCallback,
    stop: ShouldStop,
) -> Take:
    """Join both views to one take; return the take of one view where the other has no hand or it is to
    stop."""
    steps = count(1)

    def on_step() -> None:
        if stop():
            raise Cancelled("stopped before both views were joined")
        report(Progress("join", next(steps), 0))

    first, second = views
    takes = [None if view is None else view.take for view in views]
    stopped = "The capture was stopped before both views were joined"
    if first is None or second is None:
        if first is second:
            raise missing[0]
        number = 0 if second is None else 1
        none = f"No hand was found in the {('second', 'first')[number]} view"
        return alone(takes, number, stopped if stop() else none)
    try:
        return joined(first, second, options, rig, on_step)
    except Cancelled:
        return alone(takes, 0, stopped)


def _check_views(first: MediaInput, second: str) -> None:
    """Raise OptionError where both views are the same file."""
    given = [first] if isinstance(first, str | os.PathLike) else list(first)
    if any(Path(each).expanduser().resolve() == Path(second).expanduser().resolve() for each in given):
        raise OptionError(
            f"{shown(second)} is given as both views: give the clip of another camera that filmed the same "
            "hands"
        )


def add_arms(
    take: Take,
    progress: ProgressCallback | None = None,
    should_stop: ShouldStop | None = None,
    *,
    max_megapixels: float | None = None,
) -> Take:
    """Return the take with the arms of its hands, or with a sentence why there are none; arms that it had are
    found anew, and its hands stay as they are.

    Its pictures are read once more, from where the take says they are. `progress` and `should_stop` are as in
    `capture`, `max_megapixels` as in `open_media`. Raises InputError where the pictures are gone or others,
    or where the take never had any, LandmarkModelError, and Cancelled.
    """
    # A capture without arms does not load these.
    from handfit_core.capturing.arms import reopened, with_arms
    from handfit_core.detect.bodies import find_bodies

    stop, report = should_stop or never, progress or (lambda _: None)
    media, total = reopened(take, max_megapixels), len(take.frame_numbers)
    bodies = find_bodies(
        media,
        take.frame_numbers.tolist(),
        [hand.keypoints_2d for hand in take.hands],
        take.lens or take.intrinsics,
        None,
        lambda done: report(Progress("arms", done, total)),
        stop,
    )
    if stop():
        raise Cancelled("stopped before the arms were found")
    return with_arms(take, bodies)


def check_options(options: CaptureOptions) -> None:
    """Raise OptionError for options that no input can be captured with, before one is read."""
    get_solver(options.solver, options.smoothing, options.hand_length)
    DETECTORS.get(options.detector)
    if options.arms:
        body_model_path()
    if options.only_regions and not options.regions:
        raise OptionError("only the hands of regions are to be kept, and there are none: give a region")
    if options.hand_length is not None and not SOLVERS.get(options.solver).takes_hand_length:
        log.warning(
            "the solver %s takes no notice of the hand's length; the solver fast does", options.solver
        )


def bare_take(source: MediaInput, options: CaptureOptions) -> Take:
    """Return a take of that source in which no hands were detected: its frames, size and camera. Raises what
    `capture` raises before it detects any."""
    media, known = opened(source, options)
    intrinsics = known or Intrinsics.assumed(media.width, media.height)
    files = [Path(file) for file in media.source.files]
    numbers = sequence_numbers(files) if media.source.kind == "sequence" else None
    wanted = options.frames if isinstance(options.frames, FrameRange) else FrameRange()
    used = numbers or wanted.within(*media.first_and_last)
    return _without_hands(media, options, intrinsics, list(used))


def _without_hands(media: Media, options: CaptureOptions, intrinsics: Intrinsics, numbers: list[int]) -> Take:
    lens, source = options.measured_lens(media.width, media.height), media.source
    if source.kind == "sequence":  # a take has the pictures that were read, and no more
        source = replace(source, files=source.files[: len(numbers)])
    model = options.model or OPEN_HAND
    return Take(
        source=source,
        fps=media.fps,
        frame_numbers=np.array(numbers, dtype=np.int64),
        width=media.width,
        height=media.height,
        intrinsics=intrinsics,
        solver=options.solver,
        model=model if model == OPEN_HAND else str(Path(model).expanduser().resolve()),
        model_digests={},
        hands=(),
        distortion=None if lens is None else lens.distortion,
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
    cameras_to: str | os.PathLike[str] | None = None,
) -> dict[str, Any]:
    """Capture, and write the take (`compact` as in `Take.save`), or the take of `bare_take`; return a report
    of it, fit for JSON. `cameras_to`: the file to which the cameras of two views are written, too.

    Raises what `capture` raises, and OutputError: before the capture, if it can be known then.
    """
    check_writable(output, _named(source, options))
    started = time.perf_counter()
    take = bare_take(source, options) if bare else capture(source, options, progress, should_stop)
    write_copies(take, options.max_megapixels)
    report = _saved(take, output, compact, started)
    if cameras_to is not None and take.cameras is not None:
        write_rig(cameras_to, take)
    elif cameras_to is not None:
        log.warning("%s was not written: the cameras were not found", shown(cameras_to))
    return report


def write_copies(take: Take, max_megapixels: float | None = None) -> None:
    """Write copies of those pictures of a take's views that Blender cannot read."""
    for view in (take, *(take.cameras.views if take.cameras is not None else ())):
        write_copy(view.source, max_megapixels)


def add_arms_to_file(
    path: str | os.PathLike[str],
    output: str | os.PathLike[str] | None = None,
    progress: ProgressCallback | None = None,
    should_stop: ShouldStop | None = None,
    *,
    max_megapixels: float | None = None,
    compact: bool = False,
) -> dict[str, Any]:
    """Add arms to the take at `path` and write it to `output`, None: over itself; returns a report as
    `capture_to_file`. Raises TakeError, what `add_arms` raises, and OutputError."""
    started = time.perf_counter()
    take = Take.load(path)
    output = path if output is None else output
    check_writable(output, take.source.files)
    take = add_arms(take, progress, should_stop, max_megapixels=max_megapixels)
    return _saved(take, output, compact, started)


def _saved(take: Take, output: str | os.PathLike[str], compact: bool, started: float) -> dict[str, Any]:
    """Write a take; return the report of it. `started` is the time of `perf_counter`, in seconds, at which
    work on it began."""
    told = {} if take.verdict is None else {"views": vars(take.verdict)}
    return {
        "output": str(take.save(output, compact=compact)),
        "frames": len(take.frame_numbers),
        "seconds": round(time.perf_counter() - started, 3),
        "hands": hand_summaries(take),
        **told,
    }


def _named(source: MediaInput, options: CaptureOptions) -> list[str | os.PathLike[str]]:
    """Return the files that a capture reads, before it is known which are videos and which patterns."""
    given = [source] if isinstance(source, str | os.PathLike) else list(source)
    named = (options.keypoints, options.model, options.view, options.cameras)
    return [*given, *(each for each in named if each)]


def hand_summaries(take: Take) -> list[dict[str, Any]]:
    """The report of each hand: side, frames found, filled and doubtful, mean error in pixels and as a
    share of the hand's length, and the one that is expected, metres (None where they have no value), whether
    anybody can tell that one, and, where an arm was looked for, in how many frames it is and why it is in
    none."""
    return [
        {
            "side": track.side,
            "frames": int(track.detected.sum()),
            "filled": 0 if track.filled is None else int(track.filled.sum()),
            "doubtful": 0 if track.doubtful is None else int(track.doubtful.sum()),
            "mean_reprojection_error_px": finite_mean(track.reprojection_error[track.detected]),
            "mean_error_of_hand": mean_relative_error(track, take.intrinsics),
            "mean_expected_error": mean_expected_error(track),
            "error_known": error_is_known(track),
            **_arm_summary(track),
        }
        for track in take.hands
    ]


def _arm_summary(track: HandTrack) -> dict[str, Any]:
    if track.arm is None and not track.no_arm:
        return {}
    return {"arm": 0 if track.arm is None else int(track.arm.present.sum()), "no_arm": track.no_arm}
