"""Every term by one table: its derivatives by finite differences, batch equals loop; and what each of them
says."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
import pytest

from handfit_core.fit.observation import Observation, SecondView
from handfit_core.fit.settings import TERMS
from handfit_core.fit.terms import (
    Limits,
    PosePrior,
    Shape,
    Term,
    coupling,
    depth,
    distance,
    near_pose,
    reprojection,
    second_view,
)
from handfit_core.fit.terms.limits import CLOSED_HAND_MARGIN
from handfit_core.fit.terms.motion import inverse_right_jacobian, rotation_acceleration
from handfit_core.fit.terms.rows import FINGERS, HAND, POINTS, SIZES
from handfit_core.geometry.rotations import rotmat_to_rotvec, rotvec_to_rotmat
from handfit_core.hand_model.anatomy import BEND, SPREAD
from handfit_core.hand_model.chain import BETAS, DEPTH_ZERO, PLACE, Posed
from tests.core.fit.differences import by_each, close, random, unit
from tests.core.fit.hands import MIRROR, OFFSETS, anchored_near, chain_of, make_state, observe

CHAIN = chain_of("right", OFFSETS)
ROOT = random(5, 9, 12, seed=2)
COVARIANCE = ROOT @ ROOT.swapaxes(-1, -2)
MEAN = random(5, 9, seed=1, scale=0.3)
RATES = random(10, seed=5) * 0.01

TERMS_OF_FITS: list[Term] = [
    reprojection,
    second_view,
    depth,
    Limits("right"),
    PosePrior(MEAN, COVARIANCE),
    coupling,
    near_pose,
    distance,
    Shape(random(10, seed=6)),
    Shape(random(10, seed=6), RATES, 0.3),
    Shape(random(10, seed=6), RATES, 0.3, measured=False),
]
every_term = pytest.mark.parametrize(
    "term", TERMS_OF_FITS, ids=lambda t: getattr(t, "__name__", type(t).__name__)
)
VARIABLES = {
    POINTS: [(slice(0, 3), "points"), (slice(3, 4), "depth_zero")],
    FINGERS: [(slice(0, 9), "angles")],
    HAND: [(BETAS, "betas"), (PLACE, "wrist"), (DEPTH_ZERO, "depth_zero")],
}
"""What each kind's rows are derivatives by, and in which columns"""


def changed(posed: Posed, **values: np.ndarray) -> Posed:
    """With other points, or other values of its state."""
    points = values.pop("points", posed.points)
    return replace(posed, points=points, state=replace(posed.state, **values))


def hands(batch: int = 3) -> tuple[Posed, Observation]:
    """Hands far from what is seen, some angles beyond their range, of which some poses are to be kept."""
    state = make_state(batch, CHAIN, spread=0.8)
    state.angles[0, [3, 4], BEND] = 2.0, -0.2  # beyond 90 degrees the spread's range stays
    other = make_state(batch, CHAIN, seed=1)
    seen = replace(observe(CHAIN.points(other), noise=5.0), anchor=anchored_near(other))
    turns = rotvec_to_rotmat(np.tile([0.1, 0.8, -0.2], (batch, 1)))
    there = observe(CHAIN.points(other) @ turns.swapaxes(1, 2) + [0.3, 0.0, 0.4])
    shift = np.tile([0.3, 0.0, 0.4], (batch, 1))
    second = SecondView(turns, shift, there.pixels, there.pixel_sigma, there.focal, there.centre)
    return CHAIN.pose(state), replace(seen, second=second)


def with_angles(angles: np.ndarray) -> tuple[Posed, Observation]:
    """Hands of these angles (B, 5, 9)."""
    posed, seen = hands(len(angles))
    return changed(posed, angles=angles), seen


@every_term
def test_derivatives(term: Term) -> None:
    """Rows depend on their own point, finger or hand, and on nothing that they have no derivative by."""
    posed, seen = hands(1)
    rows = term(posed, seen)
    groups = SIZES[rows.of][0]
    for columns, name in VARIABLES[rows.of]:
        at = posed.points if name == "points" else getattr(posed.state, name)
        found = by_each(lambda v, name=name: term(changed(posed, **{name: v}), seen).residual[0], at)
        own = rows.jacobian[0, ..., columns]
        expected = found  # (groups, c, n), of one value for all groups
        if found.shape[-1] != own.shape[-1]:
            whole = found.reshape(*found.shape[:2], groups, -1)
            expected = np.stack([whole[group, :, group] for group in range(groups)])
            assert not any(np.delete(whole[group], group, axis=1).any() for group in range(groups))
        close(own, expected, rtol=1e-6, atol=1e-5)
    assert not rows.jacobian[0, ..., :3].any() or rows.of != HAND  # no term is judged by how a hand is turned


