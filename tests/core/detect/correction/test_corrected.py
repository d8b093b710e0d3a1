"""The network's judgement of sides beside the detector's."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest

from handfit_core.detect.correction import corrected as corrected_module
from handfit_core.detect.correction.canonical import Canonical
from handfit_core.detect.correction.corrected import TRUST, corrected, landmarked, with_side_judged
from handfit_core.detect.correction.network import Correction
from handfit_core.skeleton import SIDES, Side
from tests.core.fit.detections import landmarks_of, poses, seen

POINTS = landmarks_of("right", *poses(12, seed=3))
DETECTIONS = [seen(p, "right", noise=1.0, seed=i) for i, p in enumerate(POINTS)]


def test_a_sure_detector_keeps_its_word() -> None:
    judged = with_side_judged(DETECTIONS)
    assert [d.likely_side for d in judged] == ["right"] * 12


def test_a_wrong_and_unsure_one_does_not() -> None:
    judged = with_side_judged([replace(d, side="left", score=0.55) for d in DETECTIONS])
    assert np.mean([d.likely_side == "right" for d in judged]) > 0.5


def test_the_detectors_word_counts_more() -> None:
    unsure = [replace(d, side="left", score=0.55) for d in DETECTIONS]
    _, probability = corrected(unsure, [d.side for d in unsure])
    for p, judged in zip(probability, with_side_judged(unsure), strict=True):
        assert judged.right_side is not None
        odds = judged.right_side / (1.0 - judged.right_side)
        np.testing.assert_allclose(odds, TRUST.detector_odds * p / (1.0 - p), rtol=1e-6)


def test_nothing_else_changes() -> None:
    (judged,) = with_side_judged(DETECTIONS[:1])
    assert judged.side == "right"
    assert judged.score == DETECTIONS[0].score
    assert judged.keypoints is DETECTIONS[0].keypoints
    assert with_side_judged([]) == []


def test_what_was_said_is_not_asked_again(monkeypatch: pytest.MonkeyPatch) -> None:
    """The network runs once for a detection, and again only where the hand is taken for the other."""
    judged = with_side_judged(DETECTIONS)
    expected = {side: landmarked(DETECTIONS, side) for side in SIDES}
    asked: list[int] = []
    network = corrected_module.landmark_network()

    def counted(seen: Canonical) -> Correction:
        asked.append(len(seen.fused))
        return network(seen)

    monkeypatch.setattr(corrected_module, "landmark_network", lambda: counted)
    cases: list[tuple[Side, list[int]]] = [("right", []), ("left", [12])]
    for side, count in cases:
        found = landmarked(judged, side)
        for field in fields(found):
            if field.name != "pinned":
                aim = getattr(expected[side], field.name)
                np.testing.assert_allclose(getattr(found, field.name), aim, atol=1e-9)
        assert asked == count
    landmarked([*judged[:5], *DETECTIONS[5:]], "right")
    assert asked == [12, 7]


def test_points_where_another_hand_is_are_believed_less() -> None:
    covered = np.arange(21) > 16
    detections = [DETECTIONS[0], replace(DETECTIONS[1], overlapped=covered), *DETECTIONS[2:]]
    for before, given in (
        (landmarked(DETECTIONS, "right"), detections),
        (landmarked(with_side_judged(DETECTIONS), "right"), with_side_judged(detections)),
    ):
        doubted = landmarked(given, "right")
        np.testing.assert_array_equal(doubted.pixels, before.pixels)
        times = np.ones((12, 21))
        times[1, covered] = corrected_module.TRUST.overlapped
        np.testing.assert_array_equal(doubted.pixel_sigma, before.pixel_sigma * times[..., None])
        np.testing.assert_array_equal(doubted.depth_sigma, before.depth_sigma * times)
