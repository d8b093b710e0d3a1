"""The version stands in blender_manifest.toml alone: in a checkout, in a wheel, beside old leftovers."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

import handfit_core
from tests.conftest import ROOT

METADATA = "Metadata-Version: 2.1\nName: handfit-core\nVersion: {}\n"


@pytest.fixture
def package(tmp_path: Path) -> Path:
    """handfit_core/version.py in a folder of its own, with nothing beside it."""
    folder = tmp_path / "somewhere" / "handfit_core"
    folder.mkdir(parents=True)
    shutil.copy(ROOT / "handfit_core" / "version.py", folder)
    return folder


def version_of(package: Path) -> str:
    """As setuptools reads it: the file by itself, in a Python without NumPy or any other package."""
    code = f"import runpy; print(runpy.run_path({str(package / 'version.py')!r})['__version__'])"
    done = subprocess.run([sys.executable, "-IS", "-c", code], capture_output=True, text=True, check=True)
    return done.stdout.strip()


def test_it_stands_in_the_manifest_alone():
    manifest = tomllib.loads((ROOT / "blender_manifest.toml").read_text(encoding="utf-8"))
    assert handfit_core.__version__ == manifest["version"]
    assert not re.search(r'=\s*"\d', (ROOT / "handfit_core" / "version.py").read_text(encoding="utf-8"))
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert "version" not in project
    assert project["dynamic"] == ["version"]


def test_manifest_beside_the_package_wins_over_an_old_egg_info(package):
    (package.parent / "blender_manifest.toml").write_text('id = "manient"\nversion = "7.8.9"\n')
    old = package.parent / "handfit_core.egg-info"
    old.mkdir()
    (old / "PKG-INFO").write_text(METADATA.format("0.0.1"))
    assert version_of(package) == "7.8.9"


@pytest.mark.parametrize("other", ['id = "another"\nversion = "5.0.0"\n', "not = [toml", None])
def test_installed_package_has_its_wheels_version(package, other):
    """Blender's site-packages is shared by all extensions: another one's manifest is not ours."""
    if other is not None:
        (package.parent / "blender_manifest.toml").write_text(other)
    info = package.parent / "handfit_core-3.2.1.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(METADATA.format("3.2.1"))
    assert version_of(package) == "3.2.1"


def test_copied_package_imports_without_a_version(package):
    assert version_of(package) == "unknown"
