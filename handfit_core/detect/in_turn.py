"""Both landmark networks in turn: the fast one of December 2020 follows a hand in every frame, the present
one runs now and then, and what both see differently is interpolated between its runs.

That difference changes slowly, in sizes of the hand. It is taken again after `seconds`, sooner where it has
changed fast between the last two runs, where the hand's shape has changed, and where hands are near each
other.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Final, Self

import numpy as np

from handfit_core.common.skeleton import SIDES
from handfit_core.detect.keypoints import Detections
from handfit_core.detect.networks import average_sized


@dataclass(frozen=True)
class InTurnSettings:
    """When the present network runs beside the one of December 2020."""

    seconds: float = 6.0 / 30.0
    """Most seconds from one run of the present network to the next"""
    max_drift: float = 0.06
    """Sizes of the hand by which the difference between the networks may change until the next run, if it
    goes on changing as fast as before"""
    max_change: float = 0.05
    """Sizes of the hand, on average, by which its points may move about their mean until the present network
    runs again"""
    min_presence: float = 0.9
    """Presence by the network of December 2020, 0..1, below which the present network decides"""
    near: float = 1.0
    """Distance to another hand, in sizes of the hand, below which the present network runs in every frame"""


IN_TURN: Final = InTurnSettings()


@dataclass(frozen=True, eq=False)
class Difference:
    """What the present network sees of a hand beyond what the one of December 2020 does, in one frame."""

    time: float
    """Seconds by the source's clock at which both networks saw the hand"""
    lasts: float
    """Most seconds until the difference is to be taken again"""
    extent: float
    """Size of the hand in the picture in pixels, as the network of December 2020 sees it"""
    shape: np.ndarray
    """(21, 2) the points by the network of December 2020 about their mean, in sizes of the hand"""
    keypoints: np.ndarray
    """(21, 3) vectors from the points of the network of December 2020 to the present network's, in sizes of
    the hand"""
    world: np.ndarray
    """(21, 3) metres: vectors from the world landmarks of the network of December 2020 to the present
    network's"""
    right: float
    """Score of the right side by the present network, 0..1"""

    @classmethod
    def of(cls, hand: Detections, time: float, before: Self | None = None) -> Self:
        """Take the difference of a hand that both networks have seen at that time in seconds; `before` is the
        hand's last difference, None for its first."""
        points, by_2020 = hand.keypoints[0], _points_2020(hand)
        extent = _extent(by_2020)
        right = hand.side[0] == SIDES.index("right")
        keypoints, lasts = (points - by_2020) / extent, IN_TURN.seconds
        if before is not None:
            drift = float(np.linalg.norm(keypoints - before.keypoints, axis=-1).mean())
            lasts = min(lasts, (time - before.time) * IN_TURN.max_drift / max(drift, 1e-9))
        return cls(
            time=time,
            lasts=lasts,
            extent=extent,
            shape=_about_mean(by_2020) / extent,
            keypoints=keypoints,
            world=hand.world[0] - average_sized(by_2020),
            right=float(hand.score[0] if right else 1.0 - hand.score[0]),
        )

    def is_due(self, hand: Detections, time: float) -> bool:
        """Return True if the difference is to be taken again of a hand that the network of December 2020 sees
        at that time in seconds."""
        if time - self.time > self.lasts - 1e-3:
            return True
        return self._change(hand) > IN_TURN.max_change

    def _change(self, hand: Detections) -> float:
        """Return by how many sizes of the hand its points have moved about their mean, on average, since the
        difference was taken."""
        moved = _about_mean(_points_2020(hand)) / self.extent - self.shape
        return float(np.linalg.norm(moved, axis=-1).mean())

    def added_to(self, hand: Detections) -> Detections:
        """Return a hand that only the network of December 2020 has seen, as both networks are likely to see
        it."""
        by_2020 = _points_2020(hand)
        return replace(
            hand,
            side=np.array([SIDES.index("right" if self.right >= 0.5 else "left")]),
            score=np.array([max(self.right, 1.0 - self.right)]),
            keypoints=(by_2020 + _extent(by_2020) * self.keypoints)[None],
            world=(average_sized(by_2020) + self.world)[None],
        )

    def towards(self, other: Self, hand: Detections) -> Self:
        """Interpolate between this difference and another for the hand in a frame between their times, nearer
        to the one in which the hand's shape is more alike, which is a better guide than time."""
        since, until = self._change(hand) + 1e-9, other._change(hand) + 1e-9
        share = since / (since + until)
        values = {
            each.name: (1.0 - share) * getattr(self, each.name) + share * getattr(other, each.name)
            for each in fields(self)
        }
        return type(self)(**values)


def _points_2020(hand: Detections) -> np.ndarray:
    assert hand.keypoints_2020 is not None
    return hand.keypoints_2020[0]


def _extent(points: np.ndarray) -> float:
    return max(float(np.ptp(points[:, :2], axis=0).max()), 1e-9)


def _about_mean(points: np.ndarray) -> np.ndarray:
    return points[:, :2] - points[:, :2].mean(axis=0)
