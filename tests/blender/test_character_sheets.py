"""scripts/character_sheets.py: a captured hand, and characters' hands that do what it does."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import bpy
import cv2
import numpy as np
import pytest

from blender_manient.rigs import found_hand
from blender_manient.rigs.character import bones_of
from handfit_core.geometry.rotations import rotvec_to_rotmat
from handfit_core.hand_model import load_model
from handfit_core.hand_model.axes import bone_frames, points_to_rest
from handfit_core.hand_model.poses import ready_poses
from handfit_core.retarget.names import RIGS
from handfit_core.retarget.transfer import SourceHand, target_hand
from handfit_core.skeleton import FINGER_JOINTS, NUM_JOINTS, SIDES, Side
from scripts.character_sheets import following, main

from .characters import build_armature, hand_specs

SHOWN = ["Thumbs Up", "Letter V"]
MIXAMO = next(rig for rig in RIGS if rig.label == "Mixamo")


def character(side: Side, path: Path) -> Path:
    """A .blend with the open hand as a character's, turned and ten times as large."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    names = {slot: MIXAMO.prefix + name.replace("Left", side.title()) for slot, name in MIXAMO.slots.items()}
    turn = rotvec_to_rotmat(np.array([0.4, -1.1, 2.0]))
    armature = build_armature(hand_specs(side, np.random.default_rng(2), names=names, turn=turn, scale=10.0))
    armature.scale = (0.1, 0.1, 0.1)
    model, mesh = load_model(None, side), bpy.data.meshes.new("skin")
    flat = points_to_rest(model.v_template - model.shaped().joints[0])
    mesh.from_pydata((10.0 * flat @ turn.T).tolist(), [], model.polygons.tolist())
    skin = bpy.data.objects.new("skin", mesh)
    bpy.context.collection.objects.link(skin)
    for joint in range(NUM_JOINTS):
        group = skin.vertex_groups.new(name=names[joint])
        for vertex in np.flatnonzero(model.weights[:, joint] > 0.0).tolist():
            group.add([vertex], float(model.weights[vertex, joint]), "REPLACE")
    skin.parent = armature
    skin.modifiers.new("Armature", "ARMATURE").object = armature
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    return path


@pytest.mark.parametrize("side", SIDES)
def test_the_skin_is_where_the_captured_hand_has_it(side, tmp_path):
    """Apart from its pose correctives, which characters have not; a roll turns the thumb alone."""
    path, model = character(side, tmp_path / "hand.blend"), load_model(None, side)
    wanted = [ready_poses()[name].pose for name in SHOWN]
    plain = replace(model, posedirs=np.zeros_like(model.posedirs))
    flat = np.stack([pose.on(side) for pose in wanted])
    should = plain.posed(None, np.zeros((2, 3)), flat, -model.shaped().joints[0]).vertices
    thumb = model.weights[:, list(FINGER_JOINTS["thumb"])].sum(axis=1) > 0.0
    for roll in (0.0, 30.0):
        skins = following(str(path), wanted, side, roll, contacts=False)
        for skin, vertices in zip(skins, points_to_rest(should), strict=True):
            off = np.linalg.norm(skin.vertices - vertices, axis=1)
            assert off[~thumb].max() < 1e-4
            assert (off[thumb].max() < 1e-4) == (roll == 0.0)


def test_a_row_for_each_roll(tmp_path):
    path, sheet = character("left", tmp_path / "hand.blend"), tmp_path / "sheet.png"
    options = ["--poses", *SHOWN, "--height", "49", "--thumb-roll", "0", "40", "--no-contacts"]
    assert main([f"Mine={path}:Character", "-o", str(sheet), *options]) == 0
    picture = cv2.imread(str(sheet))[20:, 76:]
    assert picture.shape == (3 * 2 * 49, 2 * 38, 3)
    cells = picture.reshape(6, 49, 2, 38, 3)
    background = picture[0, 0].astype(int)
    covered = (np.abs(cells - background).max(axis=-1) > 25).mean(axis=(1, 3))
    assert covered.min() > 0.05, "a hand in every cell"
    assert np.abs(covered[0] - covered[2]).max() < 0.02, "the same hand"


def test_what_is_not_there_is_said(tmp_path, capsys):
    path, sheet = character("left", tmp_path / "hand.blend"), str(tmp_path / "sheet.png")
    assert main([f"Mine={tmp_path / 'none.blend'}", "-o", sheet, "--poses", "Relaxed"]) == 1
    assert main([f"Mine={path}:Other", "-o", sheet, "--poses", "Relaxed"]) == 1
    said = capsys.readouterr().err
    assert "none.blend: no such file" in said
    assert "no armature 'Other'" in said


@pytest.mark.parametrize("side", SIDES)
def test_thumbs_of_rigify_bend_about_their_own_axis(side):
    """Its metarig's bones are rolled so that they bend about X: with the roll that thumbs get, X lies where
    ours does."""
    import addon_utils  # bpy brings it

    bpy.ops.wm.read_factory_settings(use_empty=True)
    addon_utils.enable("rigify", default_set=True, persistent=True)
    try:
        bpy.ops.object.armature_human_metarig_add()
        armature = bpy.context.object
        bones, hand_map = bones_of(armature), found_hand(armature, side).hand_map
    finally:
        addon_utils.disable("rigify", default_set=True)
    shaped = load_model(None, side).shaped()
    own = bone_frames(shaped, side)
    for roll, most in ((hand_map.thumb_roll, 8.0), (0.0, 40.0)):
        target = target_hand(bones, replace(hand_map, thumb_roll=roll), SourceHand.of(shaped, side))
        for joint in FINGER_JOINTS["thumb"]:
            bone = target.joints.index((joint,))
            axis = target.aligned.T @ target.corrected[bone] @ target.rest[bone][:, 0]
            off = np.degrees(np.arccos(axis @ own[joint][:, 0]))
            assert off < most
            assert roll or off > 20.0, "without a roll it would be seen"
