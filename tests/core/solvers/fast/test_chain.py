"""The chain against the hand model, finite differences and symmetry."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest

from handfit_core.geometry.rotations import rotvec_to_rotmat
from handfit_core.hand_model import HandModel, load_model
from handfit_core.hand_model.anatomy import anatomical_angles, anatomical_axes
from handfit_core.hand_model.landmarks import LANDMARK_BONES, NO_OFFSETS, bone_axes
from handfit_core.skeleton import FINGER_JOINTS, FINGERS, SIDES, TIP_KEYPOINTS, Side
from handfit_core.solvers.fast.angles import angles_of
from handfit_core.solvers.fast.chain import Chain, State, exp
from tests.core.residuals.differences import close, of_increments, random
from tests.core.solvers.fast.hands import OFFSETS, chain_of, make_state, repeated
from tests.imitation_mano import imitation_model

Parameters = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]


def parameters(batch: int, *, seed: int = 0, scale: float = 0.5) -> Parameters:
    """betas, global_orient, hand_pose, transl."""
    rng = np.random.default_rng(seed)
    sizes, scales = (10, 3, 45, 3), (1.0, 1.5, scale, 0.3)
    return tuple(rng.normal(size=(batch, n)) * s for n, s in zip(sizes, scales, strict=True))  # type: ignore[return-value]


def state_from(
    chain: Chain, betas: np.ndarray, orient: np.ndarray, pose: np.ndarray, transl: np.ndarray
) -> State:
    """The chain's state of MANO's parameters."""
    wrist = np.stack([chain.model.shaped(b).joints[0] for b in betas]) + transl
    root, local = rotvec_to_rotmat(orient), chain.local_from_pose(pose)
    return State(root, local, wrist, betas, np.zeros((len(betas), 1)))


def keypoints_of(model: HandModel, given: Parameters) -> np.ndarray:
    return np.stack([model.keypoints(*one) for one in zip(*given, strict=True)])


@pytest.mark.parametrize("side", SIDES)
def test_pose_is_the_models_keypoints(side: Side) -> None:
    """The open hand's fingertips hang on the last bone alone, so that they agree like all others."""
    chain, given = chain_of(side), parameters(8)
    found = chain.pose(state_from(chain, *given)).points
    np.testing.assert_allclose(found, keypoints_of(chain.model, given), rtol=0, atol=1e-12)


def test_only_tips_differ_in_a_model_with_blended_skin() -> None:
    """MANO's fingertip vertices are skinned by more than one bone and moved by pose blend shapes."""
    model = imitation_model()
    chain, given = Chain(model, NO_OFFSETS), parameters(8)
    difference = chain.pose(state_from(chain, *given)).points - keypoints_of(model, given)
    difference = np.linalg.norm(difference, axis=-1)
    joints = np.setdiff1d(np.arange(21), TIP_KEYPOINTS)
    assert difference[:, joints].max() < 1e-12
    flat = tuple(np.zeros_like(a) if i == 2 else a for i, a in enumerate(given))
    at_rest = chain.pose(state_from(chain, *flat)).points - keypoints_of(model, flat)  # type: ignore[arg-type]
    assert np.abs(at_rest).max() < 1e-12


@pytest.mark.parametrize("side", SIDES)
def test_landmarks_move_with_their_bones(side: Side) -> None:
    """x = keypoint + (bone's turn) (bone's axes) offset, from the model's own joint rotations."""
    chain, given = chain_of(side, OFFSETS), parameters(3)
    model = chain.model
    offsets = np.einsum("kab,kb->ka", bone_axes(model)[list(LANDMARK_BONES)], OFFSETS.in_metres(model))
    found = chain.pose(state_from(chain, *given)).points
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
        state_from(left, betas, orient * turn_mirror, pose * np.tile(turn_mirror, 15), transl * mirror)
    )
    here = right.pose(state_from(right, betas, orient, pose, transl))
    np.testing.assert_allclose(there.points, here.points * mirror, rtol=0, atol=1e-9)


@pytest.mark.parametrize("side", SIDES)
def test_parameters_round_trip(side: Side) -> None:
    chain, given = chain_of(side), parameters(5)
    for found, expected in zip(chain.parameters(state_from(chain, *given)), given, strict=True):
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9)
    back, aim = chain.state(*given, np.zeros((5, 1))), state_from(chain, *given)
    for name in State.__dataclass_fields__:
        close(getattr(back, name), getattr(aim, name))


