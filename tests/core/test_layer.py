"""The torch layer against a naive twin, the NumPy model and finite differences."""

import numpy as np
import pytest
import torch

from handfit_core.hand_model import HandModel, load_model
from handfit_core.layer import HandLayer
from tests.imitation_mano import imitation_model

torch.set_num_threads(1)

MODELS = {"left": imitation_model("left"), "skinning only": imitation_model(pose_blendshapes=False)}
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


def turned(rotvec: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Points (..., 3) turned after Rodrigues' formula, from its textbook form."""
    angle = np.linalg.norm(rotvec)
    k = rotvec / angle if angle else rotvec
    along = np.sum(points * k, axis=-1, keepdims=True) * k * (1 - np.cos(angle))
    return points * np.cos(angle) + np.cross(np.broadcast_to(k, points.shape), points) * np.sin(angle) + along


def naive_mano(model: HandModel, betas, global_orient, hand_pose, transl):
    """MANO's definition, joint by joint: all vertices, and the 16 joints."""
    shaped = model.v_template + model.shapedirs @ betas
    rest = model.joint_regressor @ shaped
    rotvecs = [global_orient, *hand_pose.reshape(15, 3)]

    def carried(joint, points):
        """Rest points that move with `joint`: turned about it, then about each of its ancestors."""
        while joint is not None:
            points = turned(rotvecs[joint], points - rest[joint]) + rest[joint]
            joint = PARENTS[joint]
        return points

    feature = np.concatenate([(turned(r, np.eye(3)).T - np.eye(3)).ravel() for r in rotvecs[1:]])
    bent = shaped + model.posedirs @ feature
    vertices = sum(model.weights[:, [joint]] * carried(joint, bent) for joint in range(16))
    joints = np.array([carried(joint, rest[joint]) for joint in range(16)])
    return vertices + transl, joints + transl


def test_agrees_with_a_naive_implementation(model):
    args, layer = arguments(seed=3, angle=0.9), HandLayer(model)
    vertices, joints = naive_mano(model, *(a[0].numpy() for a in args))
    out = layer(*args)
    np.testing.assert_allclose(out.vertices[0].numpy(), vertices, rtol=0, atol=1e-9)
    np.testing.assert_allclose(out.joints[0].numpy(), joints, rtol=0, atol=1e-9)
    tips = vertices[model.tip_vertices]
    expected = [tips[int(s[1])] if isinstance(s, str) else joints[s] for s in MEDIAPIPE]
    np.testing.assert_allclose(out.keypoints[0].numpy(), expected, rtol=0, atol=1e-9)
    np.testing.assert_allclose(layer.keypoints(*args)[0].numpy(), expected, rtol=0, atol=1e-9)


@pytest.mark.parametrize("shape", [(10,), (1, 10), (5, 10)])
def test_agrees_with_the_numpy_model(model, shape):
    """One shape serves the whole batch; without a place the hand is where its rest pose is."""
    layer, (betas, *pose, transl) = HandLayer(model), arguments(5, seed=1)
    expected = model.posed(betas[0].numpy(), *(p.numpy() for p in pose), transl.numpy())
    given = betas[:1].expand(shape) if len(shape) == 2 else betas[0]
    out = layer(given, *pose, transl)
    for name in ("vertices", "joints", "keypoints"):
        np.testing.assert_allclose(getattr(out, name).numpy(), getattr(expected, name), rtol=0, atol=1e-12)
    points = layer.keypoints(given, *pose, transl)
    torch.testing.assert_close(points, out.keypoints, rtol=0, atol=1e-12)
    still = points - transl[:, None]
    torch.testing.assert_close(layer.keypoints(given, *pose), still, rtol=0, atol=1e-12)
    torch.testing.assert_close(layer(given, *pose).keypoints, still, rtol=0, atol=1e-12)


@pytest.mark.parametrize("angle", [0.0, 1e-9, 1e-4, 0.7, 3.0])
def test_keypoint_gradients(model, angle):
    args = list(arguments(2, seed=6, grad=True))
    # Every joint turned by exactly `angle`, zero included.
    for i, count in ((1, 1), (2, 15)):
        axes = torch.nn.functional.normalize(args[i].detach().reshape(2, count, 3), dim=-1)
        args[i] = (axes * angle).reshape(2, -1).requires_grad_()
    layer = HandLayer(model)
    assert torch.autograd.gradcheck(layer.keypoints, args, atol=1e-7)
    assert torch.autograd.gradcheck(lambda *a: layer(*a).vertices[:, [0, 100, 317]], args, atol=1e-7)


def test_float32_stays_within_a_micrometre(model):
    args = arguments(8, seed=7)
    exact, layer = HandLayer(model)(*args), HandLayer(model, dtype=torch.float32)
    close = layer(*(a.float() for a in args))
    assert close.vertices.dtype == torch.float32
    for name in ("vertices", "keypoints"):
        assert (getattr(close, name).double() - getattr(exact, name)).abs().max() < 1e-6
    zero = torch.zeros(1, 45, requires_grad=True)
    layer.keypoints(torch.zeros(10), torch.zeros(1, 3), zero).sum().backward()
    assert zero.grad is not None
    assert torch.isfinite(zero.grad).all()
    assert zero.grad.abs().max() > 1e-3


def test_layer_moves_and_casts_like_any_module():
    layer = HandLayer(MODELS["left"]).to(torch.float32)
    assert layer(*arguments(1, dtype=torch.float32)).keypoints.dtype == torch.float32
    assert (layer.faces.dtype, layer.faces.shape) == (torch.int64, (1538, 3))


@pytest.mark.skipif(not torch.cuda.is_available(), reason="no CUDA device on this machine")
def test_cuda_agrees_with_the_cpu(model):
    args = arguments(4, seed=11)
    expected = HandLayer(model)(*args)
    out = HandLayer(model, device="cuda")(*(a.cuda() for a in args))
    torch.testing.assert_close(out.keypoints.cpu(), expected.keypoints, rtol=0, atol=1e-10)
    torch.testing.assert_close(out.vertices.cpu(), expected.vertices, rtol=0, atol=1e-10)
