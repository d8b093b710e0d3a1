"""Hands made by a forward pass, what a perfect detector would see of them, and problems made of that."""

from __future__ import annotations

from functools import cache

import numpy as np

from handfit_core.common.skeleton import Side
from handfit_core.fit.observation import Observation, PoseAnchor
from handfit_core.fit.problem import Problem, SharedShape
from handfit_core.fit.settings import TERMS
from handfit_core.fit.terms import Limits, PosePrior, Shape, Term, coupling, depth, reprojection
from handfit_core.geometry.rotations import rotvec_to_rotmat
from handfit_core.hand_model import load_model
from handfit_core.hand_model.chain import Chain, State
from handfit_core.hand_model.landmarks import NO_OFFSETS, Landmarks
from tests.core.fit.differences import random, unit

FOCAL, CENTRE = 600.0, (320.0, 240.0)
OFFSETS = Landmarks(np.random.default_rng(7).normal(size=(21, 3)) * 0.05)
"""Some landmarks that are not joints, up to 10 mm away"""
RELAXED = np.tile(np.radians([0.0, 0.0, 20.0]), (5, 3)).reshape(5, 9)
MIRROR = np.tile([-1.0, -1.0, 1.0], 3)


@cache
def chain_of(side: Side = "right", landmarks: Landmarks = NO_OFFSETS) -> Chain:
    return Chain(load_model("open-hand", side), landmarks)


def prior_about_relaxed(side: Side = "right", degrees: float = 20.0) -> PosePrior:
    """Of that standard deviation, by how much ever a capture's prior counts: what is tested is the solver."""
    covariance = np.broadcast_to(np.eye(9) * np.radians(degrees) ** 2 * TERMS.pose_weight, (5, 9, 9))
    return PosePrior(RELAXED, covariance, side)


def problem_of(
    chain: Chain, seen: Observation, shape: SharedShape = "each", terms: tuple[Term, ...] | None = None
) -> Problem:
    """What a capture asks for, unless other terms are given."""
    if terms is None:
        side = chain.model.side
        terms = (reprojection, depth, Limits(side), prior_about_relaxed(side), coupling)
        terms = terms if shape == "given" else (*terms, Shape(np.zeros(10)))
    return Problem(chain, seen, terms, shape)


def points_alone(side: Side) -> tuple[Term, ...]:
    """Priors so weak that the landmarks decide."""
    return (
        reprojection,
        depth,
        Limits(side),
        prior_about_relaxed(side, 80.0),
        Shape(np.zeros(10), None, 0.0025),
    )


def make_state(batch: int, chain: Chain, *, seed: int = 0, spread: float = 0.15) -> State:
    """Slightly bent hands, turned at random, half a metre before the camera."""
    rng = np.random.default_rng(seed)
    angles = RELAXED + rng.normal(size=(batch, 5, 9)) * spread * np.tile([0.2, 0.4, 1.0], 3)
    if chain.model.side == "left":
        angles = angles * MIRROR
    turns = rotvec_to_rotmat(rng.normal(size=(batch, 3)))
    wrist = rng.normal(size=(batch, 3)) * 0.05 + [0.0, 0.0, 0.5]
    betas = rng.normal(size=(batch, 10)) * 0.7
    return State(turns, angles, wrist, betas, np.full(batch, 0.5))


def repeated(state: State, count: int) -> State:
    """The first hand, so many times."""
    return state.select(np.zeros(count, dtype=int))


def observe(points: np.ndarray, *, noise: float = 0.0, sigma: float = 4.0, seed: int = 0) -> Observation:
    """(B, 21, 3) camera frame -> exact projections, depth along the ray through their middle in pixels."""
    batch = len(points)
    centre = np.broadcast_to(CENTRE, (batch, 2))
    pixels = points[..., :2] / points[..., 2:] * FOCAL + centre[:, None]
    ray = unit(np.concatenate([(pixels.mean(axis=1) - centre) / FOCAL, np.ones((batch, 1))], axis=1))
    along = (points @ ray[..., None])[..., 0]
    middle = along.mean(axis=1, keepdims=True)
    depth_seen = (along - middle) * FOCAL / middle
    return Observation(
        pixels=pixels + noise * random(*pixels.shape, seed=seed),
        pixel_sigma=np.full(pixels.shape, sigma),
        depth=depth_seen,
        depth_sigma=np.full(depth_seen.shape, 3 * sigma),
        ray=ray,
        focal=np.full((batch, 2), FOCAL),
        centre=centre,
    )


def anchored_near(state: State, limits_sigma: float = np.nan) -> PoseAnchor:
    """To stay near those poses, each finger as firmly as another, the little one not at all."""
    sigma = np.tile([0.1, 0.2, 0.5, 1.0, np.inf], (len(state), 1))
    return PoseAnchor.at(state, 0.02, sigma, limits_sigma)
