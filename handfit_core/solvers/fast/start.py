"""Where the solver starts: a relaxed hand laid over the landmarks in closed form."""

from __future__ import annotations

import torch

from handfit_core.residuals.world import similarity
from handfit_core.skeleton import PALM_KEYPOINTS
from handfit_core.solvers.fast.angles import rotation_of
from handfit_core.solvers.fast.chain import Chain, State
from handfit_core.solvers.fast.observation import Observation

_LEAST_SCALE = 1e-3
"""of pixels per metre against the focal length; no hand is farther than a thousand metres"""


def turns_to_rays(ray: torch.Tensor) -> torch.Tensor:
    """(B, 3) unit rays -> (B, 3, 3) smallest rotations that lead from the optical axis to them."""
    zero = torch.zeros_like(ray[:, 0])
    x, y, z = ray.unbind(1)
    skew = torch.stack([zero, zero, x, zero, zero, y, -x, -y, zero], dim=1).view(-1, 3, 3)
    identity = torch.eye(3, dtype=ray.dtype, device=ray.device)
    return identity + skew + skew @ skew / (1.0 + z)[:, None, None]


def spatial(seen: Observation) -> torch.Tensor:
    """(B, 21, 3) the landmarks as points in pixels about their mean, in camera axes, as if seen from afar."""
    plane = seen.pixels - seen.pixels.mean(dim=1, keepdim=True)
    along_axis = torch.cat([plane, seen.depth.unsqueeze(-1)], dim=2)
    return along_axis @ turns_to_rays(seen.ray).mT


def relaxed_start(
    chain: Chain, seen: Observation, angles: torch.Tensor, betas: torch.Tensor, *, offsets: int = 1
) -> State:
    """angles (B, 5, 9) radians and betas (B, 10) of the hand to lay over the landmarks; `offsets` (1 or 4) of
    the terms. Rotation is that of the palm; size and place are those of all points."""
    batch = len(seen)
    identity = torch.eye(3, dtype=chain.dtype, device=chain.device).expand(batch, 3, 3)
    local = rotation_of(angles.view(batch, 5, 3, 3))
    zero = torch.zeros(batch, 3, dtype=chain.dtype, device=chain.device)
    rest = chain.pose(State(identity, local, zero, betas, zero)).points
    target = spatial(seen)
    palm = list(PALM_KEYPOINTS)
    rotation, _ = similarity(rest[:, palm], target[:, palm])
    turned = rest @ rotation.mT
    spread = turned - turned.mean(dim=1, keepdim=True)
    # The target's mean is zero.
    scale = (spread * target).sum(dim=(1, 2)) / spread.square().sum(dim=(1, 2))
    focal = seen.focal.mean(dim=1)
    distance = focal / torch.maximum(scale, _LEAST_SCALE * focal)
    middle = seen.pixels.mean(dim=1)
    towards = torch.cat([(middle - seen.centre) / seen.focal, torch.ones_like(middle[:, :1])], dim=1)
    centre = towards * (distance / torch.linalg.vector_norm(towards, dim=1))[:, None]
    wrist = centre - turned.mean(dim=1)
    along = distance[:, None]
    more = [centre] if offsets == 4 else []
    return State(rotation, local, wrist, betas, torch.cat([along, *more], dim=1))
