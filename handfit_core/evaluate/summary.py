"""From scores per hand to one number per metric, by the strict protocol or by the paper's, and comparisons.

The strict protocol counts misses: they lower the detection rate and every PCK. A mean error cannot hold
a miss, so read it beside the detection rate.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
import pandas as pd

from handfit_core.common.errors import OptionError
from handfit_core.common.skeleton import TIP_KEYPOINTS, WRIST_KEYPOINT
from handfit_core.evaluate import ProtocolName
from handfit_core.evaluate.metrics import (
    PCK_THRESHOLDS_MM,
    acceleration_error,
    auc,
    bone_length_variation,
    jitter_spectrum,
    labelled_points,
    mean_of_labelled,
    pck_curve,
)
from handfit_core.evaluate.scores import Comparison, Scores
from handfit_core.fit.doubt import DOUBT


@dataclass(frozen=True)
class Metric:
    """What a number in a table is."""

    key: str
    title: str
    unit: str
    """Empty for a share of 0..1"""
    alignment: str
    """In words: what was made to meet before measuring, and what the mean is over"""
    lower_is_better: bool


METRICS: Final[dict[str, Metric]] = {
    metric.key: metric
    for metric in (
        Metric("detection_rate", "Detected", "%", "share of labelled hands", False),
        Metric("handedness", "Side right", "%", "share of detected hands whose side is labelled", False),
        Metric("epe", "EPE", "mm", "centroids of the scored points made to meet; mean over points", True),
        Metric("epe_median", "EPE, median hand", "mm", "centroids made to meet; median over hands", True),
        Metric("auc", "AUC 20-50 mm", "", "of EPE's PCK; points of missed hands count as wrong", False),
        Metric("mpjpe", "MPJPE", "mm", "wrists made to meet; mean over hands, wrist included", True),
        Metric("auc_root", "AUC 20-50 mm, wrist", "", "of MPJPE's PCK; misses count as wrong", False),
        Metric("pa_mpjpe", "PA-MPJPE", "mm", "similarity (Procrustes); mean over hands", True),
        Metric("pa_mpjpe_median", "PA-MPJPE, median hand", "mm", "similarity; median over hands", True),
        Metric("pa_mpvpe", "PA-MPVPE", "mm", "similarity over vertices; mean over hands", True),
        Metric("f5", "F@5 mm", "", "surfaces aligned by similarity; mean over hands", False),
        Metric("f15", "F@15 mm", "", "surfaces aligned by similarity; mean over hands", False),
        Metric("camera_error", "Camera error", "mm", "none, in the camera frame; mean over hands", True),
        Metric("error_2d", "2D error", "% of hand", "none; share of the hand's size; mean over hands", True),
        Metric("deeper_2", "In itself > 2 mm", "%", "none needed; share of hands, by their capsules", True),
        Metric("deeper_4", "In itself > 4 mm", "%", "none needed; share of hands, by their capsules", True),
        Metric("penetration_95", "In itself, 95 %", "mm", "none needed; 95th percentile of hands", True),
        Metric("doubt_rank", "Doubt, rank", "", "Spearman's, of expected error and PA-MPJPE of hands", False),
        Metric("doubted_wrong", "Wrong, doubted", "%", "of hands with PA-MPJPE beyond 15 mm", False),
        Metric("doubted_right", "Others, doubted", "%", "of all other hands", True),
        Metric("bone_variation", "Bone variation", "%", "none needed; deviation over a clip", True),
        Metric("acceleration_error", "Acceleration error", "m/s²", "wrists made to meet; clips", True),
        Metric("jitter", "Jitter above 5 Hz", "mm", "wrists made to meet; RMS over clips", True),
        Metric("detect_ms", "Detection", "ms", "median over pictures", True),
        Metric("fit_ms", "Fit", "ms", "median over hands", True),
    )
}
"""Every metric of the strict protocol, in the order of display. The paper's has the three of `_paper`."""

_HAND_ERRORS = {
    "epe": "epe",
    "mpjpe": "root_error",
    "pa_mpjpe": "pa_error",
    "pa_mpvpe": "pa_mpvpe",
    "camera_error": "camera_error",
    "error_2d": "error_2d",
}
HAND_METRICS: Final = tuple(_HAND_ERRORS)
"""The metrics that every hand has a value of its own of, for `hand_means` and `compare`"""
_CLIP_METRICS = ("bone_variation", "acceleration_error", "jitter")


def hand_means(scores: Scores, metric: str) -> np.ndarray:
    """(N,) each hand's mean of one of `HAND_METRICS` over its points, in the unit that METRICS tells.

    NaN for misses, and where labels are missing; EPE also where only one point is labelled.
    """
    if metric == "pa_mpvpe":
        return scores.hands["pa_mpvpe"].to_numpy()
    errors = _counted_epe(scores) if metric == "epe" else getattr(scores, _HAND_ERRORS[metric])
    means = mean_of_labelled(errors, axis=1)
    return 100.0 * means if metric == "error_2d" else means


