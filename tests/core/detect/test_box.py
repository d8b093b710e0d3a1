"""A search in a box about which hands are known, with predictions in place of the networks'."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from handfit_core.detect.keypoints import HandDetection
from handfit_core.detect.networks import Prediction
from handfit_core.detect.search import Candidate, Search
from tests.core.detect.test_matching import hand

KNOWN = hand(0)
OTHER = replace(hand(30), keypoints=hand(30).keypoints[::-1])
BOX = [-10.0, -10.0, 130.0, 120.0]


@pytest.fixture
def found(monkeypatch):
    """Searches the box with these predictions, each from as many crops as it says."""

    def search(*seen: tuple[HandDetection, float, int]) -> HandDetection | None:
        predictions = [Prediction(presence, one) for one, presence, count in seen for _ in range(count)]
        monkeypatch.setattr(Search, "_predict_rotated", lambda *_: iter(predictions))
        monkeypatch.setattr(
            Search, "_augment", lambda _self, _rgb, first, score: Candidate(first.hand, first.presence, score)
        )
        searching = Search(SimpleNamespace(quality="standard"), 0.5)
        return searching.detect_in_box(np.zeros((2, 2, 3), np.uint8), BOX, [KNOWN])

    return search


def test_the_hand_beside_the_known_one_is_found(found):
    """Although most crops show the known one."""
    one = found((hand(2), 0.99, 18), (OTHER, 0.6, 4))
    assert one is not None
    np.testing.assert_array_equal(one.keypoints, OTHER.keypoints)


@pytest.mark.parametrize(
    "others",
    [[], [(OTHER, 0.9, 2)], [(OTHER, 0.4, 6)], [(hand(20), 0.99, 18)]],
    ids=["none", "in few crops", "unlikely", "no better"],
)
def test_the_known_hand_stays_where_nothing_is_clearly_better(found, others):
    assert found((hand(2), 0.9, 12), *others) is KNOWN


def test_what_all_crops_agree_on_replaces_a_known_hand_that_none_shows(found):
    one = found((hand(20), 0.9, 12))
    assert one is not None
    np.testing.assert_array_equal(one.keypoints, hand(20).keypoints)


def test_nothing_is_there(found):
    assert found((OTHER, 0.05, 12)) is None
    assert found() is None
