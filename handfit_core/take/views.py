"""Several cameras that filmed the same hands: where they stood, what the further ones saw, and how well that
fits together. Light to import."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final, Literal, get_args

import numpy as np

from handfit_core.common.arrays import array, array_dataclass
from handfit_core.common.skeleton import NUM_KEYPOINTS, SIDES, Side
from handfit_core.detect.keypoints import Detections
from handfit_core.geometry.camera import Intrinsics, PlacedCamera
from handfit_core.media.source import Source

Agreement = Literal["good", "doubtful", "failed"]
AGREEMENTS: Final[tuple[Agreement, ...]] = get_args(Agreement)


@dataclass(frozen=True)
class Verdict:
    """Whether views belong together, in words for an artist."""

    agreement: Agreement
    """`doubtful` views are used, of `failed` ones the better view alone"""
    text: str
    """One or a few sentences"""


@array_dataclass
class SeenHand:
    """What a further view saw of a hand in its S frames; NaN where it was not detected."""

    keypoints_2d: np.ndarray = array("S", NUM_KEYPOINTS, 2, finite="detected")
    """pixels of that view"""
    detected: np.ndarray = array("S", kind="b")
    used: np.ndarray = array("S", kind="b")
    """Detections that the fit took notice of: others lie outside the first view, or follow another hand"""
    score: np.ndarray = array("S", finite="detected")
    keypoints_depth: np.ndarray = array("S", NUM_KEYPOINTS, finite="detected")
    """pixels, as in the take's own arrays"""
    world_landmarks: np.ndarray = array("S", NUM_KEYPOINTS, 3, finite="detected")
    """metres about the hand's centre, axes as that camera's"""
    keypoints_2020: np.ndarray | None = array("S", NUM_KEYPOINTS, 3, default=None)
    overlapped: np.ndarray | None = array("S", NUM_KEYPOINTS, kind="b", default=None)
    """Keypoints that lie where another hand is, as in the take's own arrays"""

    def detections(self, rows: np.ndarray, side: Side) -> Detections:
        """What the detector found in those of its frames `rows` in which it found the hand, which is of that
        `side`. They count as frames 0, 1, ..."""
        rows = rows[self.detected[rows]]
        points = [self.keypoints_2d[rows], self.keypoints_depth[rows][..., None]]
        return Detections(
            frame=np.arange(len(rows)),
            side=np.full(len(rows), SIDES.index(side)),
            score=self.score[rows],
            keypoints=np.concatenate(points, axis=2),
            world=self.world_landmarks[rows],
            keypoints_2020=None if self.keypoints_2020 is None else self.keypoints_2020[rows],
            overlapped=None if self.overlapped is None else self.overlapped[rows],
        )


@dataclass(frozen=True, eq=False)
class View:
    """A further view: its clip."""

    source: Source
    fps: float
    width: int
    """pixels, of the upright picture"""
    height: int
    frame_numbers: np.ndarray
    """(S,) int, increasing, as in a take of that clip"""
    times: np.ndarray | None = None
    """(S,) seconds after its first frame, by the first view's clock; None: as its rate says"""
    mirrored: bool = False
    """Whether the clip shows the world mirrored, as selfie cameras do; pixels and camera are of the picture
    turned back"""


@array_dataclass
class Cameras:
    """The cameras of V views, the take's own first. Metres, pixels, seconds."""

    rotation: np.ndarray = array("V", 3, 3, finite="all")
    translation: np.ndarray = array("V", 3, finite="all")
    """x_v = rotation_v x_0 + translation_v"""
    intrinsics: np.ndarray = array("V", 4, finite="all")
    """fx, fy, cx, cy"""
    time_offset: np.ndarray = array("V", finite="all")
    """seconds from the take's first frame to the first one of the view"""
    views: tuple[View, ...] = field(default=())
    """The V - 1 further ones"""

    def camera(self, view: int) -> PlacedCamera:
        """The camera of a view, counted from 0."""
        intrinsics = Intrinsics(*self.intrinsics[view].tolist())
        return PlacedCamera(intrinsics, self.rotation[view], self.translation[view])

    def seconds(self, view: int) -> np.ndarray:
        """(S,) seconds from the take's first frame to those of a further view, counted from 1."""
        of = self.views[view - 1]
        times = (of.frame_numbers - of.frame_numbers[0]) / of.fps if of.times is None else of.times
        return np.asarray(self.time_offset[view] + times)
