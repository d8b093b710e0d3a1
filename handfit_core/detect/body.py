"""People's bodies in pictures, by MediaPipe's body networks, as far as arms need them.

The detector finds people in the whole picture, the landmark network the body in a crop about one of them:
"BlazePose: On-device Real-time Body Pose tracking" (Bazarevsky et al., 2020).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from handfit_core.common.arrays import array, array_dataclass
from handfit_core.detect.crops import Crop
from handfit_core.detect.landmark_model import BODY, body_model_path
from handfit_core.detect.networks import Runner, anchors, turn_upright
from handfit_core.geometry.camera import Intrinsics
from handfit_core.geometry.lens import Lens
from handfit_core.geometry.rotations import turn_from_axis

NUM_BODY_POINTS: Final = 33
"""Number of points of MediaPipe's body, in MediaPipe's order; from index 11 on, odd ones are on the person's
left"""
SHOULDERS, ELBOWS, WRISTS = (
    {"left": 11, "right": 12},
    {"left": 13, "right": 14},
    {"left": 15, "right": 16},
)


@dataclass(frozen=True)
class BodySettings:
    """What the body networks take and give, and how people are cropped for them."""

    detector_input_px: int = 224
    """Side of the detector's square input picture, in pixels"""
    landmarks_input_px: int = 256
    """Side of the landmark network's square input picture, in pixels"""
    grids: tuple[tuple[int, int], ...] = ((28, 2), (14, 2), (7, 6))
    """For each of the detector's grids: how many places it has along a side, and how many anchors at each
    place"""
    crop_half_side: float = 1.25
    """Half the side of a person's crop, in distances of the two points of `People.axis`"""
    same_person_distance: float = 0.5
    """Distance between the centres of two people's boxes, in sides of the boxes, below which they are one
    person"""
    numbers: int = 39
    """Number of points that the landmark network returns; after the body's 33 come two about which the next
    crop is laid"""


SETTINGS: Final = BodySettings()


@array_dataclass
class BodyTrack:
    """One person over a clip's T frames, as the body networks see them; NaN in frames without the person."""

    keypoints: np.ndarray = array("T", NUM_BODY_POINTS, 2, finite="present")
    """(T, 33, 2) pixels of the body's points in the picture"""
    visibility: np.ndarray = array("T", NUM_BODY_POINTS, finite="present")
    """(T, 33) probability that each point is in the picture and not hidden, 0..1"""
    world: np.ndarray = array("T", NUM_BODY_POINTS, 3, finite="present")
    """(T, 33, 3) metres about the middle of the hips, along the camera frame's axes; directions between
    points can be relied on, lengths cannot"""
    score: np.ndarray = array("T")
    """(T,) score of the people's detector, 0..1; NaN in frames in which it did not run"""
    present: np.ndarray = array("T", kind="b")
    cut: np.ndarray = array("T", kind="b")
    """(T,) bool: True where another shot begins, or may have begun since the frame that was looked at
    before"""


@dataclass(frozen=True, eq=False)
class People:
    """N people that the detector found in a picture, by falling score."""

    score: np.ndarray
    """(N,) score of each person, 0..1"""
    axis: np.ndarray
    """(N, 2, 2) pixels: the middle of the hips, and the point above it on a circle about the whole body"""


@dataclass(frozen=True, eq=False)
class Body:
    """One person in one picture, as the landmark network sees them; its arrays are like one frame of
    `BodyTrack`."""

    presence: float
    """Probability that the crop shows a person"""
    keypoints: np.ndarray
    """(33, 2) pixels of the body's points, without the lens' distortion"""
    visibility: np.ndarray
    """(33,) probability that each point is in the picture and not hidden, 0..1"""
    world: np.ndarray
    """(33, 3) metres about the middle of the hips, along the camera frame's axes"""
    axis: np.ndarray
    """(2, 2) pixels of the two points, defined as in `People.axis`, about which the next frame's crop is
    laid"""


def crop_about(axis: np.ndarray) -> Crop:
    """Return the crop in which the landmark network sees a person whose two points of `People.axis` are
    `axis` (2, 2), pixels."""
    up = axis[1] - axis[0]
    span = 2.0 * SETTINGS.crop_half_side * max(float(np.linalg.norm(up)), 1.0)
    return Crop.of_square(axis[0], span, SETTINGS.landmarks_input_px, turn=turn_upright(up))


class BodyNetworks(Runner):
    """The detector of people and the landmark network of bodies. Use as a context manager.

    Raises LandmarkModelError where their file is missing or damaged.
    """

    def __init__(self) -> None:
        path = body_model_path()
        super().__init__()
        self._detector, self._landmarks = self._load(path, BODY.detector[0], BODY.landmarks[0])

    def detect(self, rgb: np.ndarray, min_score: float) -> People:
        """Return the people in a picture (H, W, 3) uint8 RGB whose score is at least `min_score`."""
        height, width = rgb.shape[:2]
        size = SETTINGS.detector_input_px
        crop = Crop.of_square(np.array([width, height]) / 2.0, max(width, height), size)
        boxes, logits = self._run(self._detector, crop.render(rgb, black_beyond=True))
        chosen = np.flatnonzero(logits >= np.log(min_score / (1.0 - min_score)))
        chosen = chosen[np.argsort(-logits[chosen], kind="stable")]
        # A box's centre and size, then four points, of which the first two are used.
        numbers = boxes.reshape(-1, 6, 2)[chosen].astype(np.float64)
        centre = numbers[:, 0] + size * anchors(SETTINGS.grids)[chosen]
        side = numbers[:, 1].max(axis=1)
        kept: list[int] = []
        for i in range(len(chosen)):
            apart = np.linalg.norm(centre[kept] - centre[i], axis=-1) / np.maximum(side[kept], side[i])
            if not (apart < SETTINGS.same_person_distance).any():
                kept.append(i)
        points = numbers[kept, 2:4] + size * anchors(SETTINGS.grids)[chosen[kept]][:, None]
        return People(
            score=1.0 / (1.0 + np.exp(-logits[chosen[kept]].astype(np.float64))),
            axis=(points - crop.offset) / crop.scale,
        )

    def predict(self, rgb: np.ndarray, axis: np.ndarray, camera: Intrinsics | Lens) -> Body:
        """Return the body in the crop about two points (2, 2) in pixels of a picture (H, W, 3) uint8 RGB; the
        camera's lens distortion is taken out of its points."""
        crop = crop_about(axis)
        landmarks, presence, world = self._run(self._landmarks, crop.render(rgb))
        points = landmarks.reshape(SETTINGS.numbers, 5).astype(np.float64)
        back = crop.inverse.T
        pixels = (points[:, :2] - crop.offset) @ back
        metres = world.reshape(SETTINGS.numbers, 3)[:NUM_BODY_POINTS].astype(np.float64)
        metres[:, :2] = metres[:, :2] @ (back * crop.scale)
        # The network takes the ray through the crop's middle for the camera's axis.
        middle, straight = axis[:1], pixels[:NUM_BODY_POINTS]
        if isinstance(camera, Lens):
            middle, straight = camera.undistorted(middle), camera.undistorted(straight)
            camera = camera.intrinsics
        ray = camera.rays(middle[0])
        to_camera = turn_from_axis(ray / np.linalg.norm(ray))
        return Body(
            presence=float(presence[0]),
            keypoints=straight,
            visibility=1.0 / (1.0 + np.exp(-points[:NUM_BODY_POINTS, 3])),
            world=metres @ to_camera.T,
            axis=pixels[NUM_BODY_POINTS : NUM_BODY_POINTS + 2],
        )
