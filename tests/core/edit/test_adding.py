"""Hands that a person lays into a picture: where they lie, and what a few points make of them."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from handfit_core.edit import RefineHand, from_message, landmark_points, refit_each, refit_range, to_message
from handfit_core.edit.adding import KNUCKLE, WRIST, Seen, laid, with_added
from handfit_core.errors import OptionError, ProtocolError
from handfit_core.evaluate.metrics import similarity_aligned_distances
from handfit_core.fit.settings import TERMS
from handfit_core.geometry.camera import Intrinsics
from handfit_core.geometry.rotations import rotmat_to_rotvec, rotvec_to_rotmat
from handfit_core.hand_model.anatomy import (
    anatomical_angles,
    anatomical_axes,
    relaxed_pose,
)
from handfit_core.hand_model.files import kept_model
from handfit_core.skeleton import SIDES, Side
from handfit_core.take import Take
from scripts.benchmark.kinematics import MIRROR_ROTVEC, RightHand, hand_pose_from_angles
from scripts.benchmark.poses import random_pose
from tests.core.edit.test_refit import shown
from tests.core.fit.detections import CAMERA, columns, ends_of_range
from tests.takes import take_of, track_of

POINTS = {3: [WRIST, KNUCKLE, 4], 4: [WRIST, KNUCKLE, 8, 20], 5: [WRIST, KNUCKLE, 4, 8, 20]}
POINTS[6] = [*POINTS[5], 12]
"""In an order in which an artist would put them in place"""
KINDS = ("open", "relaxed", "fist", "point", "pinch")


@cache
def posed(side: Side) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Poses (N, 3), (N, 45), (N, 3) of all KINDS, each seen from its back, its palm, obliquely and from
    between, fingers up, sideways and down."""
    rng = np.random.default_rng(11)
    upright = rotvec_to_rotmat(np.array([-np.pi / 2, 0.0, 0.0]))
    orients, poses = [], []
    for kind in KINDS:
        for about in (0.0, 35.0, 120.0, 180.0, 215.0, 300.0):
            pose = hand_pose_from_angles(random_pose(kind, RightHand(np.zeros(10)), rng), side)
            turned = rotvec_to_rotmat(np.radians([0.0, about, 0.0])) @ upright
            turn = rotvec_to_rotmat(np.radians([20.0 * rng.normal(), 0.0, rng.uniform(-120.0, 120.0)]))
            orients.append(rotmat_to_rotvec(turn @ turned) * (1.0 if side == "right" else MIRROR_ROTVEC))
            poses.append(pose)
    transl = np.tile([0.02, -0.01, 0.6], (len(poses), 1))
    return np.array(orients), np.array(poses), transl


def seen(side: Side) -> tuple[np.ndarray, np.ndarray]:
    """Those hands' landmarks, metres and pixels."""
    points = landmark_points(kept_model("open-hand", side), np.zeros(10), *posed(side))
    return points, CAMERA.project(points)


def added(side: Side, pixels: np.ndarray, pinned: list[int], **fields: object) -> RefineHand:
    """A hand laid over its wrist and knuckle in the picture, with points (21, 2) put in place."""
    pose = laid(kept_model("open-hand", side), CAMERA, pixels[WRIST], pixels[KNUCKLE])
    pins = np.full((1, 21, 2), np.nan)
    pins[0, pinned] = pixels[pinned]
    arrays = (array[None] for array in pose)
    unlocked = np.zeros(16, dtype=bool)
    hand = RefineHand(side, np.zeros(10), *arrays, CAMERA, columns([None]), pins, unlocked, added=True)
    return replace(hand, **fields)


def points_of(hand: RefineHand, found: object) -> np.ndarray:
    arrays = (getattr(found, name) for name in ("global_orient", "hand_pose", "transl"))
    return landmark_points(kept_model("open-hand", hand.side), hand.betas, *arrays)[0]


def aligned_error(points: np.ndarray, truth: np.ndarray) -> float:
    """PA-MPJPE in millimetres."""
    return 1000.0 * float(similarity_aligned_distances(points[None], truth[None]).mean())


