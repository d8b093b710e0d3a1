"""The numbers that an evaluation yields, before they become tables."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd

from handfit_core.evaluate import ProtocolName


@dataclass(frozen=True, eq=False)
class Scores:
    """One method on one data set: N rows, one per labelled hand of every picture, in the set's order.

    Every method of an evaluation has the same rows. Where `detected` is False, predictions and errors
    are NaN: a miss, which summaries count. NaN errors of single points otherwise mean missing labels.
    """

    method: str
    """The name that the command line takes: `paper-a`, `fused`, `null-centroid`"""
    is_baseline: bool
    """True for the null baselines, which know the truth and are there to compare with"""
    hands: pd.DataFrame
    """N rows. What each hand is: `sample`, `hand` (which of the picture's), `clip`, `time` (seconds), `tags`.
    What was found: `detected`; `side_correct` (1 or 0); `penetration` (mm that its deepest two parts stand in
    each other), `expected_error` (mm of PA-MPJPE that the solver expects), `pa_mpvpe` (mm), `f5` (F-score of
    the aligned surfaces) and `fit_ms`; NaN where there is none"""
    labels_3d: np.ndarray
    """(N, 21, 3) metres, camera frame"""
    points_3d: np.ndarray
    """(N, 21, 3) metres, camera frame, before any alignment"""
    errors: Mapping[str, np.ndarray]
    """(N, 21) of each point, by the metric whose mean over points they have: `epe`, `mpjpe` and `pa_mpjpe` in
    mm, `error_2d` in pixels over the hand's size in pixels; `metrics` has their alignments"""

    @property
    def detected(self) -> np.ndarray:
        """(N,) bool"""
        return self.hands["detected"].to_numpy(dtype=bool)


class Comparison(NamedTuple):
    """Two methods on the same hands: is the difference a difference?"""

    metric: str
    """Key into `summary.METRICS`"""
    first: str
    second: str
    difference: float
    """mean over hands of first - second, on hands that both have"""
    low: float
    """2.5 % end of the bootstrap interval"""
    high: float
    """97.5 % end"""
    hands: int
    units: int
    """Number of stills and clips. A clip is resampled as a whole: its frames are not independent"""


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
    summaries: pd.DataFrame
    """A row for each method, a column for each metric; NaN where it does not apply"""
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
    """Versions, model, detector, settings and machine, by name"""
