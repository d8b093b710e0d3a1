"""What a crop shows lies where its mapping says, and back."""

import numpy as np
import pytest

from handfit_core.detect.crops import Crop, downscale
from handfit_core.detect.search import tiles

SQUARES = [(0.0, False), (np.pi / 2, False), (-np.pi / 4, True), (2.5, True)]


@pytest.mark.parametrize(("turn", "mirrored"), SQUARES)
def test_to_the_crop_and_back(turn, mirrored):
    """A perfect prediction in the crop is the hand in the picture."""
    rng = np.random.default_rng(1)
    keypoints, world = rng.uniform(0, 90, (21, 3)), rng.normal(0, 0.05, (21, 3))
    crop = Crop.of_square(np.array([40.0, 70.0]), 120.0, 256, turn=turn, mirrored=mirrored)
    assert crop.scale == pytest.approx(256 / 120)
    assert crop.mirrored == mirrored
    linear = np.eye(3) * crop.scale
    linear[:2, :2] = crop.linear
    back = crop.points_to_picture(keypoints @ linear.T + [*crop.offset, 0.0])
    np.testing.assert_allclose(back, keypoints, atol=1e-9)
    back = crop.world_to_picture(world @ linear.T / crop.scale)
    np.testing.assert_allclose(back, world, atol=1e-12)


@pytest.mark.parametrize(("turn", "mirrored"), SQUARES)
@pytest.mark.parametrize("span", [100.0, 500.0, 2400.0])
def test_pixels_lie_where_the_mapping_says(turn, mirrored, span):
    """A disc's centre of mass; the widest crop has 12 pixels in one."""
    centre, radius = np.array([700.0, 420.0]), span / 20
    y, x = np.mgrid[:900, :1300] + 0.5
    disc = np.hypot(x - centre[0], y - centre[1]) < radius
    rgb = np.repeat((disc * 255).astype(np.uint8)[..., None], 3, axis=2)
    crop = Crop.of_square(centre + span / 10, span, 200, turn=turn, mirrored=mirrored)
    shown = crop.render(rgb)[..., 0].astype(float)
    assert shown.shape == (200, 200)
    y, x = np.mgrid[:200, :200] + 0.5
    found = np.array([(shown * x).sum(), (shown * y).sum()]) / shown.sum()
    np.testing.assert_allclose(found, crop.linear @ centre + crop.offset, atol=0.1)
    # All of it is there: nothing is left out between the pixels.
    assert shown.sum() / 255 == pytest.approx(np.pi * (radius * crop.scale) ** 2, rel=0.05)


def test_the_border_is_repeated_beyond_the_picture():
    rgb = np.zeros((10, 10, 3), dtype=np.uint8)
    rgb[:, :5] = 200
    shown = Crop.of_square(np.array([5.0, 5.0]), 40.0, 40).render(rgb)
    assert (shown[:, :19] == 200).all()
    assert (shown[:, 21:] == 0).all()


@pytest.mark.parametrize("shape", [(1, 500, 3), (500, 1, 3)])
def test_slim_pictures_are_downscaled(shape):
    assert sorted(downscale(np.full(shape, 9, np.uint8), 7, 7).shape) == [1, 3, 71]


@pytest.mark.parametrize(
    ("divisor", "middles"),
    [
        (1, [(640, 360)]),
        (2, [(320, 320), (640, 320), (960, 320), (320, 400), (640, 400), (960, 400)]),
        (100, []),
    ],
)
def test_tiles_overlap_and_lie_in_the_middle(divisor, middles):
    """So small ones that no hand could be told in them are left out."""
    shown = [
        np.linalg.inv(crop.linear) @ (crop.size / 2.0 - crop.offset) for crop in tiles(1280, 720, divisor)
    ]
    np.testing.assert_allclose(np.reshape(shown, (-1, 2)), np.reshape(middles, (-1, 2)), atol=1e-9)
