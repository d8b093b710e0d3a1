"""A search in a box about which hands are known, with predictions in place of the networks'."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from handfit_core.detect.keypoints import Detections
from handfit_core.detect.networks import Palms
from handfit_core.detect.search import Candidate, Search
from tests.core.detect.test_matching import hand

KNOWN = hand(0)
OTHER = replace(hand(30), keypoints=hand(30).keypoints[:, ::-1])
BOX = [-10.0, -10.0, 130.0, 120.0]


def searching() -> Search:
    networks: Any = SimpleNamespace(quality="standard")
    return Search(networks, 0.5)


@pytest.fixture
def found(monkeypatch):
    """Searches the box with these predictions, each from as many crops as it says."""

    def search(*seen: tuple[Detections, float, int]) -> Detections | None:
        predictions = [
            replace(one, certainty=np.array([presence]))
            for one, presence, count in seen
            for _ in range(count)
        ]
        monkeypatch.setattr(Search, "_predict_rotated", lambda *_: iter(predictions))
        monkeypatch.setattr(
            Search, "_augment", lambda _self, _rgb, first, score: Candidate(first, first.certainty[0], score)
        )
        return searching().detect_in_box(np.zeros((2, 2, 3), np.uint8), BOX, [KNOWN])

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


def palms(score: float, x: float, side: float) -> Palms:
    middle = KNOWN.centroid + [x, 0.0]
    return Palms(np.array([score]), middle, np.array([side]), np.zeros((1, 7, 2)))


@pytest.mark.parametrize(
    ("doubtful", "palm", "expected"),
    [
        ((OTHER, 0.6, 0.4), None, True),
        ((OTHER, 0.2, 0.2), None, False),
        ((hand(5), 0.6, 0.4), None, False),
        (None, palms(0.7, 150.0, 70.0), True),
        (None, palms(0.3, 150.0, 70.0), False),
        (None, palms(0.7, 20.0, 70.0), False),
        (None, palms(0.7, 150.0, 300.0), False),
    ],
    ids=["tangled", "unlikely", "the same", "palm", "unlikely palm", "its own palm", "a face"],
)
def test_a_hand_that_was_likely_missed(doubtful, palm, expected):
    search, known = searching(), Candidate(KNOWN, 0.99, 0.9)
    search._rejected = [] if doubtful is None else [Candidate(*doubtful)]
    search._palms = [] if palm is None else [palm]
    search._note_missed([known])
    assert search.missed == expected
