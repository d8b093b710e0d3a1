"""Fitting hands to observed landmarks: a `Problem` in, a `Solution` out. A line here computes with NumPy, and
SciPy for clips; it opens no file and sees no picture.

The two solvers that are made of it load with the first fit.
"""

from __future__ import annotations

from functools import partial

from handfit_core.fit.solvers import Solver, TrackSolver


def _fast(smoothing: float, hand_length: float | None) -> TrackSolver:
    from handfit_core.fit.fast import fit_track  # slow to load

    return partial(fit_track, smoothing, hand_length=hand_length)


def _per_frame(_smoothing: float, hand_length: float | None) -> TrackSolver:
    return _fast(0.0, hand_length)


FAST = Solver(_fast, "Fast", "Smooth over time", takes_hand_length=True)
FAST_PER_FRAME = Solver(
    _per_frame, "Fast, Per Frame", "Other frames tell the hand's shape only", takes_hand_length=True
)
