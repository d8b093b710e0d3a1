"""From scores per hand to one number per metric, by the strict protocol or by the paper's, and comparisons.

The strict protocol counts misses: they lower the detection rate and every PCK. A mean error cannot hold
a miss, so read it beside the detection rate.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
import pandas as pd

from handfit_core.common.skeleton import TIP_KEYPOINTS, WRIST_KEYPOINT
from handfit_core.evaluate import ProtocolName
from handfit_core.evaluate.metrics import (
    PCK_THRESHOLDS_MM,
    auc,
    jitter_spectrum,
    labelled_points,
    mean_of_labelled,
    pck_curve,
)
from handfit_core.evaluate.scores import Comparison, Scores
from handfit_core.fit.doubt import DOUBT


class Metric(NamedTuple):
    """A column of the tables: its title, its digits, and what it measures."""

    title: str
    """The column's title with the unit; without one for a share of 0..1"""
    digits: int
    """How many digits are shown behind the point"""
    alignment: str
    """The alignment before measuring and what the mean is over, in words"""


METRICS: Final[dict[str, Metric]] = {
    "detection_rate": Metric("Detected, %", 1, "share of labelled hands"),
    "handedness": Metric("Side right, %", 1, "share of detected hands whose side is labelled"),
    "epe": Metric("EPE, mm", 2, "centroids of the scored points made to meet; mean over points"),
    "auc": Metric("AUC 20-50 mm", 3, "of EPE's PCK; points of missed hands count as wrong"),
    "mpjpe": Metric("MPJPE, mm", 2, "wrists made to meet; mean over hands, wrist included"),
    "auc_root": Metric("AUC 20-50 mm, wrist", 3, "of MPJPE's PCK; misses count as wrong"),
    "pa_mpjpe": Metric("PA-MPJPE, mm", 2, "similarity (Procrustes); mean over hands"),
    "pa_mpjpe_median": Metric("PA-MPJPE, median hand, mm", 2, "similarity; median over hands"),
    "pa_mpvpe": Metric("PA-MPVPE, mm", 2, "similarity over vertices; mean over hands"),
    "f5": Metric("F@5 mm", 3, "surfaces aligned by similarity; mean over hands"),
    "error_2d": Metric("2D error, % of hand", 2, "none; share of the hand's size; mean over hands"),
    "deeper_2": Metric("In itself > 2 mm, %", 1, "none needed; share of hands, by their capsules"),
    "deeper_4": Metric("In itself > 4 mm, %", 1, "none needed; share of hands, by their capsules"),
    "doubt_rank": Metric("Doubt, rank", 3, "Spearman's, of expected error and PA-MPJPE of hands"),
    "doubted_wrong": Metric("Wrong, doubted, %", 1, "of hands with PA-MPJPE beyond 15 mm"),
    "doubted_right": Metric("Others, doubted, %", 1, "of all other hands"),
    "jitter": Metric("Jitter above 5 Hz, mm", 2, "wrists made to meet; RMS over clips"),
    "fit_ms": Metric("Fit, ms", 1, "median over hands"),
}
"""Every metric of the strict protocol, in the order of display. The paper's has the three of `_paper`."""

HAND_METRICS: Final = ("epe", "mpjpe", "pa_mpjpe", "error_2d", "pa_mpvpe")
"""The metrics that each hand has a value of, for `hand_means` and `compare`"""


def hand_means(scores: Scores, metric: str) -> np.ndarray:
    """Return (N,) each hand's mean of one of `HAND_METRICS` over its points, in the unit that METRICS tells.

    NaN for misses, and where labels are missing; EPE also where a single point is labelled, which is 0 by
    its alignment.
    """
    if metric == "pa_mpvpe":
        return scores.hands["pa_mpvpe"].to_numpy()
    errors = scores.errors[metric]
    means = mean_of_labelled(errors, axis=1)
    if metric == "epe":
        means = np.where((~np.isnan(errors)).sum(axis=1) >= 2, means, np.nan)
    return 100.0 * means if metric == "error_2d" else means


