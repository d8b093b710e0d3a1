"""The detections that all solvers get: one hand of one clip, found once."""

from __future__ import annotations

import os
from dataclasses import dataclass

from handfit_core.detect.keypoints import DetectedTrack, HandDetection
from handfit_core.detect.tracks import link_tracks
from handfit_core.geometry.camera import Intrinsics
from handfit_core.hand_model import HandModel, load_model
from handfit_core.media.frame_range import FrameRange
from handfit_core.media.opening import open_media
from handfit_core.pipeline import detect_frames


@dataclass(frozen=True, eq=False)
class Hand:
    """The hand of an input that is seen in most frames, and what is needed to fit it."""

    model: HandModel
    detections: tuple[HandDetection, ...]
    intrinsics: Intrinsics
    fps: float

    def batch(self, size: int) -> list[HandDetection]:
        """`size` detections: those that there are, again and again."""
        return [self.detections[i % len(self.detections)] for i in range(size)]

    def single(self, index: int) -> DetectedTrack:
        """One frame as a track of its own, as a photo gives."""
        detection = self.detections[index % len(self.detections)]
        return DetectedTrack(self.model.side, (detection,), self.fps)


def find_hand(
    source: str, frames: FrameRange | None = None, model: str | os.PathLike[str] | None = None
) -> Hand:
    """Detect an input's hands and keep the one seen most. Raises HandfitError."""
    media = open_media(source, frames)
    _, found, _ = detect_frames(media, lambda _: None, max_hands=2, threshold=0.5, landmark_model=None)
    track = max(link_tracks(found), key=lambda t: int(t.detected.sum()))
    return Hand(
        model=load_model(model, track.side),
        detections=tuple(d for d in track.detections if d is not None),
        intrinsics=Intrinsics.assumed(media.width, media.height),
        fps=media.fps,
    )
