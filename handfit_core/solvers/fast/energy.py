"""The sum of all residual terms of single frames, and its Gauss-Newton matrices."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from handfit_core.hand_model.anatomy import JointLimits
from handfit_core.residuals.coupling import coupling
from handfit_core.residuals.depth import depth
from handfit_core.residuals.distance import distance
from handfit_core.residuals.hand_length import hand_length
from handfit_core.residuals.limits import limits
from handfit_core.residuals.near_pose import near_pose
from handfit_core.residuals.pose_prior import pose_prior
from handfit_core.residuals.reprojection import reprojection
from handfit_core.residuals.robust import Huber, Kernel, QuadraticWhere
from handfit_core.residuals.rows import AngleRows, PointRows
from handfit_core.residuals.shape_prior import shape_prior
from handfit_core.residuals.world import world
from handfit_core.skeleton import FINGER_JOINTS, FINGERS, TIP_KEYPOINTS
from handfit_core.solvers.fast.angles import angles_of, rates_of
from handfit_core.solvers.fast.blocks import Blocks
from handfit_core.solvers.fast.chain import Chain, Posed
from handfit_core.solvers.fast.keeping import Kept
from handfit_core.solvers.fast.observation import Observation

# The last joint's bend from the middle one's: slope, offset in degrees (FACTS: index, middle, ring;
# the little finger's is taken as the ring's).
_COUPLING = {"index": (0.87, 25.0), "middle": (0.79, 18.0), "ring": (0.73, 20.5), "little": (0.73, 20.5)}


_KERNEL = Huber(1.0)

PASSIVE_RANGE = float(np.radians(10.0))
"""radians beyond its own range of motion that a joint of a kept pose may be drawn: the ranges are those of
moving it oneself, and a finger that is pressed goes further. Without this, the palm is moved where a person
would only bend the finger."""


@dataclass(frozen=True)
class Weights:
    """How much each term counts; 1 is what its sigmas say."""

    reprojection: float = 1.0
    depth: float = 1.0
    world: float = 0.0
    tips: float = 1.0
    """of the reprojection of fingertips, against other keypoints"""
    limits_sigma: float = float(np.radians(1.0))
    """radians beyond the range that cost as much as one sigma"""
    coupling_sigma: float = float(np.radians(18.0))
    prior: float = 0.7
    shape_sigma: float = 1.0
    length_sigma: float = 0.001
    """metres, of a length that was measured; left to `shape_sigma` alone, proportions would overrule it"""
    world_sigma: float = 0.010
    """metres"""
    pixel_kernel: Huber = _KERNEL
    depth_kernel: Huber = _KERNEL


@dataclass(frozen=True, eq=False)
class PosePrior:
    """What hands usually do, finger by finger: (twist, spread, bend) x 3 joints, as a right hand's."""

    mean: np.ndarray
    """(5, 9) radians"""
    covariance: np.ndarray
    """(5, 9, 9)"""

    def of_side(self, side: str) -> PosePrior:
        """Mirrored for a left hand: twist and spread change their signs."""
        if side == "right":
            return self
        sign = np.tile([-1.0, -1.0, 1.0], 3)
        return PosePrior(self.mean * sign, self.covariance * sign[:, None] * sign)


@dataclass(frozen=True, eq=False)
class MeasuredHand:
    """What is known of a hand's shape."""

    betas: np.ndarray
    """(10,) the likeliest shape of its length"""
    length_rates: np.ndarray
    """(10,) metres by which the length grows with each beta"""


