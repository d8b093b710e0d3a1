"""VRM animations out of Blender, as the file itself says; three-vrm reads such files in tests/core."""

from __future__ import annotations

from dataclasses import replace

import bpy
import numpy as np
import pytest
from mathutils import Quaternion, Vector

from blender_manient.exporters.export_hands import Stage, export_hands, export_take
from blender_manient.scene.build import build_take
from blender_manient.scene.characters import CharacterObjects, keep_map
from blender_manient.scene.onto_character import TransferOptions, applying, motion_of
from handfit_core.common.errors import OptionError
from handfit_core.common.skeleton import SIDES
from handfit_core.common.slices import run_to_completion
from tests.core.interchange.humanoids import Played, apart, directions, named, wanted

from .characters import BoneSpec, build_armature, hand_specs, map_of, placed
from .looking import palm

pytestmark = pytest.mark.usefixtures("registered")


def times(take, track):
    """Rows of a take in which a hand is, and when that is from its first frame."""
    return [
        (r, (take.frame_numbers[r] - take.frame_numbers[0]) / take.fps) for r in np.flatnonzero(track.present)
    ]


def relative_to_palm(points):
    """(10, 3) directions (15, 3) of fingers without the last segments, in the palm's axes."""
    return directions(points).reshape(5, 3, 3)[:, :2].reshape(-1, 3) @ palm(points)


def test_captured_hands_point_as_captured(make_take, tmp_path):
    made = make_take(fps=29.97)
    (path,) = export_take(build_take(made.take), made.take, tmp_path, "clip", "vrma")
    played = Played(path.read_bytes())
    for track in made.take.hands:
        for row, time in times(made.take, track):
            shown = directions(named(played.places(time), track.side)).reshape(5, 3, 3)
            there = wanted(track, row).reshape(5, 3, 3)
            assert apart(shown[:, :2], there[:, :2]) < 0.1, (track.side, row)
            assert apart(shown, there) < 3.0, "fingertips lie on the skin, which bends"
        assert played.bones[f"{track.side}Hand"] not in played.tracks


def character(rng, sides=SIDES, **fields):
    """Someone with forearms, anywhere in the world, whose hands rest bent."""
    specs = [BoneSpec("Hips", "", (0, 0, 1), (0, 0, 1.1))]
    for side in sides:
        x = 0.7 if side == "left" else -0.7
        specs.append(BoneSpec(f"arm_{side}", "Hips", (x / 2, 0, 1.4), (x, 0, 1.4), rng.uniform(-3, 3)))
        place = np.array([x, 0.0, 1.4])
        specs += hand_specs(side, rng, parent=f"arm_{side}", place=place, **fields)
    armature = build_armature(specs)
    for side in sides:
        keep_map(armature, map_of(side))
    return armature


def exported(armature, take, folder, **fields):
    stage = Stage.of_take(take)
    stage = replace(stage, render={**stage.render, "fps": 30, "fps_base": 1.0})
    (path,) = export_hands([replace(CharacterObjects.of(armature), **fields)], stage, folder, "x", "vrma")
    return Played(path.read_bytes())


def test_a_characters_fingers_point_as_they_show(make_take, tmp_path):
    """Whatever its rest pose, proportions and place, and under an arm that moves."""
    rng = np.random.default_rng(2)
    take = make_take().take
    armature = character(rng, bend=0.5, stretch=0.2)
    placed(armature, rng, 0.3)
    maps = {side: map_of(side) for side in SIDES}
    motions = [(maps[track.side], motion_of(take, track)) for track in take.hands]
    run_to_completion(applying(armature, motions, TransferOptions(contacts=False)))
    arm = armature.pose.bones["arm_left"]
    arm.rotation_mode = "XYZ"
    arm.rotation_euler = (0.5, 0.4, -0.3)
    played = exported(armature, take, tmp_path)
    for track in take.hands:
        for row, time in times(take, track):
            shown = relative_to_palm(named(played.places(time), track.side))
            bpy.context.scene.frame_set(int(take.frame_numbers[row]))
            pose = armature.evaluated_get(bpy.context.evaluated_depsgraph_get()).pose.bones
            heads = np.array([pose[name].head for name in maps[track.side].bones])
            theirs = relative_to_palm(np.concatenate([heads, np.ones((5, 3))]))
            assert apart(shown, theirs) < 0.1, (track.side, row)
        assert played.bones[f"{track.side}Hand"] not in played.tracks, "it does not turn to its forearm"


@pytest.mark.parametrize("side", SIDES)
def test_a_characters_wrist_bends_as_it_shows(make_take, tmp_path, side):
    """Towards the palm, by 30 degrees: VRM's hands lie with the palm down."""
    armature = character(np.random.default_rng(4), (side,))
    posed = armature.pose.bones[map_of(side).bones[0]]
    along = np.array([1.0 if side == "left" else -1.0, 0.0, 0.0])
    down = Quaternion(Vector((0.0, along[0], 0.0)), np.radians(30.0))  # x to -z
    axes = posed.bone.matrix_local.to_quaternion()
    posed.rotation_mode = "QUATERNION"
    posed.rotation_quaternion = axes.inverted() @ down @ axes
    armature.pose.bones[f"arm_{side}"].rotation_quaternion = Quaternion((0.7, 0.1, -0.5, 0.2))
    played = exported(armature, make_take().take, tmp_path)
    _, turned = played.place(played.bones[f"{side}Hand"], 0.0)
    bent = along * np.cos(np.pi / 6.0) - [0.0, np.sin(np.pi / 6.0), 0.0]
    assert apart((turned @ along)[None], bent[None]) < 3.0
    assert np.degrees(np.arccos((np.trace(turned) - 1.0) / 2.0)) == pytest.approx(30.0, abs=0.01)


def test_the_panels_button_writes_the_selected_character(make_take, tmp_path):
    """And no other, nor what no avatar can hold."""
    armature = character(np.random.default_rng(8))
    bpy.context.view_layer.objects.active = None
    armature.select_set(False)
    with pytest.raises(RuntimeError, match="Select a character first"):
        bpy.ops.manient.export_character(filepath=str(tmp_path / "x.vrma"))
    made = make_take(sides=("left", "left"))
    with pytest.raises(OptionError, match="several left hands"):
        export_take(build_take(made.take), made.take, tmp_path, "x", "vrma")
    with pytest.raises(OptionError, match="no hand was found"):
        exported(build_armature([BoneSpec("Bone", "", (0, 0, 0), (0, 0, 1))]), made.take, tmp_path)
    assert not list(tmp_path.iterdir())
    bpy.context.scene.frame_start, bpy.context.scene.frame_end = 1, 3
    bpy.context.view_layer.objects.active = armature
    assert bpy.ops.manient.export_character(filepath=str(tmp_path / "x")) == {"FINISHED"}
    played = Played((tmp_path / "x.vrma").read_bytes())
    assert [len(times) for times, _ in played.tracks.values()] == [3] * 30
