"""A last stage of our default solver: the same loss once more, seen through the camera. Not in the paper.

The paper fits as if from infinitely far away. A hand near a lens looks different: what is nearer is
larger. This stage measures the keypoint errors in the picture, after perspective projection, and the
detected depth along the line of sight, with less weight, since it errs more.
"""

from __future__ import annotations

import numpy as np
import torch

from handfit_core.geometry.camera import Intrinsics
from handfit_core.hand_model.motion import HandMotion
from handfit_core.layer import HandLayer
from handfit_core.paper.losses import Loss
from handfit_core.paper.prior import RelaxedPrior
from handfit_core.paper.settings import PAPER


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
    """Refine a placed hand (T = 1) against (21, 3) keypoints in pixels with depth.

    The shape changes only where `fit_shape` says so.
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
