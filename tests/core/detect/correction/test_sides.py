"""The network's judgement of sides beside the detector's."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from handfit_core.detect.correction.network import side_probability
from handfit_core.detect.correction.sides import DETECTOR_ODDS, with_side_judged
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
    probability = side_probability(unsure)
    for p, judged in zip(probability, with_side_judged(unsure), strict=True):
        assert judged.right_side is not None
        odds = judged.right_side / (1.0 - judged.right_side)
        np.testing.assert_allclose(odds, DETECTOR_ODDS * p / (1.0 - p), rtol=1e-6)


def test_nothing_else_changes() -> None:
    (judged,) = with_side_judged(DETECTIONS[:1])
    assert judged.side == "right"
    assert judged.score == DETECTIONS[0].score
    assert judged.keypoints is DETECTIONS[0].keypoints
    assert with_side_judged([]) == []
