"""The numbers that an evaluation yields, before they become tables and pictures."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Literal

import numpy as np

ProtocolName = Literal["strict", "paper"]
CameraChoice = Literal["assumed", "labelled"]
"""What solvers are told about the camera: nothing, or the data set's labels"""
CAMERA_CHOICES: Final[tuple[CameraChoice, ...]] = ("assumed", "labelled")


@dataclass(frozen=True, eq=False)
class Scores:
    """One method on one data set: N rows, one per labelled hand of every picture, in the set's order.

    Every method of an evaluation has the same rows. Where `detected` is False, predictions and errors
    are NaN: a miss, which summaries count. NaN errors of single points otherwise mean missing labels.
    """

    method: str
    """As on the command line: `paper-a`, `fused`, `null-centroid`"""
    title: str
    """For people"""
    is_baseline: bool
    """True for the null baselines, which know the truth and are there to compare with"""
    samples: tuple[str, ...]
    """(N) `Entry.name`"""
    hands: np.ndarray
    """(N,) int: which of the picture's labelled hands"""
    pictures: tuple[Path, ...]
    """(N)"""
    clips: tuple[str | None, ...]
    """(N)"""
    times: np.ndarray
    """(N,) seconds since the clip's start"""
    views: tuple[str, ...]
    """(N) how the camera sees the palm: `palm`, `back`, `edge` or `unknown`"""
    tags: tuple[Mapping[str, str], ...]
    """(N)"""
    detected: np.ndarray
    """(N,) bool"""
    side_correct: np.ndarray
    """(N,) 1.0 or 0.0; NaN for misses and where the set names no side"""
    labels_3d: np.ndarray
    """(N, 21, 3) metres, camera frame"""
    labels_2d: np.ndarray
    """(N, 21, 2) pixels"""
    points_3d: np.ndarray
    """(N, 21, 3) metres, camera frame, before any alignment"""
    points_2d: np.ndarray
    """(N, 21, 2) pixels"""
    camera_error: np.ndarray
    """(N, 21) mm, no alignment: positions in the camera frame, through whatever camera was assumed"""
    epe: np.ndarray
    """(N, 21) mm, after moving the centroid of the scored points to the truth's (the paper's alignment)"""
    root_error: np.ndarray
    """(N, 21) mm, after moving the wrist to the truth's"""
    pa_error: np.ndarray
    """(N, 21) mm, after the best similarity transform (Procrustes)"""
    error_2d: np.ndarray
    """(N, 21) pixels over the hand's size in pixels (longer side of its labelled points' box)"""
    pa_mpvpe: np.ndarray
    """(N,) mm, mean over vertices after the best similarity transform; NaN without a comparable mesh"""
    f5: np.ndarray
    """(N,) F-score at 5 mm of the aligned surfaces; NaN without a mesh"""
    f15: np.ndarray
    """(N,) F-score at 15 mm"""
    penetration: np.ndarray
    """(N,) mm that the deepest two parts of the hand stand in each other; NaN without a hand model"""
    expected_error: np.ndarray
    """(N,) mm of PA-MPJPE that the solver expects; NaN where it does not say"""
    detect_ms: np.ndarray
    """(N,) milliseconds of detection for the picture; NaN where not measured"""
    fit_ms: np.ndarray
    """(N,) milliseconds of fitting this hand. Fresh detections can carry what the landmark network said of
    them, kept ones do not, and a fit asks it again: compare runs that both detected or both read
    kept detections"""


@dataclass(frozen=True)
class Comparison:
    """Two methods on the same hands: is the difference a difference?"""

    first: str
    second: str
    metric: str
    """Key into `summary.METRICS`"""
    difference: float
    """mean over hands of first - second, on hands that both have"""
    low: float
    """2.5 % end of the bootstrap interval"""
    high: float
    """97.5 % end"""
    hands: int
    units: int
    """What was resampled: stills one by one, clips as wholes (frames of one clip are not independent)"""

    @property
    def is_significant(self) -> bool:
        """Whether the interval excludes zero."""
        return self.low > 0.0 or self.high < 0.0


@dataclass(frozen=True, eq=False)
class Evaluation:
    """All that a report shows."""

    dataset: str
    kind: str
    """The reader's name, as in `egodexter`"""
    root: Path
    protocol: ProtocolName
    scores: tuple[Scores, ...]
    """Baselines first, then methods in the order asked for"""
    summaries: Mapping[str, Mapping[str, float]]
    """method -> metric -> value; NaN where it does not apply"""
    comparisons: tuple[Comparison, ...]
    pictures: int
    """Pictures evaluated"""
    labelled_hands: int
    extra_hands: int
    """Detections that belong to no labelled hand (shared by all methods)"""
    problems: Mapping[str, tuple[str, ...]]
    """kind -> where, for everything that could not be used, and everything that a protocol leaves out"""
    notes: tuple[str, ...]
    """Sentences: what the set's labels mean, what the protocol does, which camera was assumed"""
    setup: Mapping[str, str]
    """What it was run with: versions, model, detector, settings, machine"""
