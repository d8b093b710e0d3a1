"""World landmarks against keypoints, up to the rotation, size and place that suit them best."""

from __future__ import annotations

import torch

from handfit_core.residuals.rows import PointRows


def similarity(source: torch.Tensor, target: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Rotation (B, 3, 3) and scale (B,) that lay centred source (B, N, 3) over centred target (B, N, 3)
    with the least squared distance. Umeyama, 1991. Points that are not finite get a meaningless rotation and
    harm no other in the batch."""
    a = source - source.mean(dim=1, keepdim=True)
    b = target - target.mean(dim=1, keepdim=True)
    # LAPACK raises on NaN.
    covariance = torch.nan_to_num(b.mT @ a, posinf=0.0, neginf=0.0)
    u, s, vt = torch.linalg.svd(covariance)
    sign = torch.ones_like(s)
    sign[:, 2] = torch.det(u @ vt).sign()
    rotation = (u * sign[:, None, :]) @ vt
    return rotation, (s * sign).sum(dim=1) / a.square().sum(dim=(1, 2)).clamp_min(1e-12)


def world(
    points: torch.Tensor, landmarks: torch.Tensor, sigma: torch.Tensor, offset: torch.Tensor
) -> PointRows:
    """points (B, 21, 3) metres, camera frame; landmarks (B, 21, 3) metres in any frame and size; sigma
    (B, 21) metres; offset (B, 3) metres, where the landmarks' centre lies, solved for beside the hand.

    Three rows: r = x - offset - s R w. Rotation and size are the best ones for the points as they are,
    taken as constant in the derivative: since they are at a minimum, the gradient of the unweighted cost is
    exact all the same.
    """
    rotation, scale = similarity(landmarks, points)
    laid = scale[:, None, None] * (landmarks - landmarks.mean(dim=1, keepdim=True)) @ rotation.mT
    residual = points - offset[:, None] - laid
    identity = torch.eye(3, dtype=points.dtype, device=points.device)
    jacobian = (identity / sigma[..., None, None]).expand(*points.shape[:2], 3, 3)
    return PointRows(residual / sigma[..., None], jacobian, -jacobian)
