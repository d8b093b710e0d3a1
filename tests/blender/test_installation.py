"""What is found in broken installations, each made of a small zip and unpacked as Blender does; the operator
that checks, and the text blocks that it and errors write."""

from __future__ import annotations

import json
import os
import shutil
import sys
import zipfile
from pathlib import Path

import bpy
import pytest

from blender_manient.common import installation, preferences
from blender_manient.operators import check_installation
from blender_manient.session import details
from handfit_core.common.version import __version__
from tests.capturing import needs_capture

from .small_zip import FOREIGN, PLATFORM, PYTHON, cut_short, gone, small_zip


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


def of_another_version(package: str):
    def rename(folder: Path) -> None:
        info = next(site_packages(folder).glob(f"{package}-*"))
        info.rename(info.with_name(f"{package}-0.12.0.dist-info"))

    return rename


def test_nothing_is_wrong(install, tmp_path):
    system = {"linux": "linux", "win32": "windows", "darwin": "macos"}[sys.platform]
    assert installation.this_platform().startswith(f"{system}-")
    assert installation.this_python() == f"3.{sys.version_info.minor}"
    assert examined(tmp_path / "manient") is None, "a checkout"
    assert "Not installed from a zip" in installation.report()
    folder = install(pythons=(PYTHON, "3.12"))
    assert examined(folder) is None
    of_another_version("mediapipe")(folder)  # a newer one of another extension is as good
    assert examined(folder) is None


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
    assert found.runs == runs
    assert said in found.sentence
    assert found.sentence.startswith("the add-on is not whole (")
    assert found.sentence.endswith("get the zip for this machine once more and install it")
    assert "\n" not in found.sentence


def content(name: str) -> str:
    return bpy.data.texts[name].as_string()


@needs_capture
def test_the_report_has_versions_files_and_a_self_test(registered):
    assert bpy.ops.manient.check_installation() == {"FINISHED"}
    text = content("Hand Capture Check")
    assert f"Manient Hand Capture {__version__}" in text
    assert bpy.app.version_string in text
    for part in ("torch", "mediapipe", "hand_landmarker.task"):
        assert part in text, part
    assert check_installation.last_result().ok, text


def test_an_interpreter_that_does_not_exist(registered, tmp_path, monkeypatch):
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setenv("USERPROFILE", str(tmp_path))
    preferences.get().python = str(tmp_path / "no-python")
    preferences.get().mano_folder = str(tmp_path)
    assert bpy.ops.manient.check_installation() == {"FINISHED"}
    result = check_installation.last_result()
    assert not result.ok
    assert "no-python" in result.sentence
    assert "preferences" in result.sentence
    text = content("Hand Capture Check")
    assert result.sentence.replace(str(tmp_path), "~") in text
    assert "has no MANO_RIGHT" in text
    assert f"~{os.sep}no-python" in text
    assert str(tmp_path) not in text, "the user's home"
    bpy.ops.wm.read_factory_settings(use_empty=True)
    assert check_installation.last_result() is None, "results end with their text"


def test_what_a_process_said_before_it_died_is_in_the_report(registered, peer):
    preferences.get().python = peer("sys.stderr.write('out of paper\\n'); sys.exit(3)")
    bpy.ops.manient.check_installation()
    text = content("Hand Capture Check")
    assert "The process that captures said:\nout of paper" in text
    assert "exit code 3" in text


def test_details_are_replaced_complete_and_printed(registered, tmp_path, capfd):
    """A linked text of their name is left alone; without a window they are printed."""
    with pytest.raises(RuntimeError, match="nothing was written yet"):
        bpy.ops.manient.show_details()
    details.write_details("Old", "old", "")
    path = tmp_path / "library.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    bpy.ops.wm.read_factory_settings(use_empty=True)
    with bpy.data.libraries.load(str(path), link=True) as (source, target):
        target.texts = source.texts
    details.write_details("Capture of a.jpg", "it failed; try again", "Traceback of the first")
    text = details.write_details("Capture of b.jpg", "it failed; try again", "Traceback of the second")
    assert [t for t in bpy.data.texts if t.library is None] == [text]
    (linked,) = (t for t in bpy.data.texts if t.library is not None)
    assert linked.as_string().startswith("Old")
    written = text.as_string()
    assert "first" not in written
    parts = ("Capture of b.jpg", "it failed; try again", "Traceback of the second")
    assert all(part in written for part in (*parts, __version__, bpy.app.version_string))
    assert bpy.ops.manient.show_details() == {"FINISHED"}
    assert "Traceback of the second" in capfd.readouterr().out
    assert not bpy.ops.manient.copy_details.poll()  # there is no clipboard
