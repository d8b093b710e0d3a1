"""What one dragged point may move: other fingers only where the palm must follow."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from handfit_core.common.skeleton import JOINTS_BY_FINGER, PALM_KEYPOINTS, SIDES
from handfit_core.edit import RefineHand, refit_each
from handfit_core.edit.settings import PINS
from handfit_core.fit.settings import TERMS
from handfit_core.geometry.rotations import rotmat_to_rotvec
from handfit_core.hand_model.anatomy import anatomical_axes, joint_limits, rotmats_from_angles
from handfit_core.hand_model.motion import HandMotion
from handfit_core.hand_model.surface import FINGER_OF_BONE, PAIRS, surface_of
from handfit_core.hand_model.surface import PALM as PALM_BONES
from tests.core.edit.hands import distance, drag, locked, missed, moved, photo, shown
from tests.core.fit.detections import model_of

FEW = 4, 8, 11, 18
"""Keypoints that are dragged every day; the others are slow together"""

LEAST = 0.01
"""of the hand's size: what other fingers may always move by"""


def hands() -> Iterator[RefineHand]:
    """Two of each side, bent, spread and turned at random."""
    return (photo(side, seed, row) for side in SIDES for seed, row in ((1, 1), (8, 2)))


def keypoints(*all_of_them: int) -> list[Any]:
    return [point if point in FEW else pytest.param(point, marks=pytest.mark.slow) for point in all_of_them]


def size_of(hand: RefineHand) -> float:
    """pixels"""
    return float(np.ptp(shown(hand), axis=1).max())


def drags(keypoint: int) -> Iterator[tuple[RefineHand, float]]:
    """Hands that are dragged near and far, in directions that differ, and how far in parts of their size."""
    for number, hand in enumerate(hands()):
        for step, far in enumerate((0.02, 0.1, 0.3, 0.9)):
            angle = 1.57 * number + 0.4 * step + keypoint
            by = far * size_of(hand) * np.array([np.cos(angle), np.sin(angle)])
            yield drag(hand, {keypoint: by}), far


def others(keypoint: int) -> list[int]:
    """The points of other fingers."""
    return [p for p in range(1, 21) if (p - 1) // 4 != (keypoint - 1) // 4]


def pressed(hand: RefineHand, keypoint: int, found: HandMotion) -> bool:
    """Whether the finger lies on another part of the hand, which keeps it from its pin: a sigma deeper than
    flesh gives, and than before, where fingers that are side by side may press each other."""
    surface = surface_of(model_of(hand.side))
    own = (FINGER_OF_BONE[PAIRS] == (keypoint - 1) // 4) & (PAIRS < PALM_BONES)
    capsules = (surface.of(hand.betas[None], one.hand_pose) for one in (hand, found))
    gaps = (surface.near(each, within=np.inf).gap for each in capsules)
    before, now = (np.where(own.any(axis=1), -gap, 0.0) for gap in gaps)
    return bool((now > np.maximum(before, TERMS.compression) + TERMS.edit_penetration_sigma).any())


@pytest.mark.parametrize("finger", range(5))
def test_what_a_finger_can_reach_it_reaches_alone(finger: int) -> None:
    """Pins are where its points are in another pose of this finger that a person can bend it to."""
    joints, rng, tried = JOINTS_BY_FINGER[finger] - 1, np.random.default_rng(finger), 0
    for hand in hands():
        limits, axes = joint_limits(hand.side), anatomical_axes(model_of(hand.side))[joints]
        for keypoint in range(4 * finger + 2, 4 * finger + 5):
            share = rng.uniform([0.4, 0.4, 0.1], [0.6, 0.6, 0.8], (3, 3))  # twist, spread, bend
            angles = limits.lower[joints] + share * (limits.upper - limits.lower)[joints]
            pose = hand.hand_pose.reshape(15, 3).copy()
            pose[joints] = rotmat_to_rotvec(rotmats_from_angles(angles, axes))
            bent = replace(hand, hand_pose=pose.reshape(1, 45))
            if not pressed(hand, keypoint, bent):
                tried += 1
                dragged = drag(hand, {keypoint: (shown(bent) - shown(hand))[0, keypoint]})
                found = refit_each(dragged)
                assert missed(dragged, found) < 1.0
                assert moved(hand, found)[others(keypoint)].max() < LEAST * size_of(hand)
    assert tried > 6


@pytest.mark.parametrize("keypoint", keypoints(*np.setdiff1d(np.arange(21), PALM_KEYPOINTS)))
def test_other_fingers_stay(keypoint: int) -> None:
    """And where the finger falls short of its pin, they move by about as much, riding on the palm unbent.
    Points nearer to the camera than the pinned one move farther in the picture."""
    judged = 0
    for hand, _ in drags(keypoint):
        found = refit_each(hand)
        bent = (found.hand_pose != hand.hand_pose).reshape(5, 9).any(axis=1)  # fingers in MANO's order
        assert bent.sum() <= 1
        if not pressed(hand, keypoint, found):
            judged += 1
            short = missed(hand, refit_each(replace(hand, locked=locked(0)))).item()
            assert moved(hand, found)[others(keypoint)].max() <= LEAST * size_of(hand) + 2.0 * short
            assert missed(hand, found) < (1.0 if short < 1.0 else 0.03 * size_of(hand))
    assert judged >= 8  # of 16


@pytest.mark.parametrize("keypoint", keypoints(*range(21)))
def test_answers_do_not_hang_on_rounding(keypoint: int) -> None:
    """A pin that is moved by less than any picture shows changes no more than that; but for what is dragged
    out of its place altogether: a palm has several to turn to, and a finger that is pressed on another may
    slip to one side of it or the other. Nor where the finger hardly reaches its pin or not. Points of the
    palm take it along to their pins."""
    for hand, far in list(drags(keypoint))[keypoint % 3 :: 3]:
        found, other = refit_each(hand), refit_each(replace(hand, pins=hand.pins + 1e-4))
        assert keypoint not in PALM_KEYPOINTS or far > 0.2 or missed(hand, found) < 1.0
        lost = far > 0.5 and (keypoint in PALM_KEYPOINTS or pressed(hand, keypoint, found))
        if not lost and abs(missed(hand, found) - PINS.reached_pixels) > 0.1:
            assert distance(shown(found), shown(other)).max() < max(1.0, 0.01 * size_of(hand))


@pytest.mark.parametrize("onto", [2, 3, 4])
def test_drag_over_thumb(onto: int) -> None:
    for hand in hands():
        surface, way = surface_of(model_of(hand.side)), (shown(hand)[0, onto] - shown(hand)[0, 8])
        for share in (0.8, 1.0, 1.2):
            dragged = drag(hand, {8: share * way})
            found = refit_each(dragged)
            assert surface.depths(surface.of(hand.betas[None], found.hand_pose))[0] < 0.003
            assert missed(dragged, found) < 0.02 * size_of(hand)
