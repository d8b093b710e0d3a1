"""One number per metric, by the strict protocol and by the paper's, and paired comparisons."""

from __future__ import annotations

import math
from itertools import chain, pairwise

import numpy as np
import pytest

from handfit_core.evaluate.metrics import jitter_spectrum
from handfit_core.evaluate.summary import compare, paper_means, summarise
from tests.core.evaluate.made import make_hands, make_scores, with_errors

RNG = np.random.default_rng(8)


def area_by_loop(errors: list[float], misses: int = 0) -> float:
    """AUC of PCK at 20..50 mm as a plain sum of trapezoids."""
    steps = [20 + 30 * i / 99 for i in range(100)]
    shares = [sum(e <= t for e in errors) / (len(errors) + misses) for t in steps]
    return sum((a + b) / 2 for a, b in pairwise(shares)) / 99


# The strict protocol


def test_strict_values_by_a_loop() -> None:
    labels = make_hands(5)
    labels[1, 4:9] = np.nan
    labels[2, 0] = np.nan
    labels[3, 1:] = np.nan
    detected = np.array([True, True, True, True, False])
    scores = make_scores(labels_3d=labels, detected=detected, noise=0.02)
    found = summarise(scores, "strict")

    def hands(errors: np.ndarray) -> list[list[float]]:
        """Errors of each hand that has any."""
        rows = [[float(e) for e in row if not math.isnan(e)] for row in errors]
        return [row for row in rows if row]

    epe, root, pa, flat = (hands(scores.errors[key]) for key in ("epe", "mpjpe", "pa_mpjpe", "error_2d"))
    assert [len(hand) for hand in epe] == [21, 16, 20]  # a wrist alone is no hand
    assert [len(hand) for hand in root] == [21, 16]
    assert [len(hand) for hand in pa] == [21, 16, 20]
    means = {"mpjpe": root, "pa_mpjpe": pa}
    expected = {key: np.mean([np.mean(hand) for hand in rows]) for key, rows in means.items()} | {
        "detection_rate": 80.0,
        "epe": np.mean(list(chain(*epe))),
        "pa_mpjpe_median": np.median([np.mean(hand) for hand in pa]),
        "auc": area_by_loop(list(chain(*epe)), misses=21),
        "auc_root": area_by_loop(list(chain(*root)), misses=21),
        "error_2d": 100 * np.mean([np.mean(hand) for hand in flat]),
    }
    assert {key: found[key] for key in expected} == pytest.approx(expected)


def test_surfaces_sides_and_times() -> None:
    nan = np.nan
    scores = make_scores(
        4,
        detected=np.array([True, True, True, False]),
        pa_mpvpe=np.array([4.0, nan, 8.0, nan]),
        f5=np.array([0.5, nan, 0.7, nan]),
        penetration=np.array([3.0, nan, 5.0, nan]),
        side_correct=np.array([1.0, 0.0, nan, nan]),
        fit_ms=np.array([1.0, 2.0, 9.0, nan]),
    )
    found = summarise(scores, "strict")
    expected = {"pa_mpvpe": 6.0, "f5": 0.6, "handedness": 50.0, "fit_ms": 2.0}
    expected |= {"deeper_2": 100.0, "deeper_4": 50.0}  # of hands that have a model
    assert {key: found[key] for key in expected} == pytest.approx(expected)


def test_how_well_solvers_doubt_themselves() -> None:
    """Six hands, the last of them missed; the third is not told of."""
    off = np.array([4.0, 8.0, 9.0, 20.0, 30.0, np.nan])
    scores = make_scores(
        6,
        detected=np.isfinite(off),
        errors={"pa_mpjpe": np.repeat(off[:, None], 21, axis=1)},
        expected_error=np.array([5.0, 13.0, np.nan, 11.0, 25.0, 40.0]),
    )
    found = summarise(scores, "strict")
    assert found["doubt_rank"] == pytest.approx(0.8)  # of four hands two have changed places
    assert (found["doubted_wrong"], found["doubted_right"]) == (50.0, 50.0)
    assert math.isnan(summarise(make_scores(3), "strict")["doubt_rank"])


@pytest.mark.parametrize("protocol", ["strict", "paper"])
def test_no_hands_and_no_detections_are_values(protocol) -> None:
    nothing = summarise(make_scores(labels_3d=np.zeros((0, 21, 3))), protocol)
    assert all(math.isnan(value) for value in nothing.values())
    missed = summarise(make_scores(3, detected=np.zeros(3, dtype=bool)), protocol)
    assert missed["detection_rate"] == 0.0
    assert math.isnan(missed["epe"])
    if protocol == "strict":
        assert missed["auc"] == missed["auc_root"] == 0.0
    else:
        assert math.isnan(missed["auc"])


# The paper's protocol and its faults


def test_papers_means_by_lists() -> None:
    rows = RNG.uniform(0, 80, size=(40, 5))
    rows[RNG.uniform(size=rows.shape) < 0.3] = np.nan
    joints: list[list[float]] = [[] for _ in range(5)]
    for row in rows:
        for joint, error in enumerate(e for e in row if not math.isnan(e)):
            joints[joint].append(error)
    mean, area = paper_means(rows)
    used = [joint for joint in joints if joint]
    assert mean == pytest.approx(np.mean([np.mean(joint) for joint in used]))
    assert area == pytest.approx(np.mean([area_by_loop(joint) for joint in used]))


