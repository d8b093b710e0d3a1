"""Solvers by name: options, and what they can do. Those of other packages: test_registry."""

from __future__ import annotations

import sys

import pytest

from handfit_core.errors import OptionError
from handfit_core.options import CaptureOptions
from handfit_core.paper import EXPERIMENTS
from handfit_core.solvers import SOLVERS, get_solver, solver_names


def test_every_name_is_a_solver() -> None:
    assert set(solver_names()) >= {"fast", "fast-per-frame", *EXPERIMENTS}
    assert CaptureOptions.solver in solver_names()
    for name in solver_names():
        assert callable(get_solver(name))
    assert {name for name, solver in SOLVERS.all().items() if solver.needs} == set(EXPERIMENTS)


def test_other_names_are_refused() -> None:
    with pytest.raises(OptionError, match=r"no solver 'magic'.*paper-a, "):
        get_solver("magic")


def test_without_torch_the_papers_solvers_say_what_is_needed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "torch", None)
    with pytest.raises(OptionError, match="paper-a needs torch, which is not installed: install it"):
        get_solver("paper-a")
    assert "paper-a" in solver_names()  # another Python may have it
    assert callable(get_solver("fast"))
