"""The paper's method: "Monocular 3D Hand Pose Estimation with Implicit Camera Alignment" (arXiv 2506.11133),
its experiments A to H, and A+, which is made of A. A line here may import torch, which loads with the first
fit; no part of a capture imports it before its solver is asked for."""

from __future__ import annotations

from functools import partial
from typing import Final

from handfit_core.fit.solvers import Solver, TrackSolver
from handfit_core.paper.fitter import PaperOptions, fit_track

_MSE, _GEMAN, _HUBER = ("L-BFGS-B", "mse"), ("L-BFGS-B", "geman_mcclure"), ("L-BFGS-B", "huber")
_TIPS, _ALL = "error, fingertips counted again", "error of the 21 keypoints"

EXPERIMENTS: Final = {
    "paper-a": PaperOptions("A: L-BFGS, Mean Squares", f"Mean squared {_TIPS}", *_MSE, tips=True),
    "paper-b": PaperOptions("B: Without Fingertips", f"Mean squared {_ALL}", *_MSE, tips=False),
    "paper-c": PaperOptions("C: Geman-McClure", f"Geman-McClure {_TIPS}", *_GEMAN, tips=True),
    "paper-d": PaperOptions("D: Geman-McClure, Plain", f"Geman-McClure {_ALL}", *_GEMAN, tips=False),
    "paper-e": PaperOptions("E: Huber", f"Huber {_TIPS}", *_HUBER, tips=True),
    "paper-f": PaperOptions("F: Huber, Plain", f"Huber {_ALL}", *_HUBER, tips=False),
    "paper-g": PaperOptions(
        "G: BFGS", "Mean squared error with the BFGS optimizer", "BFGS", "mse", tips=True
    ),
    "paper-h": PaperOptions(
        "H: Anatomical Stage",
        "A second stage that keeps joints within their range",
        *_MSE,
        tips=False,
        anatomical_stage=True,
    ),
    "paper-a-plus": PaperOptions(
        "A+: With Pose Prior",
        "Experiment A, held by a relaxed pose, with a camera stage",
        *_MSE,
        tips=True,
        pose_prior=True,
        warm_start=True,
        camera_stage=True,
    ),
}
"""The paper's experiments as published, and `paper-a-plus`: A with a pull towards a relaxed hand and a last
stage through the camera"""


def _solver(options: PaperOptions) -> Solver:
    def make(_smoothing: float, _hand_length: float | None) -> TrackSolver:
        return partial(fit_track, options)

    can = {"slow": True, "needs": ("torch",), "published": not options.camera_stage}
    return Solver(make, options.title, options.description, **can)


A, B, C, D, E, F, G, H, A_PLUS = map(_solver, EXPERIMENTS.values())
