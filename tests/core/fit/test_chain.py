"""The chain against the mesh, its own inverse and finite differences."""

from __future__ import annotations

import numpy as np
import pytest

from handfit_core.common.skeleton import JOINTS_BY_FINGER, SIDES, TIP_KEYPOINTS, Side
from handfit_core.geometry.rotations import rotvec_to_rotmat
from handfit_core.hand_model.anatomy import anatomical_angles, anatomical_axes
from handfit_core.hand_model.chain import FIXED_SHAPE, HAND_SIZE, Chain, State
from handfit_core.hand_model.landmarks import NO_OFFSETS
from tests.core.fit.detections import Pose, landmarks_of
from tests.core.fit.differences import close, of_increments
from tests.core.fit.hands import OFFSETS, chain_of, make_state, repeated
from tests.imitation_mano import imitation_model


def parameters(batch: int) -> Pose:
    rng = np.random.default_rng(0)
    betas, orient, pose, transl = (rng.normal(size=(batch, n)) for n in (10, 3, 45, 3))
    return betas, 1.5 * orient, 0.5 * pose, 0.3 * transl


def state_from(chain: Chain, given: Pose) -> State:
    return chain.state(*given, np.zeros(len(given[0])))


@pytest.mark.parametrize("side", SIDES)
def test_points_are_those_of_the_mesh(side: Side) -> None:
    """With offsets that move with their bones. The open hand's fingertips hang on one bone alone."""
    chain, given = chain_of(side, OFFSETS), parameters(4)
    expected = landmarks_of(side, *given, landmarks=OFFSETS)
    close(chain.points(state_from(chain, given)), expected, rtol=0, atol=1e-12)


def test_blended_skin_moves_tips_only() -> None:
    """MANO's fingertip vertices are skinned by more than one bone and moved by pose blend shapes."""
    model, given = imitation_model(), parameters(8)
    chain, flat = Chain(model, NO_OFFSETS), (*given[:2], np.zeros_like(given[2]), given[3])
    joints = np.setdiff1d(np.arange(21), TIP_KEYPOINTS)
    for pose, points in ((given, joints), (flat, np.arange(21))):
        expected = np.array([model.keypoints(*one) for one in zip(*pose, strict=True)])
        close(chain.points(state_from(chain, pose))[:, points], expected[:, points], rtol=0, atol=1e-12)


@pytest.mark.parametrize("side", SIDES)
def test_parameters_round_trip(side: Side) -> None:
    chain, given = chain_of(side), parameters(5)
    state = state_from(chain, given)
    for found, expected in zip(chain.parameters(state), given, strict=True):
        close(found, expected, rtol=0, atol=1e-9)
    rotmats = rotvec_to_rotmat(given[2].reshape(-1, 15, 3))
    angles = anatomical_angles(rotmats, anatomical_axes(chain.model))[:, JOINTS_BY_FINGER - 1]
    close(state.angles, angles.reshape(5, 5, 9), rtol=0, atol=1e-9)


@pytest.mark.parametrize("shape", [True, False])
@pytest.mark.parametrize("spread", [0.0, 0.15, 1.5])
def test_jacobian_by_finite_differences(spread: float, shape: bool) -> None:
    """Also where a joint's spread is near or beyond 90 degrees."""
    chain = chain_of("right", OFFSETS)
    state = make_state(1, chain, spread=spread)
    n = HAND_SIZE if shape else len(FIXED_SHAPE)

    def after(increments: np.ndarray) -> np.ndarray:
        moved = repeated(state, len(increments)).moved(increments[:, :n], increments[:, n:].reshape(-1, 5, 9))
        return chain.points(moved)

    differences = of_increments(after, n + 45)  # (21, 3, n + 45)
    jacobian = chain.jacobian(chain.pose(state), by_place(1), shape=shape)[0]
    close(jacobian[..., 9:], differences[..., :n], rtol=1e-6, atol=1e-8)
    by_joints = np.zeros((21, 3, 5, 9))
    for point in range(1, 21):
        by_joints[point, :, (point - 1) // 4] = jacobian[point, :, :9]
    assert not jacobian[0, :, :9].any()
    close(by_joints.reshape(21, 3, 45), differences[..., n:], rtol=1e-6, atol=1e-8)


def by_place(batch: int) -> np.ndarray:
    return np.tile(np.eye(3, 4), (batch, 21, 1, 1))
