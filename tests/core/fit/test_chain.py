"""The chain against the hand model, finite differences and symmetry."""

from __future__ import annotations

import numpy as np
import pytest

from handfit_core.geometry.rotations import rotvec_to_rotmat
from handfit_core.hand_model import HandModel, load_model
from handfit_core.hand_model.anatomy import anatomical_angles, anatomical_axes
from handfit_core.hand_model.chain import FIXED_SHAPE, HAND_SIZE, Chain, State
from handfit_core.hand_model.landmarks import LANDMARK_BONES, NO_OFFSETS, bone_axes
from handfit_core.skeleton import FINGER_JOINTS, FINGERS, JOINTS_BY_FINGER, SIDES, TIP_KEYPOINTS, Side
from tests.core.fit.differences import close, of_increments, random
from tests.core.fit.hands import OFFSETS, chain_of, make_state, repeated
from tests.imitation_mano import imitation_model

Parameters = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]


def parameters(batch: int, *, seed: int = 0, scale: float = 0.5) -> Parameters:
    """betas, global_orient, hand_pose, transl."""
    rng = np.random.default_rng(seed)
    sizes, scales = (10, 3, 45, 3), (1.0, 1.5, scale, 0.3)
    return tuple(rng.normal(size=(batch, n)) * s for n, s in zip(sizes, scales, strict=True))  # type: ignore[return-value]


def state_from(chain: Chain, given: Parameters) -> State:
    return chain.state(*given, np.zeros(len(given[0])))


def keypoints_of(model: HandModel, given: Parameters) -> np.ndarray:
    return np.stack([model.keypoints(*one) for one in zip(*given, strict=True)])


@pytest.mark.parametrize("side", SIDES)
def test_pose_is_the_models_keypoints(side: Side) -> None:
    """The open hand's fingertips hang on the last bone alone, so that they agree like all others."""
    chain, given = chain_of(side), parameters(8)
    found = chain.pose(state_from(chain, given)).points
    np.testing.assert_allclose(found, keypoints_of(chain.model, given), rtol=0, atol=1e-12)


def test_blended_skin_moves_tips_only() -> None:
    """MANO's fingertip vertices are skinned by more than one bone and moved by pose blend shapes."""
    model = imitation_model()
    chain, given = Chain(model, NO_OFFSETS), parameters(8)
    difference = chain.pose(state_from(chain, given)).points - keypoints_of(model, given)
    difference = np.linalg.norm(difference, axis=-1)
    joints = np.setdiff1d(np.arange(21), TIP_KEYPOINTS)
    assert difference[:, joints].max() < 1e-12
    flat = tuple(np.zeros_like(a) if i == 2 else a for i, a in enumerate(given))
    at_rest = chain.pose(state_from(chain, flat)).points - keypoints_of(model, flat)  # type: ignore[arg-type]
    assert np.abs(at_rest).max() < 1e-12


@pytest.mark.parametrize("side", SIDES)
def test_landmarks_move_with_their_bones(side: Side) -> None:
    """x = keypoint + (bone's turn) (bone's axes) offset, from the model's own joint rotations."""
    chain, given = chain_of(side, OFFSETS), parameters(3)
    model = chain.model
    offsets = np.einsum("kab,kb->ka", bone_axes(model)[list(LANDMARK_BONES)], OFFSETS.in_metres(model))
    found = chain.pose(state_from(chain, given)).points
    keypoints = keypoints_of(model, given)
    for i, (_, orient, pose, _) in enumerate(zip(*given, strict=True)):
        root, local = rotvec_to_rotmat(orient), rotvec_to_rotmat(pose.reshape(15, 3))
        turn = {0: root}
        for finger in FINGERS:
            parent = 0
            for joint in FINGER_JOINTS[finger]:
                turn[joint] = turn[parent] @ local[joint - 1]
                parent = joint
        expected = keypoints[i] + [turn[b] @ o for b, o in zip(LANDMARK_BONES, offsets, strict=True)]
        np.testing.assert_allclose(found[i], expected, rtol=0, atol=1e-12)


