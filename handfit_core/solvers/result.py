"""What solvers take and give."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from handfit_core.detect.keypoints import DetectedTrack
from handfit_core.geometry.camera import Intrinsics
from handfit_core.hand_model.data import HandModel


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
