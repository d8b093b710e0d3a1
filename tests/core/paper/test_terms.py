import numpy as np
import pytest
import torch

from handfit_core.common.skeleton import TIP_KEYPOINTS
from handfit_core.paper import terms

RESIDUAL = np.random.default_rng(0).normal(scale=20.0, size=(1, 21, 3))

NAIVE = {
    "mse": lambda r: r**2,
    "geman_mcclure": lambda r: 100.0**2 * r**2 / (100.0**2 + r**2),
    "huber": lambda r: 0.5 * r**2 if abs(r) <= 5.0 else 5.0 * (abs(r) - 2.5),
}


@pytest.mark.parametrize("name", NAIVE)
def test_values(name: str) -> None:
    loss = getattr(terms, name)
    expected = np.mean([NAIVE[name](r) for r in RESIDUAL.reshape(-1)])
    assert float(loss(torch.tensor(RESIDUAL))) == pytest.approx(expected)
    tips = np.mean([NAIVE[name](r) for r in RESIDUAL[:, list(TIP_KEYPOINTS)].reshape(-1)])
    weighted = terms.with_tips(loss)(torch.tensor(RESIDUAL))
    assert float(weighted) == pytest.approx(expected + 4.0 * tips)


@pytest.mark.parametrize("name", NAIVE)
def test_gradients(name: str) -> None:
    residual = torch.tensor(RESIDUAL, requires_grad=True)
    assert torch.autograd.gradcheck(terms.with_tips(getattr(terms, name)), residual)
