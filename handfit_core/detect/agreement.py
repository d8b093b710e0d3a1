"""Several looks at one hand: how far apart they are, which of them agree, and their mean."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from handfit_core.detect.keypoints import HandDetection
from handfit_core.skeleton import SIDES

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


def largest_agreement(looks: Sequence[Sequence[HandDetection]], limit: float) -> list[HandDetection]:
    """The most detections, one of each look, that lie within `limit` of one of them."""
    best: list[HandDetection] = []
    for centre in (hand for look in looks for hand in look):
        group = [near for look in looks if (near := nearest(centre, look, limit)) is not None]
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