# Clips


def clip_scores(lengths: dict[str, int], **overrides):
    """Scores of clips at 25 fps: one hand each, still, with noise that differs from clip to clip."""
    rng = np.random.default_rng(5)
    labels = np.concatenate([np.repeat(make_hands(1), n, axis=0) for n in lengths.values()])
    noise = np.concatenate(
        [rng.normal(scale=0.001 * (i + 1), size=(n, 21, 3)) for i, n in enumerate(lengths.values())]
    )
    clips = tuple(clip for clip, n in lengths.items() for _ in range(n))
    times = np.concatenate([np.arange(n) / 25.0 for n in lengths.values()])
    return make_scores(
        **{"labels_3d": labels, "points_3d": labels + noise, "clip": clips, "time": times, **overrides}
    )


def test_clips_are_averaged_by_their_detected_frames() -> None:
    detected = np.ones(140, dtype=bool)
    detected[70:100] = False
    scores = clip_scores({"a": 40, "b": 100}, detected=detected)
    first, second = (
        1000 * jitter_spectrum(scores.points_3d[rows], scores.labels_3d[rows], 25.0)
        for rows in (slice(0, 40), slice(40, 140))
    )
    assert summarise(scores, "strict")["jitter"] == pytest.approx((40 * first + 70 * second) / 110)


def test_frames_that_the_set_lacks_are_a_gap() -> None:
    whole = clip_scores({"a": 100})
    jump = whole.points_3d.copy()
    jump[50:, 1:] += 0.1
    times = whole.hands["time"].to_numpy(copy=True)
    joined = summarise(clip_scores({"a": 100}, points_3d=jump, time=times), "strict")
    times[50:] += 10.0
    apart = summarise(clip_scores({"a": 100}, points_3d=jump, time=times), "strict")
    assert apart["jitter"] == pytest.approx(summarise(whole, "strict")["jitter"], rel=0.05)
    assert joined["jitter"] > 1.5 * apart["jitter"]


def test_stills_and_clips_without_times() -> None:
    assert math.isnan(summarise(make_scores(30), "strict")["jitter"])
    assert math.isnan(summarise(clip_scores({"a": 30}, time=np.zeros(30)), "strict")["jitter"])


# Comparisons


def test_a_known_difference_is_found() -> None:
    rng = np.random.default_rng(0)
    base = rng.uniform(5, 30, size=200)
    first = with_errors(base + 2.0 + rng.normal(size=200), method="first")
    second = with_errors(base, method="second")
    found = compare(first, second, "pa_mpjpe")
    assert (found.first, found.second, found.metric) == ("first", "second", "pa_mpjpe")
    assert (found.hands, found.units) == (200, 200)
    assert found.difference == pytest.approx((first.errors["pa_mpjpe"] - second.errors["pa_mpjpe"]).mean())
    assert found.low < 2.0 < found.high
    # Single, equal observations: the normal interval, 1.96 standard errors, is as good.
    assert found.high - found.low == pytest.approx(2 * 1.96 / math.sqrt(200), rel=0.15)
    back = compare(second, first, "pa_mpjpe")
    assert (back.difference, back.low, back.high) == pytest.approx(
        (-found.difference, -found.high, -found.low)
    )


@pytest.mark.parametrize(
    ("columns", "units"),
    [
        ({"sample": ("a", "a", "b"), "hand": (0, 1, 0)}, 2),  # two hands of one still
        ({"sample": ("a", "a/0", "a/1"), "clip": (None, "a", "a")}, 2),  # a still and a clip of one name
        ({"sample": ("a/0", "a/1", "a/2"), "clip": ("a", "a", "a")}, 1),
    ],
)
def test_units_are_stills_and_clips(columns, units: int) -> None:
    scores = with_errors(np.arange(3.0), **columns)
    assert compare(scores, scores, "pa_mpjpe").units == units


def test_units_of_unequal_size_by_the_exact_distribution() -> None:
    # A clip of 3 frames with difference 4 and a still with 0: a draw of two units has means 4 (1/4),
    # 3 (1/2: three frames and the still) and 0 (1/4).
    clips = ("c", "c", "c", None)
    first = with_errors(np.array([4.0, 4.0, 4.0, 0.0]), clip=clips)
    found = compare(first, with_errors(np.zeros(4), clip=clips), "pa_mpjpe", resamples=500)
    assert (found.difference, found.low, found.high) == (3.0, 0.0, 4.0)
    assert found.units == 2


def test_only_hands_that_both_have() -> None:
    first = with_errors(np.array([9.0, 1.0, 2.0, np.nan]))
    second = with_errors(np.array([np.nan, 0.0, 0.0, 5.0]))
    found = compare(first, second, "pa_mpjpe")
    assert (found.hands, found.units, found.difference) == (2, 2, 1.5)


def test_one_unit_says_nothing_and_none_less() -> None:
    clips = ("only",) * 5
    nine, zero = (with_errors(np.full(5, value), clip=clips) for value in (9.0, 0.0))
    one = compare(nine, zero, "pa_mpjpe")
    assert (one.difference, one.units) == (9.0, 1)
    assert math.isnan(one.low)
    none = compare(make_scores(), make_scores(), "pa_mpvpe")
    assert math.isnan(none.difference)
    assert (none.hands, none.units) == (0, 0)
