"""The costs that the paper's experiments minimise, in torch: losses, anatomical limits, and, not in the
paper, a pull towards a relaxed hand and a last stage through the camera.

Residuals are in millimetres, per coordinate; each loss is a mean over all of them.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import torch

from handfit_core.common.skeleton import FINGER_JOINTS, TIP_KEYPOINTS
from handfit_core.geometry.camera import Intrinsics
from handfit_core.hand_model.anatomy import JointLimits, anatomical_axes
from handfit_core.hand_model.data import HandModel
from handfit_core.hand_model.motion import HandMotion
from handfit_core.paper.layer import HandLayer, rotvec_to_rotmat
from handfit_core.paper.settings import PAPER

Loss = Callable[[torch.Tensor], torch.Tensor]


def mse(residual: torch.Tensor) -> torch.Tensor:
    """The mean of the squared residuals."""
    return residual.square().mean()


def geman_mcclure(residual: torch.Tensor) -> torch.Tensor:
    """The mean of rho^2 r^2 / (r^2 + rho^2) over the residuals r (Geman and McClure 1987)."""
    square = residual.square()
    rho2 = PAPER.geman_mcclure_rho**2
    return (rho2 * square / (square + rho2)).mean()


def huber(residual: torch.Tensor) -> torch.Tensor:
    """The mean over the residuals r of r^2 / 2 near zero, and of delta (|r| - delta / 2) beyond delta (Huber
    1964)."""
    return torch.nn.functional.huber_loss(residual, torch.zeros_like(residual), delta=PAPER.huber_delta)


def with_tips(loss: Loss) -> Loss:
    """Make a loss of residuals (B, 21, C) from `loss`, in which fingertips count again, times
    `tip_weight`."""
    tips = list(TIP_KEYPOINTS)

    def weighted(residual: torch.Tensor) -> torch.Tensor:
        return loss(residual) + PAPER.tip_weight * loss(residual[:, tips])

    return weighted


class AnatomicalPenalty:
    """The penalty a * sum(exp(l - theta) + exp(theta - u)) over the 45 anatomical angles theta and their
    limits l and u, in radians."""

    def __init__(self, axes: np.ndarray, limits: JointLimits) -> None:
        self._axes = torch.tensor(axes)
        self._lower = torch.tensor(limits.lower)
        self._upper = torch.tensor(limits.upper)

    def __call__(self, hand_pose: torch.Tensor) -> torch.Tensor:
        """Return the penalty, a scalar, of poses (B, 45), axis-angle in radians."""
        theta = self.angles(hand_pose)
        return PAPER.penalty_weight * (torch.exp(self._lower - theta) + torch.exp(theta - self._upper)).sum()

    def angles(self, hand_pose: torch.Tensor) -> torch.Tensor:
        """Return the twist, spread and bend (B, 15, 3), in radians, of the joints of poses (B, 45),
        axis-angle in radians; see `hand_model.anatomy`."""
        rotmats = rotvec_to_rotmat(hand_pose.reshape(-1, 15, 3))
        local = self._axes.transpose(-1, -2) @ rotmats @ self._axes
        # arcsine as an arctangent: its gradient stays finite at +-90 degrees.
        sine, cosine = local[..., 0, 2], torch.hypot(local[..., 0, 0], local[..., 0, 1])
        return torch.stack(
            [
                torch.atan2(-local[..., 1, 2], local[..., 2, 2]),
                torch.atan2(sine, cosine),
                torch.atan2(-local[..., 0, 1], local[..., 0, 0]),
            ],
            dim=-1,
        )


class RelaxedPrior:
    """Squared distance of pose and shape from the relaxed mean hand, in the units of the mean square
    keypoint error (mm^2), as a maximum a posteriori estimate weighs them. Not in the paper.

    It works on whitened variables, in units of the spreads below: root rotation (3), pose (45), and
    shape (10) unless that is fixed. Besides making the prior a plain sum of squares, they halve the
    iterations that L-BFGS needs.
    """

    def __init__(self, model: HandModel) -> None:
        # Spread of (twist, spread, bend) about the relaxed hand, degrees: of the order of a third of the
        # range of motion, and near nothing where a joint is a hinge. One row per joint along the finger.
        sigmas = np.empty((15, 3))
        for finger, joints in FINGER_JOINTS.items():
            sigmas[np.array(joints) - 1] = (
                ((10.0, 15.0, 20.0), (6.0, 8.0, 25.0), (3.0, 4.0, 35.0))
                if finger == "thumb"
                else ((4.0, 10.0, 40.0), (2.0, 3.0, 45.0), (2.0, 3.0, 30.0))
            )
        # Columns: what one sigma of twist, spread and bend adds to the axis-angle pose.
        self._axes = anatomical_axes(model)
        self._sigmas = np.radians(sigmas)
        self._to_pose = torch.tensor(self._axes * self._sigmas[:, None, :])
        self._mean = torch.tensor(model.hands_mean)
        self._weight = PAPER.keypoint_sigma**2 / 63.0  # the error is a mean over 63 coordinates

    def whiten(self, global_orient: np.ndarray, hand_pose: np.ndarray) -> np.ndarray:
        """Turn a root rotation (3,) and a pose (45,), radians, into the first 48 whitened variables."""
        deviation = (hand_pose - self._mean.numpy()).reshape(15, 3, 1)
        along_axes = (np.swapaxes(self._axes, -1, -2) @ deviation)[..., 0] / self._sigmas
        return np.concatenate([global_orient / PAPER.orient_scale, along_axes.reshape(45)])

    def unwhiten(self, variables: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Turn the first 48 whitened variables into a root rotation (1, 3) and a pose (1, 45), radians."""
        deviation = (self._to_pose @ variables[3:48].reshape(15, 3, 1)).reshape(45)
        return variables[None, :3] * PAPER.orient_scale, (self._mean + deviation)[None]

    def __call__(self, variables: torch.Tensor) -> torch.Tensor:
        """Return the cost, in mm^2, of whitened variables (48,), or of (58,) with the shape. The root
        rotation is free."""
        return self._weight * variables[3:].square().sum()


