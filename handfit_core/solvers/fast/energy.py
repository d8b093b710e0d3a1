"""The sum of all residual terms of single frames, and its Gauss-Newton matrices."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch

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

        def tensor(a: np.ndarray | list[float]) -> torch.Tensor:
            return torch.tensor(np.ascontiguousarray(a), dtype=chain.dtype, device=chain.device)

        whiten = np.linalg.inv(np.linalg.cholesky(prior.covariance)) * np.sqrt(weights.prior)
        joints = np.array([FINGER_JOINTS[f] for f in FINGERS]) - 1
        self._lower = tensor(joint_limits.lower[joints].reshape(5, 9))
        self._upper = tensor(joint_limits.upper[joints].reshape(5, 9))
        self._knuckles = tensor([0.0, 1.0, 1.0, 1.0, 1.0])
        rules = [_COUPLING.get(f) for f in FINGERS]
        slope = tensor([0.0 if r is None else r[0] for r in rules])
        offset = tensor([0.0 if r is None else np.radians(r[1]) for r in rules])
        sigma = tensor([np.inf if r is None else weights.coupling_sigma for r in rules])
        flat = torch.zeros(1, 5, 9, dtype=chain.dtype, device=chain.device)
        self._habit = _Quadratic.of(
            [pose_prior(flat, tensor(prior.mean), tensor(whiten)), coupling(flat, slope, offset, sigma)]
        )
        emphasis = np.full(21, np.sqrt(weights.reprojection))
        emphasis[list(TIP_KEYPOINTS)] *= np.sqrt(weights.tips)
        self._emphasis = tensor(emphasis)
        self._shape_sigma = tensor(np.full(10, weights.shape_sigma))
        self._shape_mean = tensor(np.zeros(10) if measured is None else measured.betas)
        self._length_rates = None if measured is None else tensor(measured.length_rates)
        self._same_joint = tensor(np.eye(3))[:, None, :, None]

    def of(self, posed: Posed, seen: Observation, *, shape: bool, shape_weight: float = 1.0) -> Blocks:
        """Cost and matrices. `shape`: whether betas are variables; `shape_weight` of their prior (in a clip
        with one shape, 1 / frames)."""
        batch, chain = len(posed.state), self._chain
        rows, cost = self._point_rows(posed, seen)  # (B, 21, c, 3 + m + 1)
        moving = _times(rows[..., :3], chain.jacobian(posed, shape=shape))
        offsets, residual = rows[..., 3:-1], rows[..., -1:]
        # Columns: a finger's nine increments, the hand's own n variables, the residual.
        whole = torch.cat([moving[..., :15], offsets, moving[..., 15:], residual], dim=-1)
        of_hand = whole[..., 9:].flatten(1, 2)
        corner = torch.bmm(of_hand.mT, of_hand)
        of_finger = whole[:, 1:].view(batch, 5, -1, whole.shape[-1])  # (B, 5, 4 c, 9 + n + 1)
        sides = of_finger[..., :9].mT @ of_finger

        angle_squared, angle_cost = self._of_angles(posed.state.local, seen.kept)
        finger = sides[..., :9] + angle_squared[..., :9]
        finger_gradient = sides[..., -1] + angle_squared[..., 9]
        hand, hand_gradient = corner[:, :-1, :-1], corner[:, :-1, -1]
        cost = cost + angle_cost
        if seen.kept is not None:
            off, slope = distance(posed.state.wrist, seen.kept.wrist, seen.kept.distance_sigma)
            cost = cost + off.square()
            hand_gradient[:, 3:6] += off[:, None] * slope
            hand[:, 3:6, 3:6] += slope[:, :, None] * slope[:, None]
        if shape:
            of_shape, slope = shape_prior(posed.state.betas, self._shape_sigma, self._shape_mean)
            cost = cost + shape_weight * of_shape.square().sum(dim=1)
            hand_gradient[:, -10:] += shape_weight * slope * of_shape
            hand.diagonal(dim1=1, dim2=2)[:, -10:] += shape_weight * slope * slope
            if self._length_rates is not None:
                sigma = self._weights.length_sigma
                off, slope = hand_length(posed.state.betas, self._shape_mean, self._length_rates, sigma)
                cost = cost + shape_weight * off.square()
                hand_gradient[:, -10:] += shape_weight * off[:, None] * slope
                hand[:, -10:, -10:] += shape_weight * slope[:, None] * slope
        return Blocks(hand, sides[..., 9:-1], finger, hand_gradient, finger_gradient, cost)

    def _of_angles(self, local: torch.Tensor, kept: Kept | None) -> tuple[torch.Tensor, torch.Tensor]:
        """J^T [J r] (B, 5, 9, 10) of the terms on angles by the joints' increments, and their cost (B,)."""
        angles = angles_of(local)
        rates = rates_of(angles)
        flat = angles.flatten(2)
        turn = (rates.unsqueeze(4) * self._same_joint).reshape(*flat.shape, 9)  # (B, 5, 9, 9)
        outside = self._limits(flat, kept)
        habit = self._habit
        away = flat - habit.best
        pull = (away.flatten(1) @ habit.precision).view_as(flat)
        cost = habit.least + (away * pull + outside.residual.square()).sum(dim=(1, 2))
        precision = habit.blocks
        if kept is not None:
            near = near_pose(flat, kept.angles, kept.angle_sigma)
            cost = cost + near.residual.square().sum(dim=(1, 2))
            pull = pull + (near.jacobian.mT @ near.residual.unsqueeze(-1)).squeeze(-1)
            precision = precision + near.jacobian.mT @ near.jacobian
        turn, jacobian = turn.flatten(0, 1), outside.jacobian.flatten(0, 1)  # (5 B, 9, 9)
        sloped = jacobian.mT
        by_angle = torch.bmm(sloped, jacobian).view(*flat.shape, 9) + precision
        gradient = torch.baddbmm(pull.reshape(-1, 9, 1), sloped, outside.residual.view(-1, 9, 1))
        right = torch.cat([torch.bmm(by_angle.view(-1, 9, 9), turn), gradient], dim=-1)
        return torch.bmm(turn.mT, right).view(*flat.shape, 10), cost

    def _limits(self, flat: torch.Tensor, kept: Kept | None) -> AngleRows:
        """What angles (B, 5, 9) beyond their ranges cost."""
        if kept is None or kept.limits_sigma is None:
            return limits(flat, self._lower, self._upper, self._weights.limits_sigma, self._knuckles)
        already = limits(kept.angles, self._lower, self._upper, 1.0, self._knuckles).residual.abs()
        more = already.clamp_min(PASSIVE_RANGE)
        return limits(flat, self._lower, self._upper, kept.limits_sigma, self._knuckles, more)

    def _point_rows(self, posed: Posed, seen: Observation) -> tuple[torch.Tensor, torch.Tensor]:
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
                depth(points, seen.depth, seen.depth_sigma, seen.ray, seen.focal.mean(dim=1), offsets[:, :1]),
                weights.depth,
                weights.depth_kernel,
            ),
        ]
        if seen.world is not None:
            sigma = torch.full_like(seen.depth, weights.world_sigma)
            terms.append(
                (world(points, seen.world, sigma, offsets[:, 1:4]), weights.world, weights.depth_kernel)
            )
        rows, costs, first = [], [], 0
        for term, factor, kernel in terms:
            squared = term.residual.square().sum(dim=2)
            costs.append(factor * kernel.cost(squared).sum(dim=1))
            weight = (factor * kernel.weight(squared)).sqrt()[..., None, None]
            rows.append(_side_by_side(term, first, offsets.shape[1]) * weight)
            first += 0 if term.by_offset is None else term.by_offset.shape[-1]
        return torch.cat(rows, dim=2), sum(costs[1:], start=costs[0])


