"""Solvers by name: options, and what they can do. Those of other packages: test_registry."""

from __future__ import annotations

import sys

import pytest

from handfit_core.errors import OptionError
from handfit_core.paper.fitter import EXPERIMENTS
from handfit_core.solvers import DEFAULT_SOLVER, MOST_SMOOTHING, SOLVERS, get_solver, solver_names


def test_every_name_is_a_solver() -> None:
    assert set(solver_names()) >= {"fast", "fast-per-frame", *EXPERIMENTS}
    assert DEFAULT_SOLVER in solver_names()
    for name in solver_names():
        assert callable(get_solver(name))
    assert {name for name, solver in SOLVERS.all().items() if solver.needs} == set(EXPERIMENTS)


def test_other_names_are_refused() -> None:
    with pytest.raises(OptionError, match=r"no solver 'magic'.*paper-a, "):
        get_solver("magic")


@pytest.mark.parametrize("smoothing", [-0.01, MOST_SMOOTHING + 0.01, float("nan"), float("inf")])
@pytest.mark.parametrize("name", ["fast", "paper-a"])
def test_smoothing_out_of_range(name: str, smoothing: float) -> None:
    with pytest.raises(OptionError, match="between 0 and 10"):
        get_solver(name, smoothing)


@pytest.mark.parametrize("length", [0.0, 0.049, 0.301, 18.0, float("nan")])
def test_hand_length_out_of_range(length: float) -> None:
    with pytest.raises(OptionError, match="between 50 and 300 mm"):
        get_solver("fast", hand_length=length)


@pytest.mark.parametrize("smoothing", [0.0, 1.0, MOST_SMOOTHING])
def test_smoothing_within_range(smoothing: float) -> None:
    assert callable(get_solver("fast", smoothing))


def test_without_torch_the_papers_solvers_say_what_is_needed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "torch", None)
    with pytest.raises(OptionError, match="paper-a needs torch, which is not installed: install it"):
        get_solver("paper-a")
    assert "paper-a" in solver_names()  # another Python may have it
    assert callable(get_solver("fast"))
