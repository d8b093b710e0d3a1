"""A measured lens: against OpenCV's projection, in pictures of other sizes, and beyond what was measured."""

import cv2
import numpy as np
import pytest

from handfit_core.common.errors import OptionError
from handfit_core.geometry.camera import Intrinsics
from handfit_core.geometry.lens import Lens

PHONE = Lens(Intrinsics(1400.0, 1414.0, 970.0, 530.0), (0.05, -0.1, 0.001, -0.0008, 0.02), 1920, 1080)
WEBCAM = Lens(Intrinsics(1100.0, 1100.0, 930.0, 560.0), (-0.25, 0.06, 0.001, -0.0008, 0.0), 1920, 1080)
BARREL = Lens(Intrinsics(1100.0, 1100.0, 960.0, 540.0), (-0.3, 0.0, 0.0, 0.0, 0.0), 1920, 1080)
"""Of which the polynomial folds over before the corners"""


def seen(lens: Lens, pixels: np.ndarray) -> np.ndarray:
    """Where OpenCV sees the rays of a pinhole camera's `pixels` (N, 2) through the lens."""
    k = lens.intrinsics
    matrix = np.array([[k.fx, 0.0, k.cx], [0.0, k.fy, k.cy], [0.0, 0.0, 1.0]])
    zero = np.zeros(3)
    return cv2.projectPoints(k.rays(pixels), zero, zero, matrix, np.array(lens.distortion))[0][:, 0]


def grid(lens: Lens, share: float = 1.0) -> np.ndarray:
    """(N, 2) pixels all over the middle `share` of the picture, its border included."""
    axes = (
        np.linspace(0.5 - share / 2.0, 0.5 + share / 2.0, 21) * side for side in (lens.width, lens.height)
    )
    return np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2)


@pytest.mark.parametrize(("lens", "share"), [(PHONE, 1.0), (WEBCAM, 1.0), (BARREL, 0.6)])
def test_undistorting_inverts_opencv(lens, share):
    points = grid(lens, share)
    straight = lens.undistorted(points)
    assert np.linalg.norm(straight - points, axis=-1).max() > 2.0
    np.testing.assert_allclose(seen(lens, straight), points, atol=1e-9)


@pytest.mark.parametrize("lens", [PHONE, WEBCAM, BARREL])
def test_beyond_what_was_measured_points_keep_their_order(lens):
    """Radii grow with radii, without a jump, also where the polynomial says something else."""
    out = np.linspace(0.0, 3.0 * lens.width, 2000)
    centre = np.array([lens.intrinsics.cx, lens.intrinsics.cy])
    ray = lens.undistorted(centre + out[:, None] * [0.8, 0.6]) - centre
    steps = np.diff(np.linalg.norm(ray, axis=-1)) / np.diff(out)
    assert steps.min() > 0.5
    assert steps.max() < 4.0


def test_scaled_to_pictures_of_another_size():
    points = grid(PHONE)
    half = PHONE.scaled(960, 540)
    np.testing.assert_allclose(half.undistorted(points / 2.0), PHONE.undistorted(points) / 2.0, atol=1e-9)
    upright = PHONE.scaled(1080, 1920)
    assert upright.intrinsics == Intrinsics(1414.0, 1400.0, 540.0, 960.0)
    assert upright.distortion == (0.05, -0.1, 0.0, 0.0, 0.02)
    assert PHONE.scaled(854, 480).width == 854
    with pytest.raises(OptionError, match=r"pictures of 1920x1080.*1600x1200: measure it once more"):
        PHONE.scaled(1600, 1200)


@pytest.mark.parametrize(
    ("distortion", "size"),
    [((0.1, 0.2), (640, 480)), ((np.nan, 0, 0, 0, 0), (640, 480)), ((0,) * 5, (0, 480))],
)
def test_refuses_what_no_lens_has(distortion, size):
    with pytest.raises(OptionError, match="a lens"):
        Lens(PHONE.intrinsics, distortion, *size)