def _side_by_side(rows: PointRows, first: int, count: int) -> torch.Tensor:
    """(B, 21, c, 3 + count + 1): by the point, by all terms' offsets, of which its own begin at `first`, and
    the residual."""
    residual = rows.residual.unsqueeze(-1)
    by_offset = residual.new_zeros(*residual.shape[:-1], count)
    if rows.by_offset is not None:
        by_offset[..., first : first + rows.by_offset.shape[-1]] = rows.by_offset
    return torch.cat([rows.jacobian, by_offset, residual], dim=-1)


def _times(a: torch.Tensor, b: torch.Tensor) -> torch.Tensor:
    """(..., c, 3) @ (..., 3, n). Torch's own product of many small matrices takes several times longer."""
    product = a[..., 0:1] * b[..., 0:1, :]
    for k in (1, 2):
        product = product.addcmul_(a[..., k : k + 1], b[..., k : k + 1, :])
    return product


@dataclass(frozen=True, eq=False)
class _Quadratic:
    """Terms that are linear in angles, as one: least + (a - best)^T precision (a - best), by finger."""

    blocks: torch.Tensor
    """(5, 9, 9) precision"""
    precision: torch.Tensor
    """(45, 45) the same on a diagonal"""
    best: torch.Tensor
    """(5, 9) radians"""
    least: torch.Tensor
    """()"""

    @classmethod
    def of(cls, terms: list[AngleRows]) -> _Quadratic:
        """Terms with one problem each, taken at angles of zero."""
        residual = torch.cat([t.residual[0] for t in terms], dim=1).unsqueeze(-1).double()
        jacobian = torch.cat([t.jacobian[0] for t in terms], dim=1).double()
        precision = jacobian.mT @ jacobian
        best = -torch.linalg.solve(precision, jacobian.mT @ residual)
        least = (jacobian @ best + residual).square().sum()
        dtype = terms[0].residual.dtype
        whole = torch.block_diag(*precision)
        return cls(precision.to(dtype), whole.to(dtype), best.squeeze(-1).to(dtype), least.to(dtype))
