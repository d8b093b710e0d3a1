"""The input of a fit: corrected landmarks with their expected errors, as seen through a camera."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from handfit_core.common.batch import Batch
from handfit_core.detect.keypoints import Landmarked
from handfit_core.fit.grip import Grip
from handfit_core.geometry.camera import Intrinsics, PlacedCamera
from handfit_core.hand_model.chain import State


@dataclass(frozen=True, eq=False)
class PoseAnchor(Batch):
    """Poses that B hands are to stay near, and how firmly; an infinite sigma keeps nothing. Joints that are
    fixed altogether are in `problem.FixedJoints`."""

    wrist: np.ndarray
    """(B, 3) metres, camera frame, of which only the distance from the camera counts"""
    distance_sigma: np.ndarray
    """(B,) standard deviations of the wrist's distance from the camera, as parts of that distance"""
    angles: np.ndarray
    """(B, 5, 9) radians: the angles to stay near, nine for each finger, thumb first"""
    angle_sigma: np.ndarray
    """(B, 5) radians: the standard deviation of each finger's angles"""
    limits_sigma: np.ndarray
    """(B,) radians beyond a joint's passive range (`passive_range`), or beyond the kept angles where these go
    further, that cost as much as one sigma; NaN: this hand's limits are those of hands without an anchor"""

    @classmethod
    def at(
        cls,
        state: State,
        distance_sigma: float | np.ndarray = np.inf,
        angle_sigma: float | np.ndarray = np.inf,
        limits_sigma: float | np.ndarray = np.nan,
    ) -> PoseAnchor:
        """Return anchors at the poses of B hands; each sigma is one number for all hands, or an array shaped
        like the field of that name."""
        count = len(state)
        distance, limits = (np.broadcast_to(sigma, count) for sigma in (distance_sigma, limits_sigma))
        return cls(state.wrist, distance, state.angles, np.broadcast_to(angle_sigma, (count, 5)), limits)


@dataclass(frozen=True, eq=False)
class SelfContact(Batch):
    """Observed self-contact of B hands, for the Q pairs of bones of `geometry.crossing.CROSSING`."""

    along: np.ndarray
    """(B, Q, 2) how far along their bones the two parts cross in the picture, 0..1"""
    front: np.ndarray
    """(B, Q) 1 where the first part is in front, -1 where it is behind, 0 where they do not cross"""
    separation: np.ndarray
    """(B, Q) metres between the bones' axes along the line of sight when their skins touch"""
    in_contact: np.ndarray
    """(B, Q) confidence that the skins touch where the parts cross, 0..1"""
    lifted: np.ndarray
    """(B,) bool: true where the thumb seems far off a bent finger that it crosses, which is rare"""
    pinch: np.ndarray
    """(B, P) confidence that the pairs of tips of `fit.self_contact.PINCH_BONES` touch, 0..1"""


@dataclass(frozen=True, eq=False)
class SecondView(Batch):
    """B hands as a second camera sees them, whose place is known: x_2 = rotation x + translation. Pixels and
    metres."""

    rotation: np.ndarray
    """(B, 3, 3) rotations from the first camera's frame to the second one's"""
    translation: np.ndarray
    """(B, 3) metres: the translation from the first camera's frame to the second one's"""
    pixels: np.ndarray
    """(B, 21, 2) pixels at which the second camera saw the 21 landmarks"""
    pixel_sigma: np.ndarray
    """(B, 21, 2) pixels: expected errors of these landmarks; infinite where the second camera saw nothing"""
    focal: np.ndarray
    """(B, 2) pixels: the second camera's focal lengths"""
    centre: np.ndarray
    """(B, 2) pixels: the second camera's principal point"""

    @classmethod
    def through(cls, camera: PlacedCamera, pixels: np.ndarray, pixel_sigma: np.ndarray) -> SecondView:
        """Return the view of B hands through that camera, of landmarks at `pixels` (B, 21, 2) with expected
        errors `pixel_sigma`; NaN pixels are of points that it did not see."""
        count, lens = len(pixels), camera.intrinsics
        known = np.isfinite(pixels) & np.isfinite(pixel_sigma)
        return cls(
            np.broadcast_to(camera.rotation, (count, 3, 3)),
            np.broadcast_to(camera.translation, (count, 3)),
            np.where(known, pixels, 0.0),
            np.where(known, pixel_sigma, np.inf),
            np.broadcast_to((lens.fx, lens.fy), (count, 2)),
            np.broadcast_to((lens.cx, lens.cy), (count, 2)),
        )

    @property
    def saw(self) -> np.ndarray:
        """(B,) bool: true for hands of which the second camera saw a landmark."""
        return np.asarray(np.isfinite(self.pixel_sigma).any(axis=(1, 2)))


@dataclass(frozen=True, eq=False, kw_only=True)
class Observation(Landmarked):
    """Landmarks of B pictures of one model's hand, seen through a camera: their places in pixels, and their
    depth in pixels at the hand's distance, along the line of sight of the camera frame."""

    ray: np.ndarray
    """(B, 3) unit vectors in the camera frame along the line of sight to each hand"""
    focal: np.ndarray
    """(B, 2) focal lengths of the camera in pixels"""
    centre: np.ndarray
    """(B, 2) the camera's principal point in pixels"""
    depth_zero: np.ndarray | None = None
    """(B,) metres along the line of sight at which the observed depth is zero, NaN where that is not known;
    None where it is known of no hand"""
    anchor: PoseAnchor | None = None
    """Poses that the hands are to stay near; None: there are none"""
    self_contact: SelfContact | None = None
    """The self-contact of the hands: which parts cross and touch; None where it was not looked for"""
    second: SecondView | None = None
    """The landmarks that a second camera saw of these hands; None where there is no second camera"""
    touches: np.ndarray | None = None
    """(B, 21) the number of the keypoint that each keypoint is to touch, 0 being the palm; NaN where it
    touches none; None where no hand has any"""
    grip: Grip | None = None
    """The prop that the hands are to hold; None where they hold none"""


def lines_of_sight(pixels: np.ndarray, intrinsics: Intrinsics) -> np.ndarray:
    """Return unit vectors (B, 3) in the camera frame that point towards the means of points (B, 21, 2) in
    pixels."""
    rays = intrinsics.rays(pixels.mean(axis=1))
    return np.asarray(rays / np.linalg.norm(rays, axis=1, keepdims=True))


def observation_of(
    seen: Landmarked, intrinsics: Intrinsics, depth_zero: np.ndarray | None = None
) -> Observation:
    """Make the observation of B hands from their landmarks, as seen through a camera; observed depth is zero
    at `depth_zero` (B,) metres."""
    rays = lines_of_sight(seen.pixels, intrinsics)
    focal, centre = (intrinsics.fx, intrinsics.fy), (intrinsics.cx, intrinsics.cy)
    return Observation(
        **vars(seen),
        ray=rays,
        focal=np.broadcast_to(focal, (len(rays), 2)),
        centre=np.broadcast_to(centre, (len(rays), 2)),
        depth_zero=depth_zero,
    )
