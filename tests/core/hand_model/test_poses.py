"""The ready poses, which a hand can do with no finger in another, and small pictures of hands."""

from __future__ import annotations

import numpy as np
import pytest

from handfit_core.common.errors import HandModelError
from handfit_core.common.skeleton import SIDES, Side
from handfit_core.geometry.rotations import rotvec_to_rotmat
from handfit_core.hand_model import load_model
from handfit_core.hand_model.anatomy import anatomical_angles, anatomical_axes, joint_limits, relaxed_pose
from handfit_core.hand_model.axes import REST_FROM_MODEL
from handfit_core.hand_model.drawing import _lit, colored, drawn_pose
from handfit_core.hand_model.poses import FILE, Pose, ready_poses
from handfit_core.hand_model.surface import surface_of

READY = ready_poses()
SLACK = np.radians(0.01)
"""What single precision takes"""


@pytest.mark.parametrize("side", SIDES)
@pytest.mark.parametrize("name", READY)
def test_ready_poses_are_possible(name: str, side: Side) -> None:
    model, limits = load_model(None, side), joint_limits(side)
    pose = READY[name].pose.on(side)
    angles = anatomical_angles(rotvec_to_rotmat(pose.reshape(15, 3)), anatomical_axes(model))
    assert (angles > limits.lower - SLACK).all()
    assert (angles < limits.upper + SLACK).all()
    surface = surface_of(model)
    assert surface.depths(surface.of(np.zeros((1, 10)), pose[None]))[0] < 0.002


def test_names_say_one_pose_each() -> None:
    assert 35 <= len(READY) <= 50
    assert len({name.casefold() for name in READY}) == len(READY)
    assert all(name == ready.name for name, ready in READY.items())
    letters = "".join(name.removeprefix("Letter ") for name in READY if name.startswith("Letter"))
    # J and Z are I and a pointing finger that move.
    assert sorted(letters.replace(", ", "")) == sorted("ABCDEFGHIKLMNOPQRSTUVWXY")
    poses = np.array([ready.pose.hand_pose for ready in READY.values()])
    apart = np.abs(poses[:, None] - poses).max(axis=-1)
    assert apart[np.triu_indices(len(poses), 1)].min() > np.radians(5.0)
    relaxed = relaxed_pose(load_model(None, "right"))
    np.testing.assert_allclose(READY["Relaxed"].pose.hand_pose, relaxed, atol=1e-6)
    assert FILE.stat().st_size < 300_000


@pytest.mark.parametrize(
    ("name", "first", "second"),
    [("Pinch", 4, 8), ("Pinch Middle", 4, 12), ("Letter F", 4, 8), ("Letter W", 4, 20)],
)
def test_what_pinches_touches(name: str, first: int, second: int) -> None:
    """The skins of thumb and finger meet, and are nearer than in the open hand by far."""
    model = load_model(None, "right")
    surface = surface_of(model)
    poses = np.stack([READY[name].pose.hand_pose, READY["Spread"].pose.hand_pose])
    tips = np.array([[first, second]] * 2)
    gaps = surface.gaps_at(surface.of(np.zeros((2, 10)), poses), np.arange(2), tips).gap
    assert gaps[0] < 0.006
    assert gaps[1] > 0.05


def test_pictures_show_the_poses() -> None:
    """Each stored picture is nearer to what its pose looks like than any other pose's is."""
    model = load_model(None, "right")
    names = ["Relaxed", "Claw", "Fist", "Point", "Gun", "Horns", "I Love You"]
    stored = [READY[name].drawn[..., 1] / 255.0 for name in names]
    for at, name in enumerate(names):
        now = drawn_pose(model, READY[name].pose.hand_pose, 128)[..., 1] / 255.0
        assert int(np.argmin([np.abs(one - now).mean() for one in stored])) == at, name


@pytest.mark.parametrize("side", SIDES)
def test_turns_and_back(side: Side) -> None:
    pose = READY["Fist"].pose
    turns = pose.turns(side)
    np.testing.assert_allclose(turns[0], np.eye(3))
    first = rotvec_to_rotmat(pose.on(side)[:3])
    np.testing.assert_allclose(turns[1], REST_FROM_MODEL @ first @ REST_FROM_MODEL.T)
    np.testing.assert_allclose(Pose.of_turns(side, turns).on("right"), pose.hand_pose, atol=1e-6)


def test_values_and_back() -> None:
    pose = READY["Claw"].pose
    read = Pose.of_values(pose.values())
    assert read.side == "right"
    np.testing.assert_array_equal(read.hand_pose, pose.hand_pose)


ZEROS = [0.0] * 44


@pytest.mark.parametrize(
    "values",
    [
        *(None, {}, {"side": "right"}, {"side": ["right"], "hand_pose": [0.0, *ZEROS]}),
        *({"side": "right", "hand_pose": [number, *ZEROS]} for number in (np.nan, 1e30, 10**400, "a")),
        *({"side": "right", "hand_pose": wrong} for wrong in (ZEROS, [[0.0, *ZEROS]], [[1.0], ZEROS])),
    ],
)
def test_refuses_other_values(values: object) -> None:
    with pytest.raises(HandModelError, match="pose of a hand"):
        Pose.of_values(values)


# Pictures


def test_a_picture_is_a_hand_on_nothing() -> None:
    model = load_model(None, "right")
    drawn = drawn_pose(model, np.zeros(45), 64)
    assert drawn.shape == (64, 64, 2)
    assert drawn.dtype == np.uint8
    assert (drawn[0, 0] == 0).all()
    assert (drawn[30:40, 30:34, 1] == 255).all()  # the palm
    assert drawn[..., 1].max(axis=1).nonzero()[0][[0, -1]].tolist() == pytest.approx([2, 61], abs=1)
    picture = colored(drawn)
    assert picture.shape == (64, 64, 4)
    np.testing.assert_array_equal(picture[..., 3], drawn[..., 1])


@pytest.mark.parametrize("order", [(0, 1), (1, 0)])
def test_occlusion(order: tuple[int, int]) -> None:
    corners = np.array([[1.0, 1.0, 0.0], [15.0, 1.0, 0.0], [1.0, 15.0, 0.0]])
    points = np.concatenate([corners, corners + [0.0, 0.0, 5.0]])
    faces = np.array([[0, 1, 2], [3, 4, 5]])[list(order)]
    depth, light = _lit(points, faces, 16)
    assert depth[4, 4] == 5.0
    assert depth[14, 14] == -np.inf
    assert light[4, 4] > 0.5
    assert light[14, 14] == 0.0
    # From behind, neither is seen.
    assert np.all(_lit(points, faces[:, ::-1], 16)[0] == -np.inf)
