"""The version stands in blender_manifest.toml alone: in a checkout, in a wheel, beside old leftovers."""

import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

import handfit_core
from tests.conftest import ROOT

VERSION = ROOT / "handfit_core" / "common" / "version.py"
METADATA = "Metadata-Version: 2.1\nName: handfit-core\nVersion: 3.2.1\n"
WHEEL = "handfit_core-3.2.1.dist-info/METADATA"


@pytest.fixture
def package(tmp_path: Path) -> Path:
    """handfit_core/common/version.py in a folder of its own, with nothing beside it."""
    folder = tmp_path / "somewhere" / "handfit_core"
    (folder / "common").mkdir(parents=True)
    shutil.copy(VERSION, folder / "common")
    return folder


def version_of(package: Path) -> str:
    """As setuptools reads it: the file by itself, in a Python without NumPy or any other package."""
    code = f"import runpy; print(runpy.run_path({str(package / 'common' / 'version.py')!r})['__version__'])"
    done = subprocess.run([sys.executable, "-IS", "-c", code], capture_output=True, text=True, check=True)
    return done.stdout.strip()


def test_it_stands_in_the_manifest_alone():
    manifest = tomllib.loads((ROOT / "blender_manifest.toml").read_text(encoding="utf-8"))
    assert handfit_core.__version__ == manifest["version"]
    assert not re.search(r'=\s*"\d', VERSION.read_text(encoding="utf-8"))
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert "version" not in project
    assert project["dynamic"] == ["version"]


@pytest.mark.parametrize(
    ("manifest", "info", "expected"),
    [
        ('id = "manient"\nversion = "7.8.9"\n', "handfit_core.egg-info/PKG-INFO", "7.8.9"),  # which is old
        ('id = "another"\nversion = "5.0.0"\n', WHEEL, "3.2.1"),
        ("not = [toml", WHEEL, "3.2.1"),
        (None, WHEEL, "3.2.1"),
        (None, None, "unknown"),
    ],
    ids=["a checkout", "beside another extension's manifest", "beside nonsense", "a wheel", "a copy"],
)
def test_what_it_is(package, manifest, info, expected):
    """Blender's site-packages is shared by all extensions: another one's manifest is not ours."""
    if manifest is not None:
        (package.parent / "blender_manifest.toml").write_text(manifest)
    if info is not None:
        (package.parent / info).parent.mkdir()
        (package.parent / info).write_text(METADATA)
    assert version_of(package) == expected
