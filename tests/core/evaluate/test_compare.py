import math

import numpy as np
import pytest

from handfit_core.errors import OptionError
from handfit_core.evaluate.scores import Scores
from handfit_core.evaluate.summary import compare
from tests.core.evaluate.factory import make_hands, make_scores, with_hands


def with_errors(per_hand: np.ndarray, **overrides) -> Scores:
    """Scores whose PA error is (N,) mm on every point of hand n."""
    labels = np.repeat(make_hands(1), len(per_hand), axis=0)
    return make_scores(labels_3d=labels, pa_error=np.repeat(per_hand[:, None], 21, axis=1), **overrides)


def test_a_known_difference_is_found() -> None:
    rng = np.random.default_rng(0)
    base = rng.uniform(5, 30, size=200)
    first = with_errors(base + 2.0 + rng.normal(size=200), method="first")
    second = with_errors(base, method="second")
    found = compare(first, second, "pa_mpjpe")
    assert (found.first, found.second, found.metric) == ("first", "second", "pa_mpjpe")
    assert (found.hands, found.units) == (200, 200)
    assert found.difference == pytest.approx((first.pa_error - second.pa_error).mean())
    assert found.low < 2.0 < found.high
    assert found.is_significant
    # Single, equal observations: the normal interval, 1.96 standard errors, is as good.
    assert found.high - found.low == pytest.approx(2 * 1.96 / math.sqrt(200), rel=0.15)
    back = compare(second, first, "pa_mpjpe")
    assert (back.difference, back.low, back.high) == pytest.approx(
        (-found.difference, -found.high, -found.low)
    )


def test_frames_of_a_clip_are_not_independent() -> None:
    rng = np.random.default_rng(3)
    # Ten clips of fifty frames, each clip with a difference of its own.
    errors = np.repeat(10 + rng.normal(scale=3.0, size=10), 50) + 0.1 * rng.normal(size=500)
    clips = tuple(f"clip {i // 50}" for i in range(500))
    as_stills = compare(with_errors(errors), with_errors(np.full(500, 10.0)), "pa_mpjpe")
    as_clips = compare(
        with_errors(errors, clip=clips), with_errors(np.full(500, 10.0), clip=clips), "pa_mpjpe"
    )
    assert (as_stills.units, as_clips.units) == (500, 10)
    assert as_clips.difference == as_stills.difference
    assert as_clips.high - as_clips.low > 4 * (as_stills.high - as_stills.low)


def test_hands_of_one_still_are_one_unit() -> None:
    samples = tuple(f"{i // 2}" for i in range(20))
    hands = np.tile([0, 1], 10)
    rng = np.random.default_rng(4)
    both = [with_errors(rng.uniform(size=20), sample=samples, hand=hands) for _ in range(2)]
    found = compare(*both, "pa_mpjpe")
    assert (found.hands, found.units) == (20, 10)


def test_a_still_and_a_clip_of_one_name_are_two_units() -> None:
    scores = with_errors(np.arange(3.0), sample=("a", "a/0", "a/1"), clip=(None, "a", "a"))
    assert compare(scores, scores, "pa_mpjpe").units == 2


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
    assert not one.is_significant
    none = compare(make_scores(), make_scores(), "pa_mpvpe")
    assert math.isnan(none.difference)
    assert (none.hands, none.units) == (0, 0)
    assert not none.is_significant


def test_wrong_questions_are_refused() -> None:
    scores = make_scores(4)
    with pytest.raises(OptionError, match="pa_mpjpe"):
        compare(scores, scores, "jitter")
    with pytest.raises(ValueError, match="same pictures"):
        compare(scores, make_scores(5), "epe")
    with pytest.raises(ValueError, match="same pictures"):
        compare(scores, with_hands(scores, hand=[0, 0, 1, 0]), "epe")
