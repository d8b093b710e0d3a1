"""The zip: what is in it, and that the real Blender installs it and captures with it."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest

from scripts.build_extension import build

ROOT = Path(__file__).resolve().parents[2]
CHROOT = os.environ.get("HANDFIT_BLENDER_CHROOT")

SCRIPT = """
import json, bpy
bpy.context.scene.manient.source = "{photo}"
done = bpy.ops.manient.capture()
names = [a for a in bpy.context.preferences.addons.keys() if "manient" in a]
hands = [o.manient.side for o in bpy.data.objects if o.type == "ARMATURE"]
check = bpy.ops.manient.check_installation()
print("FOUND " + json.dumps([names, list(done), hands, list(check)]))
"""


@pytest.fixture(scope="module")
def zipped(tmp_path_factory) -> Path:
    return build(tmp_path_factory.mktemp("extension"))


def test_contents(zipped):
    with zipfile.ZipFile(zipped) as archive:
        names = archive.namelist()
        manifest = tomllib.loads(archive.read("blender_manifest.toml").decode())
    assert {"__init__.py", "LICENSE", "operators/capture.py", "panels/__init__.py"} <= set(names)
    assert not [name for name in names if "__pycache__" in name or name.startswith("tests")]
    (wheel,) = manifest["wheels"]
    assert wheel.removeprefix("./") in names


def test_same_input_same_bytes(zipped, tmp_path):
    assert build(tmp_path).read_bytes() == zipped.read_bytes()


@pytest.mark.skipif(not CHROOT, reason="HANDFIT_BLENDER_CHROOT does not name a chroot with Blender in it")
def test_real_blender_installs_it_and_captures(zipped, tmp_path):
    photo = shutil.copy(ROOT / "samples" / "rendered_hand" / "hand.0001.jpg", zipped.parent)
    script = zipped.parent / "capture.py"
    script.write_text(SCRIPT.format(photo=photo))
    python = os.environ.get("HANDFIT_PYTHON", sys.executable)
    commands = (
        f"blender --command extension validate '{zipped}'",
        f"blender --command extension install-file -r user_default --enable '{zipped}'",
        f"blender -b --python-exit-code 3 --python '{script}'",
    )
    done = subprocess.run(
        [str(ROOT / "scripts" / "chroot_blender.sh"), str(Path(CHROOT or "").resolve()),
         "env", f"HANDFIT_PYTHON={python}", "sh", "-ec", "\n".join(commands)],
        capture_output=True,
        text=True,
        env={**os.environ, "HANDFIT_PYTHON": python, "CHROOT_BIND": str(zipped.parent)},
        check=False,
        timeout=300,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    found = next(line for line in done.stdout.splitlines() if line.startswith("FOUND"))
    assert json.loads(found.removeprefix("FOUND ")) == [
        ["bl_ext.user_default.manient"],
        ["FINISHED"],
        ["right"],
        ["FINISHED"],
    ]
