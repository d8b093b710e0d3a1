"""Points that a person brings together: skins meet there, and nothing else moves."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

from handfit_core.common.skeleton import FINGER_JOINTS, JOINTS_BY_FINGER, SIDES, Side
from handfit_core.edit import (
    RefineHand,
    gaps_between,
    landmark_points,
    lying_over,
    refit_each,
    refit_range,
    touching_pair,
)
from handfit_core.edit.corrections import point_rows
from handfit_core.edit.pins import hand_sizes
from handfit_core.geometry.rotations import rotmat_to_rotvec
from handfit_core.hand_model.anatomy import anatomical_axes, rotmats_from_angles
from handfit_core.hand_model.motion import HandMotion
from handfit_core.hand_model.surface import surface_of
from tests.core.edit.hands import (
    distance,
    drag,
    locked,
    missed,
    posed,
    rows_of,
    shown,
    to_refine,
    true_hands,
    turned,
)
from tests.core.fit.detections import detections_of, model_of

COUNT, FIRST, LAST = 16, 6, 10
PAIR = (8, 4)


@cache
def moving(side: Side = "right") -> RefineHand:
    """A hand that bends slowly, as captured, and as a detector sees it."""
    two = true_hands(side, 2, seed=1)
    share = (1.0 - np.cos(np.arange(COUNT) / 4.0))[:, None] / 2.0
    orient, transl = (np.repeat(rows[:1], COUNT, axis=0) for rows in (two.global_orient, two.transl))
    motion = two.with_pose(orient, (1.0 - share) * two.hand_pose[0] + share * two.hand_pose[1], transl)
    return to_refine(motion, detections_of(side, rows_of(motion), noise=1.0))


def touching(hand: RefineHand, pair: Sequence[int] = PAIR, rows: Any = slice(None)) -> RefineHand:
    touches = np.full((len(hand), 21), np.nan)
    first, second = touching_pair(*pair)
    touches[rows, first] = second
    return replace(hand, touches=touches)


def gaps(found: HandMotion, pair: Sequence[int] = PAIR) -> np.ndarray:
    """(T,) millimetres"""
    gap = gaps_between(model_of(found.side), found.betas, found.hand_pose, touching_pair(*pair))
    return 1000.0 * np.abs(gap)


def beyond(pair: Sequence[int]) -> np.ndarray:
    """(15,) bool: the joints that a pair may not move."""
    fingers = [(point - 1) // 4 for point in pair if point and point % 4 != 1]
    return ~np.isin(np.arange(1, 16), JOINTS_BY_FINGER[fingers])


@pytest.mark.parametrize("side", SIDES)
@pytest.mark.parametrize("pair", [(4, 20), (6, 4), (12, 0), (8, 12)])
def test_skins_meet_and_nothing_else_moves(side: Side, pair: tuple[int, int]) -> None:
    hand = moving(side)
    found = refit_each(touching(hand, pair))
    assert gaps(hand, pair).max() > 5.0
    assert gaps(found, pair).max() < 1.0
    moved = turned(hand, found)
    assert moved[:, beyond(pair)].max() == 0.0
    for name in ("global_orient", "transl"):
        np.testing.assert_array_equal(getattr(found, name), getattr(hand, name))
    surface = surface_of(model_of(side))
    betas = np.repeat(hand.betas[None], COUNT, axis=0)
    before, after = (surface.depths(surface.of(betas, one.hand_pose)) for one in (hand, found))
    assert (after < np.maximum(before, 0.003) + 0.001).all()
    # Frames that are nearly equal move alike, also where many ways lead together.
    assert np.abs(np.diff(moved, axis=0)).max() < 0.5 * moved.max()


def test_gaps_are_those_of_the_mesh() -> None:
    """Tips that touch do so within the skin's thickness by vertices, too."""
    found, model = refit_each(touching(moving())), model_of("right")
    owner = model.weights.argmax(axis=1)
    for vertices in model.posed(found.betas, *found.pose).vertices[::6]:
        first, second = (vertices[owner == FINGER_JOINTS[name][2]] for name in ("thumb", "index"))
        assert np.linalg.norm(first[:, None] - second, axis=-1).min() < 0.004


def test_other_frames_move_alone() -> None:
    """Each in its own way, whatever others of the same request need."""
    hand, half = moving(), COUNT // 2
    first = touching(hand, PAIR, slice(half))
    second = touching(hand, (20, 0), slice(half, None))
    both = refit_each(replace(hand, touches=np.fmax(first.touches, second.touches)))
    alone = refit_each(second)
    np.testing.assert_allclose(both.hand_pose[half:], alone.hand_pose[half:], atol=1e-6)