def hands_table(scores: Scores) -> pd.DataFrame:
    """Make a table of one row per labelled hand with its picture, its mean errors, its time and its picture's
    tags."""
    table = scores.hands[["sample", "hand", "clip", "time", "detected"]].assign(
        **{metric: hand_means(scores, metric) for metric in HAND_METRICS}
    )
    table.insert(0, "method", scores.method)
    table = table.join(scores.hands[["penetration", "expected_error", "fit_ms"]])
    tags = pd.DataFrame(scores.hands["tags"].map(dict).tolist(), index=table.index).rename(columns=str)
    return table.join(tags[sorted(tags.columns)].add_prefix("tag_"))


def summarise(scores: Scores, protocol: ProtocolName) -> dict[str, float]:
    """Return each metric's value by its key, in the units of METRICS; NaN where a metric does not apply.

    `strict` gives all of METRICS. `paper` gives `epe` and `auc` as the paper's code computes them (see
    `paper_means`), over the fingertips, and beside them the detection rate, which it does not publish.
    """
    return _paper(scores) if protocol == "paper" else _strict(scores)


def paper_means(epe_rows: np.ndarray) -> tuple[float, float]:
    """Return mean error (mm) and AUC (0..1) as the paper's code has them, faults included.

    epe_rows: (N, P) mm, NaN where a point is not labelled or the hand was missed. Alignment: as in the
    rows. Zimmermann and Brox 2017's `EvalUtil` keeps one list per joint; the paper (arXiv 2506.11133)
    removes a frame's missing points before filing the others as joints 0, 1, ...: "joints" mix. Frames
    without any point vanish. Mean, and PCK at 20..50 mm, are taken per "joint", then averaged over
    "joints" without regard to their number of points; the AUC is the trapezoid over 30 mm. NaN without
    any row.
    """
    frames = [row[~np.isnan(row)] for row in np.asarray(epe_rows, dtype=np.float64)]
    filed = [
        np.array([frame[joint] for frame in frames if len(frame) > joint])
        for joint in range(max((len(frame) for frame in frames), default=0))
    ]
    if not filed:
        return float("nan"), float("nan")
    curve = np.mean([pck_curve(errors, PCK_THRESHOLDS_MM) for errors in filed], axis=0)
    return float(np.mean([errors.mean() for errors in filed])), auc(curve, PCK_THRESHOLDS_MM)


def _paper(scores: Scores) -> dict[str, float]:
    tips = np.where(scores.detected[:, None], scores.errors["epe"], np.nan)[:, list(TIP_KEYPOINTS)]
    mean, area = paper_means(tips)
    return {"detection_rate": float(100.0 * scores.hands["detected"].mean()), "epe": mean, "auc": area}


def _strict(scores: Scores) -> dict[str, float]:
    hands, means = scores.hands, pd.DataFrame({key: hand_means(scores, key) for key in HAND_METRICS})
    depths, epe = hands["penetration"].dropna(), scores.errors["epe"]
    labelled = labelled_points(scores.labels_3d)
    scored = labelled.sum(axis=1) >= 2
    values = {
        **means.mean(),
        "detection_rate": 100.0 * hands["detected"].mean(),
        "handedness": 100.0 * hands["side_correct"].mean(),
        "epe": mean_of_labelled(epe),
        "auc": _auc(epe, labelled[~scores.detected & scored]),
        "auc_root": _auc(
            scores.errors["mpjpe"], labelled[~scores.detected & scored & labelled[:, WRIST_KEYPOINT]]
        ),
        "pa_mpjpe_median": means["pa_mpjpe"].dropna().median(),
        "f5": hands["f5"].mean(),
        **{f"deeper_{mm}": 100.0 * (depths > mm).mean() for mm in (2, 4)},
        **_doubt(hands["expected_error"], means["pa_mpjpe"]),
        "jitter": _jitter(scores),
        "fit_ms": hands["fit_ms"].dropna().median(),
    }
    return {key: float(values[key]) for key in METRICS}


def _auc(errors: np.ndarray, missed: np.ndarray) -> float:
    """Return the AUC, 0..1, of errors (N, 21) in mm, NaN where there is none, and of labelled points (M, 21)
    of `missed` hands, which are wrong at every threshold."""
    return auc(pck_curve(errors, PCK_THRESHOLDS_MM, misses=int(missed.sum())), PCK_THRESHOLDS_MM)


