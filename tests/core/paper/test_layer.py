"""The torch layer against a naive twin, the NumPy model and finite differences."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch

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


def turn(rotvec, vector):
    """Rodrigues' formula for one vector, from its textbook form, in plain numbers."""
    angle = math.sqrt(sum(float(c) ** 2 for c in rotvec))
    if angle == 0:
        return [float(c) for c in vector]
    k = [float(c) / angle for c in rotvec]
    v = [float(c) for c in vector]
    cross = [k[1] * v[2] - k[2] * v[1], k[2] * v[0] - k[0] * v[2], k[0] * v[1] - k[1] * v[0]]
    dot = sum(a * b for a, b in zip(k, v, strict=True))
    return [
        v[i] * math.cos(angle) + cross[i] * math.sin(angle) + k[i] * dot * (1 - math.cos(angle))
        for i in range(3)
    ]


def naive_mano(model: HandModel, betas, global_orient, hand_pose, transl, vertices):
    """MANO's definition, one vertex and one joint at a time: vertices asked for, and the 16 joints."""
    shaped = {}

    def shaped_vertex(v):
        if v not in shaped:
            shaped[v] = [
                model.v_template[v][c] + sum(model.shapedirs[v][c][b] * betas[b] for b in range(10))
                for c in range(3)
            ]
        return shaped[v]

    rest = []
    for joint in range(16):
        used = [int(v) for v in np.flatnonzero(model.joint_regressor[joint])]
        rest.append(
            [sum(model.joint_regressor[joint][v] * shaped_vertex(v)[c] for v in used) for c in range(3)]
        )
    rotvecs = [global_orient] + [hand_pose[3 * i : 3 * i + 3] for i in range(15)]

    def carried(joint, point):
        """A rest point that moves with `joint`: turned about it, then about each of its ancestors."""
        while joint is not None:
            turned = turn(rotvecs[joint], [point[c] - rest[joint][c] for c in range(3)])
            point = [turned[c] + rest[joint][c] for c in range(3)]
            joint = PARENTS[joint]
        return point

    feature = []
    for rotvec in rotvecs[1:]:
        columns = [turn(rotvec, axis) for axis in ((1, 0, 0), (0, 1, 0), (0, 0, 1))]
        feature += [columns[j][i] - (1.0 if i == j else 0.0) for i in range(3) for j in range(3)]
    posed = []
    for v in vertices:
        point = [
            shaped_vertex(v)[c] + sum(model.posedirs[v][c][p] * feature[p] for p in range(135))
            for c in range(3)
        ]
        total = [0.0, 0.0, 0.0]
        for joint in range(16):
            if model.weights[v][joint]:
                moved = carried(joint, point)
                total = [total[c] + model.weights[v][joint] * moved[c] for c in range(3)]
        posed.append([total[c] + transl[c] for c in range(3)])
    joints = [[carried(j, rest[j])[c] + transl[c] for c in range(3)] for j in range(16)]
    return np.array(posed), np.array(joints)


def test_agrees_with_a_naive_implementation(model: HandModel) -> None:
    args = arguments(seed=3, angle=0.9)
    some = [*range(0, len(model.v_template), 7), *model.tip_vertices.tolist()]
    plain = [a[0].tolist() for a in args]
    vertices, joints = naive_mano(model, *plain, some)
    out = HandLayer(model)(*args)
    np.testing.assert_allclose(out.vertices[0, some].numpy(), vertices, rtol=0, atol=1e-9)
    np.testing.assert_allclose(out.joints[0].numpy(), joints, rtol=0, atol=1e-9)
    tips = vertices[-5:]
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


@pytest.mark.parametrize("angle", [0.0, 1e-9, 1e-4, 0.7, 3.0])
def test_keypoint_gradients(model: HandModel, angle: float) -> None:
    args = list(arguments(2, seed=6, grad=True))
    # Every joint turned by exactly `angle`, zero included.
    for i, count in ((1, 1), (2, 15)):
        axes = torch.nn.functional.normalize(args[i].detach().reshape(2, count, 3), dim=-1)
        args[i] = (axes * angle).reshape(2, -1).requires_grad_()
    assert torch.autograd.gradcheck(HandLayer(model).keypoints, args, atol=1e-7)


def test_mesh_gradients_at_the_zero_pose() -> None:
    layer = HandLayer(MODELS["blend shapes"])
    chosen = [0, 100, 317, 745]

    def some_vertices(*args: torch.Tensor) -> torch.Tensor:
        return layer(*args).vertices[:, chosen]

    args = [torch.zeros(1, n, dtype=torch.float64, requires_grad=True) for n in (10, 3, 45, 3)]
    assert torch.autograd.gradcheck(some_vertices, args, atol=1e-7)


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
