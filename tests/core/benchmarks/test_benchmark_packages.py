"""The packages part."""

import subprocess
import sys
import zipfile
from importlib.metadata import distribution
from pathlib import Path

import pytest

from benchmarks.interleaved import Spread
from benchmarks.packages import PackageCost, PackageCosts, installed_size, measure_packages
from benchmarks.report import Results, json_of, text_of
from handfit_core.errors import InputError
from tests.conftest import ROOT
from tests.core.benchmarks.test_benchmark_report import MACHINE, line_of


def zip_of(path: Path, sizes: dict[str, int]) -> Path:
    with zipfile.ZipFile(path, "w") as archive:
        for name, size in sizes.items():
            archive.writestr(name, bytes(size))
    return path


def test_real_packages(tmp_path: Path) -> None:
    wheels = {
        "wheels/scipy-1.15.3-cp311-cp311-linux.whl": 2_000_000,
        "wheels/scipy-1.17.1-cp313-cp313-linux.whl": 1_000_000,
        "wheels/opencv_python_headless-4.11-abi3.whl": 500_000,
        "worker/__init__.py": 700_000,
    }
    told: list[int] = []
    extension = zip_of(tmp_path / "built.zip", wheels)
    costs = measure_packages(2, names=("numpy", "scipy"), extension=extension, on_round=told.append)
    assert told == [1, 2]
    numpy, scipy = costs.packages
    assert (numpy.name, scipy.name) == ("numpy", "scipy")
    assert (numpy.zipped, scipy.zipped) == (0.0, pytest.approx(3.0))
    assert costs.whole_zip == pytest.approx(4.2, rel=0.01)
    for package in costs.packages:
        assert 10 < package.installed < 1000
        assert 0 < package.seconds.low <= package.seconds.median <= package.seconds.high
        assert 1 < package.memory < 500 or sys.platform != "linux"


def test_installed_size_is_of_the_packages_own_files() -> None:
    import numpy as np

    core = Path(np.__file__).parent
    own = sum(p.stat().st_size for p in core.rglob("*") if p.is_file() and p.suffix != ".pyc") / 1e6
    assert own <= installed_size("numpy") < own + 100
    assert distribution("numpy").version == np.__version__


def test_child_loads_nothing_before_it_measures() -> None:
    code = (
        "import sys, benchmarks.packages_child as child\n"
        "assert 'numpy' not in sys.modules\n"
        "child.main('numpy')\n"
        "assert not {'torch', 'scipy', 'cv2', 'mediapipe'} & set(sys.modules)\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True, cwd=ROOT)


def test_zip_that_cannot_be_read(tmp_path: Path) -> None:
    torn = tmp_path / "torn.zip"
    torn.write_bytes(b"PK")
    with pytest.raises(InputError, match=r"torn\.zip: this is no zip that can be read"):
        measure_packages(1, names=(), extension=torn)
    with pytest.raises(InputError, match=r"gone\.zip: this is no zip"):
        measure_packages(1, names=(), extension=tmp_path / "gone.zip")
    with pytest.raises(InputError, match="there are no wheels in this zip"):
        measure_packages(1, names=(), extension=zip_of(tmp_path / "other.zip", {"a.txt": 3}))


def test_package_that_is_not_installed() -> None:
    with pytest.raises(InputError, match="no-such-package is not installed"):
        installed_size("no-such-package")


def test_table() -> None:
    def cost(name: str, installed: float, zipped: float | None) -> PackageCost:
        return PackageCost(name, installed, Spread(1.5, 1.25, 2.0), 190.0, zipped)

    costs = PackageCosts([cost("scipy", 250.0, 50.0), cost("torch", 750.0, 192.0)], 320.0)
    text = text_of(Results(MACHINE, "hand", packages=costs))
    assert line_of(text, "torch").split() == [
        *("torch", "750.0", "75", "%", "1.50", "1.25-2.00", "190"),
        *("192.0", "60", "%"),
    ]
    assert "the whole zip: 320.0 MB" in text
    without = Results(MACHINE, "hand", packages=PackageCosts([cost("torch", 750.0, None)], None))
    assert "zip" not in text_of(without)
    assert json_of(without)["packages_mb"]["packages"][0]["seconds"]["median"] == 1.5
    assert "packages_mb" not in json_of(Results(MACHINE, "hand"))
