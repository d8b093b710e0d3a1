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
    """`Detections` of one hand over T frames; NaN in frames without. Arrays that may be None are absent where
    no frame has them."""

    keypoints_2d: np.ndarray = array("T", NUM_KEYPOINTS, 2, finite="detected", sent=np.float32)
    """pixels"""
    detected: np.ndarray = array("T", kind="b")
    score: np.ndarray = array("T", finite="detected", sent=np.float32)
    """The detector's confidence in this hand, 0..1"""
    keypoints_depth: np.ndarray | None = array(
        "T", NUM_KEYPOINTS, finite="detected", sent=np.float32, default=None
    )
    """pixels: depth of keypoints_2d towards the scene, relative to the wrist; None: an old take lacks it"""
    world_landmarks: np.ndarray | None = array(
        "T", NUM_KEYPOINTS, 3, finite="detected", sent=np.float32, default=None
    )
    """metres about the hand's centre, axes as the camera frame's; None: an old take lacks them"""
    keypoints_2020: np.ndarray | None = array("T", NUM_KEYPOINTS, 3, sent=np.float32, default=None)
    """What the landmark network of December 2020 sees: pixels, and depth; NaN where it was not asked"""
    right_side: np.ndarray | None = array("T", default=None)
    """Probability that the detector named the true side; NaN where it was not judged"""
    other_side: np.ndarray | None = array("T", kind="b", default=None)
    """Frames in which the detector named the other side"""
    overlapped: np.ndarray | None = array("T", NUM_KEYPOINTS, kind="b", default=None)
    """Keypoints that lie where another hand is, or that another program did not find (they are guessed) or
    doubts, and are believed less"""

    @classmethod
    def of(cls, hands: Detections, side: Side, count: int) -> FoundRows:
        """The detections of a hand of that side in `count` frames, at most one in each."""

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
        """The inverse, for a hand of that side; depth and world landmarks that are absent are NaN."""
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