def hands_table(scores: Scores) -> pd.DataFrame:
    """One row per labelled hand with its picture, its mean errors, its times and its picture's tags."""
    table = scores.hands[["sample", "hand", "clip", "time", "view"]].assign(
        detected=scores.detected.astype(int),
        **{metric: hand_means(scores, metric) for metric in HAND_METRICS},
    )
    table.insert(0, "method", scores.method)
    table = table.join(scores.hands[["penetration", "expected_error", "detect_ms", "fit_ms"]])
    tags = tags_of(scores)
    return table.join(tags[sorted(tags.columns)].add_prefix("tag_"))


def tags_of(scores: Scores) -> pd.DataFrame:
    """(N, tags) what the set tells about each hand's picture; missing where it does not."""
    tags = pd.DataFrame(scores.hands["tags"].map(dict).tolist(), index=scores.hands.index)
    return tags.rename(columns=str)


def summarise(scores: Scores, protocol: ProtocolName) -> dict[str, float]:
    """Metric key -> value, in the units of METRICS; NaN where a metric does not apply.

    `strict` gives all of METRICS. `paper` gives `epe` and `auc` as the paper's code computes them (see
    `paper_pck`), over the fingertips, and beside them the detection rate, which it does not publish.
    """
    return _paper(scores) if protocol == "paper" else _strict(scores)


def paper_pck(epe_rows: np.ndarray) -> tuple[float, np.ndarray, float]:
    """Mean error (mm), PCK curve (100,) and AUC (0..1) as the paper's code has them, faults included.

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
        return float("nan"), np.full(len(PCK_THRESHOLDS_MM), np.nan), float("nan")
    curve = np.mean([pck_curve(errors, PCK_THRESHOLDS_MM) for errors in filed], axis=0)
    return float(np.mean([errors.mean() for errors in filed])), curve, auc(curve, PCK_THRESHOLDS_MM)


def pck(scores: Scores, protocol: ProtocolName) -> np.ndarray:
    """(100,) PCK of EPE at `PCK_THRESHOLDS_MM`; the `auc` of `summarise` is the area under it.

    `strict`: points of missed hands are wrong at every threshold; hands with a single labelled point
    cannot be scored and are left out, detected or not. `paper`: see `paper_pck`. NaN without any point.
    """
    if protocol == "paper":
        return paper_pck(_paper_rows(scores))[1]
    labelled = labelled_points(scores.labels_3d).sum(axis=1)
    misses = labelled[~scores.detected & (labelled >= 2)].sum()
    return pck_curve(_counted_epe(scores), PCK_THRESHOLDS_MM, misses=int(misses))


def pck_root(scores: Scores) -> np.ndarray:
    """(100,) PCK of the wrist-aligned error at `PCK_THRESHOLDS_MM`, strict: misses as in `pck`.

    Hands without a labelled wrist, or with nothing else, are left out; NaN where none remains.
    """
    labelled = labelled_points(scores.labels_3d)
    scored = labelled[:, WRIST_KEYPOINT] & (labelled.sum(axis=1) >= 2)
    misses = labelled[~scores.detected & scored].sum()
    return pck_curve(scores.root_error, PCK_THRESHOLDS_MM, misses=int(misses))


def _paper(scores: Scores) -> dict[str, float]:
    mean, _, area = paper_pck(_paper_rows(scores))
    return {"detection_rate": float(100.0 * scores.hands["detected"].mean()), "epe": mean, "auc": area}


def _paper_rows(scores: Scores) -> np.ndarray:
    """(N, 5) mm: the fingertips' EPE; NaN for missed hands and where not labelled."""
    return np.where(scores.detected[:, None], scores.epe, np.nan)[:, list(TIP_KEYPOINTS)]


def _strict(scores: Scores) -> dict[str, float]:
    hands, means = scores.hands, pd.DataFrame({key: hand_means(scores, key) for key in HAND_METRICS})
    depths = hands["penetration"].dropna()
    values = {
        **means.mean(),
        "detection_rate": 100.0 * hands["detected"].mean(),
        "handedness": 100.0 * hands["side_correct"].mean(),
        "epe": mean_of_labelled(_counted_epe(scores)),
        "epe_median": means["epe"].dropna().median(),
        "auc": auc(pck(scores, "strict"), PCK_THRESHOLDS_MM),
        "auc_root": auc(pck_root(scores), PCK_THRESHOLDS_MM),
        "pa_mpjpe_median": means["pa_mpjpe"].dropna().median(),
        **hands[["f5", "f15"]].mean(),
        **{f"deeper_{mm}": 100.0 * (depths > mm).mean() for mm in (2, 4)},
        "penetration_95": depths.quantile(0.95),
        **_doubt(hands["expected_error"], means["pa_mpjpe"]),
        # A picture is detected once, however many of its hands are labelled.
        "detect_ms": hands.drop_duplicates("sample")["detect_ms"].dropna().median(),
        "fit_ms": hands["fit_ms"].dropna().median(),
        **_of_clips(scores),
    }
    return {key: float(values[key]) for key in METRICS}


