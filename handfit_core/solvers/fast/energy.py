"""The sum of all residual terms of single frames, and its Gauss-Newton matrices."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch

from handfit_core.hand_model.anatomy import JointLimits
from handfit_core.residuals.coupling import coupling
from handfit_core.residuals.depth import depth
from handfit_core.residuals.limits import limits
from handfit_core.residuals.pose_prior import pose_prior
from handfit_core.residuals.reprojection import reprojection
from handfit_core.residuals.robust import Huber
from handfit_core.residuals.rows import PointRows
from handfit_core.residuals.shape_prior import shape_prior
from handfit_core.residuals.world import world
from handfit_core.skeleton import FINGER_JOINTS, FINGERS, TIP_KEYPOINTS
from handfit_core.solvers.fast.angles import angles_of, rates_of
from handfit_core.solvers.fast.blocks import Blocks
from handfit_core.solvers.fast.chain import Chain, Posed
from handfit_core.solvers.fast.observation import Observation

# The last joint's bend from the middle one's: slope, offset in degrees (FACTS: index, middle, ring;
# the little finger's is taken as the ring's).
_COUPLING = {"index": (0.87, 25.0), "middle": (0.79, 18.0), "ring": (0.73, 20.5), "little": (0.73, 20.5)}


@dataclass(frozen=True)
class Weights:
    """How much each term counts; 1 is what its sigmas say."""

    reprojection: float = 1.0
    depth: float = 1.0
    world: float = 0.0
    tips: float = 1.0
    """of the reprojection of fingertips, against other keypoints"""
    limits_sigma: float = np.radians(2.0)
    """radians beyond the range that cost as much as one sigma"""
    coupling_sigma: float = np.radians(18.0)
    prior: float = 0.7
    shape_sigma: float = 1.0
    world_sigma: float = 0.010
    """metres"""
    pixel_kernel: Huber = Huber(1.0)
    depth_kernel: Huber = Huber(1.0)


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


class Energy:
    """All terms of one model's frames. Holds nothing of a problem but constants."""

    def __init__(self, chain: Chain, prior: PosePrior, joint_limits: JointLimits, weights: Weights) -> None:
        self._chain, self._weights = chain, weights
        prior = prior.of_side(chain.model.side)
        tensor = lambda a: torch.tensor(np.ascontiguousarray(a), dtype=chain.dtype, device=chain.device)  # noqa: E731
        whiten = np.linalg.inv(np.linalg.cholesky(prior.covariance)) * np.sqrt(weights.prior)
        self._mean, self._whiten = tensor(prior.mean), tensor(whiten)
        joints = np.array([FINGER_JOINTS[f] for f in FINGERS]) - 1
        self._lower = tensor(joint_limits.lower[joints].reshape(5, 9))
        self._upper = tensor(joint_limits.upper[joints].reshape(5, 9))
        self._knuckles = tensor([0.0, 1.0, 1.0, 1.0, 1.0])
        rules = [_COUPLING.get(f) for f in FINGERS]
        self._slope = tensor([0.0 if r is None else r[0] for r in rules])
        self._offset = tensor([0.0 if r is None else np.radians(r[1]) for r in rules])
        self._coupling_sigma = tensor([np.inf if r is None else weights.coupling_sigma for r in rules])
        emphasis = np.full(21, np.sqrt(weights.reprojection))
        emphasis[list(TIP_KEYPOINTS)] *= np.sqrt(weights.tips)
        self._emphasis = tensor(emphasis)
        self._shape_sigma = tensor(np.full(10, weights.shape_sigma))

    def of(self, posed: Posed, seen: Observation, *, shape: bool, shape_weight: float = 1.0) -> Blocks:
        """Cost and matrices. `shape`: whether betas are variables; `shape_weight` of their prior (in a clip
        with one shape, 1 / frames)."""
        batch = len(posed.state)
        chain, weights = self._chain, self._weights
        point_rows, cost = self._point_rows(posed, seen)
        residual = torch.cat([r.residual for r in point_rows], dim=2)  # (B, 21, c)
        jacobian = torch.cat([r.jacobian for r in point_rows], dim=2)  # (B, 21, c, 3)
        count = residual.shape[2]

        by_hand = chain.jacobian_of_hand(posed, shape=shape) @ jacobian.mT
        by_offsets = self._by_offsets(point_rows, posed.state.offsets.shape[1])  # (B, 21, m, c)
        by_hand = torch.cat([by_hand[:, :, :6], by_offsets, by_hand[:, :, 6:]], dim=2)  # (B, 21, n, c)
        n = by_hand.shape[2]
        by_finger = chain.jacobian_of_fingers(posed) @ jacobian[:, 1:].view(batch, 5, 4, count, 3).mT
        flat_hand = by_hand.transpose(1, 2).reshape(batch, n, 21 * count)
        of_fingers = by_hand[:, 1:].view(batch, 5, 4, n, count).transpose(2, 3).reshape(batch, 5, n, 4 * count)
        flat_finger = by_finger.transpose(2, 3).reshape(batch, 5, 9, 4 * count)
        finger_residual = residual[:, 1:].reshape(batch, 5, 4 * count, 1)

        angles = angles_of(posed.state.local)
        angle_rows = self._angle_rows(angles.view(batch, 5, 9))
        rates = rates_of(angles)
        turn = torch.zeros(batch, 5, 9, 9, dtype=chain.dtype, device=chain.device)
        for joint in range(3):
            part = slice(3 * joint, 3 * joint + 3)
            turn[:, :, part, part] = rates[:, :, joint]
        angle_residual = torch.cat([r.residual for r in angle_rows], dim=2)
        angle_jacobian = (torch.cat([r.jacobian for r in angle_rows], dim=2) @ turn).mT  # (B, 5, 9, c)

        hand = flat_hand @ flat_hand.mT
        hand_gradient = (flat_hand @ residual.reshape(batch, -1, 1)).squeeze(-1)
        finger = flat_finger @ flat_finger.mT + angle_jacobian @ angle_jacobian.mT
        finger_gradient = flat_finger @ finger_residual + angle_jacobian @ angle_residual.unsqueeze(-1)
        cost = cost + angle_residual.square().sum(dim=(1, 2))
        if shape:
            betas, slope = shape_prior(posed.state.betas, self._shape_sigma)
            cost = cost + shape_weight * betas.square().sum(dim=1)
            hand_gradient[:, -10:] += shape_weight * slope * betas
            hand[:, -10:, -10:] += torch.diag(shape_weight * slope * slope)
        return Blocks(hand, flat_finger @ of_fingers.mT, finger, hand_gradient, finger_gradient.squeeze(-1), cost)

    def _point_rows(self, posed: Posed, seen: Observation) -> tuple[list[PointRows], torch.Tensor]:
        weights = self._weights
        points = posed.points
        plane = reprojection(
            points, seen.pixels, seen.pixel_sigma / self._emphasis[:, None], seen.focal, seen.centre
        )
        squared = plane.residual.square().sum(dim=2)
        cost = weights.pixel_kernel.cost(squared).sum(dim=1)
        rows = [_scaled(plane, weights.pixel_kernel.weight(squared).sqrt())]
        offsets = posed.state.offsets
        along = depth(
            points, seen.depth, seen.depth_sigma, seen.ray, seen.focal.mean(dim=1), offsets[:, :1]
        )
        squared = along.residual.square().sum(dim=2)
        cost = cost + weights.depth * weights.depth_kernel.cost(squared).sum(dim=1)
        rows.append(_scaled(along, (weights.depth * weights.depth_kernel.weight(squared)).sqrt()))
        if seen.world is not None:
            sigma = torch.full_like(seen.depth, weights.world_sigma)
            laid = world(points, seen.world, sigma, offsets[:, 1:4])
            squared = laid.residual.square().sum(dim=2)
            cost = cost + weights.world * weights.depth_kernel.cost(squared).sum(dim=1)
            rows.append(_scaled(laid, (weights.world * weights.depth_kernel.weight(squared)).sqrt()))
        return rows, cost

    @staticmethod
    def _by_offsets(point_rows: list[PointRows], count: int) -> torch.Tensor:
        """(B, 21, m, c): each term's offsets are its own, in the order of the terms."""
        columns, at = [], 0
        for rows in point_rows:
            block = rows.residual.new_zeros(*rows.residual.shape, count)
            if rows.by_offset is not None:
                width = rows.by_offset.shape[-1]
                block[..., at : at + width] = rows.by_offset
                at += width
            columns.append(block)
        return torch.cat(columns, dim=2).mT

    def _angle_rows(self, angles: torch.Tensor):
        sigma = self._weights.limits_sigma
        return [
            pose_prior(angles, self._mean, self._whiten),
            limits(angles, self._lower, self._upper, sigma, self._knuckles),
            coupling(angles, self._slope, self._offset, self._coupling_sigma),
        ]


def _scaled(rows: PointRows, weight: torch.Tensor) -> PointRows:
    """Rows times a weight per keypoint (B, 21)."""
    wide = weight[..., None, None]
    return PointRows(
        rows.residual * weight[..., None],
        rows.jacobian * wide,
        None if rows.by_offset is None else rows.by_offset * wide,
    )
