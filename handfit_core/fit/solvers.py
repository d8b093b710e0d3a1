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
"""Strengths of smoothing; 0 takes every frame by itself"""

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
        track: Track,
        intrinsics: Intrinsics,
        on_frame: OnFrame,
        should_stop: ShouldStop = never,
    ) -> HandMotion:
        """Fit; calls `on_frame` once for every detected frame that was fitted. What is neither detected nor
        filled, and what was not reached when it was stopped, is NaN."""
        ...


@dataclass(frozen=True)
class Solver:
    """What a solver can do, and how it is made."""

    make: Callable[[float, float | None], TrackSolver]
    """From smoothing and a hand's length in metres or None; what it takes no notice of may be ignored"""
    title: str
    """For lists, in title case"""
    description: str
    """One line for those who choose"""
    smooths: bool = False
    """True if it takes notice of smoothing"""
    takes_hand_length: bool = False
    """True if it takes notice of a given length"""
    slow: bool = False
    """True if a frame takes it longer than the detector: once stopped, it gets a moment for what was found
    until then, where others get the time that they need"""
    published: bool = False
    """True if it is the paper's: its own protocol runs it frame by frame, as published"""
    needs: tuple[str, ...] = ()
    """Packages that it imports beside those that every capture needs"""


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
"""All there are, by name"""


def solver_names() -> tuple[str, ...]:
    """The names of all solvers."""
    return SOLVERS.names()


def get_solver(
    name: str, smoothing: float = USUAL_SMOOTHING, hand_length: float | None = None
) -> TrackSolver:
    """The solver of that name, ready to fit; `smoothing` and `hand_length` as the options of those names.

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
