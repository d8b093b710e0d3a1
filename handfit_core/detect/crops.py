"""Square crops of a picture: what a network sees, and the way back to the picture's pixels."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np


def downscale(rgb: np.ndarray, block_width: int, block_height: int) -> np.ndarray:
    """Average whole blocks of pixels: (H, W, 3) uint8 to (H // block_height, W // block_width, 3), at least
    one pixel a side. Pixels left over at the right and the bottom do not count."""
    import cv2

    height, width = max(1, rgb.shape[0] // block_height), max(1, rgb.shape[1] // block_width)
    whole = rgb[: height * block_height, : width * block_width]
    return cv2.resize(whole, (width, height), interpolation=cv2.INTER_AREA)


@dataclass(frozen=True, eq=False)
class Crop:
    """A square of a picture, turned, scaled and perhaps mirrored to `size` pixels a side.

    q = linear @ p + offset takes picture pixels p to crop pixels q. A pixel is an area: the picture spans
    0..W by 0..H, and its first pixel's centre is (0.5, 0.5).
    """

    linear: np.ndarray
    """(2, 2) matrix from picture to crop: a rotation, perhaps times a mirroring, times one positive scale"""
    offset: np.ndarray
    """(2,) shift in pixels of the crop, added after `linear`"""
    size: int
    """Width and height of the crop, in its own pixels"""

    @classmethod
    def of_square(
        cls, centre: np.ndarray, span: float, size: int, *, turn: float = 0.0, mirrored: bool = False
    ) -> Crop:
        """Make the crop of a square of `span` picture pixels about `centre` (2,), turned clockwise (as seen,
        y down) by `turn` radians; `mirrored` swaps left and right before that."""
        cos, sin = np.cos(turn), np.sin(turn)
        linear = np.array([[cos, -sin], [sin, cos]]) * (size / span)
        if mirrored:
            linear[:, 0] *= -1.0
        return cls(linear, size / 2.0 - linear @ np.asarray(centre, dtype=np.float64), size)

    @cached_property
    def inverse(self) -> np.ndarray:
        """(2, 2) inverse of `linear`, from crop pixels to picture pixels."""
        return np.linalg.inv(self.linear)

    @cached_property
    def scale(self) -> float:
        """Crop pixels per picture pixel."""
        return float(np.sqrt(abs(np.linalg.det(self.linear))))

    @cached_property
    def mirrored(self) -> bool:
        """True if the crop is a mirror image, so that left and right hands are swapped."""
        return bool(np.linalg.det(self.linear) < 0.0)

    def render(self, rgb: np.ndarray, *, black_beyond: bool = False) -> np.ndarray:
        """Cut the crop out of a picture (H, W, 3) uint8; return (size, size, 3) uint8. Beyond the picture its
        border is repeated, or with `black_beyond` it is black there."""
        import cv2

        height, width = rgb.shape[:2]
        linear, offset, half = self.linear, self.offset, 0.5 / self.scale
        # Only the part that is seen is warped, with the margin that its outer pixels mix in.
        centre = self.inverse @ (self.size / 2.0 - offset)
        reach = np.abs(self.inverse).sum(axis=1) * self.size / 2.0 + 2.0 + 2.0 * half
        first = np.minimum(np.maximum(np.floor(centre - reach), 0), [width - 1, height - 1]).astype(int)
        last = np.minimum(np.maximum(np.ceil(centre + reach), first + 1), [width, height]).astype(int)
        rgb, offset = rgb[first[1] : last[1], first[0] : last[0]], offset + linear @ first
        if half >= 1.5:
            # Linear interpolation alone would skip pixels, so whole blocks are averaged first.
            block = np.minimum(round(half), last - first)
            rgb, linear = downscale(rgb, *block), linear * block
        # OpenCV's coordinates have their origin at the centre of the first pixel.
        centred = offset + linear @ np.array([0.5, 0.5]) - 0.5
        return cv2.warpAffine(
            rgb,
            np.column_stack([linear, centred]),
            (self.size, self.size),
            flags=cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_CONSTANT if black_beyond else cv2.BORDER_REPLICATE,
        )

    def world_to_picture(self, world: np.ndarray) -> np.ndarray:
        """Turn world landmarks (21, 3), metres, from the crop's axes to the picture's."""
        plane = world[:, :2] @ (self.inverse * self.scale).T
        return np.column_stack([plane, world[:, 2]])

    def points_to_picture(self, points: np.ndarray) -> np.ndarray:
        """Map points (21, 3) from crop pixels to picture pixels; their depth is scaled alike."""
        plane = (points[:, :2] - self.offset) @ self.inverse.T
        return np.column_stack([plane, points[:, 2] / self.scale])
