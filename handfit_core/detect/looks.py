"""Several looks at one hand: squares cut from the picture, what a detector finds in them, which looks agree,
and their mean."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from handfit_core.detect.detector import Backend, Detector, DetectorSettings
from handfit_core.detect.keypoints import HandDetection
from handfit_core.skeleton import SIDES, other_side

SAME_HAND = 0.25
"""Two detections of one picture nearer than this (see `distance`) are looks at one hand."""

AGREEMENT = 0.2
"""Second looks at one hand that are nearer than this agree on it."""


def distance(a: HandDetection, b: HandDetection, moved: np.ndarray | float = 0.0) -> float:
    """Mean keypoint distance in the picture, in units of the hands' size, once `a` has `moved` by (2,)
    pixels."""
    size = max(a.extent, b.extent, 1e-9)
    return float(np.mean(np.linalg.norm(a.keypoints_2d + moved - b.keypoints_2d, axis=-1))) / size


def nearest(hand: HandDetection, others: Sequence[HandDetection], limit: float) -> HandDetection | None:
    """The nearest of `others`, unless it is `limit` or more away."""
    found = min(others, key=lambda other: distance(hand, other), default=None)
    return found if found is not None and distance(hand, found) < limit else None


def largest_agreement(looks: Sequence[Sequence[HandDetection]]) -> list[HandDetection]:
    """The most detections, one of each look, that agree with one of them."""
    best: list[HandDetection] = []
    for centre in (hand for look in looks for hand in look):
        group = [near for look in looks if (near := nearest(centre, look, AGREEMENT)) is not None]
        if len(group) > len(best):
            best = group
    return best


def mean_of(hands: Sequence[HandDetection], looks: int) -> HandDetection:
    """One detection from those of one hand in `looks` looks.

    Keypoints and world landmarks are averaged. The side is voted for, each look by its score; the score
    is what that side got per look, so that looks that saw nothing, or the other side, lower it.
    """
    votes = {side: sum(hand.score for hand in hands if hand.side == side) for side in SIDES}
    side = max(SIDES, key=lambda s: votes[s])
    keypoints = np.array([hand.keypoints for hand in hands])
    return HandDetection(
        side=side,
        score=votes[side] / max(looks, len(hands)),
        keypoints=keypoints.mean(axis=0),
        world=np.mean([hand.world for hand in hands], axis=0),
        spread=keypoints.std(axis=0) if len(hands) > 1 else None,
    )


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


SECOND_THRESHOLD = 0.15
"""Far lower than for a first look. One look is therefore never believed: two must agree."""

PASSES = 3
"""How often the landmark network sees a view, each time cut out and turned by its own last landmarks. On
rendered hands that the plain detector misses, the third has a tenth less PA-MPJPE than the first."""

_BLANK = np.full((64, 64, 3), 128, dtype=np.uint8)
_MOST_BLANKS = 3


class SecondLook:
    """Looks at views of pictures, each by itself, for hands that the plain detector finds nothing of: with a
    lower threshold, and landmarks that are found again from where they were. `close` it after use.

    The detector's following of a hand over a video does the passes: the same view is shown several times,
    after blank pictures in which it loses what it followed before.

    Raises LandmarkModelError when the model file is missing or damaged.
    """

    def __init__(
        self,
        backend: Backend,
        settings: DetectorSettings,
        *,
        max_hands: int | None,
        threshold: float = SECOND_THRESHOLD,
    ) -> None:
        self._following: Detector = backend.open(
            replace(settings, video=True, max_hands=max_hands, threshold=threshold)
        )

    def close(self) -> None:
        """Give the detector's threads and memory back."""
        self._following.close()

    def look(self, rgb: np.ndarray, view: View) -> tuple[HandDetection, ...]:
        """The hands of a picture (H, W, 3) uint8 RGB that `view` shows, in the picture's pixels, after
        all passes."""
        passes = self.passes(rgb, view, PASSES)
        return passes[-1] if len(passes) == PASSES else ()

    def passes(self, rgb: np.ndarray, view: View, count: int) -> list[tuple[HandDetection, ...]]:
        """What each of `count` passes found; the first that finds nothing is the last."""
        for _ in range(_MOST_BLANKS):
            if not self._following.find(_BLANK):
                break
        shown = view.render(rgb)
        passes: list[tuple[HandDetection, ...]] = []
        while len(passes) < count and (found := self._following.find(shown)):
            passes.append(tuple(view.to_picture(hand) for hand in found))
        return passes


MOVED = 0.8
"""A hand is found again nearer than this to where it was seen, in units of its size."""

_CROPS_AROUND = ((2.0, 45, False), (2.0, -45, True), (3.0, 45, False), (3.0, -45, True), (2.5, 0, False))
"""Side in units of the hand's size, turn in degrees, mirrored. Turned ones see many hands that upright ones
do not; the wide ones, hands of which only a part was seen before."""


def look_again(rgb: np.ndarray, seen: HandDetection, second: SecondLook) -> HandDetection | None:
    """The hand of a picture (H, W, 3) uint8 RGB near where it was `seen`, if two looks agree on it."""
    looks: list[list[HandDetection]] = []
    for span, degrees, mirrored in _CROPS_AROUND:
        view = square_about(seen, span, CROP_SIZE, turn=np.radians(degrees), mirrored=mirrored)
        hand = nearest(seen, second.look(rgb, view), MOVED)
        looks.append([] if hand is None else [hand])
        group = largest_agreement(looks)
        if len(group) == 2:
            return mean_of(group, len(looks))
    return None


AVERAGED_SPAN = 2.0
"""Side of a crop in units of the hand's size"""

AVERAGED_PASSES = 2
"""Looks at that crop. The first errs less on easy hands, the second on hard ones, which it holds askew"""


def averaged(rgb: np.ndarray, hand: HandDetection, second: SecondLook) -> HandDetection:
    """The hand's mean over looks at the picture (H, W, 3) uint8 RGB, with the spread of its keypoints.

    Looked at is one mirrored crop, since the networks err on left and right hands differently; it has most of
    what more crops gain. Passes that show nothing, or another hand, are left out.
    """
    view = square_about(hand, AVERAGED_SPAN, CROP_SIZE, mirrored=True)
    again = (nearest(hand, found, SAME_HAND) for found in second.passes(rgb, view, AVERAGED_PASSES))
    return mean_of([hand, *(look for look in again if look is not None)], 1 + AVERAGED_PASSES)