@pytest.mark.parametrize("landmarks", [NO_OFFSETS, OFFSETS], ids=["joints", "landmarks"])
def test_left_mirrors_right(landmarks) -> None:
    mirror, turn_mirror = np.array([-1.0, 1.0, 1.0]), np.array([1.0, -1.0, -1.0])
    betas, orient, pose, transl = parameters(4)
    right, left = (Chain(load_model("open-hand", s), landmarks) for s in ("right", "left"))
    there = left.pose(
        state_from(left, (betas, orient * turn_mirror, pose * np.tile(turn_mirror, 15), transl * mirror))
    )
    here = right.pose(state_from(right, (betas, orient, pose, transl)))
    np.testing.assert_allclose(there.points, here.points * mirror, rtol=0, atol=1e-9)


@pytest.mark.parametrize("side", SIDES)
def test_parameters_round_trip(side: Side) -> None:
    chain, given = chain_of(side), parameters(5)
    for found, expected in zip(chain.parameters(state_from(chain, given)), given, strict=True):
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9)


def test_angles_are_anatomical() -> None:
    chain, given = chain_of(), parameters(3)
    rotmats = rotvec_to_rotmat(given[2].reshape(-1, 15, 3))
    expected = anatomical_angles(rotmats, anatomical_axes(chain.model))
    found = state_from(chain, given).angles.reshape(3, 5, 3, 3)
    np.testing.assert_allclose(found, expected[:, JOINTS_BY_FINGER - 1], atol=1e-9)


@pytest.mark.parametrize("shape", [True, False])
@pytest.mark.parametrize("spread", [0.0, 0.15, 1.5])
def test_jacobians_by_finite_differences_over_moved(spread: float, shape: bool) -> None:
    """Also where a joint's spread is near or beyond 90 degrees."""
    chain = chain_of("right", OFFSETS)
    state = make_state(1, chain, spread=spread)
    posed, n = chain.pose(state), HAND_SIZE if shape else len(FIXED_SHAPE)

    def after(increments: np.ndarray) -> np.ndarray:
        moved = repeated(state, len(increments)).moved(increments[:, :n], increments[:, n:].reshape(-1, 5, 9))
        return chain.pose(moved).points

    differences = of_increments(after, n + 45)  # (21, 3, n + 45)
    rows = np.zeros((1, 21, 3, 4))
    rows[..., :3] = np.eye(3)
    jacobian = chain.jacobian(posed, rows, shape=shape)[0]
    np.testing.assert_allclose(jacobian[..., 9:], differences[..., :n], rtol=1e-6, atol=1e-8)
    by_joints = np.zeros((21, 3, 5, 9))
    for f in range(5):
        of_finger = slice(1 + 4 * f, 5 + 4 * f)
        by_joints[of_finger, :, f] = jacobian[of_finger, :, :9]
    assert not jacobian[0, :, :9].any()
    np.testing.assert_allclose(by_joints.reshape(21, 3, 45), differences[..., n:], rtol=1e-6, atol=1e-8)


def test_rows_go_through_the_jacobian() -> None:
    """Rows by the point are multiplied, other columns stay."""
    chain = chain_of("left", OFFSETS)
    posed = chain.pose(make_state(2, chain))
    rows = random(2, 21, 4, 6)
    plain = np.zeros((2, 21, 3, 4))
    plain[..., :3] = np.eye(3)
    whole, by_point = chain.jacobian(posed, rows, shape=True), chain.jacobian(posed, plain, shape=True)
    close(whole[..., :25], rows[..., :3] @ by_point[..., :25])
    close(whole[..., 25:], rows[..., 3:])


def test_zero_increments() -> None:
    state = make_state(2, chain_of())
    still = state.moved(np.zeros((2, 17)), np.zeros((2, 5, 9)))
    for name in State.__dataclass_fields__:
        close(getattr(still, name), getattr(state, name))
    after = state.moved(random(2, 7, scale=0.1), random(2, 5, 9, scale=0.1))
    assert np.array_equal(after.betas, state.betas)


def test_state_where_chooses_hand_by_hand() -> None:
    chain = chain_of()
    first, second = make_state(3, chain, seed=1), make_state(3, chain, seed=2)
    mixed = first.where(np.array([True, False, True]), second)
    for name in State.__dataclass_fields__:
        assert np.array_equal(getattr(mixed, name)[0], getattr(first, name)[0])
        assert np.array_equal(getattr(mixed, name)[1], getattr(second, name)[1])
