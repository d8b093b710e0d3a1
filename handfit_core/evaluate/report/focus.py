"""Which methods and which error a report puts in front."""

from __future__ import annotations

import math

import numpy as np

from handfit_core.errors import OptionError
from handfit_core.evaluate.metrics import labelled_points
from handfit_core.evaluate.scores import Evaluation, Scores
from handfit_core.evaluate.summary import METRICS
from handfit_core.skeleton import NUM_KEYPOINTS, TIP_KEYPOINTS

_INNER_POINTS = sorted(set(range(NUM_KEYPOINTS)) - set(TIP_KEYPOINTS))


def methods_of(evaluation: Evaluation) -> tuple[Scores, ...]:
    """All methods but the null baselines, in the order asked for."""
    return tuple(s for s in evaluation.scores if not s.is_baseline)


def focus_of(evaluation: Evaluation, focus: str | None = None) -> Scores | None:
    """The method whose hands the sheets show: the one named, or the last; None where there is none.

    Raises OptionError where no method has that name.
    """
    methods = {s.method: s for s in methods_of(evaluation)}
    if focus is None:
        return list(methods.values())[-1] if methods else None
    if focus not in methods:
        raise OptionError(
            f"the report cannot show '{focus}': it is not among the evaluated solvers ({', '.join(methods)})"
        )
    return methods[focus]


def error_metric(evaluation: Evaluation) -> str:
    """`pa_mpjpe` where it was measured on hands with more than fingertips labelled, else `epe`.

    A similarity that is free to fit five tips hides most of what is wrong with them.
    """
    measured = any(np.isfinite(s.pa_error).any() for s in methods_of(evaluation))
    inner = any(labelled_points(s.labels_3d)[:, _INNER_POINTS].any() for s in evaluation.scores[:1])
    return "pa_mpjpe" if measured and inner else "epe"


def value_of(evaluation: Evaluation, method: str, metric: str) -> float:
    """A number of the summaries; NaN where it does not apply."""
    return float(evaluation.summaries.get(method, {}).get(metric, math.nan))


def best_method(evaluation: Evaluation, metric: str) -> Scores | None:
    """The method with the best value, baselines aside; the first of equals, None where none has one."""
    sign = 1.0 if METRICS[metric].lower_is_better else -1.0
    known = [s for s in methods_of(evaluation) if math.isfinite(value_of(evaluation, s.method, metric))]
    return min(known, key=lambda s: sign * value_of(evaluation, s.method, metric), default=None)