def test_what_touches_already_hardly_moves() -> None:
    once = touching(moving())
    once = replace(once, hand_pose=refit_each(once).hand_pose)
    assert turned(once, refit_each(once)).max() < 1.0


def test_a_drag_takes_along_what_touches() -> None:
    clip, at = moving(), slice(1)
    seen, pins = clip.detections.select(at), clip.pins[at]
    one = touching(posed(clip, *(rows[at] for rows in clip.pose), detections=seen, pins=pins))
    held = drag(replace(one, hand_pose=refit_each(one).hand_pose), {8: (8.0, -6.0)})
    for draft in (False, True):
        found = refit_each(held, draft=draft)
        assert missed(held, found).max() < 2.0
        assert gaps(found).max() < 1.0
        assert turned(held, found)[0, beyond(PAIR)].max() < 2.0


def test_locked_fingers_stay() -> None:
    thumb = locked(*FINGER_JOINTS["thumb"])
    hand = replace(touching(moving()), locked=thumb)
    found = refit_each(hand)
    assert turned(hand, found)[:, thumb[1:]].max() == 0.0
    assert 0.0 < gaps(found).max() < gaps(hand).max()


def over_each_other(hand: RefineHand | HandMotion) -> list[dict[int, int]]:
    pixels = moving().intrinsics.project(landmark_points(model_of("right"), hand.betas, *hand.pose))
    return lying_over(model_of("right"), hand.betas, np.asarray(hand.hand_pose), pixels)


def test_what_lies_over_each_other_is_pressed_together_in_the_picture() -> None:
    apart = moving()
    assert not any(over_each_other(apart))
    near = replace(apart, hand_pose=0.8 * refit_each(touching(apart)).hand_pose + 0.2 * apart.hand_pose)
    crossing = over_each_other(near)
    rows = np.flatnonzero([bool(of_row) for of_row in crossing])
    assert len(rows) > 5
    assert {abs(other) for row in rows for other in crossing[row].values()} <= {3, 4}
    _, touches = point_rows([{}] * COUNT, crossing)
    found = refit_each(replace(near, touches=touches))
    pairs = np.array([next(iter(crossing[row].items())) for row in rows])
    before, after = (
        np.abs(gaps_between(model_of("right"), one.betas, np.asarray(one.hand_pose)[rows], pairs))
        for one in (near, found)
    )
    assert before.max() > 0.003
    assert after.max() < 0.001
    shift, size = distance(shown(found), shown(near))[rows], hand_sizes(shown(near))[rows]
    assert (shift.max(axis=1) < 0.03 * size).all()


def test_fingertips_lie_on_the_palm_only_where_they_are_near_it() -> None:
    """A fist's, and not those of fingers that point at the camera."""
    model, clip = model_of("right"), moving()
    for bend, expected in ((1.5, {8: 0, 12: 0, 16: 0}), (0.0, {})):
        bends = np.tile([0.0, 0.0, bend], (15, 1)) * (np.arange(15) < 12)[:, None]
        pose = rotmat_to_rotvec(rotmats_from_angles(bends, anatomical_axes(model))).reshape(1, 45)
        pixels = clip.intrinsics.project(
            landmark_points(model, clip.betas, clip.global_orient[:1], pose, clip.transl[:1])
        )
        if bend == 0.0:
            pixels[0, [8, 12, 16, 20]] = pixels[0, [0, 5, 9, 13, 17]].mean(axis=0)
        assert lying_over(model, clip.betas, pose, pixels) == [expected]


def test_range_with_touches() -> None:
    hand = moving()
    plain, found = refit_range(hand), refit_range(touching(hand, PAIR, slice(FIRST, LAST + 1)))
    inside = slice(FIRST, LAST + 1)
    assert gaps(plain)[inside].max() > 5.0
    assert gaps(found)[inside].max() < 1.0
    # Frames around lead there.
    apart = np.abs(gaps(found) - gaps(plain))
    assert apart[[FIRST - 1, LAST + 1]].min() > 0.1 * gaps(plain)[[FIRST, LAST]].min()
    steps = [np.abs(np.diff(gaps(one))).max() for one in (plain, found)]
    assert steps[1] < steps[0] + 0.5 * gaps(plain).max()
