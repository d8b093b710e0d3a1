"""The add-on comes and goes without a trace, loads nothing heavy, and imports takes."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import bpy
import pytest

import blender_manient

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture
def registered():
    blender_manient.register()
    yield
    blender_manient.unregister()


def _traces() -> list[str]:
    menu = bpy.types.TOPBAR_MT_file_import
    drawn = [f.__module__ for f in getattr(menu.draw, "_draw_funcs", ())]
    types = [name for name in dir(bpy.types) if "manient" in name.lower()]
    operators = list(dir(bpy.ops.manient)) if "manient" in dir(bpy.ops) else []
    return types + operators + [m for m in drawn if "manient" in m]


def test_register_and_unregister_leave_nothing():
    assert _traces() == []
    for _ in range(2):
        blender_manient.register()
        assert _traces() != []
        blender_manient.unregister()
        assert _traces() == []


def test_import_operator(registered, make_take, tmp_path):
    path = make_take().take.save(tmp_path / "a.take.npz")
    assert bpy.ops.manient.import_take(filepath=str(path)) == {"FINISHED"}
    assert "photo of a hand" in bpy.data.collections
    assert len([o for o in bpy.data.objects if o.type == "ARMATURE"]) == 2


def test_import_operator_says_what_is_wrong_in_one_sentence(registered, tmp_path):
    bad = tmp_path / "bad.npz"
    bad.write_text("no take")
    with pytest.raises(RuntimeError) as caught:
        bpy.ops.manient.import_take(filepath=str(bad))
    assert "not a take file" in str(caught.value)
    assert "Traceback" not in str(caught.value)


def test_importing_the_addon_loads_nothing_heavy():
    code = (
        "import sys, bpy, blender_manient, blender_manient.scene.export, blender_manient.scene.preview,"
        "handfit_core.worker.client;"
        "blender_manient.register();"
        "print([m for m in ('torch', 'scipy', 'cv2', 'mediapipe') if m in sys.modules]);"
        "blender_manient.unregister()"  # the bpy wheel of 4.5 hangs at exit on classes left behind
    )
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True, timeout=120
    )
    assert done.stdout.strip().splitlines()[-1] == "[]"
