"""A second look at a picture: a square cut from it, enlarged, turned or mirrored, and the way back."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from handfit_core.detect.keypoints import HandDetection
from handfit_core.skeleton import other_side

CROP_SIZE = 256
"""Pixels a side of a view of one hand: a little more than the landmark network's 224"""


@dataclass(frozen=True, eq=False)
class View:
    """p -> linear @ p + offset takes pixels of the picture to pixels of a square `size` pixels wide.

    A pixel is an area: the picture spans 0..W by 0..H, and its first pixel's centre is (0.5, 0.5).
    """

    linear: np.ndarray
    """(2, 2): a turn, perhaps a mirror image, times one positive scale"""
    offset: np.ndarray
    """(2,)"""
    size: int

    @classmethod
    def of_square(
        cls, centre: np.ndarray, span: float, size: int, *, turn: float = 0.0, mirrored: bool = False
    ) -> View:
        """Show the square of `span` picture pixels about `centre` (2,), turned clockwise (as seen, y
        down) by `turn` radians; `mirrored` swaps left and right before that.
        """
        cos, sin = np.cos(turn), np.sin(turn)
        linear = np.array([[cos, -sin], [sin, cos]]) * (size / span)
        if mirrored:
            linear[:, 0] *= -1.0
        return cls(linear, size / 2.0 - linear @ np.asarray(centre, dtype=np.float64), size)

    @property
    def scale(self) -> float:
        """View pixels per picture pixel."""
        return float(np.sqrt(abs(np.linalg.det(self.linear))))

    @property
    def mirrored(self) -> bool:
        """Whether left and right hands are swapped."""
        return bool(np.linalg.det(self.linear) < 0.0)

    def render(self, rgb: np.ndarray) -> np.ndarray:
        """(H, W, 3) uint8 -> (size, size, 3) uint8. Beyond the picture its border goes on."""
        import cv2

        linear, offset = self.linear, self.offset
        half = 0.5 / self.scale
        if half > 1.0:
            # Linear interpolation would leave out pixels. Averaging them first is the remedy.
            height, width = rgb.shape[:2]
            small = (max(1, round(width / half)), max(1, round(height / half)))
            rgb = cv2.resize(rgb, small, interpolation=cv2.INTER_AREA)
            linear = linear * np.array([width / small[0], height / small[1]])
        # OpenCV counts from the centre of the first pixel.
        centred = offset + linear @ np.array([0.5, 0.5]) - 0.5
        return cv2.warpAffine(
            rgb,
            np.column_stack([linear, centred]),
            (self.size, self.size),
            flags=cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_REPLICATE,
        )

    def to_picture(self, found: HandDetection) -> HandDetection:
        """A hand found in the view, as one of the picture: pixels, camera axes and side."""
        keypoints, world = found.keypoints.copy(), found.world.copy()
        back = np.linalg.inv(self.linear)
        keypoints[:, :2] = (keypoints[:, :2] - self.offset) @ back.T
        keypoints[:, 2] /= self.scale
        world[:, :2] = world[:, :2] @ (back * self.scale).T
        side = other_side(found.side) if self.mirrored else found.side
        return HandDetection(side, found.score, keypoints, world)


def square_about(
    hand: HandDetection, span: float, size: int, *, turn: float = 0.0, mirrored: bool = False
) -> View:
    """The view of a hand and its surroundings: `span` times the hand's size. `turn` in radians."""
    points = hand.keypoints_2d
    centre = (points.min(axis=0) + points.max(axis=0)) / 2.0
    # A hand seen end on is small in the picture; the crop shall hold some pixels all the same.
    return View.of_square(centre, span * max(hand.extent, 8.0), size, turn=turn, mirrored=mirrored)
