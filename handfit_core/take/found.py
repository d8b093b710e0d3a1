"""What a detector found of one hand, as takes and messages lay it out: an array a column, a row a frame."""

from __future__ import annotations

from typing import Any

import numpy as np

from handfit_core.common.arrays import array, array_dataclass
from handfit_core.common.batch import scatter
from handfit_core.common.skeleton import NUM_KEYPOINTS, SIDES, Side
from handfit_core.detect.keypoints import Detections


@array_dataclass
class FoundRows:
    """The detections of one hand over T frames, as arrays; NaN in frames without a detection. Arrays that may
    be None are absent where no frame has them."""

    keypoints_2d: np.ndarray = array("T", NUM_KEYPOINTS, 2, finite="detected", sent=np.float32)
    """(T, 21, 2) pixels: the detected keypoints in the upright picture"""
    detected: np.ndarray = array("T", kind="b")
    score: np.ndarray = array("T", finite="detected", sent=np.float32)
    """(T,) the detector's confidence in this hand, 0..1"""
    keypoints_depth: np.ndarray | None = array(
        "T", NUM_KEYPOINTS, finite="detected", sent=np.float32, default=None
    )
    """(T, 21) pixels: depth of keypoints_2d towards the scene, relative to the wrist; None: an old take lacks
    it"""
    world_landmarks: np.ndarray | None = array(
        "T", NUM_KEYPOINTS, 3, finite="detected", sent=np.float32, default=None
    )
    """(T, 21, 3) metres about the hand's centre, along the camera frame's axes; None: an old take lacks
    them"""
    keypoints_2020: np.ndarray | None = array("T", NUM_KEYPOINTS, 3, sent=np.float32, default=None)
    """(T, 21, 3) pixels x and y, and depth, that the landmark network of December 2020 sees; NaN where it was
    not run"""
    right_side: np.ndarray | None = array("T", default=None)
    """(T,) probability that the detector named the true side; NaN where it was not judged"""
    other_side: np.ndarray | None = array("T", kind="b", default=None)
    """(T,) bool: True for frames in which the detector named the other side"""
    overlapped: np.ndarray | None = array("T", NUM_KEYPOINTS, kind="b", default=None)
    """(T, 21) bool: True for keypoints that lie where another hand is, or that another program did not find
    (they are guessed) or doubts; they are believed less"""

    @classmethod
    def of(cls, hands: Detections, side: Side, count: int) -> FoundRows:
        """Lay out the detections of a hand of that side in `count` frames, at most one in each, as arrays."""

        def over_time(rows: np.ndarray, nothing: Any = np.nan) -> np.ndarray:
            return scatter(rows, hands.frame, count, nothing)

        points, world = over_time(hands.keypoints), over_time(hands.world)
        second, doubted, known = hands.keypoints_2020, hands.overlapped, not np.isnan(hands.world).any()
        return cls(
            keypoints_2d=points[..., :2],
            detected=over_time(np.ones(len(hands), dtype=bool), False),
            score=over_time(hands.score),
            keypoints_depth=points[..., 2] if known else None,
            world_landmarks=world if known else None,
            keypoints_2020=None if second is None or not hands.asked_2020.any() else over_time(second),
            right_side=over_time(hands.right_side) if len(hands) else None,
            other_side=over_time(hands.side != SIDES.index(side), False) if len(hands) else None,
            overlapped=None if doubted is None or not doubted.any() else over_time(doubted, False),
        )

    def detections(self, side: Side) -> Detections:
        """Return these rows as the `Detections` of a hand of that side; depth and world landmarks that are
        absent become NaN."""
        frame = np.flatnonzero(self.detected)
        named = np.full(len(frame), SIDES.index(side))
        nothing = np.full((len(frame), NUM_KEYPOINTS, 3), np.nan)
        depth = nothing[..., 0] if self.keypoints_depth is None else self.keypoints_depth[frame]
        return Detections(
            frame=frame,
            side=named if self.other_side is None else np.where(self.other_side[frame], 1 - named, named),
            score=self.score[frame],
            keypoints=np.concatenate([self.keypoints_2d[frame], depth[..., None]], axis=2),
            world=nothing if self.world_landmarks is None else self.world_landmarks[frame],
            keypoints_2020=None if self.keypoints_2020 is None else self.keypoints_2020[frame],
            right_side=np.full(len(frame), np.nan) if self.right_side is None else self.right_side[frame],
            overlapped=None if self.overlapped is None else self.overlapped[frame],
        )
