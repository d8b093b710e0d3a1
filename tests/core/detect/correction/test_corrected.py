"""The network's judgement of sides beside the detector's."""

from dataclasses import replace

import numpy as np

from handfit_core.common.skeleton import SIDES
from handfit_core.detect.correction import corrected as corrected_module
from handfit_core.detect.correction.corrected import BLEND, corrected, landmarked, with_side_judged
from tests.core.fit.detections import columns, landmarks_of, poses, seen

POINTS = landmarks_of("right", *poses(12, seed=3))
DETECTIONS = columns([seen(p, "right", noise=1.0, seed=i) for i, p in enumerate(POINTS)])
UNSURE = replace(DETECTIONS, side=np.zeros(12, dtype=int), score=np.full(12, 0.55))
"""Named left hands, and not surely"""


def test_the_detectors_word_counts_more():
    """A sure one keeps its word, a wrong and unsure one does not; nothing else changes."""
    judged, right = with_side_judged(DETECTIONS), SIDES.index("right")
    assert judged.likely_side.tolist() == [right] * 12
    for name in ("side", "score", "keypoints"):
        assert getattr(judged, name) is getattr(DETECTIONS, name)
    assert np.mean(with_side_judged(UNSURE).likely_side == right) > 0.5
    _, probability = corrected(UNSURE, UNSURE.side)
    found = with_side_judged(UNSURE).right_side
    aim = BLEND.detector_odds * probability / (1.0 - probability)
    np.testing.assert_allclose(found / (1.0 - found), aim, rtol=1e-6)
    none = with_side_judged(columns([]))
    assert none.corrected is not None
    assert none.corrected.shape == (0, 21, 6)


def test_points_where_another_hand_is_are_believed_less():
    covered = (np.arange(21) > 16) & (np.arange(12) == 1)[:, None]
    detections = replace(DETECTIONS, overlapped=covered)
    for before, given in (
        (landmarked(DETECTIONS, "right"), detections),
        (landmarked(with_side_judged(DETECTIONS), "right"), with_side_judged(detections)),
    ):
        doubted = landmarked(given, "right")
        np.testing.assert_array_equal(doubted.pixels, before.pixels)
        times = np.ones((12, 21))
        times[covered] = corrected_module.BLEND.overlapped
        np.testing.assert_array_equal(doubted.pixel_sigma, before.pixel_sigma * times[..., None])
        np.testing.assert_array_equal(doubted.depth_sigma, before.depth_sigma * times)


def test_what_the_network_has_said_before_changes_no_landmarks():
    judged = with_side_judged(DETECTIONS)
    for side in SIDES:
        found, aim = landmarked(judged, side), landmarked(DETECTIONS, side)
        for name in ("pixels", "pixel_sigma", "depth_sigma"):
            np.testing.assert_allclose(getattr(found, name), getattr(aim, name), atol=1e-9)