def _doubt(expected: pd.Series, errors: pd.Series) -> dict[str, float]:
    """How well expected errors (N,) tell of true ones, both in mm; hands without either are left out."""
    known = expected.notna() & errors.notna()
    wrong, doubted = errors > 1000.0 * DOUBT.wrong_error, 100.0 * (expected > 1000.0 * DOUBT.doubtful_error)
    return {
        "doubt_rank": float(expected[known].corr(errors[known], method="spearman")),
        "doubted_wrong": doubted[known & wrong].mean(),
        "doubted_right": doubted[known & ~wrong].mean(),
    }


def _counted_epe(scores: Scores) -> np.ndarray:
    """(N, 21) EPE without hands of a single scored point, which are 0 by construction."""
    enough = (~np.isnan(scores.epe)).sum(axis=1) >= 2
    return np.where(enough[:, None], scores.epe, np.nan)


def _of_clips(scores: Scores) -> dict[str, float]:
    """The metrics of each hand of each clip, averaged with the number of its detected frames as weight."""
    tracks = scores.hands.groupby(["clip", "hand"], sort=False).indices.values()
    values = [_of_clip(scores, np.asarray(rows)) for rows in tracks]
    table = pd.DataFrame(values, columns=["frames", *_CLIP_METRICS], dtype=float)
    weights = table[list(_CLIP_METRICS)].notna().mul(table.pop("frames"), axis="index")
    means = table.mul(weights).sum() / weights.sum()
    return {key: float(means[key]) for key in _CLIP_METRICS}


def _of_clip(scores: Scores, rows: np.ndarray) -> tuple[int, float, float, float]:
    """Detected frames of one hand of one clip, and its values of _CLIP_METRICS."""
    points, truth, times = (
        scores.points_3d[rows],
        scores.labels_3d[rows],
        scores.hands["time"].to_numpy()[rows],
    )
    frames = int(labelled_points(points).all(axis=1).sum())
    steps = np.diff(times)
    if len(steps) == 0 or not np.all(steps > 0.0):  # the set has no times
        return frames, bone_length_variation(points), np.nan, np.nan
    # Where frames are missing from the set, one NaN frame stands for the gap.
    step = float(np.median(steps))
    gaps = np.flatnonzero(steps > 1.5 * step) + 1
    points, truth = (np.insert(part, gaps, np.nan, axis=0) for part in (points, truth))
    times = np.insert(times, gaps, (times[gaps - 1] + times[gaps]) / 2.0)
    return (
        frames,
        bone_length_variation(points),
        acceleration_error(points, truth, times),
        1000.0 * jitter_spectrum(points, truth, 1.0 / step),
    )


def compare(first: Scores, second: Scores, metric: str, *, resamples: int = 2000) -> Comparison:
    """Mean over hands of first - second with its 95 % bootstrap interval, on the hands that both have.

    The interval is a cluster bootstrap's (Davison and Hinkley 1997, section 3.8; the percentile interval is
    Efron's): what is drawn with replacement are pictures and whole clips, not hands. SciPy's `bootstrap`
    draws single observations or pairs of them, and cannot draw clusters of unequal size.

    metric: one of `summary.HAND_METRICS`; each hand counts with its mean over points. A still picture is
    one unit, with all its hands; a clip is one unit, with all its frames. The interval is NaN with fewer
    than two units, which say nothing about others; with fewer than about ten it is too narrow. Hands
    that only one method detected are left out: compare detection rates beside it.

    Raises OptionError for another metric, ValueError where the two do not have the same rows.
    """
    if metric not in HAND_METRICS:
        raise OptionError(f"Expected a metric out of {', '.join(HAND_METRICS)}, but got {metric!r}.")
    which = ["sample", "hand", "clip"]
    if not first.hands[which].equals(second.hands[which]):
        raise ValueError(
            f"{first.method} and {second.method} must have the same pictures and hands in the same order; "
            "evaluate both on the same data set"
        )
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
    """2.5 and 97.5 % points of the mean over all hands, when units with these (N,) totals and numbers of
    hands are drawn anew."""
    units = len(totals)
    if units < 2:
        return float("nan"), float("nan")
    rng = np.random.default_rng(0)
    draws = (rng.integers(units, size=units) for _ in range(resamples))
    low, high = np.percentile([totals[d].sum() / sizes[d].sum() for d in draws], [2.5, 97.5])
    return float(low), float(high)
