"""Solvers by name. Each fits one hand model to one detected track."""

from __future__ import annotations

from functools import partial
from typing import Final

from handfit_core.camera import Intrinsics
from handfit_core.errors import OptionError
from handfit_core.hand_model.data import HandModel
from handfit_core.keypoints import DetectedTrack
from handfit_core.solvers.paper import PaperOptions, fit_track
from handfit_core.solvers.result import OnFrame, TrackFit, TrackSolver

PAPER_SOLVERS: Final[dict[str, PaperOptions]] = {
    "paper-a": PaperOptions("L-BFGS-B", "mse", tips=True),
    "paper-b": PaperOptions("L-BFGS-B", "mse", tips=False),
    "paper-c": PaperOptions("L-BFGS-B", "geman_mcclure", tips=True),
    "paper-d": PaperOptions("L-BFGS-B", "geman_mcclure", tips=False),
    "paper-e": PaperOptions("L-BFGS-B", "huber", tips=True),
    "paper-f": PaperOptions("L-BFGS-B", "huber", tips=False),
    "paper-g": PaperOptions("BFGS", "mse", tips=True),
    "paper-h": PaperOptions("L-BFGS-B", "mse", tips=False, anatomical_stage=True),
    "paper-a-plus": PaperOptions(
        "L-BFGS-B", "mse", tips=True, pose_prior=True, warm_start=True, camera_stage=True
    ),
}
"""The paper's experiments as published, and `paper-a-plus`: A with a pull towards a relaxed hand and a
last stage through the camera."""

FAST_SOLVERS: Final = ("fast", "fast-per-frame")
"""Our own, and the same without looking at other frames than for the shape"""

DEFAULT_SOLVER: Final = "fast"
DEFAULT_SMOOTHING: Final = 1.0
MOST_SMOOTHING: Final = 10.0
"""How smooth motion is: 0 takes every frame by itself, 2 is twice as stiff as the default"""


def solver_names() -> tuple[str, ...]:
    """All solvers there are."""
    return (*FAST_SOLVERS, *PAPER_SOLVERS)


def get_solver(name: str, smoothing: float = DEFAULT_SMOOTHING) -> TrackSolver:
    """The solver of that name; `smoothing` is for those that smooth. Raises OptionError."""
    if name not in solver_names():
        raise OptionError(f"there is no solver '{name}'; choose one of {', '.join(solver_names())}")
    if not 0.0 <= smoothing <= MOST_SMOOTHING:
        raise OptionError(f"smoothing must lie between 0 and {MOST_SMOOTHING:g}, not {smoothing:g}")
    if name in FAST_SOLVERS:
        return partial(_fit_fast, smoothing if name == "fast" else 0.0)
    return partial(fit_track, PAPER_SOLVERS[name])


def _fit_fast(
    smoothing: float, model: HandModel, track: DetectedTrack, intrinsics: Intrinsics, on_frame: OnFrame
) -> TrackFit:
    # Torch loads here and not with the names of the solvers.
    from handfit_core.solvers.fast import fit

    return fit.fit_track(smoothing, model, track, intrinsics, on_frame)


__all__ = [
    "DEFAULT_SMOOTHING",
    "DEFAULT_SOLVER",
    "FAST_SOLVERS",
    "MOST_SMOOTHING",
    "PAPER_SOLVERS",
    "TrackFit",
    "TrackSolver",
    "get_solver",
    "solver_names",
]
