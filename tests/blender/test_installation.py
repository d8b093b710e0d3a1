"""What is found in broken installations, each made of a small zip and unpacked as Blender does."""

from __future__ import annotations

import json
import re
import shutil
import sys
import zipfile
from pathlib import Path

import pytest

from blender_manient.common import installation
from tests.blender.small_zip import FOREIGN, PLATFORM, PYTHON, cut_short, gone, small_zip


@pytest.fixture
def install(tmp_path):
    """install(**options of small_zip) -> the add-on's folder, beside a folder of extensions; wheels that
    Blender could not unpack are not unpacked."""

    def make(**options) -> Path:
        folder = tmp_path / "manient"
        site = site_packages(folder)
        with zipfile.ZipFile(small_zip(tmp_path / "a.zip", **options)) as archive:
            archive.extractall(folder)
        site.mkdir(parents=True)
        for wheel in (folder / "wheels").iterdir():
            try:
                with zipfile.ZipFile(wheel) as archive:
                    archive.extractall(site)
            except zipfile.BadZipFile:
                name = wheel.name.partition("-")[0]
                for left in site.glob(f"{name}*"):
                    shutil.rmtree(left)
        return folder

    return make


def site_packages(folder: Path) -> Path:
    return folder.parent / "extensions" / ".local" / "lib" / f"python{PYTHON}" / "site-packages"


def examined(folder: Path) -> installation.Fault | None:
    return installation.examine(folder.parent / "extensions", folder)


def test_this_machine():
    system = {"linux": "linux", "win32": "windows", "darwin": "macos"}[sys.platform]
    assert installation.this_platform().startswith(f"{system}-")
    assert installation.this_python() == f"3.{sys.version_info.minor}"


def test_a_checkout_has_nothing_to_check(tmp_path):
    assert not installation.is_installed()
    assert examined(tmp_path / "manient") is None
    assert "Not installed from a zip" in installation.report()


def test_a_whole_installation(install):
    assert examined(install(pythons=(PYTHON, "3.12"))) is None


def of_another_version(package: str):
    def rename(folder: Path) -> None:
        info = next(site_packages(folder).glob(f"{package}-*"))
        info.rename(info.with_name(f"{package}-0.12.0.dist-info"))

    return rename


def not_unpacked(folder: Path) -> None:
    for left in site_packages(folder).glob("mediapipe*"):
        shutil.rmtree(left)
    (site_packages(folder) / "mediapipe").mkdir()  # as Blender leaves it


def mixed(folder: Path) -> None:
    data = json.loads((folder / "wheels.json").read_text())
    (folder / "wheels.json").write_text(json.dumps({**data, "version": "0.0.9"}))


@pytest.mark.parametrize(
    ("options", "change", "runs", "said"),
    [
        ({"platform": FOREIGN}, None, True, f"it is for {FOREIGN}, and this is {PLATFORM}"),
        ({"pythons": ("3.12",)}, None, True, f"no parts for this Blender's Python {PYTHON}"),
        ({"damage": {"handfit-core": gone}}, None, False, "handfit-core 0.1.0 is not unpacked"),
        ({"damage": {"mediapipe": gone}}, None, True, "mediapipe 0.10.31 is not unpacked"),
        ({"damage": {"mediapipe": cut_short}}, None, True, "mediapipe 0.10.31 is not unpacked"),
        ({}, not_unpacked, True, "mediapipe 0.10.31 is not unpacked"),
        ({}, of_another_version("handfit_core"), False, "handfit_core, is version 0.12.0"),
        ({}, mixed, False, "its files are of the versions 0.1.0 and 0.0.9"),
        ({}, lambda f: (f / "wheels.json").unlink(), False, "its list of parts cannot be read"),
        ({}, lambda f: (f / "blender_manifest.toml").unlink(), False, "its list of parts cannot be read"),
        ({}, lambda f: next(f.rglob("mediapipe*.whl")).write_bytes(b"x"), True, "missing or damaged"),
    ],
)
def test_a_broken_installation_is_one_sentence(install, options, change, runs, said):
    folder = install(**options)
    if change is not None:
        change(folder)
    found = examined(folder)
    assert found is not None
    assert found.runs == runs
    assert re.search(said, found.sentence)
    assert found.sentence.startswith("the add-on is not whole (")
    assert found.sentence.endswith("get the zip for this machine once more and install it")
    assert "\n" not in found.sentence


def test_a_newer_package_of_another_extension_is_as_good(install):
    folder = install()
    of_another_version("mediapipe")(folder)
    assert examined(folder) is None


@pytest.mark.parametrize("name", ["wheels.json", "blender_manifest.toml"])
@pytest.mark.parametrize(
    "content",
    ['{"version": 1', "[" * 100_000, "[]", "7", "\udcff", '{"wheels": [3], "version": "1"}'],
    ids=["half", "deep", "list", "number", "bytes", "entries"],
)
def test_a_list_that_is_damaged(install, name, content):
    folder = install()
    (folder / name).write_text(content, encoding="utf-8", errors="surrogateescape")
    found = examined(folder)
    assert found is not None
    assert not found.runs
    assert "the add-on is not whole" in found.sentence
