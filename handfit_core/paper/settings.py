"""Weights and stopping criteria of the paper's experiments."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final


@dataclass(frozen=True)
class PaperSettings:
    """Weights, scales and iterations of the paper's experiments."""

    max_iterations: int = 500
    """Most iterations of scipy's minimiser, as in the published code"""
    prior_tolerance: float = 1e-5
    """Relative change of the cost at which the variant with a prior stops; scipy's own tolerance, which the
    published experiments use, costs more iterations for a thousandth of the cost."""
    shape_frames: int = 8
    """Number of frames, evenly spread over a clip, that decide the hand's one shape"""
    tip_weight: float = 4.0
    """Weight of the loss of the fingertips where they count again, as in the published code"""
    geman_mcclure_rho: float = 100.0
    """mm: scale rho of Geman and McClure's loss; the paper's own results with it and with MSE differ by 0.01
    mm, so it must be wide"""
    huber_delta: float = 5.0
    """mm: residual at which Huber's loss turns from square to linear"""
    keypoint_sigma: float = 3.0
    """mm: expected error of a detected keypoint, against which the spreads of `RelaxedPrior` are weighed"""
    orient_scale: float = 0.3
    """radians per unit of the root rotation's variables, so that all variables have similar effects"""
    min_depth: float = 0.05
    """metres from the camera, nearer than which no hand is placed"""
    penalty_weight: float = 1.0
    """mm^2 per unit of exp(radians): weight of the anatomical penalty, for which the paper names no value"""
    depth_weight: float = 0.3
    """Weight of an error in depth against one in the picture plane"""
    transl_scale: float = 0.02
    """metres per unit of the translation's variables"""
    camera_iterations: int = 200
    camera_tolerance: float = 1e-4
    """Relative change of the cost at which the stage through the camera stops; a hundred times less doubles
    the time for 0.1 px"""
    nearest: float = 0.02
    """metres from the camera, nearer than which no point is projected, so that a wild step cannot divide by
    zero"""


PAPER: Final = PaperSettings()
