from __future__ import annotations

import os

import pytest

from scripts.extension.errors import BuildError
from scripts.extension.targets import platform_named
from scripts.lock_wheels import locked

LINUX = platform_named("linux-x64")
CPU_311 = "torch-2.13.0+cpu-cp311-cp311-manylinux_2_28_x86_64.whl"
CUDA_313 = "torch-2.13.0-cp313-cp313-manylinux_2_28_x86_64.whl"


@pytest.fixture
def index(tmp_path, monkeypatch):
    """A folder that is all that pip knows."""
    monkeypatch.setenv("PIP_CONFIG_FILE", os.devnull)
    monkeypatch.setenv("PIP_NO_INDEX", "1")
    monkeypatch.setenv("PIP_FIND_LINKS", str(tmp_path / "index"))
    (tmp_path / "index").mkdir()
    return tmp_path / "index"


def test_the_locked_wheel_is_the_one_that_pip_finds(index, make_wheel):
    wheel = make_wheel(CPU_311, folder=index)
    lock = locked(["torch"], LINUX, "3.11", {"torch": "2.13.0"})
    assert [(pin.name, pin.version, pin.sha256) for pin in lock.pins] == [
        ("torch", "2.13.0+cpu", wheel.sha256)
    ]
    assert lock.missing == {}


def test_torch_is_missing_where_the_index_has_it_for_another_python(index, make_wheel):
    make_wheel(CPU_311, folder=index)
    make_wheel(CUDA_313, folder=index)
    lock = locked(["torch"], LINUX, "3.13", {"torch": "2.13.0"})
    assert lock.pins == ()
    assert "no CPU build of torch 2.13.0 for Python 3.13" in lock.missing["torch"]


@pytest.mark.parametrize("there", [[], [CUDA_313]])
def test_without_a_network_or_the_index_of_cpu_builds_nothing_is_locked(index, make_wheel, there):
    for name in there:
        make_wheel(name, folder=index)
    with pytest.raises(
        BuildError, match=r"torch 2\.13\.0\+cpu: no wheel for linux-x64, Python 3\.13 .*network"
    ):
        locked(["torch"], LINUX, "3.13", {"torch": "2.13.0"})


def test_any_other_package_must_be_there(index, make_wheel):
    make_wheel("scipy-1.17.1-cp311-cp311-manylinux_2_28_x86_64.whl", folder=index)
    with pytest.raises(BuildError, match=r"scipy 1\.17\.1: no wheel for linux-x64, Python 3\.13 was found"):
        locked(["scipy"], LINUX, "3.13", {"scipy": "1.17.1"})
    with pytest.raises(BuildError, match=r"setuptools 81: no wheel for all platforms was found"):
        locked(["setuptools"], None, "3.11", {"setuptools": "81"})