@pytest.mark.parametrize("side", SIDES)
@pytest.mark.parametrize("view", ["back", "palm"])
@pytest.mark.parametrize("towards", [(0.0, -80.0), (50.0, 20.0), (-7.0, 30.0)])
def test_a_hand_is_laid_where_it_was_drawn(side: Side, view: Seen, towards: tuple[float, float]) -> None:
    camera = Intrinsics(700.0, 650.0, 300.0, 260.0)
    wrist = np.array([410.0, 130.0])
    model = kept_model("open-hand", side)
    orient, pose, transl = laid(model, camera, wrist, wrist + towards, view)
    points = landmark_points(model, np.zeros(10), orient[None], pose[None], transl[None])
    pixels = camera.project(points)[0]
    np.testing.assert_allclose(pixels[[WRIST, KNUCKLE]], [wrist, wrist + towards], atol=1e-6)
    np.testing.assert_allclose(pose, 0.5 * relaxed_pose(model))
    # From the little finger's knuckle to the index finger's, as one looks at the hand with fingers up.
    along, across = pixels[KNUCKLE] - pixels[WRIST], pixels[5] - pixels[17]
    to_the_right = along[0] * across[1] - along[1] * across[0] > 0
    assert to_the_right == ((side == "left") == (view == "back"))


@pytest.mark.parametrize("knuckle", [(30.0, 40.0), (30.2, 40.0), (np.nan, 0.0)])
def test_a_hand_needs_a_size(knuckle: tuple[float, float]) -> None:
    with pytest.raises(OptionError, match="drag from its wrist"):
        laid(kept_model("open-hand", "left"), CAMERA, np.array([30.0, 40.0]), np.array(knuckle))


@pytest.mark.parametrize("side", SIDES)
def test_more_points_better_poses(side: Side) -> None:
    truth, pixels = seen(side)
    alone = [
        aligned_error(points_of(h := added(side, p, []), h), t) for p, t in zip(pixels, truth, strict=True)
    ]
    errors, left = {0: float(np.mean(alone))}, []
    for count, pinned in POINTS.items():
        found = []
        for place, true in zip(pixels, truth, strict=True):
            hand = added(side, place, pinned)
            result = refit_each(hand)
            away = np.linalg.norm(shown(result)[0] - place, axis=1)[pinned].max()
            left.append(away / np.ptp(place, axis=0).max())
            found.append(aligned_error(points_of(hand, result), true))
        errors[count] = float(np.mean(found))
    # Of the hand's size; a fist seen from its edge may end where the way is blocked by joints.
    assert np.percentile(left, 95) < 0.005
    assert max(left) < 0.03
    assert errors[3] < 1.1 * errors[0]
    assert errors[4] < 0.9 * errors[0]
    assert errors[5] < 0.75 * errors[0]
    assert errors[6] < 0.55 * errors[0]


@pytest.mark.parametrize("side", SIDES)
def test_poses_are_what_a_hand_can_do(side: Side) -> None:
    model = kept_model("open-hand", side)
    lower, upper = ends_of_range(side)
    for place in seen(side)[1]:
        result = refit_each(added(side, place, POINTS[6]))
        rotations = rotvec_to_rotmat(result.hand_pose[0].reshape(15, 3))
        angles = anatomical_angles(rotations, anatomical_axes(model))
        assert np.all(angles < upper + TERMS.step_margin + 1e-6)
        assert np.all(angles > lower - TERMS.step_margin - 1e-6)


@pytest.mark.parametrize("side", SIDES)
def test_visible_side_follows_points(side: Side) -> None:
    """Thumb and little finger tell palm from back, however the hand was laid."""
    truth = rotvec_to_rotmat(posed(side)[0])[:, :, 1]
    turned = [
        rotvec_to_rotmat(refit_each(added(side, place, POINTS[5])).global_orient[0])[:, 1] @ back > 0
        for place, back in zip(seen(side)[1], truth, strict=True)
    ]
    assert np.mean(turned) > 0.9


def test_path_does_not_count() -> None:
    """A draft comes near to what is kept, and neither depends on an answer before."""
    place = seen("right")[1][8]
    hand = added("right", place, POINTS[6])
    kept = refit_each(hand)
    other = refit_each(added("right", place + 40.0, POINTS[3]))
    np.testing.assert_array_equal(
        refit_each(hand, other, draft=True).transl, refit_each(hand, draft=True).transl
    )
    away = np.linalg.norm(shown(refit_each(hand, draft=True)) - shown(kept), axis=-1)
    assert away.mean() < 0.1 * np.ptp(place, axis=0).max()


