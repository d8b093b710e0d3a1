"""Several cameras that filmed the same hands: where they stood, what the further ones saw, and how well that
fits together. Light to import."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Final, Literal, get_args

import numpy as np

from handfit_core.common.arrays import array, array_dataclass
from handfit_core.common.skeleton import SIDES
from handfit_core.detect.keypoints import Detections
from handfit_core.geometry.camera import Intrinsics, PlacedCamera
from handfit_core.media.source import Source
from handfit_core.take.found import FoundRows

Agreement = Literal["good", "doubtful", "failed"]
AGREEMENTS: Final[tuple[Agreement, ...]] = get_args(Agreement)


@dataclass(frozen=True)
class Verdict:
    """How well several views belong together, in words for an artist."""

    agreement: Agreement
    """How the views are used: `doubtful` views are all used, of `failed` ones only the better view"""
    text: str
    """The judgement in one or a few sentences"""


@array_dataclass
class SeenHand:
    """What a further view saw of a hand in the view's S frames."""

    used: np.ndarray = array("S", kind="b")
    """(S,) bool: True for frames whose detection the fit took notice of; others lie outside the first view,
    or follow another hand"""
    detections: Detections
    """The hand's detections in that view, at most one in a frame, of the hand's side"""

    @cached_property
    def rows(self) -> FoundRows:
        """The `detections` as arrays over the S frames."""
        side = SIDES[self.detections.side[0]] if len(self.detections) else SIDES[0]
        rows = FoundRows.of(self.detections, side, len(self.used))
        return replace(rows, right_side=None, other_side=None)

    @property
    def detected(self) -> np.ndarray:
        """(S,) bool: True for the frames in which the hand was detected."""
        return self.rows.detected

    @property
    def keypoints_2d(self) -> np.ndarray:
        """(S, 21, 2) pixels of that view: the detected keypoints; NaN where the hand was not detected."""
        return self.rows.keypoints_2d


@dataclass(frozen=True, eq=False)
class View:
    """The clip of a further view, with its size, frames and times."""

    source: Source
    fps: float
    width: int
    """Width of the upright picture in pixels, as `height` is its height"""
    height: int
    frame_numbers: np.ndarray
    """(S,) int, increasing: the frame numbers, as in a take of that clip"""
    times: np.ndarray | None = None
    """(S,) seconds after the view's first frame, by the first view's clock; None: as the clip's frame rate
    says"""
    mirrored: bool = False
    """True if the clip shows the world mirrored, as selfie cameras do; pixels and camera are of the picture
    turned back"""


@array_dataclass
class Cameras:
    """The cameras of V views, the take's own first, in metres, pixels and seconds."""

    rotation: np.ndarray = array("V", 3, 3, finite="all")
    translation: np.ndarray = array("V", 3, finite="all")
    """(V, 3) metres: a point x_0 of the first camera's frame is x_v = rotation_v x_0 + translation_v in view
    v's"""
    intrinsics: np.ndarray = array("V", 4, finite="all")
    """(V, 4) pixels: fx, fy, cx, cy of each camera"""
    time_offset: np.ndarray = array("V", finite="all")
    """(V,) seconds from the take's first frame to the first frame of each view"""
    views: tuple[View, ...] = field(default=())
    """The V - 1 further views, without the take's own"""

    def camera(self, view: int) -> PlacedCamera:
        """Return the camera of a view, counted from 0, with its place."""
        intrinsics = Intrinsics(*self.intrinsics[view].tolist())
        return PlacedCamera(intrinsics, self.rotation[view], self.translation[view])

    def seconds(self, view: int) -> np.ndarray:
        """Return (S,) the seconds from the take's first frame to the frames of a further view, counted from
        1."""
        of = self.views[view - 1]
        times = (of.frame_numbers - of.frame_numbers[0]) / of.fps if of.times is None else of.times
        return np.asarray(self.time_offset[view] + times)
