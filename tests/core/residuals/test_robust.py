import numpy as np
import pytest

from handfit_core.residuals.robust import GemanMcClure, Huber, Kernel, QuadraticWhere
from tests.core.residuals.differences import STEP, close

KERNELS = [Huber(2.0), Huber(0.5), GemanMcClure(1.0), GemanMcClure(3.0)]
SQUARED = np.array([0.0, 1e-3, 0.2, 1.0, 3.9, 4.1, 50.0, 1e4])


@pytest.mark.parametrize("kernel", KERNELS, ids=str)
def test_weight_is_the_derivative_of_the_cost(kernel: Kernel) -> None:
    inside = SQUARED[1:]
    difference = (kernel.cost(inside + STEP) - kernel.cost(inside - STEP)) / (2 * STEP)
    close(kernel.weight(inside), difference, rtol=1e-4, atol=1e-6)


@pytest.mark.parametrize("kernel", KERNELS, ids=str)
def test_small_residuals_are_squares(kernel: Kernel) -> None:
    small = np.array([0.0, 1e-8])
    close(kernel.cost(small), small)
    close(kernel.weight(small), np.ones_like(small))


@pytest.mark.parametrize("kernel", KERNELS, ids=str)
def test_cost_rises_and_weight_falls(kernel: Kernel) -> None:
    cost, weight = kernel.cost(SQUARED), kernel.weight(SQUARED)
    assert (np.diff(cost) > 0).all()
    assert (np.diff(weight) <= 0).all()
    assert (weight > 0).all()


def test_huber_is_quadratic_then_linear() -> None:
    kernel = Huber(2.0)
    inside, outside = np.array([0.0, 1.0, 4.0]), np.array([16.0, 100.0])
    close(kernel.cost(inside), inside)
    # 2 delta |r| - delta^2
    close(kernel.cost(outside), np.array([12.0, 36.0]))
    close(kernel.weight(outside), np.array([0.5, 0.2]))


def test_geman_mcclure_saturates() -> None:
    kernel = GemanMcClure(3.0)
    far = np.array([1e9])
    assert kernel.cost(far)[0] == pytest.approx(9.0)
    assert kernel.weight(far)[0] < 1e-15
    assert kernel.cost(np.array([9.0]))[0] == pytest.approx(4.5)


def test_what_is_certain_is_squared() -> None:
    other, certain = Huber(1.0), np.arange(len(SQUARED)) % 2 == 0
    kernel = QuadraticWhere(certain, other)
    for value, plain, quadratic in (
        (kernel.cost(SQUARED), other.cost(SQUARED), SQUARED),
        (kernel.weight(SQUARED), other.weight(SQUARED), np.ones_like(SQUARED)),
    ):
        close(value[certain], quadratic[certain])
        close(value[~certain], plain[~certain])
