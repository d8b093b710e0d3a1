import numpy as np
import pytest
import torch

from handfit_core.geometry.rotations import rotvec_to_rotmat
from handfit_core.solvers.fast.angles import angles_of, rates_of, rotation_of
from tests.core.residuals.differences import by_each, random

ANGLES = torch.cat([random(6, 3, scale=0.6), torch.zeros(1, 3, dtype=torch.float64)])
"""The last one is a flat joint"""


def test_rotation_is_twist_then_spread_then_bend() -> None:
    expected = np.eye(3)
    for i in range(3):
        expected = expected @ rotvec_to_rotmat(ANGLES.numpy()[:, i : i + 1] * np.eye(3)[i])
    np.testing.assert_allclose(rotation_of(ANGLES).numpy(), expected, atol=1e-14)


def test_round_trip() -> None:
    torch.testing.assert_close(angles_of(rotation_of(ANGLES)), ANGLES)


@pytest.mark.parametrize("index", range(len(ANGLES)))
def test_rates_by_finite_differences(index: int) -> None:
    angles = ANGLES[index]

    def after(increment: torch.Tensor) -> torch.Tensor:
        return angles_of(rotation_of(angles) @ torch.tensor(rotvec_to_rotmat(increment.numpy())))

    differences = by_each(after, torch.zeros(3, dtype=torch.float64))
    torch.testing.assert_close(rates_of(angles), differences, rtol=1e-6, atol=1e-8)


def test_at_the_pole_all_is_finite() -> None:
    pole = torch.tensor([[0.3, torch.pi / 2, 0.2], [0.3, -torch.pi / 2, 0.2]], dtype=torch.float64)
    assert rates_of(pole).isfinite().all()
    assert angles_of(rotation_of(pole)).isfinite().all()