def _doubt(expected: pd.Series, errors: pd.Series) -> dict[str, float]:
    """Measure how well expected errors (N,) predict true ones, both in mm; hands without either are left
    out."""
    known = expected.notna() & errors.notna()
    wrong, doubted = errors > 1000.0 * DOUBT.wrong_error, 100.0 * (expected > 1000.0 * DOUBT.doubtful_error)
    return {
        "doubt_rank": float(expected[known].corr(errors[known], method="spearman")),
        "doubted_wrong": doubted[known & wrong].mean(),
        "doubted_right": doubted[known & ~wrong].mean(),
    }


def _jitter(scores: Scores) -> float:
    """Return the jitter in mm of each hand of each clip, averaged with the number of its detected frames as
    weight."""
    clips = scores.hands.groupby(["clip", "hand"], sort=False).indices.values()
    values = np.array([_jitter_of(scores, np.asarray(rows)) for rows in clips]).reshape(-1, 2)
    jitter, frames = values[np.isfinite(values[:, 0])].T
    return float(np.average(jitter, weights=frames)) if len(jitter) else float("nan")


def _jitter_of(scores: Scores, rows: np.ndarray) -> tuple[float, int]:
    """Return the jitter in mm of one hand of one clip, and the number of its detected frames."""
    points, truth = scores.points_3d[rows], scores.labels_3d[rows]
    times = scores.hands["time"].to_numpy()[rows]
    frames = int(labelled_points(points).all(axis=1).sum())
    steps = np.diff(times)
    if len(steps) == 0 or not np.all(steps > 0.0):  # the set has no times
        return float("nan"), frames
    # Where frames are missing from the set, one NaN frame stands for the gap.
    step = float(np.median(steps))
    gaps = np.flatnonzero(steps > 1.5 * step) + 1
    points, truth = (np.insert(part, gaps, np.nan, axis=0) for part in (points, truth))
    return 1000.0 * jitter_spectrum(points, truth, 1.0 / step), frames


def compare(first: Scores, second: Scores, metric: str, *, resamples: int = 2000) -> Comparison:
    """Return the mean over hands of first - second with its 95 % bootstrap interval, on the hands that both
    have.

    The interval is a cluster bootstrap's (Davison and Hinkley 1997, section 3.8; the percentile interval is
    Efron's): what is drawn with replacement are pictures and whole clips, not hands. SciPy's `bootstrap`
    draws single observations or pairs of them, and cannot draw clusters of unequal size.

    metric: one of `summary.HAND_METRICS`; each hand counts with its mean over points. A still picture is
    one unit, with all its hands; a clip is one unit, with all its frames. The interval is NaN with fewer
    than two units, which say nothing about others; with fewer than about ten it is too narrow. Hands
    that only one method detected are left out: compare detection rates beside it.
    """
    means = hand_means(first, metric) - hand_means(second, metric)
    hands = first.hands.assign(difference=means).dropna(subset="difference")
    # A clip is one unit; a still picture is one of its own, whatever clips are called.
    is_still = hands["clip"].isna()
    units = hands.groupby([is_still, hands["clip"].where(~is_still, hands["sample"])], sort=False)[
        "difference"
    ]
    low, high = _interval(units.sum().to_numpy(), units.size().to_numpy(), resamples)
    difference = float(hands["difference"].mean())
    return Comparison(metric, first.method, second.method, difference, low, high, len(hands), len(units))


def _interval(totals: np.ndarray, sizes: np.ndarray, resamples: int) -> tuple[float, float]:
    """Return the 2.5 and 97.5 % points of the mean over all hands, when units with these (N,) totals and
    numbers of hands are drawn anew."""
    units = len(totals)
    if units < 2:
        return float("nan"), float("nan")
    rng = np.random.default_rng(0)
    draws = (rng.integers(units, size=units) for _ in range(resamples))
    low, high = np.percentile([totals[d].sum() / sizes[d].sum() for d in draws], [2.5, 97.5])
    return float(low), float(high)
