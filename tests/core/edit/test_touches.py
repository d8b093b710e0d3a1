"""Points that a person brings together: skins meet there, and nothing else moves."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

from handfit_core.edit import (
    RefineHand,
    from_message,
    gaps_between,
    refit_each,
    refit_range,
    to_message,
    touching_pair,
)
from handfit_core.errors import OptionError
from handfit_core.geometry.rotations import rotmat_to_rotvec, rotvec_to_rotmat
from handfit_core.hand_model.motion import POSE_ARRAYS, HandMotion
from handfit_core.hand_model.surface import surface_of
from handfit_core.skeleton import FINGER_JOINTS, FINGERS, SIDES, Side, can_touch
from tests.core.edit.test_refit import make_hand, no_pins, shown, true_hands, unlocked
from tests.core.fit.detections import landmarks_of, model_of, seen

COUNT = 24
FIRST, LAST = 8, 15
TOUCHES = 0.001
"""metres"""
PAIRS = ((4, 8), (4, 20), (6, 4), (12, 0), (14, 4), (8, 12))


def touches(count: int, pair: Sequence[int], rows: Any = slice(None)) -> np.ndarray:
    found = np.full((count, 21), np.nan)
    first, second = touching_pair(*pair)
    found[rows, first] = second
    return found


@cache
def moving(side: Side = "right") -> RefineHand:
    """A hand that bends slowly, as captured, and as a detector sees it."""
    betas, orient, pose, transl = true_hands(side, 2, seed=1)
    share = (1.0 - np.cos(np.arange(COUNT) / 6.0))[:, None] / 2.0
    still = np.repeat(orient[:1], COUNT, axis=0), np.repeat(transl[:1], COUNT, axis=0)
    clip = np.repeat(betas[:1], COUNT, axis=0), still[0], (1.0 - share) * pose[0] + share * pose[1], still[1]
    points = landmarks_of(side, *clip)
    return make_hand(side, [seen(row, side, noise=1.0, seed=n) for n, row in enumerate(points)], clip)


def gaps(hand: RefineHand, pair: Sequence[int], found: HandMotion) -> np.ndarray:
    return gaps_between(model_of(hand.side), hand.betas, found.hand_pose, touching_pair(*pair))


def turned(hand: RefineHand, found: HandMotion) -> np.ndarray:
    """(T, 15) radians by which joints differ from the pose that they had."""
    before, after = (rotvec_to_rotmat(one.hand_pose.reshape(-1, 15, 3)) for one in (hand, found))
    return np.linalg.norm(rotmat_to_rotvec(before.swapaxes(-1, -2) @ after), axis=-1)


def of_fingers(pair: Sequence[int]) -> np.ndarray:
    """(15,) bool: the joints of the fingers that a pair may move."""
    own = [
        joint - 1
        for point in pair
        if point % 4 != 1 and point
        for joint in FINGER_JOINTS[FINGERS[(point - 1) // 4]]
    ]
    return np.isin(np.arange(15), own)


@pytest.mark.parametrize("side", SIDES)
@pytest.mark.parametrize("pair", PAIRS)
def test_skins_meet_and_nothing_else_moves(side: Side, pair: tuple[int, int]) -> None:
    hand = moving(side)
    assert np.abs(gaps(hand, pair, hand)).max() > 5.0 * TOUCHES
    found = refit_each(replace(hand, touches=touches(COUNT, pair)))
    assert np.abs(gaps(hand, pair, found)).max() < TOUCHES
    moved = turned(hand, found)
    assert moved[:, ~of_fingers(pair)].max() == 0.0
    for name in ("global_orient", "transl"):
        np.testing.assert_array_equal(getattr(found, name), getattr(hand, name))
    surface = surface_of(model_of(side))
    betas = np.repeat(hand.betas[None], COUNT, axis=0)
    before, after = (surface.depths(surface.of(betas, one.hand_pose)) for one in (hand, found))
    assert (after < np.maximum(before, 0.003) + 0.001).all()


def test_gaps_are_those_of_the_mesh() -> None:
    """Tips that touch do so within the skin's thickness by vertices, too."""
    hand, pair = moving(), (8, 4)
    found = refit_each(replace(hand, touches=touches(COUNT, pair)))
    model = model_of("right")
    owner = model.weights.argmax(axis=1)
    meshes = model.posed(hand.betas, found.global_orient, found.hand_pose, found.transl).vertices
    for vertices in meshes[::6]:
        first, second = (vertices[owner == FINGER_JOINTS[name][2]] for name in ("thumb", "index"))
        assert np.linalg.norm(first[:, None] - second, axis=-1).min() < 0.004


