"""Solvers: what they take and give, what they can do, and where they are found.

A solver fits one hand model to one detected track. Those of other packages are found by their entry points of
the group `handfit.solvers` (see `registry`). Light to import: what a solver needs loads with it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from importlib.util import find_spec
from typing import Final, Protocol

from handfit_core.common.errors import OptionError
from handfit_core.common.registry import Registry
from handfit_core.detect.keypoints import Track
from handfit_core.geometry.camera import Intrinsics
from handfit_core.hand_model.data import HandModel
from handfit_core.hand_model.motion import HandMotion

USUAL_SMOOTHING: Final = 1.0
MOST_SMOOTHING: Final = 10.0
"""The strongest smoothing that may be asked for, where 0 takes every frame by itself"""

OnFrame = Callable[[], None]
"""A function that is called once for every frame that is done, and may raise to end the run without a
result."""

ShouldStop = Callable[[], bool]
"""A function that is asked between frames, or groups of them, whether to stop: when it returns True, what is
fitted so far, at least one frame, is returned"""


def never() -> bool:
    """Return False: the `ShouldStop` of callers who want the whole fit."""
    return False


class TrackSolver(Protocol):
    """A function that fits one hand model to one detected track, seen through one camera."""

    def __call__(
        self,
        model: HandModel,
        track: Track,
        intrinsics: Intrinsics,
        on_frame: OnFrame,
        should_stop: ShouldStop = never,
    ) -> HandMotion:
        """Fit the track's hand, and call `on_frame` once for every detected frame that was fitted. Frames
        that are neither detected nor filled, and those not reached when the fit was stopped, are NaN."""
        ...


@dataclass(frozen=True)
class Solver:
    """A solver that can be chosen: its capabilities, and the function that makes it."""

    make: Callable[[float, float | None], TrackSolver]
    """A function that makes the solver from the strength of smoothing and a hand's length in metres, or None
    for an unknown length; it may ignore either"""
    title: str
    """The solver's name as lists show it, in title case"""
    description: str
    """One line about the solver, for those who choose among several"""
    takes_hand_length: bool = False
    """True if the solver takes a given hand length into account"""
    slow: bool = False
    """True if a frame takes the solver longer than the detector: once stopped, it gets a moment for what was
    found until then, where other solvers get the time that they need"""
    published: bool = False
    """True if the solver is the paper's own, which its own protocol runs frame by frame, as published"""
    needs: tuple[str, ...] = ()
    """Names of the packages that the solver imports beside those that every capture needs"""


SOLVERS: Final[Registry[Solver]] = Registry(
    "handfit.solvers",
    "solver",
    Solver,
    {
        "fast": "handfit_core.fit:FAST",
        "fast-per-frame": "handfit_core.fit:FAST_PER_FRAME",
        **{f"paper-{letter}": f"handfit_core.paper:{letter.upper()}" for letter in "abcdefgh"},
        "paper-a-plus": "handfit_core.paper:A_PLUS",
    },
)
"""All solvers by name, those of other packages included"""


def solver_names() -> tuple[str, ...]:
    """Return the names of all solvers."""
    return SOLVERS.names()


def get_solver(
    name: str, smoothing: float = USUAL_SMOOTHING, hand_length: float | None = None
) -> TrackSolver:
    """Return the solver of that name, ready to fit; `smoothing` is the strength (0: none), and `hand_length`
    the metres from wrist joint to the tip of the middle finger, None where not known.

    Raises OptionError where there is no such solver, and where a package that it needs is not installed.
    """
    solver = SOLVERS.get(name)
    missing = [package for package in solver.needs if find_spec(package) is None]
    if missing:
        raise OptionError(
            f"the solver {name} needs {' and '.join(missing)}, which is not installed: install it, or choose "
            f"another solver, such as fast"
        )
    with SOLVERS.blamed(name):
        return solver.make(smoothing, hand_length)
