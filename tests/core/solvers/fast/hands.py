"""Hands made by a forward pass, and what a perfect detector would see of them."""

from __future__ import annotations

from functools import cache

import numpy as np

from handfit_core.geometry.rotations import rotvec_to_rotmat
from handfit_core.hand_model import load_model
from handfit_core.hand_model.anatomy import joint_limits
from handfit_core.hand_model.landmarks import NO_OFFSETS, Landmarks
from handfit_core.skeleton import Side
from handfit_core.solvers.fast.angles import rotation_of
from handfit_core.solvers.fast.chain import Chain, State
from handfit_core.solvers.fast.energy import Energy, PosePrior, Weights
from handfit_core.solvers.fast.observation import Observation
from tests.core.residuals.differences import random, unit

FOCAL, CENTRE = 600.0, (320.0, 240.0)
OFFSETS = Landmarks(np.random.default_rng(7).normal(size=(21, 3)) * 0.05)
"""Some landmarks that are not joints, up to 10 mm away"""
RELAXED = np.tile(np.radians([0.0, 0.0, 20.0]), (5, 3)).reshape(5, 9)


@cache
def chain_of(side: Side = "right", landmarks: Landmarks = NO_OFFSETS) -> Chain:
    return Chain(load_model("open-hand", side), landmarks)


def prior_about_relaxed(degrees: float = 20.0) -> PosePrior:
    covariance = np.broadcast_to(np.eye(9) * np.radians(degrees) ** 2, (5, 9, 9)).copy()
    return PosePrior(RELAXED, covariance)


def energy_of(chain: Chain, weights: Weights | None = None, degrees: float = 20.0) -> Energy:
    limits = joint_limits(chain.model.side)
    return Energy(chain, prior_about_relaxed(degrees), limits, weights or Weights())


def make_state(batch: int, chain: Chain, *, seed: int = 0, offsets: int = 1, spread: float = 0.15) -> State:
    """Slightly bent hands, turned at random, half a metre before the camera."""
    rng = np.random.default_rng(seed)
    angles = RELAXED + rng.normal(size=(batch, 5, 9)) * spread * np.tile([0.2, 0.4, 1.0], 3)
    if chain.model.side == "left":
        angles = angles * np.tile([-1.0, -1.0, 1.0], 3)
    turns = rotvec_to_rotmat(rng.normal(size=(batch, 3)))
    wrist = rng.normal(size=(batch, 3)) * 0.05 + [0.0, 0.0, 0.5]
    return State(
        root=turns,
        local=rotation_of(angles.reshape(batch, 5, 3, 3)),
        wrist=wrist,
        betas=rng.normal(size=(batch, 10)) * 0.7,
        offsets=np.tile([0.5, *wrist[0]][:offsets], (batch, 1)),
    )


def repeated(state: State, count: int) -> State:
    """The first hand, so many times."""
    return state.select(np.zeros(count, dtype=int))


def observe(
    points: np.ndarray, *, world: bool = False, noise: float = 0.0, sigma: float = 4.0, seed: int = 0
) -> Observation:
    """(B, 21, 3) camera frame -> exact projections, depth along the ray through their middle in pixels."""
    batch = len(points)
    focal = np.full((batch, 2), FOCAL)
    centre = np.broadcast_to(CENTRE, (batch, 2))
    pixels = points[..., :2] / points[..., 2:] * FOCAL + centre[:, None]
    towards = np.concatenate([(pixels.mean(axis=1) - centre) / FOCAL, np.ones((batch, 1))], axis=1)
    ray = unit(towards)
    along = (points @ ray[..., None]).squeeze(-1)
    middle = along.mean(axis=1, keepdims=True)
    depth = (along - middle) * FOCAL / middle
    pixels = pixels + noise * random(*pixels.shape, seed=seed)
    return Observation(
        pixels=pixels,
        pixel_sigma=np.full_like(pixels, sigma),
        depth=depth,
        depth_sigma=np.full_like(depth, 3 * sigma),
        ray=ray,
        focal=focal,
        centre=centre,
        world=(points - points.mean(axis=1, keepdims=True)) * 1.2 if world else None,
    )
