"""The paper's method: "Monocular 3D Hand Pose Estimation with Implicit Camera Alignment" (arXiv 2506.11133),
its experiments A to H, and A+, which is made of A. They need torch, which loads with the first fit."""

from __future__ import annotations

from functools import partial

from handfit_core.solvers import Solver, TrackSolver


def _made(name: str, _smoothing: float, _hand_length: float | None) -> TrackSolver:
    from handfit_core.paper.fitter import EXPERIMENTS, fit_track

    return partial(fit_track, EXPERIMENTS[name])


def _experiment(name: str, title: str, description: str) -> Solver:
    return Solver(partial(_made, name), title, description, slow=True, needs=("torch",))


A = _experiment("paper-a", "A: L-BFGS, Mean Squares", "Mean squared error, fingertips counted again")
B = _experiment("paper-b", "B: Without Fingertips", "Mean squared error of the 21 keypoints")
C = _experiment("paper-c", "C: Geman-McClure", "Geman-McClure error, fingertips counted again")
D = _experiment("paper-d", "D: Geman-McClure, Plain", "Geman-McClure error of the 21 keypoints")
E = _experiment("paper-e", "E: Huber", "Huber error, fingertips counted again")
F = _experiment("paper-f", "F: Huber, Plain", "Huber error of the 21 keypoints")
G = _experiment("paper-g", "G: BFGS", "Mean squared error with the BFGS optimizer")
H = _experiment("paper-h", "H: Anatomical Stage", "A second stage that keeps joints within their range")
A_PLUS = _experiment(
    "paper-a-plus", "A+: With Pose Prior", "Experiment A, held by a relaxed pose, with a camera stage"
)