class Energy:
    """All terms of one model's frames. Holds nothing of a problem but constants.

    `measured`: where the hand's length is known; None: an average hand is expected.
    """

    def __init__(
        self,
        chain: Chain,
        prior: PosePrior,
        joint_limits: JointLimits,
        weights: Weights,
        measured: MeasuredHand | None = None,
    ) -> None:
        self._chain, self._weights = chain, weights
        prior = prior.of_side(chain.model.side)

        whiten = np.linalg.inv(np.linalg.cholesky(prior.covariance)) * np.sqrt(weights.prior)
        joints = np.array([FINGER_JOINTS[f] for f in FINGERS]) - 1
        self._lower = joint_limits.lower[joints].reshape(5, 9)
        self._upper = joint_limits.upper[joints].reshape(5, 9)
        self._knuckles = np.array([0.0, 1.0, 1.0, 1.0, 1.0])
        rules = [_COUPLING.get(f) for f in FINGERS]
        slope = np.array([0.0 if r is None else r[0] for r in rules])
        offset = np.array([0.0 if r is None else np.radians(r[1]) for r in rules])
        sigma = np.array([np.inf if r is None else weights.coupling_sigma for r in rules])
        flat = np.zeros((1, 5, 9))
        self._habit = _Quadratic.of(
            [pose_prior(flat, prior.mean, whiten), coupling(flat, slope, offset, sigma)]
        )
        emphasis = np.full(21, np.sqrt(weights.reprojection))
        emphasis[list(TIP_KEYPOINTS)] *= np.sqrt(weights.tips)
        self._emphasis = emphasis
        self._shape_sigma = np.full(10, weights.shape_sigma)
        self._shape_mean = np.zeros(10) if measured is None else measured.betas
        self._length_rates = None if measured is None else measured.length_rates
        self._same_joint = np.eye(3)[:, None, :, None]

    def of(self, posed: Posed, seen: Observation, *, shape: bool, shape_weight: float = 1.0) -> Blocks:
        """Cost and matrices. `shape`: whether betas are variables; `shape_weight` of their prior (in a clip
        with one shape, 1 / frames)."""
        batch, chain = len(posed.state), self._chain
        rows, cost = self._point_rows(posed, seen)  # (B, 21, c, 3 + m + 1)
        moving = _times(rows[..., :3], chain.jacobian(posed, shape=shape))
        offsets, residual = rows[..., 3:-1], rows[..., -1:]
        # Columns: a finger's nine increments, the hand's own n variables, the residual.
        whole = np.concatenate([moving[..., :15], offsets, moving[..., 15:], residual], axis=-1)
        of_hand = whole[..., 9:].reshape(batch, -1, whole.shape[-1] - 9)
        corner = np.swapaxes(of_hand, 1, 2) @ of_hand
        of_finger = whole[:, 1:].reshape(batch, 5, -1, whole.shape[-1])  # (B, 5, 4 c, 9 + n + 1)
        sides = np.swapaxes(of_finger[..., :9], 2, 3) @ of_finger

        angle_squared, angle_cost = self._of_angles(posed.state.local, seen.kept)
        finger = sides[..., :9] + angle_squared[..., :9]
        finger_gradient = sides[..., -1] + angle_squared[..., 9]
        hand, hand_gradient = corner[:, :-1, :-1], corner[:, :-1, -1]
        cost = cost + angle_cost
        if seen.kept is not None:
            off, slope = distance(posed.state.wrist, seen.kept.wrist, seen.kept.distance_sigma)
            cost = cost + np.square(off)
            hand_gradient[:, 3:6] += off[:, None] * slope
            hand[:, 3:6, 3:6] += slope[:, :, None] * slope[:, None]
        if shape:
            of_shape, slope = shape_prior(posed.state.betas, self._shape_sigma, self._shape_mean)
            cost = cost + shape_weight * np.square(of_shape).sum(axis=1)
            hand_gradient[:, -10:] += shape_weight * slope * of_shape
            np.einsum("bii->bi", hand)[:, -10:] += shape_weight * slope * slope
            if self._length_rates is not None:
                sigma = self._weights.length_sigma
                off, slope = hand_length(posed.state.betas, self._shape_mean, self._length_rates, sigma)
                cost = cost + shape_weight * np.square(off)
                hand_gradient[:, -10:] += shape_weight * off[:, None] * slope
                hand[:, -10:, -10:] += shape_weight * slope[:, None] * slope
        return Blocks(hand, sides[..., 9:-1], finger, hand_gradient, finger_gradient, cost)

    def _of_angles(self, local: np.ndarray, kept: Kept | None) -> tuple[np.ndarray, np.ndarray]:
        """J^T [J r] (B, 5, 9, 10) of the terms on angles by the joints' increments, and their cost (B,)."""
        angles = angles_of(local)
        rates = rates_of(angles)
        flat = angles.reshape(-1, 5, 9)
        turn = (rates[..., None, :] * self._same_joint).reshape(*flat.shape, 9)  # (B, 5, 9, 9)
        outside = self._limits(flat, kept)
        habit = self._habit
        away = flat - habit.best
        pull = (away.reshape(-1, 45) @ habit.precision).reshape(flat.shape)
        cost = habit.least + (away * pull + np.square(outside.residual)).sum(axis=(1, 2))
        precision = habit.blocks
        if kept is not None:
            near = near_pose(flat, kept.angles, kept.angle_sigma)
            cost = cost + np.square(near.residual).sum(axis=(1, 2))
            pull = pull + (np.swapaxes(near.jacobian, 2, 3) @ near.residual[..., None])[..., 0]
            precision = precision + np.swapaxes(near.jacobian, 2, 3) @ near.jacobian
        sloped = np.swapaxes(outside.jacobian, 2, 3)
        by_angle = sloped @ outside.jacobian + precision
        gradient = pull[..., None] + sloped @ outside.residual[..., None]
        right = np.concatenate([by_angle @ turn, gradient], axis=-1)
        return np.swapaxes(turn, 2, 3) @ right, cost

    def _limits(self, flat: np.ndarray, kept: Kept | None) -> AngleRows:
        """What angles (B, 5, 9) beyond their ranges cost."""
        if kept is None or kept.limits_sigma is None:
            return limits(flat, self._lower, self._upper, self._weights.limits_sigma, self._knuckles)
        already = limits(kept.angles, self._lower, self._upper, 1.0, self._knuckles).residual
        more = np.maximum(np.abs(already), PASSIVE_RANGE)
        return limits(flat, self._lower, self._upper, kept.limits_sigma, self._knuckles, more)

    def _point_rows(self, posed: Posed, seen: Observation) -> tuple[np.ndarray, np.ndarray]:
        """Weighted rows (B, 21, c, 3 + m + 1) by the point and by the terms' offsets, and their residuals;
        and the cost (B,)."""
        weights, points, offsets = self._weights, posed.points, posed.state.offsets
        sigma = seen.pixel_sigma / self._emphasis[:, None]
        of_pixels: Kernel = weights.pixel_kernel
        if seen.pinned is not None:
            of_pixels = QuadraticWhere(seen.pinned, of_pixels)
        terms: list[tuple[PointRows, float, Kernel]] = [
            (reprojection(points, seen.pixels, sigma, seen.focal, seen.centre), 1.0, of_pixels),
            (
                depth(
                    points, seen.depth, seen.depth_sigma, seen.ray, seen.focal.mean(axis=1), offsets[:, :1]
                ),
                weights.depth,
                weights.depth_kernel,
            ),
        ]
        if seen.world is not None:
            sigma = np.full_like(seen.depth, weights.world_sigma)
            terms.append(
                (world(points, seen.world, sigma, offsets[:, 1:4]), weights.world, weights.depth_kernel)
            )
        rows, costs, first = [], [], 0
        for term, factor, kernel in terms:
            squared = np.square(term.residual).sum(axis=2)
            costs.append(factor * kernel.cost(squared).sum(axis=1))
            weight = np.sqrt(factor * kernel.weight(squared))[..., None, None]
            rows.append(_side_by_side(term, first, offsets.shape[1]) * weight)
            first += 0 if term.by_offset is None else term.by_offset.shape[-1]
        return np.concatenate(rows, axis=2), sum(costs[1:], start=costs[0])


