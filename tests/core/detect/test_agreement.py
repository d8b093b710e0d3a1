import numpy as np
import pytest

from handfit_core.detect.agreement import distance, largest_agreement, mean_of, nearest
from handfit_core.detect.keypoints import HandDetection
from handfit_core.skeleton import Side

SHAPE = np.random.default_rng(5).uniform(0, 1, (21, 3))
SHAPE = 100.0 * (SHAPE - SHAPE.min(axis=0)) / np.ptp(SHAPE, axis=0)  # 100 pixels a side


def hand(x: float, side: Side = "right", score: float = 0.9) -> HandDetection:
    return HandDetection(side, score, SHAPE + [x, 0.0, 0.0], SHAPE / 1000 + x)


def test_distance_is_in_units_of_the_hand() -> None:
    assert distance(hand(0), hand(30)) == pytest.approx(0.3)
    assert distance(hand(0), hand(30), moved=np.array([20.0, 0.0])) == pytest.approx(0.1)


def test_nearest_within_a_limit() -> None:
    near, far = hand(10), hand(50)
    assert nearest(hand(0), [far, near], 0.2) is near
    assert nearest(hand(0), [far, near], 0.05) is None
    assert nearest(hand(0), [], 0.2) is None


def test_largest_agreement_takes_one_of_each_look() -> None:
    looks = [[hand(0), hand(300)], [hand(8), hand(2)], [], [hand(310)], [hand(5)]]
    assert [h.keypoints[0, 0] - SHAPE[0, 0] for h in largest_agreement(looks, 0.2)] == pytest.approx(
        [0, 2, 5]
    )
    assert largest_agreement([[], []], 0.2) == []


def test_the_mean_of_looks() -> None:
    looks = [hand(0, "left", 0.6), hand(6, "right", 0.9), hand(12, "left", 0.6)]
    mean = mean_of(looks, looks=4)
    assert mean.side == "left"
    assert mean.score == pytest.approx(1.2 / 4)  # the fourth saw nothing, the second another side
    np.testing.assert_allclose(mean.keypoints, SHAPE + [6.0, 0.0, 0.0])
    np.testing.assert_allclose(mean.world, SHAPE / 1000 + 6.0)
    assert mean.spread is not None
    np.testing.assert_allclose(mean.spread, np.tile([np.sqrt(24.0), 0.0, 0.0], (21, 1)), atol=1e-9)
    assert mean_of([hand(0)], looks=1).spread is None
