"""The torch layer against 4x4 matrices, the NumPy model and finite differences."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from handfit_core.hand_model import HandModel, load_model
from handfit_core.paper.layer import HandLayer
from tests.imitation_mano import imitation_model

torch.set_num_threads(1)

MODELS = {"blend shapes": imitation_model(), "skinning only": imitation_model(pose_blendshapes=False)}
# In MANO's joint order, written out again on purpose.
PARENTS = [None, 0, 1, 2, 0, 4, 5, 0, 7, 8, 0, 10, 11, 0, 13, 14]
MEDIAPIPE = [0, 13, 14, 15, "t0", 1, 2, 3, "t1", 4, 5, 6, "t2", 10, 11, 12, "t3", 7, 8, 9, "t4"]


@pytest.fixture(params=[*MODELS, "open hand"])
def model(request: pytest.FixtureRequest) -> HandModel:
    return load_model(None, "right") if request.param == "open hand" else MODELS[request.param]


def arguments(batch: int = 1, *, seed: int = 0, angle: float = 0.6, dtype=torch.float64, grad=False):
    """Random betas, global_orient, hand_pose and transl."""
    generator = torch.Generator().manual_seed(seed)
    sizes, scales = (10, 3, 45, 3), (1.5, 2.0, angle, 0.3)
    return tuple(
        (torch.randn(batch, n, generator=generator, dtype=torch.float64) * scale)
        .to(dtype)
        .requires_grad_(grad)
        for n, scale in zip(sizes, scales, strict=True)
    )


def by_matrices(model: HandModel, betas, orient, pose, transl) -> tuple[np.ndarray, np.ndarray]:
    """MANO's definition by 4x4 matrices: vertices (V, 3) and joints (16, 3)."""
    shaped = model.v_template + model.shapedirs @ betas
    rest = model.joint_regressor @ shaped
    turns = Rotation.from_rotvec(np.concatenate([orient, pose]).reshape(16, 3)).as_matrix()
    moved = shaped + model.posedirs @ (turns[1:] - np.eye(3)).ravel()
    placed: list[np.ndarray] = []
    for joint, parent in enumerate(PARENTS):
        own = np.eye(4)
        own[:3, :3], own[:3, 3] = turns[joint], rest[joint] - turns[joint] @ rest[joint]
        placed.append(own if parent is None else placed[parent] @ own)
    blended, points = (
        np.tensordot(model.weights, placed, 1),
        np.pad(moved, ((0, 0), (0, 1)), constant_values=1),
    )
    vertices = np.einsum("vij,vj->vi", blended, points)[:, :3] + transl
    joints = (
        np.einsum("kij,kj->ki", placed, np.pad(rest, ((0, 0), (0, 1)), constant_values=1))[:, :3] + transl
    )
    return vertices, joints


def test_agrees_with_matrices(model: HandModel) -> None:
    args = arguments(seed=3, angle=0.9)
    vertices, joints = by_matrices(model, *(a[0].numpy() for a in args))
    out = HandLayer(model)(*args)
    np.testing.assert_allclose(out.vertices[0].numpy(), vertices, rtol=0, atol=1e-9)
    np.testing.assert_allclose(out.joints[0].numpy(), joints, rtol=0, atol=1e-9)
    tips = vertices[model.tip_vertices]
    expected = [tips[int(s[1])] if isinstance(s, str) else joints[s] for s in MEDIAPIPE]
    np.testing.assert_allclose(out.keypoints[0].numpy(), expected, rtol=0, atol=1e-9)
    np.testing.assert_allclose(HandLayer(model).keypoints(*args)[0].numpy(), expected, rtol=0, atol=1e-9)


def test_agrees_with_the_numpy_model(model: HandModel) -> None:
    betas, global_orient, hand_pose, transl = arguments(5, seed=1)
    expected = model.posed(betas[0].numpy(), global_orient.numpy(), hand_pose.numpy(), transl.numpy())
    layer = HandLayer(model)
    out = layer(betas[0], global_orient, hand_pose, transl)  # one shape for all
    close = layer.keypoints(betas[:1], global_orient, hand_pose, transl)
    np.testing.assert_allclose(close.numpy(), expected.keypoints, rtol=0, atol=1e-12)
    assert layer.faces.shape == (len(model.faces), 3)
    np.testing.assert_allclose(out.vertices.numpy(), expected.vertices, rtol=0, atol=1e-12)
    np.testing.assert_allclose(out.joints.numpy(), expected.joints, rtol=0, atol=1e-12)
    np.testing.assert_allclose(out.keypoints.numpy(), expected.keypoints, rtol=0, atol=1e-12)


@pytest.mark.parametrize("angle", [0.0, 1e-4, 3.0])
def test_keypoint_gradients(model: HandModel, angle: float) -> None:
    args = list(arguments(2, seed=6, grad=True))
    # Every joint turned by exactly `angle`, zero included.
    for i, count in ((1, 1), (2, 15)):
        axes = torch.nn.functional.normalize(args[i].detach().reshape(2, count, 3), dim=-1)
        args[i] = (axes * angle).reshape(2, -1).requires_grad_()
    assert torch.autograd.gradcheck(HandLayer(model).keypoints, args, atol=1e-7)


def test_float32_stays_within_a_micrometre(model: HandModel) -> None:
    args = arguments(8, seed=7)
    exact = HandLayer(model)(*args)
    single = HandLayer(model).to(torch.float32)
    close = single(*(a.float() for a in args))
    assert close.vertices.dtype == torch.float32
    assert (close.vertices.double() - exact.vertices).abs().max() < 1e-6
    assert (single.keypoints(*(a.float() for a in args)).double() - exact.keypoints).abs().max() < 1e-6
    zero = torch.zeros(1, 45, requires_grad=True)
    single.keypoints(torch.zeros(10), torch.zeros(1, 3), zero).sum().backward()
    assert zero.grad is not None
    assert torch.isfinite(zero.grad).all()
    assert zero.grad.abs().max() > 1e-3


@pytest.mark.skipif(not torch.cuda.is_available(), reason="no CUDA device on this machine")
def test_cuda_agrees_with_the_cpu(model: HandModel) -> None:
    args = arguments(4, seed=11)
    expected = HandLayer(model)(*args)
    layer = HandLayer(model, device="cuda")
    moved = [a.cuda().requires_grad_() for a in args]
    keypoints = layer.keypoints(*moved)
    torch.testing.assert_close(keypoints.cpu(), expected.keypoints, rtol=0, atol=1e-10)
    torch.testing.assert_close(layer(*moved).vertices.cpu(), expected.vertices, rtol=0, atol=1e-10)
    keypoints.sum().backward()
    assert all(a.grad is not None and torch.isfinite(a.grad).all() for a in moved)