@every_term
def test_behind_camera_stays_finite(term: Term) -> None:
    posed, seen = hands()
    posed.points[0, 3, 2], posed.points[0, 4, 2], posed.state.depth_zero[:] = -0.4, 0.0, -0.1
    assert np.isfinite(term(posed, seen).columns).all()


def test_depth_zero() -> None:
    """It is solved where it is not known, so that a hand twice as large and far away is seen alike."""
    posed, seen = hands()
    plain = depth(posed, seen)
    moved = changed(posed, points=2 * posed.points, depth_zero=2 * posed.state.depth_zero)
    close(depth(moved, seen).residual, plain.residual)
    # NaN says where it is not known.
    known = replace(seen, depth_zero=np.array([0.6, np.nan, 0.7]))
    rows = depth(posed, known)
    close(rows.columns[1], plain.columns[1])
    elsewhere = depth(changed(posed, depth_zero=known.depth_zero), seen)
    close(rows.residual[[0, 2]], elsewhere.residual[[0, 2]])


def test_limits() -> None:
    limits = Limits("right")
    inside = np.broadcast_to((limits.lower + limits.upper) / 2, (2, 5, 9)).copy()
    inside[..., SPREAD] *= 0.1
    assert not limits(*with_angles(inside)).columns.any()
    outside = inside.copy()
    outside[0, 1, 5] = limits.upper[1, 5] + CLOSED_HAND_MARGIN[1, 5] + 3.5 * TERMS.limits_sigma
    outside[0, 2, 8] = limits.lower[2, 8] - 3 * TERMS.limits_sigma
    residual = limits(*with_angles(outside)).residual
    assert (residual[0, 1, 5], residual[0, 2, 8]) == pytest.approx((3.5, -3.0))
    assert np.abs(residual).sum() == pytest.approx(6.5)


def test_pose_prior() -> None:
    posed, seen = hands()
    prior = PosePrior(MEAN, COVARIANCE)
    away = (posed.state.angles - MEAN)[..., None]
    expected = (away.swapaxes(-1, -2) @ np.linalg.inv(COVARIANCE) @ away)[..., 0, 0]
    left = changed(posed, angles=posed.state.angles * MIRROR)
    for found in (prior(posed, seen), PosePrior(MEAN, COVARIANCE, "left")(left, seen)):
        close(np.square(found.residual).sum(axis=-1), TERMS.pose_weight * expected)


AXES = unit(random(8, 3, seed=3))


@pytest.mark.parametrize("angle", [0.0, 0.99e-4, 1.01e-4, 0.5, np.pi - 1e-5])
def test_inverse_right_jacobian(angle: float) -> None:
    """log(exp(w) exp(d)) = w + Jr^-1 d, for small d; beyond pi the logarithm jumps."""
    for axis in AXES:
        turn = rotvec_to_rotmat(axis * angle)
        expected = by_each(lambda d, turn=turn: rotmat_to_rotvec(turn @ rotvec_to_rotmat(d)), np.zeros(3))
        close(inverse_right_jacobian(axis * angle), expected, rtol=0, atol=2e-6)


@pytest.mark.parametrize("spread", [0.0, 0.02, 2.0])
def test_derivatives_of_rotation_acceleration(spread: float) -> None:
    turns = rotvec_to_rotmat(np.concatenate([random(1, 2, 3), random(4, 2, 3, seed=1) / 2 * spread]))
    rotations = [turns[0]]
    for turn in turns[1:]:
        rotations.append(rotations[-1] @ turn)
    jacobian = rotation_acceleration(np.array(rotations))[1]
    expected = by_each(
        lambda d: rotation_acceleration(rotations @ rotvec_to_rotmat(d))[0], np.zeros((5, 2, 3))
    )
    expected = expected.reshape(3, 2, 3, 5, 2, 3)
    found = np.zeros_like(expected)
    for t, frame, joint in product(range(3), range(3), range(2)):
        found[t, joint, :, t + frame, joint] = jacobian[t, frame, joint]
    close(found, expected, rtol=0, atol=1e-7)
