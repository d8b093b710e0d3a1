"""Where the solver starts: a relaxed hand laid over the landmarks in closed form."""

from __future__ import annotations

import numpy as np

from handfit_core.geometry.rotations import skew
from handfit_core.residuals.world import similarity
from handfit_core.skeleton import PALM_KEYPOINTS
from handfit_core.solvers.fast.angles import rotation_of
from handfit_core.solvers.fast.chain import Chain, State
from handfit_core.solvers.fast.observation import Observation

_LEAST_SCALE = 1e-3
"""of pixels per metre against the focal length; no hand is farther than a thousand metres"""


def turns_to_rays(ray: np.ndarray) -> np.ndarray:
    """(B, 3) unit rays -> (B, 3, 3) smallest rotations that lead from the optical axis to them."""
    axis = np.stack([-ray[:, 1], ray[:, 0], np.zeros(len(ray))], axis=1)  # z x ray
    turn = skew(axis)
    return np.eye(3) + turn + turn @ turn / (1.0 + ray[:, 2])[:, None, None]


def spatial(seen: Observation) -> np.ndarray:
    """(B, 21, 3) the landmarks as points in pixels about their mean, in camera axes, as if seen from afar."""
    plane = seen.pixels - seen.pixels.mean(axis=1, keepdims=True)
    along_axis = np.concatenate([plane, seen.depth[..., None]], axis=2)
    return along_axis @ np.swapaxes(turns_to_rays(seen.ray), 1, 2)


@np.errstate(all="ignore")
def relaxed_start(
    chain: Chain, seen: Observation, angles: np.ndarray, betas: np.ndarray, *, offsets: int = 1
) -> State:
    """angles (B, 5, 9) radians and betas (B, 10) of the hand to lay over the landmarks; `offsets` (1 or 4) of
    the terms. Rotation is that of the palm; size and place are those of all points."""
    batch = len(seen)
    identity = np.broadcast_to(np.eye(3), (batch, 3, 3))
    local = rotation_of(angles.reshape(batch, 5, 3, 3))
    zero = np.zeros((batch, 3))
    rest = chain.pose(State(identity, local, zero, betas, zero)).points
    target = spatial(seen)
    palm = list(PALM_KEYPOINTS)
    rotation, _ = similarity(rest[:, palm], target[:, palm])
    turned = rest @ np.swapaxes(rotation, 1, 2)
    spread = turned - turned.mean(axis=1, keepdims=True)
    # The target's mean is zero.
    scale = (spread * target).sum(axis=(1, 2)) / np.square(spread).sum(axis=(1, 2))
    focal = seen.focal.mean(axis=1)
    distance = focal / np.maximum(scale, _LEAST_SCALE * focal)
    middle = seen.pixels.mean(axis=1)
    towards = np.concatenate([(middle - seen.centre) / seen.focal, np.ones((batch, 1))], axis=1)
    centre = towards * (distance / np.linalg.norm(towards, axis=1))[:, None]
    wrist = centre - turned.mean(axis=1)
    along = distance[:, None]
    more = [centre] if offsets == 4 else []
    return State(rotation, local, wrist, betas, np.concatenate([along, *more], axis=1))
