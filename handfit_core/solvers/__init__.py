"""Solvers by name. Each fits one hand model to one detected track."""

from __future__ import annotations

from functools import partial
from typing import Final

from handfit_core.detect.keypoints import DetectedTrack
from handfit_core.errors import OptionError
from handfit_core.geometry.camera import Intrinsics
from handfit_core.hand_model.data import HandModel
from handfit_core.solvers.paper import PaperOptions, fit_track
from handfit_core.solvers.result import OnFrame, ShouldStop, TrackFit, TrackSolver, never

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

SHORTEST_HAND: Final = 0.05
LONGEST_HAND: Final = 0.30
"""metres, wrist joint to the tip of the middle finger"""


def solver_names() -> tuple[str, ...]:
    """All solvers there are."""
    return (*FAST_SOLVERS, *PAPER_SOLVERS)


def get_solver(
    name: str, smoothing: float = DEFAULT_SMOOTHING, hand_length: float | None = None
) -> TrackSolver:
    """The solver of that name; `smoothing` is for those that smooth, `hand_length` (metres, wrist joint to
    the tip of the middle finger) for `FAST_SOLVERS`. Raises OptionError."""
    if name not in solver_names():
        raise OptionError(f"there is no solver '{name}'; choose one of {', '.join(solver_names())}")
    if not 0.0 <= smoothing <= MOST_SMOOTHING:
        raise OptionError(f"smoothing must lie between 0 and {MOST_SMOOTHING:g}, not {smoothing:g}")
    if hand_length is not None and not SHORTEST_HAND <= hand_length <= LONGEST_HAND:
        raise OptionError(
            f"a hand's length must lie between {SHORTEST_HAND * 1e3:g} and {LONGEST_HAND * 1e3:g} mm, not "
            f"{hand_length * 1e3:g} mm; measure from the wrist to the tip of the middle finger"
        )
    if name in FAST_SOLVERS:
        return partial(_fit_fast, smoothing if name == "fast" else 0.0, hand_length)
    return partial(fit_track, PAPER_SOLVERS[name])


def _fit_fast(
    smoothing: float,
    hand_length: float | None,
    model: HandModel,
    track: DetectedTrack,
    intrinsics: Intrinsics,
    on_frame: OnFrame,
    should_stop: ShouldStop = never,
) -> TrackFit:
    # Torch loads here and not with the names of the solvers.
    from handfit_core.solvers.fast import fit

    return fit.fit_track(smoothing, model, track, intrinsics, on_frame, should_stop, hand_length)


__all__ = [
    "DEFAULT_SMOOTHING",
    "DEFAULT_SOLVER",
    "FAST_SOLVERS",
    "LONGEST_HAND",
    "MOST_SMOOTHING",
    "PAPER_SOLVERS",
    "SHORTEST_HAND",
    "TrackFit",
    "TrackSolver",
    "get_solver",
    "solver_names",
]
