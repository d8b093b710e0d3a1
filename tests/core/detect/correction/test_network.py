"""The landmark network: the file that ships, and the forward pass against torch's."""

from dataclasses import replace

import numpy as np
import torch

from handfit_core.common.skeleton import Side
from handfit_core.detect.correction.canonical import FEATURES, Canonical, canonical
from handfit_core.detect.correction.corrected import corrected
from handfit_core.detect.correction.network import (
    FILE,
    LOG_SIGMA,
    MAX_FEATURE,
    LandmarkNetwork,
    landmark_network,
)
from handfit_core.detect.keypoints import Detections
from tests.core.fit.detections import columns, landmarks_of, mirror_image, poses, seen

RIGHT: Side = "right"
POINTS = landmarks_of(RIGHT, *poses(12, seed=2))
HANDS = [seen(p, RIGHT, noise=2.0, seed=i) for i, p in enumerate(POINTS)]
DETECTIONS = columns(HANDS)
RIGHTS = DETECTIONS.side


def looked_at(count: int, spread: float = 1.0) -> Canonical:
    rng = np.random.default_rng(1)
    return Canonical(
        features=spread * rng.normal(size=(count, FEATURES)),
        fused=rng.normal(size=(count, 21, 3)),
        turn=np.tile(np.eye(3), (count, 1, 1)),
        mirror=np.ones(count),
        size=np.ones(count),
        middle=np.zeros((count, 2)),
    )


def torch_forward(arrays: dict[str, np.ndarray], seen: Canonical) -> torch.Tensor:
    """(N, 127) by torch's own layers, in float64."""
    layers = []
    for i in range(3):
        weight = torch.tensor(arrays[f"weight_{i}"].astype(np.float64))
        linear = torch.nn.Linear(weight.shape[1], weight.shape[0], dtype=torch.float64)
        linear.weight.data, linear.bias.data = weight, torch.tensor(arrays[f"bias_{i}"].astype(np.float64))
        layers += [linear, torch.nn.GELU(approximate="tanh")]
    mean, deviation = (torch.tensor(arrays[n].astype(np.float64)) for n in ("mean", "deviation"))
    values = ((torch.tensor(seen.features) - mean) / deviation).clamp(-MAX_FEATURE, MAX_FEATURE)
    with torch.no_grad():
        return torch.nn.Sequential(*layers[:-1])(values)


def shipped() -> dict[str, np.ndarray]:
    with np.load(FILE, allow_pickle=False) as arrays:
        return dict(arrays)


def probability(hands: list[Detections]) -> np.ndarray:
    detections = columns(hands)
    return corrected(detections, detections.side)[1]


def test_forward_pass_is_torchs():
    arrays = shipped()
    # Also where features are cut off.
    for looked in (canonical(DETECTIONS, RIGHTS), looked_at(5), looked_at(5, spread=30.0)):
        ours, theirs = LandmarkNetwork(arrays)(looked), torch_forward(arrays, looked).numpy()
        per_point = theirs[:, :-1].reshape(-1, 21, 6)
        np.testing.assert_allclose(ours.points - looked.fused, per_point[..., :3], atol=2e-5)
        np.testing.assert_allclose(ours.sigma, np.exp(per_point[..., 3:] + LOG_SIGMA), rtol=1e-4)
        np.testing.assert_allclose(ours.right_side, 1 / (1 + np.exp(-theirs[:, -1])), atol=1e-4)


def test_bad_landmarks_are_expected_to_be_worse():
    """And perfect ones are hardly moved."""
    frame, network = canonical(DETECTIONS, RIGHTS), landmark_network()
    assert network is landmark_network()
    said = network(frame)
    assert np.abs(said.points - frame.fused).mean() < 0.1  # of the hand's size
    noisy = columns([seen(p, RIGHT, noise=25.0, seed=i) for i, p in enumerate(POINTS)])
    assert network(canonical(noisy, RIGHTS)).sigma.mean() > 1.3 * said.sigma.mean() > 0


def test_sides():
    """A right hand named a right one is likely; what is named wrong is not. Mirrored, it is the same."""
    right = probability(HANDS)
    wrong = probability([replace(d, side=1 - d.side, score=np.array([0.6])) for d in HANDS])
    assert right.mean() > 0.8
    assert wrong.mean() < right.mean() - 0.2
    np.testing.assert_allclose(probability([mirror_image(d) for d in HANDS]), right, atol=1e-4)
    assert probability([]).shape == (0,)
