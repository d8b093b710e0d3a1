"""Solvers: what they take and give, what they can do, and where they are found.

A solver fits one hand model to one detected track. Those of other packages are found by their entry points in
the group `handfit.solvers`, each of which loads a `Solver`. Light to import: what a solver needs loads with
it.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, partial
from importlib.metadata import entry_points
from importlib.util import find_spec
from typing import Final, Protocol

import numpy as np

from handfit_core.detect.keypoints import DetectedTrack
from handfit_core.errors import OptionError
from handfit_core.geometry.camera import Intrinsics
from handfit_core.hand_model.data import HandModel

DEFAULT_SOLVER: Final = "fast"
DEFAULT_SMOOTHING: Final = 1.0
MOST_SMOOTHING: Final = 10.0
"""How smooth motion is: 0 takes every frame by itself, 2 is twice as stiff as the default"""

SHORTEST_HAND: Final = 0.05
LONGEST_HAND: Final = 0.30
"""metres, wrist joint to the tip of the middle finger"""

ENTRY_POINTS: Final = "handfit.solvers"

log = logging.getLogger("handfit")


@dataclass(frozen=True, eq=False)
class TrackFit:
    """A hand fitted to a whole track, in the camera frame; NaN in frames that are neither detected nor
    filled."""

    betas: np.ndarray
    """(10,)"""
    global_orient: np.ndarray
    """(T, 3) radians"""
    hand_pose: np.ndarray
    """(T, 45) radians"""
    transl: np.ndarray
    """(T, 3) metres"""
    converged: np.ndarray
    """(T,) bool: False where the optimiser stopped for another reason, or nothing was detected"""
    filled: np.ndarray | None = None
    """(T,) bool: frames of short gaps that were bridged from their neighbours; None: there are none"""
    doubtful: np.ndarray | None = None
    """(T,) bool: frames whose pose may well be wrong; None where the solver does not tell"""

    @property
    def present(self) -> np.ndarray:
        """(T,) bool: frames with a hand, detected or filled."""
        return np.asarray(np.isfinite(self.transl).all(axis=1))


OnFrame = Callable[[], None]
"""Called once for every frame that is done; may raise to end the run with nothing."""

ShouldStop = Callable[[], bool]
"""Asked between frames, or groups of them; True: return what is fitted so far, at least one frame"""


def never() -> bool:
    """The `ShouldStop` of those who want everything."""
    return False


class TrackSolver(Protocol):
    """Fits one hand model to one detected track, seen through one camera."""

    def __call__(
        self,
        model: HandModel,
        track: DetectedTrack,
        intrinsics: Intrinsics,
        on_frame: OnFrame,
        should_stop: ShouldStop = never,
    ) -> TrackFit:
        """Fit; calls `on_frame` once for every detected frame that was fitted."""
        ...


@dataclass(frozen=True)
class Solver:
    """A solver by name, and what it can do."""

    name: str
    make: Callable[[float, float | None], TrackSolver]
    """From smoothing and a hand's length in metres or None; what it takes no notice of may be ignored"""
    title: str
    """For lists, in title case"""
    description: str
    """One line for those who choose"""
    smooths: bool = False
    """Whether it takes notice of smoothing"""
    takes_hand_length: bool = False
    """Whether it takes notice of a given length"""
    slow: bool = False
    """Whether a frame takes it longer than the detector: once stopped, it gets a moment for what was found
    until then, where others get the time that they need"""
    needs: tuple[str, ...] = ()
    """Packages that it imports beside those that every capture needs"""

    @property
    def missing(self) -> tuple[str, ...]:
        """Those that this Python lacks."""
        return tuple(package for package in self.needs if find_spec(package) is None)


def _fast(smoothing: float, hand_length: float | None) -> TrackSolver:
    from handfit_core.fit.fast import fit_track

    return partial(fit_track, smoothing, hand_length=hand_length)


def _fast_per_frame(smoothing: float, hand_length: float | None) -> TrackSolver:  # noqa: ARG001
    return _fast(0.0, hand_length)