def test_equal_frames_move_alike() -> None:
    """Also where many ways lead together: a step of what was turned is a small part of it."""
    hand, pair = moving(), (6, 4)
    moved = turned(hand, refit_each(replace(hand, touches=touches(COUNT, pair))))
    assert np.abs(np.diff(moved, axis=0)).max() < 0.5 * moved.max()


def test_other_frames_move_alone() -> None:
    """Each in its own way, whatever others of the same request need."""
    hand = moving()
    half = len(hand) // 2
    first, second = touches(len(hand), (8, 4), slice(half)), touches(len(hand), (20, 0), slice(half, None))
    both = refit_each(replace(hand, touches=np.where(np.isfinite(first), first, second)))
    alone = refit_each(replace(hand, touches=second))
    assert np.abs(both.hand_pose[half:] - alone.hand_pose[half:]).max() < 1e-6


def test_what_touches_already_hardly_moves() -> None:
    hand, pair = moving(), (8, 4)
    touching = touches(COUNT, pair)
    once = refit_each(replace(hand, touches=touching))
    again = replace(hand, hand_pose=once.hand_pose, touches=touching)
    assert turned(again, refit_each(again)).max() < np.radians(1.0)


def test_a_drag_takes_along_what_touches() -> None:
    hand, pair = moving(), (8, 4)
    pose = {name: getattr(hand, name)[:1] for name in POSE_ARRAYS}
    first = hand.detections.select(slice(1))
    one = replace(hand, detections=first, pins=no_pins(1), touches=touches(1, pair), **pose)
    start = refit_each(one)
    pins = no_pins(1)
    pins[0, 8] = shown(start)[0, 8] + [8.0, -6.0]
    held = replace(one, hand_pose=start.hand_pose, pins=pins)
    for found in (refit_each(held), refit_each(held, draft=True)):
        assert np.linalg.norm(shown(found)[0, 8] - pins[0, 8]) < 2.0
        assert np.abs(gaps(one, pair, found)).max() < TOUCHES
        assert turned(held, found)[0, ~of_fingers(pair)].max() < np.radians(2.0)


def test_locked_fingers_stay() -> None:
    hand, pair = moving(), (8, 4)
    locked = unlocked(*FINGER_JOINTS["thumb"])
    found = refit_each(replace(hand, locked=locked, touches=touches(COUNT, pair)))
    moved = turned(hand, found)
    assert moved[:, locked[1:]].max() == 0.0
    assert moved.max() > 0.0
    assert np.abs(gaps(hand, pair, found)).max() < np.abs(gaps(hand, pair, hand)).max()


def test_range_with_touches() -> None:
    hand, pair = moving(), (8, 4)
    within = touches(COUNT, pair, slice(FIRST, LAST + 1))
    plain, found = refit_range(hand), refit_range(replace(hand, touches=within))
    inside = np.isfinite(within).any(axis=1)
    assert np.abs(gaps(hand, pair, plain)[inside]).max() > 5.0 * TOUCHES
    assert np.abs(gaps(hand, pair, found)[inside]).max() < TOUCHES
    # Frames around lead there, those farther off stay.
    apart = np.abs(gaps(hand, pair, found) - gaps(hand, pair, plain))
    assert apart[[FIRST - 1, LAST + 1]].min() > 0.1 * np.abs(gaps(hand, pair, plain)[[FIRST, LAST]]).min()
    steps = [np.abs(np.diff(gaps(hand, pair, one))).max() for one in (plain, found)]
    assert steps[1] < steps[0] + 0.5 * np.abs(gaps(hand, pair, plain)).max()


@pytest.mark.parametrize(("one", "other"), [(8, 6), (5, 0), (8, 8), (1, 5), (13, 9), (21, 4), (-1, 4)])
def test_points_that_cannot_touch(one: int, other: int) -> None:
    with pytest.raises(OptionError, match=r"choose points of two fingers|points that touch are 0 to 20"):
        touching_pair(one, other)
    assert not can_touch(max(one, other), min(one, other))


@pytest.mark.parametrize("other", [9.0, 8.0, 7.0, 1.5, -1.0, np.inf])
def test_touches_that_are_none(other: float) -> None:
    wrong = touches(COUNT, (8, 4))
    wrong[3, 8] = other
    with pytest.raises(OptionError, match="touches: keypoint 8 must name a smaller one"):
        replace(moving(), touches=wrong)
    with pytest.raises(OptionError, match="touches has shape"):
        replace(moving(), touches=wrong[1:])


def test_messages_hold_touches() -> None:
    hand = replace(moving(), touches=touches(COUNT, (12, 0)))
    back = from_message(json.loads(json.dumps(to_message(hand), allow_nan=False)))
    assert back.touches is not None
    np.testing.assert_array_equal(back.touches, hand.touches)
    assert from_message(to_message(moving())).touches is None
