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
    """(N, 21, 3) metres in the camera frame: the true keypoints, NaN where not labelled"""
    points_3d: np.ndarray
    """(N, 21, 3) metres in the camera frame: the predicted keypoints before any alignment, NaN for a miss"""
    errors: Mapping[str, np.ndarray]
    """(N, 21) of each point, by the metric whose mean over points they have: `epe`, `mpjpe` and `pa_mpjpe` in
    mm, `error_2d` in pixels over the hand's size in pixels; `metrics` has their alignments"""

    @property
    def detected(self) -> np.ndarray:
        """(N,) bool: the rows in which the method has a hand."""
        return self.hands["detected"].to_numpy(dtype=bool)


class Comparison(NamedTuple):
    """The difference of two methods on the same hands, with its bootstrap interval."""

    metric: str
    """Key into `summary.METRICS`"""
    first: str
    second: str
    difference: float
    """Mean over hands of first - second, on hands that both have, in the metric's unit"""
    low: float
    """The 2.5 % end of the bootstrap interval"""
    high: float
    """The 97.5 % end of the bootstrap interval"""
    hands: int
    units: int
    """How many stills and clips were compared. A clip is resampled as a whole: its frames are not
    independent"""


@dataclass(frozen=True, eq=False)
class Evaluation:
    """The whole result of an evaluation, as a report shows it."""

    dataset: str
    kind: str
    """The name of the data set's reader, as in `egodexter`"""
    root: Path
    protocol: ProtocolName
    scores: tuple[Scores, ...]
    """The scores of baselines first, then of methods in the order asked for"""
    summaries: pd.DataFrame
    """A row for each method, a column for each metric; NaN where the metric does not apply"""
    comparisons: tuple[Comparison, ...]
    pictures: int
    """How many pictures were evaluated"""
    labelled_hands: int
    extra_hands: int
    """How many detections belong to no labelled hand (shared by all methods)"""
    problems: Mapping[str, tuple[str, ...]]
    """For each kind of problem the files or entries that have it: everything that could not be used, and
    everything that a protocol leaves out"""
    notes: tuple[str, ...]
    """Sentences: what the set's labels mean, what the protocol does, which camera was assumed"""
    setup: Mapping[str, str]
    """Versions, model, detector, settings and machine, by name"""
