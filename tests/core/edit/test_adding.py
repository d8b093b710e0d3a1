"""Hands that a person lays into a picture: where they lie, and what a few points make of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from handfit_core.common.errors import OptionError
from handfit_core.common.skeleton import SIDES, Side
from handfit_core.edit import RefineHand, landmark_points, refit_each, refit_range
from handfit_core.edit.adding import KNUCKLE, WRIST, Seen, laid, with_added
from handfit_core.evaluate.metrics import similarity_aligned_distances
from handfit_core.fit.settings import TERMS
from handfit_core.geometry.camera import Intrinsics
from handfit_core.geometry.rotations import rotmat_to_rotvec, rotvec_to_rotmat
from handfit_core.hand_model.anatomy import anatomical_angles, anatomical_axes, relaxed_pose
from handfit_core.hand_model.motion import HandMotion
from handfit_core.take import Take
from scripts.benchmark.kinematics import MIRROR_ROTVEC, RightHand, hand_pose_from_angles
from scripts.benchmark.poses import random_pose
from tests.core.edit.hands import distance, drag, locked, posed, shown, to_refine
from tests.core.fit.detections import CAMERA, ends_of_range, model_of
from tests.takes import take_of, track_of

POINTS = {0: [], 3: [WRIST, KNUCKLE, 4], 4: [WRIST, KNUCKLE, 8, 20], 5: [WRIST, KNUCKLE, 4, 8, 20]}
POINTS[6] = [*POINTS[5], 12]
"""In an order in which an artist would put them in place"""
KINDS = ("open", "relaxed", "fist", "point", "pinch")
FISTS = slice(12, 18)


@cache
def true_hands(side: Side) -> HandMotion:
    """Of all KINDS, each seen from its back, its palm, obliquely and from between, fingers up, sideways and
    down."""
    rng = np.random.default_rng(11)
    upright = rotvec_to_rotmat(np.array([-np.pi / 2, 0.0, 0.0]))
    orients, poses = [], []
    for kind in KINDS:
        for about in (0.0, 35.0, 120.0, 180.0, 215.0, 300.0):
            poses.append(hand_pose_from_angles(random_pose(kind, RightHand(np.zeros(10)), rng), side))
            turned = rotvec_to_rotmat(np.radians([0.0, about, 0.0])) @ upright
            turn = rotvec_to_rotmat(np.radians([20.0 * rng.normal(), 0.0, rng.uniform(-120.0, 120.0)]))
            orients.append(rotmat_to_rotvec(turn @ turned) * (1.0 if side == "right" else MIRROR_ROTVEC))
    transl = np.tile([0.02, -0.01, 0.6], (len(poses), 1))
    return HandMotion(side, np.zeros(10), np.array(orients), np.array(poses), transl)


def points_of(motion: HandMotion) -> np.ndarray:
    return landmark_points(model_of(motion.side), motion.betas, *motion.pose)


def added(side: Side, pixels: np.ndarray, pinned: Sequence[int] = ()) -> RefineHand:
    """A hand laid over its wrist and knuckle in the picture, with points (21, 2) put in place."""
    pose = laid(model_of(side), CAMERA, pixels[WRIST], pixels[KNUCKLE])
    pins = np.full((1, 21, 2), np.nan)
    pins[0, list(pinned)] = pixels[list(pinned)]
    motion = HandMotion(side, np.zeros(10), *(rows[None] for rows in pose))
    return to_refine(motion, [None], pins, added=True)


@cache
def posed_by(side: Side, count: int, step: int = 1) -> tuple[HandMotion, ...]:
    """What so many points make of every `step`th of the hands."""
    pictures = shown(true_hands(side))[::step]
    return tuple(refit_each(added(side, pixels, POINTS[count])) for pixels in pictures)


@pytest.mark.parametrize("side", SIDES)
@pytest.mark.parametrize("view", ["back", "palm"])
@pytest.mark.parametrize("towards", [(0.0, -80.0), (50.0, 20.0), (-7.0, 30.0)])
def test_a_hand_is_laid_where_it_was_drawn(side: Side, view: Seen, towards: tuple[float, float]) -> None:
    camera, wrist, model = Intrinsics(700.0, 650.0, 300.0, 260.0), np.array([410.0, 130.0]), model_of(side)
    orient, pose, transl = laid(model, camera, wrist, wrist + towards, view)
    points = landmark_points(model, np.zeros(10), orient[None], pose[None], transl[None])
    pixels = camera.project(points)[0]
    np.testing.assert_allclose(pixels[[WRIST, KNUCKLE]], [wrist, wrist + towards], atol=1e-6)
    np.testing.assert_allclose(pose, 0.5 * relaxed_pose(model))
    # From the little finger's knuckle to the index finger's, as one looks at the hand with fingers up.
    along, across = pixels[KNUCKLE] - pixels[WRIST], pixels[5] - pixels[17]
    to_the_right = along[0] * across[1] - along[1] * across[0] > 0
    assert to_the_right == ((side == "left") == (view == "back"))


@pytest.mark.parametrize("knuckle", [(30.2, 40.0), (np.nan, 0.0)])
def test_a_hand_needs_a_size(knuckle: tuple[float, float]) -> None:
    with pytest.raises(OptionError, match="drag from its wrist"):
        laid(model_of("left"), CAMERA, np.array([30.0, 40.0]), np.array(knuckle))


@pytest.mark.slow
@pytest.mark.parametrize("side", SIDES)
def test_more_points_better_poses(side: Side) -> None:
    truth, pictures = points_of(true_hands(side)), shown(true_hands(side))
    errors, left = {}, []
    for count, pinned in POINTS.items():
        found = np.concatenate([points_of(motion) for motion in posed_by(side, count)])
        errors[count] = similarity_aligned_distances(found, truth).mean()
        away = distance(CAMERA.project(found), pictures)[:, pinned].max(axis=1, initial=0.0)
        left.append(away / np.ptp(pictures, axis=1).max(axis=1))
    # Of the hand's size; a fist seen from its edge may end where the way is blocked by joints.
    assert np.percentile(left[1:], 95) < 0.005
    assert np.max(left) < 0.03
    for count, share in ((3, 1.1), (4, 0.9), (5, 0.75), (6, 0.55)):
        assert errors[count] < share * errors[0]


def angles_of(side: Side, poses: np.ndarray) -> np.ndarray:
    return anatomical_angles(rotvec_to_rotmat(poses.reshape(-1, 15, 3)), anatomical_axes(model_of(side)))


@pytest.mark.parametrize(("side", "step"), [("right", 4), pytest.param("left", 1, marks=pytest.mark.slow)])
def test_few_points(side: Side, step: int) -> None:
    """Poses are what a hand can do; thumb and little finger tell palm from back, however it was laid."""
    found, (lower, upper) = posed_by(side, 5, step), ends_of_range(side)
    angles = angles_of(side, np.concatenate([motion.hand_pose for motion in found]))
    assert np.all(angles < upper + TERMS.step_margin + 1e-6)
    assert np.all(angles > lower - TERMS.step_margin - 1e-6)
    orients = (
        np.concatenate([motion.global_orient for motion in found]),
        true_hands(side).global_orient[::step],
    )
    backs = [rotvec_to_rotmat(orient)[:, :, 1] for orient in orients]
    assert np.mean((backs[0] * backs[1]).sum(axis=1) > 0) >= 0.875


@pytest.mark.slow
def test_fingers_without_points() -> None:
    """Of a fist, index and little fingertips are enough for the two between them."""
    bends = []
    for count in (3, 5):
        poses = np.concatenate([motion.hand_pose for motion in posed_by("right", count)[FISTS]])
        bends.append(np.degrees(angles_of("right", poses)[:, [3, 4, 9, 10], 2].mean()))
    assert bends[1] > bends[0] + 15.0


def test_path_does_not_count() -> None:
    """A draft comes near to what is kept, and neither depends on an answer before."""
    pixels = shown(true_hands("right"))[8]
    hand, other = added("right", pixels, POINTS[6]), added("right", pixels + 40.0, POINTS[3])
    draft = refit_each(hand, refit_each(other), draft=True)
    np.testing.assert_array_equal(draft.transl, refit_each(hand, draft=True).transl)
    away = distance(shown(draft), shown(refit_each(hand)))
    assert away.mean() < 0.1 * np.ptp(pixels, axis=0).max()


def test_locked_joints_stay() -> None:
    hand = replace(added("left", shown(true_hands("left"))[3], POINTS[5]), locked=locked(4, 5, 6))
    np.testing.assert_array_equal(refit_each(hand).hand_pose[0, 9:18], hand.hand_pose[0, 9:18])
    whole = refit_each(replace(hand, locked=locked(0, 4, 5, 6)))
    np.testing.assert_array_equal(whole.global_orient, hand.global_orient)
    np.testing.assert_array_equal(whole.transl, hand.transl)
    assert np.any(whole.hand_pose != hand.hand_pose)


def test_one_palm_point() -> None:
    """In another frame of a clip a hand holds: a fingertip that is dragged there bends its finger alone."""
    hand = drag(added("right", shown(true_hands("right"))[0]), {8: (4.0, 6.0)})
    found = refit_each(hand)
    np.testing.assert_array_equal(found.transl, hand.transl)
    np.testing.assert_array_equal(found.hand_pose[0, 9:], hand.hand_pose[0, 9:])
    assert distance(shown(found), hand.pins)[0, 8] < 0.5


def test_frames_between_two_are_filled() -> None:
    """Re-fit Range: between two frames with points, half a second apart at most, the hand moves evenly."""
    pixels = shown(true_hands("right"))[0]
    ends = [added("right", pixels + [x, 0.0], POINTS[6]) for x in (0.0, 30.0)]
    pins = np.full((6, 21, 2), np.nan)
    pins[[0, 5]] = [hand.pins[0] for hand in ends]
    pose = [np.full((6, rows.shape[1]), np.nan) for rows in ends[0].pose]
    for row, hand in zip((0, 5), ends, strict=True):
        for rows, own in zip(pose, refit_each(hand).pose, strict=True):
            rows[row] = own[0]
    found = refit_range(posed(ends[0], *pose, pins=pins))
    assert found.present.all()
    assert np.all(np.diff(shown(found)[:, KNUCKLE, 0]) > 0)


@pytest.mark.parametrize("side", SIDES)
def test_a_take_gets_one_more_hand(side: Side, tmp_path: Path) -> None:
    still = np.zeros((3, 3)), np.zeros((3, 45)), np.tile([0.0, 0.0, 0.6], (3, 1))
    take = take_of([track_of("right", *still, CAMERA)], CAMERA, 640, 480)
    wrist, knuckle = np.array([200.0, 300.0]), np.array([220.0, 210.0])
    path = with_added(take, model_of(side), 1, wrist, knuckle).save(tmp_path / "t.npz")
    kept, hand = Take.load(path).hands
    assert (kept.placed, kept.added, hand.added, hand.refinable) == (None, False, True, True)
    assert (hand.side, len(hand.detections)) == (side, 0)
    np.testing.assert_array_equal(hand.present, [False, True, False])
    np.testing.assert_array_equal(hand.placed[1, [WRIST, KNUCKLE]], [wrist, knuckle])
    assert np.isfinite(hand.placed).sum() == 4
    np.testing.assert_allclose(CAMERA.project(hand.joints_3d)[1, KNUCKLE], knuckle, atol=1.0)
