"""The whole path from pictures to a take, as one readable function."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from handfit_core.camera import Intrinsics
from handfit_core.detect.tracks import HAND_CHOICES, HandChoice, link_tracks
from handfit_core.errors import HandModelError, InputError, NoHandFoundError, OptionError
from handfit_core.frame_range import FrameRange
from handfit_core.hand_model import OPEN_HAND, HandModel, load_model
from handfit_core.keypoints import DetectedTrack, HandDetection
from handfit_core.lens import known_intrinsics
from handfit_core.media import Media, MediaInput, open_media
from handfit_core.read_ahead import read_ahead
from handfit_core.skeleton import NUM_KEYPOINTS, SIDES
from handfit_core.solvers import DEFAULT_SMOOTHING, DEFAULT_SOLVER, TrackFit, get_solver
from handfit_core.take import HandTrack, Take

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


def capture(
    source: MediaInput,
    hands: HandChoice = "auto",
    model: str | os.PathLike[str] | None = None,
    solver: str = DEFAULT_SOLVER,
    progress: ProgressCallback | None = None,
    *,
    frames: FrameRange | None = None,
    intrinsics: Intrinsics | None = None,
    max_hands: int = 2,
    threshold: float = 0.5,
    landmark_model: str | os.PathLike[str] | None = None,
    smoothing: float = DEFAULT_SMOOTHING,
    persistent: bool = True,
) -> Take:
    """Find the hands in a photo, image sequence or video and fit a hand model to each.

    source
        A photo; a folder or list of photos; a `name.%04d.png`, `name.####.png` or glob pattern; a video.
    hands
        "auto": whatever is seen; "left" or "right": that one only; "both": one of each.
    model
        None for the open hand; or the path of a MANO file, or of a folder that holds both sides.
    solver
        One of `handfit_core.solvers.solver_names()`.
    progress
        Called with a `Progress` after every frame; an exception raised there ends the capture.
    frames
        Which source frames to use; all by default.
    intrinsics
        The camera in pixels of the upright picture; by default what the file tells about its lens, or else
        one with a 53 degree view.
    threshold
        The detector's confidence threshold, 0..1.
    smoothing
        How smooth motion is, for the solvers that smooth: 0 takes every frame by itself, 1 is the
        default, up to `solvers.MOST_SMOOTHING`.
    persistent
        Look again where the detector finds too little.

    Raises a `HandfitError` whose message is meant for the user: OptionError, InputError,
    NoHandFoundError, HandModelError, LandmarkModelError.
    """
    if hands not in HAND_CHOICES:
        raise OptionError(f"hands must be one of {', '.join(HAND_CHOICES)}; got {hands!r}")
    if max_hands < 1:
        raise OptionError(f"max_hands must be at least 1, not {max_hands}")
    solve = get_solver(solver, smoothing)
    report = progress or (lambda _: None)
    media = open_media(source, frames)
    if model is not None:
        _check_some_side(model)  # before the long part: a wrong path should not cost a detection run

    numbers, found = detect_frames(
        media,
        report,
        max_hands=max(max_hands, 2),
        threshold=threshold,
        landmark_model=landmark_model,
        persistent=persistent,
    )
    if intrinsics is None:
        intrinsics = known_intrinsics(media) or Intrinsics.assumed(media.width, media.height)
    try:
        tracks = link_tracks(found, hands, max_hands, _rate(media, numbers), _holes(numbers))
    except NoHandFoundError as error:
        raise NoHandFoundError(f"{media.source.name}: {error}") from None

    total = sum(int(track.detected.sum()) for track in tracks)
    done = 0

    def one_more() -> None:
        nonlocal done
        done += 1
        report(Progress("fit", done, total))

    models = {track.side: load_model(model, track.side) for track in tracks}
    fitted: list[HandTrack] = []
    for track in tracks:
        fit = solve(models[track.side], track, intrinsics, one_more)
        fitted.append(hand_track(models[track.side], track, fit, intrinsics))
    return Take(
        source=media.source,
        fps=media.fps,
        frame_numbers=np.array(numbers, dtype=np.int64),
        width=media.width,
        height=media.height,
        intrinsics=intrinsics,
        solver=solver,
        model=OPEN_HAND if model is None else _absolute(model),
        model_digests={side: hand_model.digest for side, hand_model in models.items()},
        hands=tuple(fitted),
    )


def detect_frames(
    media: Media,
    report: ProgressCallback,
    *,
    max_hands: int,
    threshold: float,
    landmark_model: str | os.PathLike[str] | None,
    persistent: bool = True,
) -> tuple[list[int], list[tuple[HandDetection, ...]]]:
    """Frame numbers and the hands found in each frame; an unreadable frame has none.

    `persistent`: look again where the plain detector finds too little (see `HandFinder`).
    """
    from handfit_core.detect.finder import HandFinder

    numbers: list[int] = []
    found: list[tuple[HandDetection, ...]] = []
    with HandFinder(
        max_hands=max_hands,
        video=media.source.kind != "photo",
        threshold=threshold,
        landmark_model=landmark_model,
        persistent=persistent,
    ) as finder:
        with contextlib.closing(read_ahead(media.frames())) as frames:
            for frame in frames:
                numbers.append(frame.number)
                found.append(finder.find(frame.rgb, frame.time))
                report(Progress("detect", len(numbers), max(media.expected_frames, len(numbers))))
        found = finder.completed(found)
    if not numbers:
        raise InputError(f"{media.source.files[0]}: no frame could be read from it")
    return numbers, found


def _rate(media: Media, numbers: list[int]) -> float:
    """Used frames per second: of a source of which every fourth frame is used, a quarter of its own."""
    return media.fps / float(np.median(np.diff(numbers))) if len(numbers) > 1 else media.fps


def _holes(numbers: list[int]) -> tuple[int, ...]:
    """Rows of used frames after which the source lacks some."""
    steps = np.diff(numbers)
    return tuple(np.flatnonzero(steps > np.median(steps)).tolist()) if len(steps) else ()


def hand_track(model: HandModel, track: DetectedTrack, fit: TrackFit, intrinsics: Intrinsics) -> HandTrack:
    """What a take keeps of one fitted track: the parameters and what follows from them."""
    count = len(track.detections)
    keypoints_2d = np.full((count, NUM_KEYPOINTS, 2), np.nan)
    score = np.full(count, np.nan)
    for i, detection in enumerate(track.detections):
        if detection is not None:
            keypoints_2d[i] = detection.keypoints_2d
            score[i] = detection.score
    joints_3d = np.full((count, NUM_KEYPOINTS, 3), np.nan)
    present = fit.present
    joints_3d[present] = model.keypoints(
        fit.betas, fit.global_orient[present], fit.hand_pose[present], fit.transl[present]
    )
    distance = np.linalg.norm(intrinsics.project(joints_3d) - keypoints_2d, axis=-1)
    seen = track.detected
    return HandTrack(
        side=track.side,
        betas=fit.betas,
        global_orient=fit.global_orient,
        hand_pose=fit.hand_pose,
        transl=fit.transl,
        joints_3d=joints_3d,
        keypoints_2d=keypoints_2d,
        reprojection_error=distance.mean(axis=-1),
        detected=seen,
        score=score,
        filled=present & ~seen,
        doubtful=fit.doubtful,
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