def _paper(name: str, smoothing: float, hand_length: float | None) -> TrackSolver:  # noqa: ARG001
    from handfit_core.paper.fitter import EXPERIMENTS, fit_track

    return partial(fit_track, EXPERIMENTS[name])


_PAPER: Final = {
    "paper-a": ("A: L-BFGS, Mean Squares", "Mean squared error, fingertips counted again"),
    "paper-b": ("B: Without Fingertips", "Mean squared error of the 21 keypoints"),
    "paper-c": ("C: Geman-McClure", "Geman-McClure error, fingertips counted again"),
    "paper-d": ("D: Geman-McClure, Plain", "Geman-McClure error of the 21 keypoints"),
    "paper-e": ("E: Huber", "Huber error, fingertips counted again"),
    "paper-f": ("F: Huber, Plain", "Huber error of the 21 keypoints"),
    "paper-g": ("G: BFGS", "Mean squared error with the BFGS optimizer"),
    "paper-h": ("H: Anatomical Stage", "A second stage that keeps joints within their range"),
    "paper-a-plus": ("A+: With Pose Prior", "Experiment A, held by a relaxed pose, with a camera stage"),
}

_OWN: Final = (
    Solver("fast", _fast, "Fast", "Smooth over time", smooths=True, takes_hand_length=True),
    Solver("fast-per-frame", _fast_per_frame, "Fast, Per Frame", "Other frames tell the shape only",
           takes_hand_length=True),
    *(
        Solver(name, partial(_paper, name), title, description, slow=True, needs=("torch",))
        for name, (title, description) in _PAPER.items()
    ),
)  # fmt: skip


@cache
def solvers() -> dict[str, Solver]:
    """All solvers by name: our own, then those of other packages. One that fails to load is told and left
    out."""
    found = {solver.name: solver for solver in _OWN}
    for entry in entry_points(group=ENTRY_POINTS):
        try:
            solver = entry.load()
            if not isinstance(solver, Solver):
                raise TypeError(f"{entry.value} is no handfit_core.solvers.Solver")
            if solver.name in found:
                raise ValueError(f"there is a solver {solver.name} already")
        except Exception as error:  # whatever another package does wrong
            log.warning("the solver '%s' is left out: it cannot be loaded (%s)", entry.name, error)
        else:
            found[solver.name] = solver
    return found


def solver_names() -> tuple[str, ...]:
    """All solvers there are."""
    return tuple(solvers())


def solver_of(name: str, smoothing: float = DEFAULT_SMOOTHING, hand_length: float | None = None) -> Solver:
    """The solver of that name, which another Python may have to run. Raises OptionError where there is none,
    or for options that no solver can take."""
    if name not in solvers():
        raise OptionError(f"there is no solver '{name}'; choose one of {', '.join(solver_names())}")
    if not 0.0 <= smoothing <= MOST_SMOOTHING:
        raise OptionError(f"smoothing must lie between 0 and {MOST_SMOOTHING:g}, not {smoothing:g}")
    if hand_length is not None and not SHORTEST_HAND <= hand_length <= LONGEST_HAND:
        raise OptionError(
            f"a hand's length must lie between {SHORTEST_HAND * 1e3:g} and {LONGEST_HAND * 1e3:g} mm, not "
            f"{hand_length * 1e3:g} mm; measure from the wrist to the tip of the middle finger"
        )
    return solvers()[name]


def get_solver(
    name: str, smoothing: float = DEFAULT_SMOOTHING, hand_length: float | None = None
) -> TrackSolver:
    """The solver of that name, ready to fit; `hand_length` in metres, wrist joint to the tip of the middle
    finger.

    Raises OptionError as `solver_of` does, and where a package that the solver needs is not installed.
    """
    solver = solver_of(name, smoothing, hand_length)
    if solver.missing:
        raise OptionError(
            f"the solver {name} needs {' and '.join(solver.missing)}, which is not installed: install it, or "
            f"choose another solver, such as {DEFAULT_SOLVER}"
        )
    return solver.make(smoothing, hand_length)
