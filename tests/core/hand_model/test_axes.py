"""The bones' axes: rigs from takes and back, other axes, mirrors."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from handfit_core.common.skeleton import SIDES, other_side
from handfit_core.geometry.rotations import quat_to_rotmat, rotvec_to_rotmat
from handfit_core.hand_model import OPEN_HAND, axes, load_model
from handfit_core.hand_model.anatomy import anatomical_axes


def random_pose(count=20):
    rng = np.random.default_rng(3)
    orient = rng.normal(size=(count, 3))
    pose = rng.normal(scale=0.6, size=(count, 45))
    return orient, pose, rng.normal(size=(count, 3))


def rest_of(shaped, side):
    return axes.RestPose(side, axes.bone_frames(shaped, side), axes.points_to_rest(shaped.joints[0]))


@pytest.mark.parametrize("side", SIDES)
def test_to_bones_and_back(side):
    """Also with other signs of quaternions, and with another origin."""
    shaped = load_model(OPEN_HAND, side).shaped(np.linspace(-1.5, 1.5, 10))
    rest = rest_of(shaped, side)
    moved = replace(rest, origin=np.array([0.1, 0.5, -0.2]))
    orient, pose, transl = random_pose()
    quats, locations = rest.to_bones(shaped, orient, pose, transl)
    other_quats, other_locations = moved.to_bones(shaped, orient, pose, transl)
    np.testing.assert_array_equal(other_quats, quats)
    np.testing.assert_allclose(rest.moved_to(moved, locations), other_locations, atol=1e-12)
    off = (locations - other_locations) @ rest.frames[0].T
    np.testing.assert_allclose(off, np.tile(moved.origin - rest.origin, (20, 1)), atol=1e-12)
    for found in (
        rest.from_bones(shaped, -quats, locations),
        moved.from_bones(shaped, quats, other_locations),
    ):
        for ours, given in zip(found[:2], (orient, pose), strict=True):
            turns = (rotvec_to_rotmat(each.reshape(-1, 3)) for each in (ours, given))
            np.testing.assert_allclose(*turns, atol=1e-12)
        np.testing.assert_allclose(found[2], transl, atol=1e-12)


@pytest.mark.parametrize("side", SIDES)
def test_turned_to_other_shape(side):
    hand = load_model(OPEN_HAND, side)
    before, after = hand.shaped(np.full(10, -1.0)), hand.shaped(np.full(10, 1.0))
    orient, pose, transl = random_pose()
    quats, locations = rest_of(before, side).to_bones(before, orient, pose, transl)
    moved = transl + before.joints[0] - after.joints[0]  # the wrist keeps its place
    expected, places = rest_of(after, side).to_bones(after, orient, pose, moved)
    old, new = rest_of(before, side), rest_of(after, side)
    np.testing.assert_allclose(
        quat_to_rotmat(old.turned_to(new, quats)), quat_to_rotmat(expected), atol=1e-12
    )
    np.testing.assert_allclose(old.moved_to(new, locations), places, atol=1e-12)


@pytest.mark.parametrize("side", SIDES)
@pytest.mark.parametrize("plane", [0.0, 0.3])
def test_mirrored_bones(side, plane):
    other = other_side(side)
    one, two = (load_model(OPEN_HAND, s).shaped() for s in (side, other))
    source, target = rest_of(one, side), rest_of(two, other)
    orient, pose, transl = random_pose()
    place = (one.joints[0] + transl) @ axes.MIRROR_X + np.array([2 * plane, 0.0, 0.0])
    quats, locations = source.to_bones(one, orient, pose, transl)
    expected, places = target.to_bones(two, *axes.mirrored_pose(orient, pose), place - two.joints[0])
    np.testing.assert_allclose(
        quat_to_rotmat(source.turned_to(target, quats)), quat_to_rotmat(expected), atol=1e-12
    )
    np.testing.assert_allclose(source.moved_to(target, locations, plane), places, atol=1e-12)


@pytest.mark.parametrize("side", SIDES)
def test_anatomical_axes_lie_so_in_bones(side):
    model = load_model(OPEN_HAND, side)
    bones = axes.REST_FROM_MODEL.T @ axes.bone_frames(model.shaped(), side)
    np.testing.assert_allclose(bones[1:] @ axes.ANATOMICAL_IN_BONE, anatomical_axes(model), atol=1e-12)
