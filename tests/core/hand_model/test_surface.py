"""The collision shape: it lies in the skin, follows the shape, and its gaps are the least there are."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from handfit_core.common.skeleton import SIDES, Side
from handfit_core.hand_model import load_model
from handfit_core.hand_model.length import flat_hand_length
from handfit_core.hand_model.surface import PAIRS, Capsules, Surface, gaps_along, surface_of


@pytest.fixture(scope="module")
def surface() -> Surface:
    return surface_of(load_model(None, "right"))


def _capsules(rng: np.random.Generator, count: int) -> Capsules:
    """Hands of capsules that lie anywhere, those of the first half side by side."""
    ends = rng.uniform(-0.03, 0.03, (count, 19, 2, 3))
    along = rng.normal(size=(count, 19, 3))
    along[: count // 2] = [1.0, 0.0, 0.0]
    ends[:, :, 1] = ends[:, :, 0] + 0.03 * along / np.linalg.norm(along, axis=-1, keepdims=True)
    radii = rng.uniform(0.004, 0.009, (count, 19, 1)) + rng.uniform(-0.002, 0.002, (count, 19, 2))
    return Capsules(ends, radii, np.zeros((count, len(PAIRS))))


def test_gaps_are_the_least_of_all_spheres(surface: Surface) -> None:
    capsules = _capsules(np.random.default_rng(0), 6)
    near = surface.near(capsules, within=1.0)
    assert len(near.gap) == 6 * len(PAIRS)
    a, b = ((capsules.ends[near.hand, bone], capsules.radii[near.hand, bone]) for bone in near.bones.T)
    least = np.full(len(near.gap), np.inf)
    for s in np.linspace(0.0, 1.0, 41):
        for t in np.linspace(0.0, 1.0, 41):
            least = np.minimum(least, gaps_along(*a, *b, np.broadcast_to([s, t], (len(least), 2)))[1])
    # Nowhere on the grid are they nearer, and some place of the grid is all but as near.
    assert (near.gap <= least + 1e-12).all()
    assert (least - near.gap).max() < 4e-4


def test_near_pairs(surface: Surface) -> None:
    capsules = _capsules(np.random.default_rng(1), 20)
    every, some = surface.near(capsules, within=1.0), surface.near(capsules)
    overlapping = every.gap < 0.0
    assert 0.02 < overlapping.mean() < 0.98
    assert np.array_equal(every.hand[overlapping], some.hand)
    assert np.array_equal(every.bones[overlapping], some.bones)
    assert np.allclose(every.gap[overlapping], some.gap)
    deepest = [-min(some.gap[some.hand == row], default=0.0) for row in range(20)]
    assert np.allclose(surface.depths(capsules), deepest)


@pytest.mark.parametrize("side", SIDES)
@pytest.mark.parametrize("beta", [np.zeros(10), 2.0 * np.eye(10)[0], -2.0 * np.eye(10)[1]])
def test_capsules_fit_skin(side: Side, beta: np.ndarray) -> None:
    model = load_model(None, side)
    capsules = surface_of(model).of(beta[None], np.zeros((1, 45)))
    skin = model.shaped(beta).vertices[model.weights.argmax(axis=1) > 0]
    off = np.min(
        [_height(skin, e, r) for e, r in zip(capsules.ends[0, :15], capsules.radii[0, :15], strict=True)],
        axis=0,
    )
    assert abs(np.median(off)) < 0.001
    # A hand of the mean size has 5 mm: the skin of the thumb's web lies deepest, beside its knuckle.
    assert off.min() > -0.005 * flat_hand_length(model, beta) / flat_hand_length(model)


def _height(points: np.ndarray, ends: np.ndarray, radii: np.ndarray) -> np.ndarray:
    """(N,) metres of points above a capsule, straight away from its axis."""
    axis = ends[1] - ends[0]
    along = np.clip((points - ends[0]) @ axis / (axis @ axis), 0.0, 1.0)
    radius = radii[0] + along * (radii[1] - radii[0])
    return np.linalg.norm(points - ends[0] - along[:, None] * axis, axis=1) - radius


def test_joined_parts_do_not_overlap(surface: Surface) -> None:
    betas = np.random.default_rng(2).normal(size=(20, 10))
    assert surface.depths(surface.of(betas, np.zeros((20, 45)))).max() < 0.0015


def test_left_hands_are_mirrored(surface: Surface) -> None:
    rng = np.random.default_rng(3)
    betas, pose = rng.normal(size=(8, 10)), rng.normal(size=(8, 15, 3)) * 0.5
    left = surface_of(load_model(None, "left"))
    depths = surface.depths(surface.of(betas, pose.reshape(8, 45)))
    assert depths.max() > 0.005
    mirrored = (pose * [1.0, -1.0, -1.0]).reshape(8, 45)
    assert np.allclose(left.depths(left.of(betas, mirrored)), depths, atol=1e-6)


def test_sparse_mesh() -> None:
    """All of it belongs to the wrist, or to one bone: what is left is lines."""
    model = load_model(None, "right")
    for joint in (0, 4):
        weights = np.zeros_like(model.weights)
        weights[:, joint] = 1.0
        bare = Surface(replace(model, weights=weights))
        pose = np.random.default_rng(4).normal(size=(5, 45)) * 0.5
        assert np.isfinite(bare.depths(bare.of(np.zeros((5, 10)), pose))).all()
