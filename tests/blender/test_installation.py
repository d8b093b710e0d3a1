"""Check Installation, and the text blocks that it and errors write."""

from __future__ import annotations

import os

import bpy
import pytest

from blender_manient.common import preferences
from blender_manient.session import details
from handfit_core.common.version import __version__
from tests.capturing import needs_capture


def content(name: str) -> str:
    return bpy.data.texts[name].as_string()


@needs_capture
def test_the_report_has_versions(registered):
    assert bpy.ops.manient.check_installation() == {"FINISHED"}
    text = content("Hand Capture Check")
    assert text.startswith("Everything works\n")
    for part in (f"Manient Hand Capture {__version__}", bpy.app.version_string, "\nscipy ", "\nmediapipe "):
        assert part in text, part


def test_an_interpreter_that_does_not_exist(registered, tmp_path, monkeypatch):
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setenv("USERPROFILE", str(tmp_path))
    preferences.get().python = str(tmp_path / "no-python")
    assert bpy.ops.manient.check_installation() == {"FINISHED"}
    text = content("Hand Capture Check")
    assert text.startswith(f"The Python '~{os.sep}no-python' cannot be started")
    assert "in the add-on's preferences" in text.splitlines()[0]
    assert str(tmp_path) not in text, "the user's home"


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
