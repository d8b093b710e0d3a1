"""The add-on comes and goes without a trace, loads nothing heavy, and imports takes."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import bpy
import pytest

ROOT = Path(__file__).resolve().parents[2]


def test_import_operator_says_what_is_wrong_in_one_sentence(registered, tmp_path):
    bad = tmp_path / "bad.npz"
    bad.write_text("no take")
    with pytest.raises(RuntimeError) as caught:
        bpy.ops.manient.import_take(filepath=str(bad))
    assert "not a take file" in str(caught.value)
    assert "Traceback" not in str(caught.value)


def test_importing_the_addon_loads_nothing_heavy():
    code = (
        "import sys, bpy, blender_manient, blender_manient.exporters.export_hands, "
        "blender_manient.scene.preview, handfit_core.worker.client;"
        "blender_manient.register();"
        "print([m for m in ('torch', 'scipy', 'cv2', 'mediapipe') if m in sys.modules]);"
        "blender_manient.unregister()"  # the bpy wheel of 4.5 hangs at exit on classes left behind
    )
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True, timeout=120
    )
    assert done.stdout.strip().splitlines()[-1] == "[]"
