"""The solver's start: a relaxed hand laid over the landmarks in closed form."""

from __future__ import annotations

import numpy as np

from handfit_core.common.skeleton import PALM_KEYPOINTS
from handfit_core.fit.observation import Observation
from handfit_core.geometry.rotations import turn_from_axis
from handfit_core.geometry.similarity import laid_over
from handfit_core.hand_model.chain import Chain, State


def spatial(seen: Observation) -> np.ndarray:
    """(B, 21, 3) the landmarks in pixels relative to their mean, in camera axes, as under orthographic
    projection."""
    plane = seen.pixels - seen.pixels.mean(axis=1, keepdims=True)
    along_axis = np.concatenate([plane, seen.depth[..., None]], axis=2)
    return along_axis @ turn_from_axis(seen.ray).swapaxes(1, 2)


@np.errstate(all="ignore")
def relaxed_start(chain: Chain, seen: Observation, angles: np.ndarray, betas: np.ndarray) -> State:
    """Lay B relaxed hands with `angles` (5, 9) in radians and `betas` (10,) over the observed landmarks.

    The rotation is fitted to the palm, size and place to all points.
    """
    batch = len(seen)
    flat = State(np.eye(3)[None], angles[None], np.zeros((1, 3)), betas[None], np.zeros(1))
    rest = chain.pose(flat).points[0]
    target = spatial(seen)
    palm = list(PALM_KEYPOINTS)
    aim = target[:, palm] - target[:, palm].mean(axis=1, keepdims=True)
    rotation, _ = laid_over(np.broadcast_to(rest[palm] - rest[palm].mean(axis=0), aim.shape), aim)
    turned = rest @ rotation.swapaxes(1, 2)
    spread = turned - turned.mean(axis=1, keepdims=True)
    # The target's mean is zero.
    scale = (spread * target).sum(axis=(1, 2)) / np.square(spread).sum(axis=(1, 2))
    focal = seen.focal.mean(axis=1)
    # Pixels per metre in parts of the focal length: no hand is farther than a thousand metres
    distance = focal / np.maximum(scale, 1e-3 * focal)
    if seen.depth_zero is not None:
        distance = np.where(np.isnan(seen.depth_zero), distance, seen.depth_zero)
    towards = np.ones((batch, 3))
    towards[:, :2] = (seen.pixels.mean(axis=1) - seen.centre) / seen.focal
    centre = towards * (distance / np.linalg.norm(towards, axis=1))[:, None]
    return State(
        root=rotation,
        angles=np.broadcast_to(angles, (batch, 5, 9)),
        wrist=centre - turned.mean(axis=1),
        betas=np.broadcast_to(betas, (batch, len(betas))),
        depth_zero=distance,
    )
