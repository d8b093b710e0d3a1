"""What is timed: solvers against each other on the same detections, and the pipeline against detection."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from handfit_core.detect.keypoints import DetectedTrack, HandDetection
from handfit_core.detect.tracks import link_tracks
from handfit_core.fit.fast import fit_frames
from handfit_core.geometry.camera import Intrinsics
from handfit_core.hand_model import HandModel, load_model
from handfit_core.media.frame_range import FrameRange
from handfit_core.media.opening import open_media
from handfit_core.options import CaptureOptions
from handfit_core.pipeline import capture, detect_frames
from handfit_core.solvers import get_solver
from scripts.speed.interleaved import Contender, Timing, interleaved

_CALLS = 20
"""One frame alone is over in milliseconds: so many calls a round, and fewer for batches"""


@dataclass(frozen=True, eq=False)
class Hand:
    """The hand that is seen in most frames of an input, and what is needed to fit it."""

    model: HandModel
    detections: tuple[HandDetection, ...]
    intrinsics: Intrinsics
    fps: float

    def batch(self, size: int) -> list[HandDetection]:
        """`size` detections: those that there are, again and again."""
        return [self.detections[i % len(self.detections)] for i in range(size)]

    def single(self, index: int) -> DetectedTrack:
        """One frame as a track of its own, as a photo gives."""
        return DetectedTrack(self.model.side, (self.detections[index],), self.fps)

    def fast_quality(self) -> tuple[float, float]:
        """Shares of the fast solver's fits that converged and that it doubts, over all detections."""
        fits = fit_frames(self.model, self.detections, self.intrinsics)
        return float(fits.solution.converged.mean()), float(fits.doubtful.mean())


def find_hand(source: str, frames: FrameRange | None = None, model: str | None = None) -> Hand:
    """Detect an input's hands and keep the one seen most. Raises HandfitError."""
    media = open_media(source, frames)
    _, found, _ = detect_frames(media, CaptureOptions())
    track = max(link_tracks(found), key=lambda t: int(t.detected.sum()))
    return Hand(
        model=load_model(model, track.side),
        detections=tuple(d for d in track.detections if d is not None),
        intrinsics=Intrinsics.assumed(media.width, media.height),
        fps=media.fps,
    )


def time_solvers(
    hand: Hand,
    slow: Sequence[str],
    batches: Sequence[int],
    rounds: int,
    on_round: Callable[[int], None] = lambda _: None,
) -> list[Timing]:
    """Time the fast solver alone and in batches, and `slow` solvers by name, in turn.

    In one round all that take one frame take the same, and rounds take frames evenly spread over the
    clip. Batches are of independent frames, each with its own shape. Raises OptionError for a solver that
    does not exist.
    """
    frames = np.linspace(0, len(hand.detections) - 1, rounds).round().astype(int)

    def alone(solver: str) -> Callable[[int], object]:
        solve = get_solver(solver)
        return lambda number: solve(hand.model, hand.single(frames[number]), hand.intrinsics, lambda: None)

    def batch(size: int) -> Callable[[int], object]:
        detections = hand.batch(size)
        return lambda _: fit_frames(hand.model, detections, hand.intrinsics)

    contenders = [
        *(Contender(name, alone(name)) for name in slow),
        Contender("fast, one frame", alone("fast"), calls=_CALLS),
        *(Contender(f"fast, batch of {n}", batch(n), n, max(1, _CALLS // n)) for n in batches),
    ]
    return interleaved(contenders, rounds, on_round)


def time_pipeline(
    source: str,
    frames: FrameRange | None,
    rounds: int,
    model: str | None = None,
    on_round: Callable[[int], None] = lambda _: None,
) -> list[Timing]:
    """Time reading and detecting an input, and capturing it from the file to the take, in turn.

    Both open the input and the detector anew each time, as a user's run does. Raises HandfitError.
    """

    def detect(_: int) -> int:
        media = open_media(source, frames)
        return len(detect_frames(media, CaptureOptions())[0])

    def whole(_: int) -> object:
        return capture(source, model=model, frames=frames)

    count = detect(0)
    contenders = Contender("detection alone", detect, count), Contender("whole pipeline", whole, count)
    return interleaved(contenders, rounds, on_round)
