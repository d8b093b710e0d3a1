"""Check Installation, and the text blocks that it and errors write."""

from __future__ import annotations

import os

import bpy
import pytest

from blender_manient.common import preferences
from blender_manient.operators import check_installation
from blender_manient.session import details
from handfit_core.version import __version__
from tests.capturing import needs_capture


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
    result = check_installation.last_result()
    assert result is not None
    assert result.ok, text


def test_an_interpreter_that_does_not_exist(registered, tmp_path):
    preferences.get().python = str(tmp_path / "no-python")
    preferences.get().mano_folder = str(tmp_path)
    assert bpy.ops.manient.check_installation() == {"FINISHED"}
    result = check_installation.last_result()
    assert result is not None
    assert not result.ok
    assert "no-python" in result.sentence
    assert "preferences" in result.sentence
    assert result.sentence in content("Hand Capture Check")
    assert "has no MANO_RIGHT" in content("Hand Capture Check")
    bpy.ops.wm.read_factory_settings(use_empty=True)
    assert check_installation.last_result() is None, "results end with their text"


def test_what_a_process_said_before_it_died_is_in_the_report(registered, peer):
    preferences.get().python = peer("sys.stderr.write('out of paper\\n'); sys.exit(3)")
    bpy.ops.manient.check_installation()
    text = content("Hand Capture Check")
    assert "The process that captures said:\nout of paper" in text
    assert "exit code 3" in text


def test_the_users_home_is_not_told(registered, monkeypatch, tmp_path):
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setenv("USERPROFILE", str(tmp_path))
    preferences.get().python = str(tmp_path / "no-python")
    bpy.ops.manient.check_installation()
    assert str(tmp_path) not in content("Hand Capture Check")
    assert f"~{os.sep}no-python" in content("Hand Capture Check")


def test_details_are_replaced_and_complete(registered):
    details.write_details("Capture of a.jpg", "it failed; try again", "Traceback of the first")
    text = details.write_details("Capture of b.jpg", "it failed; try again", "Traceback of the second")
    assert text.name == "Hand Capture Details"
    assert [t.name for t in bpy.data.texts] == ["Hand Capture Details"]
    written = text.as_string()
    assert "Traceback of the second" in written
    assert "first" not in written
    for part in ("Capture of b.jpg", "it failed; try again", __version__, bpy.app.version_string):
        assert part in written


def test_a_linked_text_of_the_same_name_is_left_alone(registered, tmp_path):
    details.write_details("Old", "old", "")
    path = tmp_path / "library.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    bpy.ops.wm.read_factory_settings(use_empty=True)
    with bpy.data.libraries.load(str(path), link=True) as (source, target):
        target.texts = source.texts
    new = details.write_details("New", "new", "")
    assert new.library is None
    (linked,) = [t for t in bpy.data.texts if t.library is not None]
    assert linked.as_string().startswith("Old")


def test_without_a_window_details_are_printed(registered, capfd):
    with pytest.raises(RuntimeError, match="nothing was written yet"):
        bpy.ops.manient.show_details()
    details.write_details("Capture of a.jpg", "it failed; try again", "where it was")
    assert bpy.ops.manient.show_details() == {"FINISHED"}
    assert "where it was" in capfd.readouterr().out
    assert not bpy.ops.manient.copy_details.poll()  # there is no clipboard
