"""The bones' axes: rigs from takes and back, other axes, mirrors."""

from __future__ import annotations

import numpy as np
import pytest

from blender_manient import axes
from handfit_core.geometry.rotations import quat_to_rotmat, rotvec_to_rotmat
from handfit_core.hand_model import load_model
from handfit_core.skeleton import SIDES, other_side


def random_pose(count=20):
    rng = np.random.default_rng(3)
    orient = rng.normal(size=(count, 3))
    pose = rng.normal(scale=0.6, size=(count, 45))
    return orient, pose, rng.normal(size=(count, 3))


@pytest.mark.parametrize("side", SIDES)
def test_pose_from_bones_is_the_inverse_of_bone_pose(side, model):
    shaped = load_model(model, side).shaped(np.linspace(-1.5, 1.5, 10))
    frames = axes.bone_frames(shaped, side)
    orient, pose, transl = random_pose()
    quats, locations = axes.bone_pose(shaped, frames, orient, pose, transl)
    found = axes.pose_from_bones(shaped, frames, quats, locations)
    np.testing.assert_allclose(rotvec_to_rotmat(found[0]), rotvec_to_rotmat(orient), atol=1e-12)
    np.testing.assert_allclose(
        rotvec_to_rotmat(found[1].reshape(-1, 3)), rotvec_to_rotmat(pose.reshape(-1, 3)), atol=1e-12
    )
    np.testing.assert_allclose(found[2], transl, atol=1e-12)
    # q and -q are one rotation.
    np.testing.assert_allclose(
        axes.pose_from_bones(shaped, frames, -quats, locations)[1], found[1], atol=1e-12
    )


@pytest.mark.parametrize("side", SIDES)
def test_turned_bones_rotate_the_same(side, model):
    hand = load_model(model, side)
    before, after = hand.shaped(np.full(10, -1.0)), hand.shaped(np.full(10, 1.0))
    old, new = axes.bone_frames(before, side), axes.bone_frames(after, side)
    orient, pose, transl = random_pose()
    quats, _ = axes.bone_pose(before, old, orient, pose, transl)
    expected, _ = axes.bone_pose(after, new, orient, pose, transl)
    found = axes.turned_bones(old, new, quats)
    np.testing.assert_allclose(quat_to_rotmat(found), quat_to_rotmat(expected), atol=1e-12)


@pytest.mark.parametrize("side", SIDES)
def test_mirrored_bones_are_manos_mirrored_pose(side, model):
    """In a mirror at x = 0 MANO's axis-angle (a, b, c) is (a, -b, -c)."""
    other = other_side(side)
    one, two = (load_model(model, s).shaped() for s in (side, other))
    source, target = axes.bone_frames(one, side), axes.bone_frames(two, other)
    orient, pose, transl = random_pose()
    turn = np.array([1.0, -1.0, -1.0])
    quats, _ = axes.bone_pose(one, source, orient, pose, transl)
    expected, _ = axes.bone_pose(two, target, orient * turn, pose * np.tile(turn, 15), transl)
    found = axes.mirrored_bones(source, target, quats)
    np.testing.assert_allclose(quat_to_rotmat(found), quat_to_rotmat(expected), atol=1e-12)
