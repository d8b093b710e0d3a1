"""Detections in the canonical frame: the same hand looks the same, wherever and however it is seen."""

from dataclasses import replace

import numpy as np
import pytest

from handfit_core.common.skeleton import SIDES, Side
from handfit_core.detect.correction.canonical import FEATURES, Canonical, canonical
from handfit_core.detect.keypoints import Detections
from tests.core.fit.detections import columns, landmarks_of, poses, seen

RIGHT: Side = "right"
HANDS = [seen(p, RIGHT, noise=4.0, seed=i) for i, p in enumerate(landmarks_of(RIGHT, *poses(8, seed=1)))]
DETECTIONS = columns(HANDS)


def canonical_right(detections: Detections) -> Canonical:
    return canonical(detections, np.full(len(detections), SIDES.index(RIGHT)))


def changed(
    d: Detections, angle: float, scale: float, shift: tuple[float, float], mirror: bool
) -> Detections:
    """The detection of the picture turned, scaled, moved and perhaps mirrored."""
    turn = np.eye(3)
    turn[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    flip = np.diag([-1.0 if mirror else 1.0, 1.0, 1.0])
    keypoints = d.keypoints @ (turn @ flip).T * scale + [*shift, 0.0]
    side = 1 - d.side if mirror else d.side
    return replace(d, side=side, keypoints=keypoints, world=d.world @ (turn @ flip).T)


@pytest.mark.parametrize("mirror", [False, True])
@pytest.mark.parametrize(
    ("angle", "scale", "shift"), [(0.0, 1.0, (0, 0)), (2.5, 3.0, (-40, 900)), (-1.2, 0.2, (7, 5))]
)
def test_how_the_picture_is_held_makes_no_difference(mirror, angle, scale, shift):
    before = canonical_right(DETECTIONS)
    moved = columns([changed(d, angle, scale, shift, mirror) for d in HANDS])
    after = canonical(moved, moved.side)
    np.testing.assert_allclose(after.features, before.features, atol=1e-9)
    np.testing.assert_allclose(after.fused, before.fused, atol=1e-9)
    np.testing.assert_allclose(after.size, scale * before.size)
    # And the way back leads to where each was.
    np.testing.assert_allclose(after.to_picture(after.fused)[..., :2], moved.keypoints_2d, atol=1e-7)


def test_points_in_one_place_do_no_harm():
    frame = canonical_right(columns([Detections.hand(RIGHT, 0.5, np.full((21, 3), 7.0), np.zeros((21, 3)))]))
    assert np.isfinite(frame.features).all()
    assert canonical_right(columns([])).features.shape == (0, FEATURES)
