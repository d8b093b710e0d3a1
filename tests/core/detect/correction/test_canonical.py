"""Detections in the canonical frame: the same hand looks the same, wherever and however it is seen."""

import numpy as np
import pytest

from handfit_core.common.skeleton import SIDES, Side, other_side
from handfit_core.detect.correction.canonical import FEATURES, KNUCKLES, WORLD_SCALE, Canonical, canonical
from handfit_core.detect.keypoints import Detections, HandDetection
from handfit_core.geometry.similarity import align
from tests.core.fit.detections import columns, landmarks_of, poses, seen

RIGHT: Side = "right"
HANDS = [seen(p, RIGHT, noise=4.0, seed=i) for i, p in enumerate(landmarks_of(RIGHT, *poses(8, seed=1)))]
DETECTIONS = columns(HANDS)


def canonical_right(detections: Detections) -> Canonical:
    return canonical(detections, np.full(len(detections), SIDES.index(RIGHT)))


def test_upright_centred_and_of_unit_size():
    frame = canonical_right(DETECTIONS)
    assert frame.features.shape == (8, FEATURES)
    image = frame.features[:, :63].reshape(-1, 21, 3)
    keypoints = DETECTIONS.keypoints
    expected = keypoints - keypoints.mean(axis=1, keepdims=True) * [0, 0, 1]
    np.testing.assert_allclose(frame.to_picture(image), expected, atol=1e-9)
    np.testing.assert_allclose(image.mean(axis=1), 0.0, atol=1e-12)
    np.testing.assert_allclose(np.square(image[..., :2]).sum(axis=-1).mean(axis=1), 1.0)
    up = image[:, KNUCKLES, :2].mean(axis=1) - image[:, 0, :2]
    np.testing.assert_allclose(up[:, 0], 0.0, atol=1e-12)
    assert np.all(up[:, 1] < 0)  # y points down


def changed(
    d: HandDetection, angle: float, scale: float, shift: tuple[float, float], mirror: bool
) -> HandDetection:
    """The detection of the picture turned, scaled, moved and perhaps mirrored."""
    turn = np.eye(3)
    turn[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    flip = np.diag([-1.0 if mirror else 1.0, 1.0, 1.0])
    keypoints = d.keypoints @ (turn @ flip).T * scale + [*shift, 0.0]
    side = other_side(d.side) if mirror else d.side
    return HandDetection(side, d.score, keypoints, d.world @ (turn @ flip).T)


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


def test_world_landmarks_are_laid_over_the_image_ones():
    frame = canonical_right(DETECTIONS)
    image, world, over = (frame.features[:, i : i + 63].reshape(-1, 21, 3) for i in (0, 63, 126))
    for one, other, laid in zip(image, world, over, strict=True):
        np.testing.assert_allclose(laid, align(other, one, with_scale=True).apply(other), atol=1e-9)
    size = np.linalg.norm(world, axis=-1).mean(axis=1)
    metres = [np.linalg.norm(d.world - d.world.mean(axis=0), axis=1).mean() for d in HANDS]
    np.testing.assert_allclose(size, WORLD_SCALE * np.array(metres))
    np.testing.assert_allclose(frame.fused[..., :2], image[..., :2])
    np.testing.assert_allclose(frame.fused[..., 2], (image[..., 2] + over[..., 2]) / 2)


def test_points_in_one_place_do_no_harm():
    frame = canonical_right(columns([HandDetection(RIGHT, 0.5, np.full((21, 3), 7.0), np.zeros((21, 3)))]))
    assert np.isfinite(frame.features).all()
    assert canonical_right(columns([])).features.shape == (0, FEATURES)
