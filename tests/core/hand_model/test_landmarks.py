import numpy as np
import pytest

from handfit_core.hand_model import load_model
from handfit_core.hand_model.anatomy import anatomical_axes
from handfit_core.hand_model.landmarks import LANDMARK_BONES, NO_OFFSETS, Landmarks, bone_axes, hand_length
from handfit_core.skeleton import JOINT_NAMES, KEYPOINT_NAMES, SIDES, Side


def test_landmark_bones() -> None:
    assert len(LANDMARK_BONES) == 21
    assert LANDMARK_BONES[0] == 0
    for keypoint, bone in zip(KEYPOINT_NAMES[1:], LANDMARK_BONES[1:], strict=True):
        assert JOINT_NAMES[bone].split("_")[0] == keypoint.split("_")[0]
    for tip in (4, 8, 12, 16, 20):
        assert LANDMARK_BONES[tip] == LANDMARK_BONES[tip - 1]


@pytest.mark.parametrize("side", SIDES)
def test_length_is_wrist_to_middle_knuckle(side: Side) -> None:
    model = load_model("open-hand", side)
    rest = model.keypoints(None, np.zeros(3), np.zeros(45), np.zeros(3))
    assert hand_length(model) == pytest.approx(np.linalg.norm(rest[9] - rest[0]))


@pytest.mark.parametrize("side", SIDES)
def test_bones_have_their_anatomical_axes(side: Side) -> None:
    model = load_model("open-hand", side)
    axes = bone_axes(model)
    np.testing.assert_array_equal(axes[0], np.eye(3))
    np.testing.assert_array_equal(axes[1:], anatomical_axes(model))


def test_no_offsets_are_none() -> None:
    assert not NO_OFFSETS.in_metres(load_model("open-hand", "left")).any()


def test_left_offsets_are_mirrored() -> None:
    """In the model frame, x changes its sign."""
    landmarks = Landmarks(np.random.default_rng(0).normal(size=(21, 3)) * 0.05)
    in_model = {}
    for side in SIDES:
        model = load_model("open-hand", side)
        axes = bone_axes(model)[list(LANDMARK_BONES)]
        in_model[side] = np.einsum("kab,kb->ka", axes, landmarks.in_metres(model))
    np.testing.assert_allclose(in_model["left"], in_model["right"] * [-1.0, 1.0, 1.0], atol=1e-9)
