"""What docs/extending.md shows, made from the page alone: a file put into its folder, found, used."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from tests.conftest import ROOT

PAGE = (ROOT / "docs" / "extending.md").read_text(encoding="utf-8")
BROKEN = "import what_is_not_there\n"
BESIDE = {
    "exporters": """
from .exporter import Exporter

class Nameless(Exporter):
    suffix = ".none"
    def write(self, path, hands, preset, final): path.write_text({}["whole"])

class Usurper(Nameless):
    name, label, description = "fbx", "FBX", "Another"

class Failing(Nameless):
    name, label, description = "failing", "Failing", "Fails"
""",
    "rigs": """
from .character import Character
from .rig import Rig

class Wrong(Character):
    label = "Wrong"
    @classmethod
    def find(cls, armature, bones, side): return armature["what is not there"]

class Raising(Rig):
    @classmethod
    def recognises(cls, armature, side): return armature["what is not there"]
    bones = ()
""",
}
"""Files beside those of the page, with what can be wrong"""

BEGIN = """
import bpy, os, sys
import numpy as np
from pathlib import Path
import blender_manient
from handfit_core.take import Take
blender_manient.register()
from blender_manient.scene.build import build_take
bpy.ops.wm.read_factory_settings(use_empty=True)
hand = build_take(Take.load(sys.argv[1]), picture=False).hands[0]
"""

EXPORT = """
bpy.context.view_layer.objects.active = hand.armature
bpy.context.scene.manient.export_format = "wrists"
bpy.ops.manient.export_hand(filepath=sys.argv[2])
scene, wrists = bpy.context.scene, []
for frame in range(scene.frame_start, scene.frame_end + 1):
    scene.frame_set(frame)
    wrists.append(",".join(f"{x:.6f}" for x in hand.armature.matrix_world @ hand.armature.pose.bones[0].head))
assert Path(sys.argv[2] + ".csv").read_text().split("\\n") == ["out", *wrists, ""], wrists
from blender_manient.exporters import EXPORTERS
assert type(EXPORTERS["fbx"]).__name__ == "FbxExporter"
from blender_manient.panels.preferences import ManientPreferences
from blender_manient.common import preferences
from tests.drawn import drawn
shown = drawn(ManientPreferences, **{name: "" for name in preferences.Values.__annotations__})
assert "broken.py is left out" in shown.loud.lower(), shown.loud
assert bpy.ops.manient.open_plugins() == {"FINISHED"}
try:
    bpy.ops.manient.export_hand(filepath=sys.argv[2], file_format="failing")
except RuntimeError as error:
    assert "out.none: the plug-in aaa.py failed in Failing (KeyError: 'whole'): mend" in str(error), error
assert not Path(sys.argv[2] + ".none").exists()
"""

RIG = """
from blender_manient.rigs import rig_of
from blender_manient.scene.keys import read_pose_keys
before = read_pose_keys(rig_of(hand.armature))
assert type(rig_of(hand.armature)).__name__ == "CapturedHandRig"
bones, seen = rig_of(hand.armature).bones, {}
for name in bones:
    finger = name.partition("_")[0].removesuffix(".R")
    seen[finger] = seen.get(finger, 0) + 1
    new = "hand_r" if finger == "wrist" else f"{finger}{seen[finger]}_r"
    hand.armature.data.bones[name].name = new
rig = rig_of(hand.armature)
assert type(rig).__name__ == "NumberedRig" and rig.side == "right", rig
after = read_pose_keys(rig)
np.testing.assert_array_equal(after.quats, before.quats)
np.testing.assert_array_equal(after.locations, before.locations)
"""

CHARACTER = """
from handfit_core.common.errors import OptionError
from handfit_core.common.slices import run_to_completion
from blender_manient.rigs import found_hand
from blender_manient.scene.onto_character import TransferOptions, putting
from blender_manient.scene.store import hand_of
puppet = hand.armature.copy()
puppet.data = hand.armature.data.copy()
puppet.animation_data_clear()
puppet.manient.is_hand = False
bpy.context.collection.objects.link(puppet)
seen = {}
for bone in puppet.data.bones:
    finger = bone.name.partition("_")[0].removesuffix(".R")
    seen[finger] = seen.get(finger, -1) + 1
    bone.name = "palm_r_ctl" if finger == "wrist" else f"{finger}_{'abc'[seen[finger]]}_r_ctl"
found = found_hand(puppet, "right").hand_map
assert found.rig == "Studio puppet", found
puppet["finger_ik"] = 1.0
def put():
    run_to_completion(putting(puppet, [(found, hand_of(hand.armature))], TransferOptions(contacts=False)))
try:
    put()
    raise SystemExit("applied with IK")
except OptionError as error:
    assert "follow IK: set its property finger_ik to 0" in str(error), error
assert puppet.animation_data is None or puppet.animation_data.action is None
puppet["finger_ik"] = 0.0
put()
bpy.context.scene.frame_set(4)
for ours, theirs in zip(hand.armature.pose.bones[1:], puppet.pose.bones[1:], strict=True):
    turned = ours.matrix_basis.to_quaternion().rotation_difference(theirs.matrix_basis.to_quaternion())
    assert turned.angle < 1e-3, ours.name
"""

END = """
blender_manient.unregister()
sys.stderr.flush()
os._exit(0)  # bpy as a module may crash or hang while Python ends
"""


def make(heading: str, folder: Path) -> None:
    """Write a section's file into its folder, and one beside it that cannot be loaded."""
    section = PAGE.split(f"## {heading}\n")[1].split("\n## ")[0]
    code = re.search(r"```python\n(.*?)```", section, re.DOTALL)
    assert code is not None
    name = re.match(r'"""(\w+\.py)', code[1])
    assert name is not None
    (folder / name[1]).write_text(code[1], encoding="utf-8")
    (folder / "broken.py").write_text(BROKEN)
    (folder / "aaa.py").write_text(BESIDE[folder.name])


@pytest.mark.parametrize(
    ("heading", "folder", "script"),
    [("An exporter", "exporters", EXPORT), ("A rig", "rigs", RIG), ("A character", "rigs", CHARACTER)],
)
def test_one_file_adds_it(make_take, tmp_path, heading, folder, script):
    plugins = tmp_path / "user" / "manient" / folder
    plugins.mkdir(parents=True)
    make(heading, plugins)
    (plugins / "vrma.py" if folder == "exporters" else plugins / "rigify.py").write_text(BROKEN)
    take = make_take(sides=("right",)).take.save(tmp_path / "hand.take.npz")
    done = subprocess.run(
        [sys.executable, "-c", BEGIN + script + END, str(take), str(tmp_path / "out")],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(ROOT), "BLENDER_USER_DATAFILES": str(tmp_path / "user")},
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-3000:]
    assert "broken.py is left out" in done.stderr
    assert "py is left out: the add-on has a file of this name" in done.stderr
    for said in {
        "An exporter": (
            "aaa.py is left out: Nameless has no name, label, description",
            "Usurper of aaa.py is left out: there is a format 'fbx' already",
        ),
        "A rig": ("the plug-in aaa.py failed in Raising (KeyError: ",),
        "A character": ("the plug-in aaa.py failed in Wrong (KeyError: ",),
    }[heading]:
        assert done.stderr.count(said) == 1, done.stderr[-3000:]
    assert "Traceback" not in done.stderr