def _side_by_side(rows: PointRows, first: int, count: int) -> np.ndarray:
    """(B, 21, c, 3 + count + 1): by the point, by all terms' offsets, of which its own begin at `first`, and
    the residual."""
    residual = rows.residual[..., None]
    by_offset = np.zeros((*residual.shape[:-1], count))
    if rows.by_offset is not None:
        by_offset[..., first : first + rows.by_offset.shape[-1]] = rows.by_offset
    return np.concatenate([rows.jacobian, by_offset, residual], axis=-1)


def _times(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """(..., c, 3) @ (..., 3, n). The general product of many small matrices takes several times longer."""
    product = a[..., 0:1] * b[..., 0:1, :]
    for k in (1, 2):
        product += a[..., k : k + 1] * b[..., k : k + 1, :]
    return product


@dataclass(frozen=True, eq=False)
class _Quadratic:
    """Terms that are linear in angles, as one: least + (a - best)^T precision (a - best), by finger."""

    blocks: np.ndarray
    """(5, 9, 9) precision"""
    precision: np.ndarray
    """(45, 45) the same on a diagonal"""
    best: np.ndarray
    """(5, 9) radians"""
    least: float

    @classmethod
    def of(cls, terms: list[AngleRows]) -> _Quadratic:
        """Terms with one problem each, taken at angles of zero."""
        residual = np.concatenate([t.residual[0] for t in terms], axis=1)[..., None]
        jacobian = np.concatenate([t.jacobian[0] for t in terms], axis=1)
        transposed = np.swapaxes(jacobian, 1, 2)
        precision = transposed @ jacobian
        best = -np.linalg.solve(precision, transposed @ residual)
        least = float(np.square(jacobian @ best + residual).sum())
        whole = np.zeros((5, 9, 5, 9))
        whole[range(5), :, range(5)] = precision
        return cls(precision, whole.reshape(45, 45), best[..., 0], least)