def test_local_rotations_have_the_anatomical_angles() -> None:
    chain, (_, _, pose, _) = chain_of(), parameters(3)
    expected = anatomical_angles(rotvec_to_rotmat(pose.reshape(-1, 15, 3)), anatomical_axes(chain.model))
    found = angles_of(chain.local_from_pose(pose))
    for f, finger in enumerate(FINGERS):
        rows = [j - 1 for j in FINGER_JOINTS[finger]]
        np.testing.assert_allclose(found[:, f], expected[:, rows], atol=1e-9)


@pytest.mark.parametrize("offsets", [1, 4])
@pytest.mark.parametrize("flat", [False, True])
def test_jacobians_by_finite_differences_over_moved(offsets: int, flat: bool) -> None:
    chain = chain_of("right", OFFSETS)
    state = make_state(1, chain, offsets=offsets)
    if flat:
        state = State(
            np.eye(3)[None],
            np.broadcast_to(np.eye(3), (1, 5, 3, 3, 3)),
            state.wrist,
            np.zeros_like(state.betas),
            state.offsets,
        )
    posed, n = chain.pose(state), 6 + offsets + 10

    def after(increments: np.ndarray) -> np.ndarray:
        of_hand, of_fingers = increments[:, :n], increments[:, n:].reshape(-1, 5, 9)
        return chain.pose(chain.moved(repeated(state, len(increments)), of_hand, of_fingers)).points

    differences = of_increments(after, n + 45)  # (21, 3, n + 45)
    assert np.abs(differences[..., 6 : 6 + offsets]).max() == 0
    wrist, rest = differences[0], differences[1:].reshape(5, 4, 3, n + 45)
    own = [*range(6), *range(6 + offsets, n)]
    near = partial(close, rtol=1e-6, atol=1e-8)
    jacobian = chain.jacobian(posed, shape=True)[0]
    of_wrist, of_fingers = jacobian[0], jacobian[1:].reshape(5, 4, 3, 25)
    near(of_wrist[:, 9:], wrist[:, own])
    assert np.abs(wrist[:, n:]).max() < 1e-9
    assert np.abs(of_wrist[:, :9]).max() == 0
    near(of_fingers[..., 9:], rest[..., own])
    close(chain.jacobian(posed, shape=False)[0], jacobian[..., :15])
    by_joints = np.zeros((5, 4, 3, 5, 9))
    for f in range(5):
        by_joints[f, :, :, f] = of_fingers[f, ..., :9]
    near(by_joints.reshape(5, 4, 3, 45), rest[..., n:])


def test_moved_by_nothing_is_the_same() -> None:
    chain = chain_of()
    state = make_state(2, chain)
    zero = np.zeros((2, 17)), np.zeros((2, 5, 9))
    close(chain.pose(chain.moved(state, *zero)).points, chain.pose(state).points)


def test_moved_without_shape_keeps_betas() -> None:
    chain = chain_of()
    state = make_state(2, chain)
    after = chain.moved(state, random(2, 7, scale=0.1), random(2, 5, 9, scale=0.1))
    assert np.array_equal(after.betas, state.betas)


def test_batch_equals_loop() -> None:
    chain = chain_of("left", OFFSETS)
    state = make_state(4, chain)
    whole = chain.pose(state)
    for i in range(4):
        one = chain.pose(state.select(np.array([i])))
        close(whole.points[i], one.points[0])
        for shape in (False, True):
            close(chain.jacobian(whole, shape=shape)[i], chain.jacobian(one, shape=shape)[0])


def test_exp_is_rodrigues_also_near_zero() -> None:
    turns = np.concatenate([random(5, 3), random(5, 3, scale=1e-9), np.zeros((1, 3))])
    np.testing.assert_allclose(exp(turns), rotvec_to_rotmat(turns), rtol=0, atol=1e-12)


def test_state_where_chooses_hand_by_hand() -> None:
    chain = chain_of()
    first, second = make_state(3, chain, seed=1), make_state(3, chain, seed=2)
    mixed = first.where(np.array([True, False, True]), second)
    for name in State.__dataclass_fields__:
        assert np.array_equal(getattr(mixed, name)[0], getattr(first, name)[0])
        assert np.array_equal(getattr(mixed, name)[1], getattr(second, name)[1])
