import pytest
import torch

from handfit_core.residuals.robust import GemanMcClure, Huber, Kernel, QuadraticWhere
from tests.core.residuals.differences import STEP

KERNELS = [Huber(2.0), Huber(0.5), GemanMcClure(1.0), GemanMcClure(3.0)]
SQUARED = torch.tensor([0.0, 1e-3, 0.2, 1.0, 3.9, 4.1, 50.0, 1e4], dtype=torch.float64)


@pytest.mark.parametrize("kernel", KERNELS, ids=str)
def test_weight_is_the_derivative_of_the_cost(kernel: Kernel) -> None:
    inside = SQUARED[1:]
    difference = (kernel.cost(inside + STEP) - kernel.cost(inside - STEP)) / (2 * STEP)
    torch.testing.assert_close(kernel.weight(inside), difference, rtol=1e-4, atol=1e-6)


@pytest.mark.parametrize("kernel", KERNELS, ids=str)
def test_small_residuals_are_squares(kernel: Kernel) -> None:
    small = torch.tensor([0.0, 1e-8], dtype=torch.float64)
    torch.testing.assert_close(kernel.cost(small), small)
    torch.testing.assert_close(kernel.weight(small), torch.ones_like(small))


@pytest.mark.parametrize("kernel", KERNELS, ids=str)
def test_cost_rises_and_weight_falls(kernel: Kernel) -> None:
    cost, weight = kernel.cost(SQUARED), kernel.weight(SQUARED)
    assert (cost.diff() > 0).all()
    assert (weight.diff() <= 0).all()
    assert (weight > 0).all()


def test_huber_is_quadratic_then_linear() -> None:
    kernel = Huber(2.0)
    inside, outside = torch.tensor([0.0, 1.0, 4.0]), torch.tensor([16.0, 100.0])
    torch.testing.assert_close(kernel.cost(inside), inside)
    # 2 delta |r| - delta^2
    torch.testing.assert_close(kernel.cost(outside), torch.tensor([12.0, 36.0]))
    torch.testing.assert_close(kernel.weight(outside), torch.tensor([0.5, 0.2]))


def test_geman_mcclure_saturates() -> None:
    kernel = GemanMcClure(3.0)
    far = torch.tensor([1e9], dtype=torch.float64)
    assert float(kernel.cost(far)) == pytest.approx(9.0)
    assert float(kernel.weight(far)) < 1e-15
    assert float(kernel.cost(torch.tensor([9.0]))) == pytest.approx(4.5)


def test_what_is_certain_is_squared() -> None:
    other, certain = Huber(1.0), torch.arange(len(SQUARED)) % 2 == 0
    kernel = QuadraticWhere(certain, other)
    for value, plain, quadratic in (
        (kernel.cost(SQUARED), other.cost(SQUARED), SQUARED),
        (kernel.weight(SQUARED), other.weight(SQUARED), torch.ones_like(SQUARED)),
    ):
        torch.testing.assert_close(value[certain], quadratic[certain])
        torch.testing.assert_close(value[~certain], plain[~certain])