def test_fingers_without_points() -> None:
    """Of a fist, index and little fingertips are enough for the two between them."""
    model = kept_model("open-hand", "right")
    axes = anatomical_axes(model)
    fist = seen("right")[1][12:18]

    def bend(pinned: list[int]) -> float:
        poses = np.array([refit_each(added("right", p, pinned)).hand_pose[0] for p in fist])
        angles = anatomical_angles(rotvec_to_rotmat(poses.reshape(-1, 15, 3)), axes)
        return float(np.degrees(angles[:, [3, 4, 9, 10], 2].mean()))

    assert bend(POINTS[5]) > bend(POINTS[3]) + 15.0


def test_locked_joints_stay() -> None:
    place = seen("left")[1][3]
    locked = np.zeros(16, dtype=bool)
    locked[[4, 5, 6]] = True
    hand = added("left", place, POINTS[5], locked=locked)
    found = refit_each(hand)
    np.testing.assert_array_equal(found.hand_pose[0, 9:18], hand.hand_pose[0, 9:18])
    locked[0] = True
    whole = refit_each(replace(hand, locked=locked))
    np.testing.assert_array_equal(whole.global_orient, hand.global_orient)
    np.testing.assert_array_equal(whole.transl, hand.transl)
    assert np.any(whole.hand_pose != hand.hand_pose)


def test_one_palm_point() -> None:
    """In another frame of a clip a hand holds: a fingertip that is dragged there bends its finger alone."""
    place = seen("right")[1][0]
    hand = added("right", place, [])
    at = shown(refit_each(hand))[0, 8]
    pins = hand.pins.copy()
    pins[0, 8] = at + [4.0, 6.0]
    found = refit_each(replace(hand, pins=pins))
    np.testing.assert_array_equal(found.transl, hand.transl)
    np.testing.assert_array_equal(found.hand_pose[0, 9:], hand.hand_pose[0, 9:])
    assert np.linalg.norm(shown(found)[0, 8] - pins[0, 8]) < 0.5


def test_frames_between_two_are_filled() -> None:
    """Re-fit Range: between two frames with points, half a second apart at most, the hand moves evenly."""
    place = seen("right")[1][0]
    one = refit_each(added("right", place, POINTS[6]))
    other = refit_each(added("right", place + [30.0, 0.0], POINTS[6]))
    rows = np.array([0, 5])
    arrays = {}
    for name in ("global_orient", "hand_pose", "transl"):
        arrays[name] = np.full((6, *getattr(one, name).shape[1:]), np.nan)
        arrays[name][rows] = getattr(one, name)[0], getattr(other, name)[0]
    pins = np.full((6, 21, 2), np.nan)
    pins[0, POINTS[6]], pins[5, POINTS[6]] = place[POINTS[6]], (place + [30.0, 0.0])[POINTS[6]]
    hand = replace(added("right", place, []), pins=pins, **arrays)
    found = refit_range(hand)
    assert found.present.all()
    assert np.all(np.diff(shown(found)[:, KNUCKLE, 0]) > 0)


def test_messages_of_added_hands() -> None:
    hand = added("left", seen("left")[1][0], POINTS[3])
    message = json.loads(json.dumps(to_message(hand), allow_nan=False))
    assert from_message(message).added
    assert not from_message({name: v for name, v in message.items() if name != "added"}).added
    with pytest.raises(ProtocolError, match="added must be true or false"):
        from_message({**message, "added": 1})


@pytest.mark.parametrize("side", SIDES)
def test_a_take_gets_one_more_hand(side: Side, tmp_path: Path) -> None:
    still, pose = np.zeros((3, 3)), np.zeros((3, 45))
    first = track_of("right", still, pose, np.tile([0.0, 0.0, 0.6], (3, 1)), CAMERA)
    take = take_of([first], CAMERA, 640, 480)
    wrist, knuckle = np.array([200.0, 300.0]), np.array([220.0, 210.0])
    path = with_added(take, kept_model("open-hand", side), 1, wrist, knuckle).save(tmp_path / "t.npz")
    kept, hand = Take.load(path).hands
    assert kept.placed is None
    assert not kept.added
    assert hand.added
    assert hand.refinable
    assert (hand.side, len(hand.detections())) == (side, 0)
    np.testing.assert_array_equal(hand.present, [False, True, False])
    assert hand.placed is not None
    np.testing.assert_array_equal(hand.placed[1, [WRIST, KNUCKLE]], [wrist, knuckle])
    assert np.isfinite(hand.placed).sum() == 4
    np.testing.assert_allclose(CAMERA.project(hand.joints_3d)[1, KNUCKLE], knuckle, atol=1.0)
