"""Two methods on the same hands, with an interval that tells whether their difference is one.

The interval is a cluster bootstrap's (Davison and Hinkley 1997, section 3.8; the percentile interval is
Efron's): what is drawn with replacement are pictures and whole clips, not hands. SciPy's `bootstrap`
draws single observations or pairs of them, and cannot draw clusters of unequal size.
"""

from __future__ import annotations

import numpy as np

from handfit_core.errors import OptionError
from handfit_core.evaluate.scores import Comparison, Scores
from handfit_core.evaluate.summary import HAND_METRICS, hand_means

_NUMBERS_AT_ONCE = 2_000_000


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
    differences = hand_means(first, metric) - hand_means(second, metric)
    rows = np.flatnonzero(~np.isnan(differences))
    if len(rows) == 0:
        return Comparison(first.method, second.method, metric, np.nan, np.nan, np.nan, 0, 0)
    names = [
        ("still", first.samples[row]) if (clip := first.clips[row]) is None else ("clip", clip)
        for row in rows
    ]
    numbers = {name: number for number, name in enumerate(dict.fromkeys(names))}
    unit = np.array([numbers[name] for name in names])
    low, high = _interval(differences[rows], unit, len(numbers), resamples, seed)
    return Comparison(
        first=first.method,
        second=second.method,
        metric=metric,
        difference=float(differences[rows].mean()),
        low=low,
        high=high,
        hands=len(rows),
        units=len(numbers),
    )


def _interval(
    differences: np.ndarray, unit: np.ndarray, units: int, resamples: int, seed: int
) -> tuple[float, float]:
    """2.5 and 97.5 % points of the mean over (N,) differences when (N,) unit numbers are drawn anew."""
    if units < 2:
        return float("nan"), float("nan")
    totals = np.bincount(unit, weights=differences, minlength=units)
    sizes = np.bincount(unit, minlength=units)
    rng = np.random.default_rng(seed)
    means: list[np.ndarray] = []
    at_once = max(1, _NUMBERS_AT_ONCE // units)
    for start in range(0, resamples, at_once):
        drawn = rng.integers(units, size=(min(at_once, resamples - start), units))
        means.append(totals[drawn].sum(axis=1) / sizes[drawn].sum(axis=1))
    low, high = np.percentile(np.concatenate(means), [2.5, 97.5])
    return float(low), float(high)
