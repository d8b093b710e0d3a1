"""Several looks at one hand: squares cut from the picture, what is of one hand, and the mean."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from handfit_core.batch import slices
from handfit_core.detect.keypoints import HandDetection
from handfit_core.skeleton import KEYPOINT_PARENTS, NUM_KEYPOINTS, SIDES, other_side

_PALM = [0, 5, 9, 13, 17]
_BONES = [[parent, point] for point, parent in enumerate(KEYPOINT_PARENTS) if parent >= 0]

SAME_PALM = 0.25
"""Detections whose palms are nearer than this, in units of the hands' size, are of one hand."""

SAME_BOX = 0.5
"""So are those whose boxes share more than this part of what they cover together."""

ITS_BOX = 0.97
"""A box that shares more than this part with that of a hand's points was drawn about that very hand."""

THICKNESS = 0.14
"""A point nearer than this to another hand's bones, in units of that hand's size, lies on it, or so near that
the landmark network may take the one for the other"""

SAME_HAND = 0.25
"""Two detections of one picture nearer than this (see `distance`) are looks at one hand."""

OF_ONE = 0.5
"""With so many of the smaller one's points in the box of the other, two detections may be a hand and its
part, or a hand and the same with its forearm."""

OTHER_SIZE = 0.6
"""Then the smaller one has less than this part of the other's size."""


def distance(a: HandDetection, b: HandDetection, moved: np.ndarray | float = 0.0) -> float:
    """Mean keypoint distance in the picture, in units of the hands' size, once `a` has `moved` by (2,)
    pixels."""
    size = max(a.extent, b.extent, 1e-9)
    return float(np.mean(np.linalg.norm(a.keypoints_2d + moved - b.keypoints_2d, axis=-1))) / size


