"""Solvers by name. Each fits one hand model to one detected track."""

from __future__ import annotations

from functools import partial
from typing import Final

from handfit_core.errors import OptionError
from handfit_core.solvers.paper import PaperOptions, fit_track
from handfit_core.solvers.result import TrackFit, TrackSolver

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

DEFAULT_SOLVER: Final = "paper-a-plus"


def solver_names() -> tuple[str, ...]:
    """All solvers there are."""
    return tuple(PAPER_SOLVERS)


def get_solver(name: str) -> TrackSolver:
    """The solver of that name. Raises OptionError."""
    if name not in PAPER_SOLVERS:
        raise OptionError(f"there is no solver '{name}'; choose one of {', '.join(solver_names())}")
    return partial(fit_track, PAPER_SOLVERS[name])


__all__ = ["DEFAULT_SOLVER", "PAPER_SOLVERS", "TrackFit", "TrackSolver", "get_solver", "solver_names"]
