"""Two methods on the same hands, with an interval that tells whether their difference is one.

The interval is a cluster bootstrap's (Davison and Hinkley 1997, section 3.8; the percentile interval is
Efron's): what is drawn with replacement are pictures and whole clips, not hands. SciPy's `bootstrap`
draws single observations or pairs of them, and cannot draw clusters of unequal size.
"""

from __future__ import annotations

import numpy as np
import pandas as pd

from handfit_core.errors import OptionError
from handfit_core.evaluate.scores import Comparison, Scores
from handfit_core.evaluate.summary import HAND_METRICS, hand_means


def compare(
    first: Scores, second: Scores, metric: str, *, resamples: int = 2000, seed: int = 0
) -> Comparison:
    """Mean over hands of first - second with its 95 % bootstrap interval, on the hands that both have.

    metric: one of `summary.HAND_METRICS`; each hand counts with its mean over points. A still picture is
    one unit, with all its hands; a clip is one unit, with all its frames. The interval is NaN with fewer
    than two units, which say nothing about others; with fewer than about ten it is too narrow. Hands
    that only one method detected are left out: compare detection rates beside it.

    Raises OptionError for another metric, ValueError where the two do not have the same rows.
    """
    if metric not in HAND_METRICS:
        raise OptionError(f"Expected a metric out of {', '.join(HAND_METRICS)}, but got {metric!r}.")
    if first.samples != second.samples or not np.array_equal(first.hands, second.hands):
        raise ValueError(
            f"{first.method} and {second.method} must have the same pictures and hands in the same order; "
            "evaluate both on the same data set"
        )
    means = pd.Series(hand_means(first, metric) - hand_means(second, metric))
    differences = means.dropna()
    # A clip is one unit; a still picture is one of its own, whatever clips are called.
    pictures = zip(first.samples, first.clips, strict=True)
    names = [("still", sample) if clip is None else ("clip", clip) for sample, clip in pictures]
    units = differences.groupby(pd.Series(names)[differences.index], sort=False)
    low, high = _interval(units.sum().to_numpy(), units.size().to_numpy(), resamples, seed)
    return Comparison(
        first=first.method,
        second=second.method,
        metric=metric,
        difference=float(differences.mean()),
        low=low,
        high=high,
        hands=len(differences),
        units=len(units),
    )


def _interval(totals: np.ndarray, sizes: np.ndarray, resamples: int, seed: int) -> tuple[float, float]:
    """2.5 and 97.5 % points of the mean over all hands, when units with these (N,) totals and numbers of
    hands are drawn anew."""
    units = len(totals)
    if units < 2:
        return float("nan"), float("nan")
    rng = np.random.default_rng(seed)
    draws = (rng.integers(units, size=units) for _ in range(resamples))
    low, high = np.percentile([totals[d].sum() / sizes[d].sum() for d in draws], [2.5, 97.5])
    return float(low), float(high)
