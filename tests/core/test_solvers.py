"""Solvers by name: options, what they can do, and those of other packages."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from importlib.metadata import EntryPoint

import pytest

from handfit_core import solvers
from handfit_core.errors import OptionError
from handfit_core.paper.fitter import EXPERIMENTS
from handfit_core.solvers import DEFAULT_SOLVER, MOST_SMOOTHING, Solver, get_solver, solver_names, solver_of

TOY = Solver("toy", lambda smoothing, length: (smoothing, length), "Toy", "Fits nothing")  # type: ignore


@pytest.fixture
def others(monkeypatch: pytest.MonkeyPatch) -> Iterator[list[EntryPoint]]:
    """What other packages bring."""
    found: list[EntryPoint] = []
    monkeypatch.setattr(solvers, "entry_points", lambda group: [e for e in found if e.group == group])
    solvers.solvers.cache_clear()
    yield found
    solvers.solvers.cache_clear()


def entry(name: str, value: str) -> EntryPoint:
    return EntryPoint(name, value, solvers.ENTRY_POINTS)


def test_every_name_is_a_solver() -> None:
    assert set(solver_names()) >= {"fast", "fast-per-frame", *EXPERIMENTS}
    assert DEFAULT_SOLVER in solver_names()
    for name in solver_names():
        assert callable(get_solver(name))
    assert {name for name in solver_names() if solver_of(name).needs} == set(EXPERIMENTS)


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
    assert solver_of("paper-a").name == "paper-a"  # another Python may have it
    assert callable(get_solver("fast"))


def test_a_package_brings_a_solver(others: list[EntryPoint], caplog: pytest.LogCaptureFixture) -> None:
    others.append(entry("toy", f"{__name__}:TOY"))
    assert solver_names()[-1] == "toy"
    assert get_solver("toy", 2.0, 0.2) == (2.0, 0.2)
    assert not caplog.records


@pytest.mark.parametrize(
    ("name", "value", "why"),
    [
        ("gone", "no_such_package.solvers:MINE", "No module named 'no_such_package'"),
        ("empty", f"{__name__}:NOTHING", "NOTHING"),
        ("odd", f"{__name__}:entry", "is no handfit_core.solvers.Solver"),
        ("again", "handfit_core.solvers:_OWN", "is no handfit_core.solvers.Solver"),
    ],
)
def test_one_that_cannot_be_loaded_is_named_and_left_out(
    others: list[EntryPoint], caplog: pytest.LogCaptureFixture, name: str, value: str, why: str
) -> None:
    others += [entry(name, value), entry("toy", f"{__name__}:TOY"), entry("second toy", f"{__name__}:TOY")]
    assert "toy" in solver_names()
    first, second = (record.getMessage() for record in caplog.records)
    assert f"the solver '{name}' is left out" in first
    assert why in first
    assert "second toy" in second
    assert "there is a solver toy already" in second
