"""From the tracks of hands to what a take keeps of each: the fitted model, and how well it fits."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from typing import Final

import numpy as np

from handfit_core.capturing.options import CaptureOptions
from handfit_core.capturing.sources import Found
from handfit_core.common.batch import slices
from handfit_core.common.skeleton import FINGERS, NUM_KEYPOINTS
from handfit_core.detect.keypoints import Track
from handfit_core.fit.solvers import SOLVERS, ShouldStop, get_solver, never
from handfit_core.geometry.camera import Intrinsics
from handfit_core.hand_model import HandModel, load_model
from handfit_core.hand_model.length import warn_of_odd_shapes
from handfit_core.hand_model.motion import HandMotion
from handfit_core.interchange.taking import seen_of
from handfit_core.take import HandTrack
from handfit_core.take.found import FoundRows

LAST_FITS_SECONDS: Final = 0.3
"""Seconds that slow solvers get for the hands that were found when detection was stopped. Other solvers get
the time that they need, since that is a small part of what detecting took."""


def fit_hands(
    found: Found,
    options: CaptureOptions,
    fps: float,
    on_frame: Callable[[int, int], None],
    should_stop: ShouldStop,
) -> tuple[tuple[HandTrack, ...], dict[str, str]]:
    """Fit the hands of a source; return them as a take has them, and the digests of their models by side.

    `on_frame` gets the counts of fitted frames and of all. Once it is to stop, the hands that were fitted are
    kept, at least one.
    """
    solver = SOLVERS.get(options.solver)
    solve = get_solver(options.solver, options.smoothing, options.hand_length)
    if should_stop():
        should_stop = _after(LAST_FITS_SECONDS) if solver.slow else never
    total = sum(int(track.detected.sum()) for track in found.tracks)
    done = 0

    def one_more() -> None:
        nonlocal done
        done += 1
        on_frame(done, total)

    # A long clip's detections take most of the memory: they are not kept of hands that are fitted.
    waiting = found.tracks
    models = {each.side: load_model(options.model, each.side) for each in waiting}
    digests = {side: model.digest for side, model in models.items()}
    if found.fits is not None:
        pairs = zip(waiting, found.fits, strict=True)
        return tuple(hand_track(models[t.side], t, fit, found.intrinsics) for t, fit in pairs), digests
    if options.hand_length is not None and solver.takes_hand_length:
        # Both hands' models have one length.
        warn_of_odd_shapes(next(iter(models.values())), options.hand_length)
    fitted: list[HandTrack] = []
    while waiting and not (fitted and should_stop()):
        track = waiting.pop(0)
        model = models[track.side]
        with SOLVERS.blamed(options.solver):
            fit = solve(model, track, found.intrinsics, one_more, should_stop)
            if (np.isfinite(fit.transl).all(axis=1) != fit.present).any():
                raise ValueError("a frame's global_orient, hand_pose and transl must be finite together")
            hand = hand_track(model, _where(track, fit.present), fit, found.intrinsics)
        fitted.append(
            hand if track.landmarks is None else _as_detected(model, hand, fit, fps, found.intrinsics)
        )
    return tuple(fitted), digests


def _after(seconds: float) -> ShouldStop:
    end = time.monotonic() + seconds
    return lambda: time.monotonic() > end


def _where(track: Track, frames: np.ndarray) -> Track:
    """Return the track without the detections in other frames than `frames` (T,) bool, as one that a stopped
    solver did not come to the end of."""
    kept = frames[track.detections.frame]
    return track if kept.all() else replace(track, detections=track.detections.select(kept))


def _as_detected(
    model: HandModel, told: HandTrack, fit: HandMotion, fps: float, intrinsics: Intrinsics
) -> HandTrack:
    """Return a hand that was fitted to points elsewhere on it with the points that the detector would see: to
    these it can be fitted again."""
    seen = seen_of(model, fit, intrinsics, fps, told.score)
    clean = hand_track(model, _where(seen, told.detected), fit, intrinsics)
    rows = replace(clean.rows, overlapped=told.rows.overlapped)
    return replace(clean, reprojection_error=told.reprojection_error, detections=rows.detections(clean.side))


def hand_track(model: HandModel, track: Track, fit: HandMotion, intrinsics: Intrinsics) -> HandTrack:
    """Return what a take keeps of one fitted track: the parameters and what follows from them."""
    count, present = track.frame_count, fit.present
    found = FoundRows.of(track.detections, track.side, count)
    if fit.expected_error is None and not track.calibrated:
        fit = replace(fit, expected_error=np.full((count, len(FINGERS)), np.nan))
    there, error = np.flatnonzero(present), np.full(count, np.nan)
    joints_3d = np.full((count, NUM_KEYPOINTS, 3), np.nan)
    for rows in (there[part] for part in slices(len(there))):
        joints_3d[rows] = model.keypoints(fit.betas, *(each[rows] for each in fit.pose))
        distance = np.linalg.norm(intrinsics.project(joints_3d[rows]) - found.keypoints_2d[rows], axis=-1)
        error[rows] = distance.mean(axis=-1)
    return HandTrack(
        **vars(fit),
        joints_3d=joints_3d,
        reprojection_error=error,
        detections=found.detections(track.side),
        filled=present & ~found.detected,
    )
