"""Both landmark networks in turn: when the present one runs, and what stands for it where it does not."""

from dataclasses import replace
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from handfit_core.common.skeleton import Side
from handfit_core.detect.clips import ClipFinder
from handfit_core.detect.crops import Crop
from handfit_core.detect.detector import DetectorSettings
from handfit_core.detect.in_turn import IN_TURN, Difference
from handfit_core.detect.keypoints import Detections
from handfit_core.detect.networks import Networks
from handfit_core.detect.tracker import TrackedHand, redetect
from tests.core.detect.clips import picture

RNG = np.random.default_rng(5)


def both(apart: float = 0.05, *, side: Side = "right", size: float = 100.0, seed: int = 1) -> Detections:
    """A hand that the present network sees a little aside from the one of December 2020."""
    points = RNG.uniform(0.0, size, (21, 3))
    points[:2, :2] = [[0.0, 0.0], [size, size]]
    moved = points + apart * size * np.random.default_rng(seed).normal(size=(21, 3))
    return Detections.hand(side, 0.9, moved, RNG.normal(size=(21, 3)) * 0.03, keypoints_2020=points)


def points_2020(hand: Detections) -> np.ndarray:
    assert hand.keypoints_2020 is not None
    return hand.keypoints_2020


def alone(hand: Detections, change: np.ndarray | float = 0.0) -> Detections:
    """What the network of December 2020 says of it."""
    points = points_2020(hand) + change
    return replace(hand, keypoints=points, keypoints_2020=points, world=0.0 * hand.world)


def test_what_was_seen_by_both_comes_back():
    hand = both()
    found = Difference.of(hand, 0.0).added_to(alone(hand, 7.0))
    np.testing.assert_allclose(found.keypoints, hand.keypoints + 7.0, atol=1e-9)
    np.testing.assert_allclose(found.world, hand.world, atol=1e-9)
    assert (found.side[0], found.score[0]) == (hand.side[0], pytest.approx(0.9))


def test_it_grows_with_the_hand():
    hand = both()
    found = Difference.of(hand, 0.0).added_to(replace(alone(hand), keypoints_2020=2.0 * points_2020(hand)))
    np.testing.assert_allclose(found.keypoints, 2.0 * hand.keypoints, atol=1e-9)


def test_between_two_frames_it_is_nearer_to_that_of_the_more_similar_hand():
    one, other = both(), both(side="left", seed=2)
    first, last = Difference.of(one, 0.1), Difference.of(other, 0.5)
    points = 0.75 * points_2020(one) + 0.25 * points_2020(other)
    middle = first.towards(last, replace(one, keypoints_2020=points))
    np.testing.assert_allclose(middle.keypoints, 0.75 * first.keypoints + 0.25 * last.keypoints, atol=1e-6)
    assert middle.right == pytest.approx(0.75 * 0.9 + 0.25 * 0.1)


@pytest.mark.parametrize(
    ("apart", "change", "seconds", "due"),
    [
        (0.01, 0.0, 0.1, False),
        (0.01, 0.0, IN_TURN.seconds, True),
        (0.5, 0.0, 0.1, False),
        (0.01, np.linspace(0.0, 30.0, 21)[:, None], 0.1, True),
        (0.01, 500.0, 0.1, False),
    ],
    ids=["quiet", "late", "networks disagree steadily", "another pose", "only elsewhere"],
)
def test_when_the_present_network_runs(apart, change, seconds, due):
    hand = both(apart)
    assert Difference.of(hand, 2.0).is_due(alone(hand, change), 2.0 + seconds) is due


def test_a_difference_that_changes_fast_is_taken_again_sooner():
    """A tenth of `seconds` after a change of `max_drift` it is due, and after one of half as much later."""
    hand, passed = both(), IN_TURN.seconds / 10.0
    first = Difference.of(hand, 2.0)
    for share, due in ((1.0, True), (0.5, False)):
        change = share * IN_TURN.max_drift * 100.0 * np.array([0.6, 0.8, 0.0])
        second = Difference.of(replace(hand, keypoints=hand.keypoints + change), 2.0 + passed, first)
        assert second.is_due(alone(hand), 2.0 + 2.0 * passed) is due


@pytest.mark.parametrize(("moved", "runs"), [(5.0, [True]), (60.0, [True, False, False])])
def test_a_hand_that_moves_far_is_found_by_the_present_network(moved, runs):
    """It sees a hand at the edge of its crop better than the one of December 2020 does."""
    hand, by_2020_runs = both(), []

    def predict(rgb: np.ndarray, crop: Crop, *, by_2020: bool = False) -> Detections:
        by_2020_runs.append(by_2020)
        return replace(alone(hand, moved), certainty=np.array([1.0]))

    networks = cast(Networks, SimpleNamespace(take_turns=True, quality="standard", predict=predict))
    tracked = TrackedHand.of(hand, 0.5)
    tracked.points, tracked.differences = points_2020(hand)[0, :, :2], [Difference.of(hand, 2.0)]
    assert redetect(networks, np.zeros((8, 8, 3), np.uint8), tracked, 2.1) is not None
    assert by_2020_runs == runs
    assert tracked.seen_alone is (runs == [True])


@pytest.mark.usefixtures("landmark_model")
def test_a_clip_is_seen_as_by_both_at_half_the_cost(monkeypatch):
    """The present network runs in every fourth frame; a second hand near the first is seen by both."""
    runs = []
    predict = Networks.predict
    monkeypatch.setattr(
        Networks,
        "predict",
        lambda self, rgb, crop, **how: runs.append(how) or predict(self, rgb, crop, **how),
    )
    found = []
    for every in (True, False):
        monkeypatch.setattr(
            "handfit_core.detect.in_turn.IN_TURN", replace(IN_TURN, seconds=0.0 if every else 0.16)
        )
        with (
            Networks() as networks,
            ClipFinder(DetectorSettings(max_hands=1, video=True), networks) as finder,
        ):
            runs.clear()
            for number in range(9):
                finder.find(picture(number), number / 25.0)
            finder.finish()
            found.append((finder.frames, [how for how in runs if not how.get("by_2020")]))
    (expected, many), (frames, few) = found
    assert len(many) - len(few) == 6, "of frames 2 to 9 it saw the fifth and the ninth"
    for hands, truth in zip(frames, expected, strict=True):
        off = np.linalg.norm(hands[0].keypoints_2d - truth[0].keypoints_2d, axis=-1).mean()
        assert off < 0.015 * truth[0].extent[0]
