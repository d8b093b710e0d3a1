"""Parts by name: built-in ones, those of installed packages, and packages that are broken."""

import logging
import sys
from pathlib import Path

import pytest

from handfit_core.capturing.options import CaptureOptions
from handfit_core.common import registry
from handfit_core.common.errors import OptionError
from handfit_core.common.registry import Registry
from handfit_core.fit.solvers import SOLVERS, get_solver, solver_names
from handfit_core.paper import EXPERIMENTS

GROUP = "handfit.toys"


@pytest.fixture
def installed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Install a package whose one module has this source, with these entry points of toys."""
    monkeypatch.syspath_prepend(str(tmp_path))

    def install(package: str, source: str, **points: str) -> None:
        (tmp_path / f"{package}.py").write_text(source)
        info = tmp_path / f"{package}-1.0.dist-info"
        info.mkdir()
        (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {package}\nVersion: 1.0\n")
        lines = [f"{name} = {package}:{attribute}" for name, attribute in points.items()]
        (info / "entry_points.txt").write_text("\n".join([f"[{GROUP}]", *lines, ""]))

    yield install
    for name in [n for n in sys.modules if n.startswith("toys_")]:
        del sys.modules[name]


def test_plug_ins_load_when_they_are_asked_for(installed, monkeypatch):
    installed("toys_good", "from pathlib import Path\nTOY = Path('toy')", blocks="TOY", apples="TOY")
    toys = Registry(GROUP, "toy", Path, {})
    assert toys.names() == ("apples", "blocks")
    assert "toys_good" not in sys.modules
    assert toys.get("blocks") is toys.get("blocks") is toys.all()["blocks"]
    assert str(toys.get("blocks")) == "toy"
    with pytest.raises(OptionError, match=r"there is no toy 'ball'; choose one of apples, blocks"):
        toys.get("ball")
    # Nobody looks for them where a built-in part is asked for.
    monkeypatch.setattr(registry, "entry_points", lambda **_: pytest.fail("looked for"))
    assert Registry(GROUP, "toy", object, {"home": "pathlib:Path"}).get("home") is Path


@pytest.mark.parametrize(
    ("source", "reason"),
    [
        ("raise RuntimeError('no\\nlicence')", r"RuntimeError: no licence"),
        ("raise SystemExit('bye')", r"SystemExit: bye"),
        ("import a_package_that_is_missing", r"ModuleNotFoundError: .*a_package_that_is_missing"),
        ("", r"AttributeError: .*TOY"),
        ("TOY = 'a text'", r"TypeError: it is a str and no int"),
    ],
)
def test_a_broken_plug_in_is_named_once_and_left_out(installed, caplog, source, reason):
    installed("toys_bad", source, wagon="TOY")
    installed("toys_good", "TOY = 1", blocks="TOY")
    toys = Registry(GROUP, "toy", int, {})
    with caplog.at_level(logging.WARNING):
        assert toys.all() == toys.all() == {"blocks": 1}
    (record,) = caplog.records
    assert record.getMessage().startswith("the toy wagon of the package toys_bad cannot be loaded")
    assert toys.names() == ("blocks",)
    with pytest.raises(OptionError, match=reason):
        toys.get("wagon")


def test_no_plug_in_takes_the_name_of_another_part(installed, caplog):
    installed("toys_good", "from pathlib import Path\nTOY = Path('mine')", home="TOY")
    with caplog.at_level(logging.WARNING):
        names = Registry(GROUP, "toy", object, {"home": "pathlib:Path"}).names()
    assert names == ("home",)
    assert "home of the package toys_good is left out, as its name is taken" in caplog.text


def test_a_built_in_part_that_cannot_be_imported_raises_what_it_raised():
    with pytest.raises(ImportError):
        Registry(GROUP, "toy", object, {"torch": "a_package_that_is_missing:X"}).all()


def test_solvers(monkeypatch):
    """Without torch the paper's say what is needed, and are still named: another Python may have it."""
    assert set(solver_names()) >= {"fast", "fast-per-frame", *EXPERIMENTS}
    assert CaptureOptions.solver in solver_names()
    assert {name for name, solver in SOLVERS.all().items() if solver.needs} == set(EXPERIMENTS)
    assert all(callable(get_solver(name)) for name in solver_names())
    monkeypatch.setitem(sys.modules, "torch", None)
    with pytest.raises(OptionError, match="paper-a needs torch, which is not installed: install it"):
        get_solver("paper-a")
    assert "paper-a" in solver_names()
    assert callable(get_solver("fast"))