@dataclass(frozen=True, eq=False)
class Crowd:
    """N hands as arrays, so that many pairs of them are compared at once."""

    points: np.ndarray
    """(N, 21, 2) pixels"""
    low: np.ndarray
    """(N, 2) the upper left corners of their points' boxes"""
    high: np.ndarray
    """(N, 2) the lower right ones"""
    middle: np.ndarray
    """(N, 2) the means of their points"""
    extent: np.ndarray
    """(N,) pixels, as `HandDetection.extent`"""

    @classmethod
    def of(cls, hands: Sequence[HandDetection]) -> Crowd:
        """These hands."""
        points = np.array([hand.keypoints_2d for hand in hands]).reshape(-1, NUM_KEYPOINTS, 2)
        low, high = points.min(axis=1), points.max(axis=1)
        return cls(points, low, high, points.mean(axis=1), np.max(high - low, axis=1))

    def distances(
        self, mine: np.ndarray, other: Crowd, theirs: np.ndarray, most: float, moved: np.ndarray | float = 0.0
    ) -> np.ndarray:
        """(P,) `distance` of the hands numbered `mine` (P,) of this crowd, once each has `moved` by (P, 2)
        pixels, to those numbered `theirs` (P,) of the other; infinite where it is larger than `most`, which
        their means alone mostly tell."""
        moved = np.broadcast_to(moved, (len(mine), 2))
        size = np.maximum(np.maximum(self.extent.take(mine), other.extent.take(theirs)), 1e-9)
        apart = _lengths(self.middle.take(mine, axis=0) + moved - other.middle.take(theirs, axis=0))
        found = np.full(len(mine), np.inf)
        # The mean of the points' distances is no less than the distance of their means.
        near = np.flatnonzero(apart <= most * size * 1.001)
        for part in slices(len(near), _AT_ONCE):
            rows = near[part]
            apart = self.points.take(mine[rows], axis=0)
            apart += moved[rows, None]
            apart -= other.points.take(theirs[rows], axis=0)
            found[rows] = _lengths(apart).mean(axis=-1) / size[rows]
        return found

    def share_within(self, mine: np.ndarray, theirs: np.ndarray) -> np.ndarray:
        """(P,) the shares of the points of the hands numbered `mine` (P,) that lie in the boxes of those
        numbered `theirs` (P,)."""
        share = np.zeros(len(mine))
        meet = (self.low[mine] <= self.high[theirs]) & (self.high[mine] >= self.low[theirs])
        both = np.flatnonzero(meet.all(axis=1))
        for part in slices(len(both), _AT_ONCE):
            rows = both[part]
            points, of = self.points[mine[rows]], theirs[rows]
            inside = (points >= self.low[of, None]) & (points <= self.high[of, None])
            share[rows] = inside.all(axis=-1).mean(axis=-1)
        return share

    def covers(self, points: np.ndarray, theirs: np.ndarray) -> np.ndarray:
        """(K,) bool: which points (K, 2) lie where a hand of those numbered `theirs` (P,) is."""
        covered = np.zeros(len(points), dtype=bool)
        for part in slices(len(theirs), _AT_ONCE // NUM_KEYPOINTS):
            # In a dense crowd a few hands cover every point.
            free = np.flatnonzero(~covered)
            if not len(free):
                break
            bones, reach = (
                self.points[theirs[part], None][:, :, _BONES],
                THICKNESS * self.extent[theirs[part]],
            )
            start, along = bones[..., 0, :], bones[..., 1, :] - bones[..., 0, :]
            away = points[free, None] - start
            share = (away * along).sum(axis=-1) / np.maximum(np.square(along).sum(axis=-1), 1e-9)
            nearest = start + np.clip(share, 0.0, 1.0)[..., None] * along
            near = _lengths(points[free, None] - nearest) < reach[:, None, None]
            covered[free] = near.any(axis=(0, 2))
        return covered


_AT_ONCE: Final = 1 << 9
"""pairs of hands whose points are compared at once: what a processor's cache holds, and what takes no new
memory from the system each time"""


def _lengths(vectors: np.ndarray) -> np.ndarray:
    """(...) of (..., 2), as NumPy's norm has them, which takes several times as long."""
    return np.sqrt(np.square(vectors[..., 0]) + np.square(vectors[..., 1]))


def same_hand(a: HandDetection, b: HandDetection) -> bool:
    """Whether two detections of one picture are of one hand, be it once as a left and once as a right one."""
    if distance(a, b) < SAME_HAND:
        return True
    apart = a.keypoints_2d[_PALM].mean(axis=0) - b.keypoints_2d[_PALM].mean(axis=0)
    if float(np.linalg.norm(apart)) < SAME_PALM * max(a.extent, b.extent):
        return True
    return _shared(a.keypoints_2d, b.keypoints_2d) > SAME_BOX


def of_one(a: HandDetection, b: HandDetection) -> bool:
    """Whether two detections of different size may be a hand and what is part of it."""
    small, large = sorted((a, b), key=lambda hand: hand.extent)
    low, high = large.keypoints_2d.min(axis=0), large.keypoints_2d.max(axis=0)
    inside = ((small.keypoints_2d >= low) & (small.keypoints_2d <= high)).all(axis=-1)
    return small.extent < OTHER_SIZE * large.extent and float(inside.mean()) > OF_ONE


def hand_of_box(hands: Iterable[HandDetection], box: Sequence[float]) -> HandDetection | None:
    """The one about whose points a box (x, y, width, height) was drawn; None: it is of none of them."""
    x, y, width, height = box
    corners = np.array([[x, y], [x + width, y + height]])
    shared = [(_shared(hand.keypoints_2d, corners), hand) for hand in hands]
    share, hand = max(shared, key=lambda each: each[0], default=(0.0, None))
    return hand if share > ITS_BOX else None


def _shared(a: np.ndarray, b: np.ndarray) -> float:
    """The part that the boxes of two sets of points (N, 2) share of what they cover together."""
    low, high = np.maximum(a.min(axis=0), b.min(axis=0)), np.minimum(a.max(axis=0), b.max(axis=0))
    common = float(np.clip(high - low, 0.0, None).prod())
    both = sum(float(np.ptp(points, axis=0).prod()) for points in (a, b))
    return common / max(both - common, 1e-9)


def overlapped(hand: HandDetection, other: HandDetection) -> np.ndarray:
    """(21,) bool: which points of a hand lie where another one is."""
    return Crowd.of([other]).covers(hand.keypoints_2d, np.zeros(1, dtype=int))


def mean_of(hands: Sequence[HandDetection]) -> HandDetection:
    """One detection from several looks at one hand.

    Keypoints and world landmarks are averaged; those of December 2020 over the looks that have them. The side
    is voted for, each look by its score; the score is what that side got per look, so that looks that saw the
    other side lower it.
    """
    votes = {side: sum(hand.score for hand in hands if hand.side == side) for side in SIDES}
    side = max(SIDES, key=lambda s: votes[s])
    keypoints = np.array([hand.keypoints for hand in hands])
    second = [hand.keypoints_2020 for hand in hands if hand.keypoints_2020 is not None]
    return HandDetection(
        side=side,
        score=votes[side] / len(hands),
        keypoints=keypoints.mean(axis=0),
        world=np.mean([hand.world for hand in hands], axis=0),
        keypoints_2020=np.mean(second, axis=0) if second else None,
        spread=keypoints.std(axis=0) if len(hands) > 1 else None,
    )


def shrunk(rgb: np.ndarray, across: int, down: int) -> np.ndarray:
    """A picture (H, W, 3) uint8 with the means of blocks of so many pixels; less than a block is left out,
    unless there is no whole one."""
    import cv2

    height, width = max(1, rgb.shape[0] // down), max(1, rgb.shape[1] // across)
    return cv2.resize(rgb[: height * down, : width * across], (width, height), interpolation=cv2.INTER_AREA)


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

        height, width = rgb.shape[:2]
        linear, offset, half = self.linear, self.offset, 0.5 / self.scale
        # Nothing but the part that is seen, with as much around it as its pixels mix.
        corners = (np.array([[0, 0], [1, 0], [0, 1], [1, 1]]) * self.size - offset) @ np.linalg.inv(linear).T
        margin = 2.0 + 2.0 * half
        first = np.clip(np.floor(corners.min(axis=0) - margin), 0, [width - 1, height - 1]).astype(int)
        last = np.clip(np.ceil(corners.max(axis=0) + margin), first + 1, [width, height]).astype(int)
        rgb, offset = rgb[first[1] : last[1], first[0] : last[0]], offset + linear @ first
        if half >= 1.5:
            # Linear interpolation would leave out pixels. Averaging whole blocks first is the remedy.
            block = np.minimum(round(half), last - first)
            rgb, linear = shrunk(rgb, *block), linear * block
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
        world, back = found.world.copy(), np.linalg.inv(self.linear)
        world[:, :2] = world[:, :2] @ (back * self.scale).T
        side = other_side(found.side) if self.mirrored else found.side
        return HandDetection(side, found.score, self.points_to_picture(found.keypoints), world)

    def points_to_picture(self, points: np.ndarray) -> np.ndarray:
        """(21, 3) points of the view with their depth, in its pixels -> of the picture, in its pixels."""
        plane = (points[:, :2] - self.offset) @ np.linalg.inv(self.linear).T
        return np.column_stack([plane, points[:, 2] / self.scale])
