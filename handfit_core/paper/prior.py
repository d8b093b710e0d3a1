"""A small pull towards a relaxed hand, for what the keypoints leave open. Not in the paper."""

from __future__ import annotations

import numpy as np
import torch

from handfit_core.hand_model.anatomy import anatomical_axes
from handfit_core.hand_model.data import HandModel
from handfit_core.paper.settings import PAPER
from handfit_core.skeleton import FINGER_JOINTS

# Spread of (twist, spread, bend) about the relaxed hand, degrees: of the order of a third of the
# range of motion, and near nothing where a joint is a hinge. One row per joint along the finger.


class RelaxedPrior:
    """Squared distance of pose and shape from the relaxed mean hand, in the units of the mean square
    keypoint error (mm^2), as a maximum a posteriori estimate weighs them.

    It works on whitened variables, in units of the spreads above: root rotation (3), pose (45), and
    shape (10) unless that is fixed. Besides making the prior a plain sum of squares, they halve the
    iterations that L-BFGS needs.
    """

    def __init__(self, model: HandModel) -> None:
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
        """(3,) and (45,) radians -> the first 48 variables."""
        deviation = (hand_pose - self._mean.numpy()).reshape(15, 3, 1)
        along_axes = (np.swapaxes(self._axes, -1, -2) @ deviation)[..., 0] / self._sigmas
        return np.concatenate([global_orient / PAPER.orient_scale, along_axes.reshape(45)])

    def unwhiten(self, variables: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """The first 48 variables -> (1, 3) and (1, 45) radians."""
        deviation = (self._to_pose @ variables[3:48].reshape(15, 3, 1)).reshape(45)
        return variables[None, :3] * PAPER.orient_scale, (self._mean + deviation)[None]

    def __call__(self, variables: torch.Tensor) -> torch.Tensor:
        """Cost of (48,) variables, or of (58,) with the shape. The root rotation is free."""
        return self._weight * variables[3:].square().sum()