def refine(
    layer: HandLayer,
    prior: RelaxedPrior,
    loss: Loss,
    keypoints: np.ndarray,
    intrinsics: Intrinsics,
    start: HandMotion,
    *,
    fit_shape: bool,
) -> HandMotion:
    """Refine a placed hand (T = 1) against (21, 3) keypoints in pixels with depth. Not in the paper.

    The paper fits as if from infinitely far away. A hand near a lens looks different: what is nearer is
    larger. This stage measures the keypoint errors in the picture, after perspective projection, and the
    detected depth along the line of sight, with less weight, since it errs more. The shape changes only
    where `fit_shape` says so.
    """
    from scipy.optimize import minimize

    focal = torch.tensor([intrinsics.fx, intrinsics.fy], dtype=torch.float64)
    centre = torch.tensor([intrinsics.cx, intrinsics.cy], dtype=torch.float64)
    target = torch.tensor(keypoints)
    target_depth = target[:, 2] - target[:, 2].mean()
    first_points = layer.model.keypoints(start.betas, start.global_orient, start.hand_pose, start.transl)
    # So many metres one pixel spans at the hand; fixed, or the hand could shrink its errors by moving.
    metres = torch.tensor(first_points[..., 2].mean() / np.array([intrinsics.fx, intrinsics.fy]))
    fixed_betas = torch.tensor(start.betas)[None]
    first_transl = torch.tensor(start.transl)

    def cost(x: np.ndarray) -> tuple[float, np.ndarray]:
        variables = torch.tensor(x, requires_grad=True)
        moved, hand = variables[:3], variables[3:]
        orient, pose = prior.unwhiten(hand)
        betas = hand[None, 48:] if fit_shape else fixed_betas
        points = layer.keypoints(betas, orient, pose)[0] + first_transl + PAPER.transl_scale * moved
        pixels = points[:, :2] / points[:, 2:].clamp(min=PAPER.nearest) * focal + centre
        in_plane = (pixels - target[:, :2]) * metres
        depth = points[:, 2] - points[:, 2].mean() - target_depth * metres[0]
        residual = torch.cat([in_plane, PAPER.depth_weight * depth[:, None]], dim=-1)[None] * 1000.0
        total = loss(residual) + prior(hand)
        total.backward()
        assert variables.grad is not None
        return total.item(), variables.grad.numpy()

    parts = [np.zeros(3), prior.whiten(start.global_orient[0], start.hand_pose[0])]
    first = np.concatenate(parts + ([start.betas] if fit_shape else []))
    options = {"maxiter": PAPER.camera_iterations, "ftol": PAPER.camera_tolerance}
    found = minimize(cost, first, jac=True, method="L-BFGS-B", options=options).x
    orient, pose = prior.unwhiten(torch.tensor(found[3:]))
    return HandMotion(
        side=start.side,
        betas=found[51:] if fit_shape else start.betas,
        global_orient=orient.numpy(),
        hand_pose=pose.numpy(),
        transl=start.transl + PAPER.transl_scale * found[:3],
    )
