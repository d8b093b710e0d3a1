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
    """How well views belong together, in words for an artist."""

    agreement: Agreement
    """`doubtful` views are used, of `failed` ones the better view alone"""
    text: str
    """One or a few sentences"""


@array_dataclass
class SeenHand:
    """What a further view saw of a hand in its S frames."""

    used: np.ndarray = array("S", kind="b")
    """Frames whose detection the fit took notice of: others lie outside the first view, or follow another
    hand"""
    detections: Detections
    """What was found in that view, at most one in a frame, of the hand's side"""

    @cached_property
    def rows(self) -> FoundRows:
        """`detections` as arrays over the S frames."""
        side = SIDES[self.detections.side[0]] if len(self.detections) else SIDES[0]
        rows = FoundRows.of(self.detections, side, len(self.used))
        return replace(rows, right_side=None, other_side=None)

    @property
    def detected(self) -> np.ndarray:
        """(S,) bool"""
        return self.rows.detected

    @property
    def keypoints_2d(self) -> np.ndarray:
        """(S, 21, 2) pixels of that view; NaN where it was not detected."""
        return self.rows.keypoints_2d


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
    """True if the clip shows the world mirrored, as selfie cameras do; pixels and camera are of the picture
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
