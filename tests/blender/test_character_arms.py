"""Captured arms on characters' arms, judged by evaluated bones."""

from __future__ import annotations

from dataclasses import replace

import bpy
import numpy as np
import pytest
from mathutils import Quaternion, Vector

from blender_manient import command
from blender_manient.panels.character import MANIENT_PT_character
from blender_manient.rigs.captured_hand import bone_names
from blender_manient.scene.build import build_take
from blender_manient.scene.characters import hand_map_of
from blender_manient.scene.onto_character import TransferOptions, putting
from blender_manient.scene.store import hand_of
from blender_manient.session import live_link
from handfit_core.common.skeleton import SIDES
from handfit_core.common.slices import run_to_completion
from handfit_core.hand_model.arm import ArmMotion
from handfit_core.interchange import humanoid
from tests.drawn import drawn

from .characters import BoneSpec, build_armature, hand_specs, mixamo_names, placed
from .conftest import world
from .looking import bones_at, chosen, keyed_bones, palm
from .test_live_link import settle

pytestmark = pytest.mark.usefixtures("registered")

RIGS = {"mixamo": ("LeftArm", "LeftForeArm"), "vrm": ("leftUpperArm", "leftLowerArm")}
FRAMES = (3, 5, 8, 17)
"""Of takes, whose first is 3 and whose last is 18"""


def character(kind, down=0.0, arms=True):
    """A character of bones that begin where others end, in the middle of a T or an A, and its skin."""
    prefix, rng = ("mixamorig:" if kind == "mixamo" else ""), np.random.default_rng(3)
    hips, chest = f"{prefix}Hips", f"{prefix}Chest"
    specs = [BoneSpec(hips, "", (0, 0, 1.0), (0, 0, 1.2)), BoneSpec(chest, hips, (0, 0, 1.2), (0, 0, 1.5))]
    for side in SIDES:
        sign = 1.0 if side == "left" else -1.0
        named = [
            prefix + name.replace("Left", side.capitalize()).replace("left", side) for name in RIGS[kind]
        ]
        along = np.array([sign * np.cos(down), 0.1 * sign, -np.sin(down)])
        along /= np.linalg.norm(along)
        joints = np.array([sign * 0.17, 0.02, 1.42]) + np.array([[0.0], [0.3], [0.55]]) * along
        parent = chest
        for name, head, tail in zip(named if arms else (), joints[:-1], joints[1:], strict=False):
            specs.append(BoneSpec(name, parent, head, tail, rng.uniform(-3, 3)))
            parent = name
        names = mixamo_names(side) if kind == "mixamo" else dict(enumerate(humanoid.bone_names(side)))
        specs += hand_specs(side, rng, names=names, parent=parent, place=joints[2], scale=0.9)
    return build_armature(specs)


def with_arms(take, *, towards=None):
    """A take whose person faces the camera; arms wave, or the forearms point `towards` (world axes)."""
    hands, count = [], len(take.frame_numbers)
    t = np.linspace(0.0, 1.0, count)
    for hand in take.hands:
        sign = 1.0 if hand.side == "left" else -1.0
        upper = np.stack([sign * (0.3 + t), -0.5 + 0.2 * t, -0.9 + 1.2 * t], axis=-1)
        fore = np.stack([-sign * (0.6 - t), -0.7 + 0 * t, 0.5 * np.cos(5 * t)], axis=-1)
        if towards is not None:
            upper = np.tile([0.15 * sign, -0.3, -1.0], (count, 1))
            fore = np.tile([-sign * towards[0], *towards[1:]], (count, 1))
        upper, fore = (
            np.stack([one[:, 0], -one[:, 2], one[:, 1]], axis=-1)
            / np.linalg.norm(one, axis=-1, keepdims=True)
            for one in (upper, fore)
        )
        shoulder = np.tile([0.17 * sign, 0.1, 1.2], (count, 1))
        elbow = shoulder + 0.28 * upper
        there = hand.present[:, None]
        ends = [np.where(there, one, np.nan) for one in (shoulder, elbow, elbow + 0.25 * fore)]
        error = np.where(there, [0.1, 0.1], np.nan)
        hands.append(replace(hand, arm=ArmMotion(*ends, np.array([0.28, 0.25]), hand.present, error)))
    return replace(take, hands=tuple(hands))


@pytest.fixture
def hands(make_take):
    """Both captured hands, with arms."""
    return [hand_of(one.armature) for one in build_take(with_arms(make_take().take)).hands]


def put(armature, hands, **options):
    onto = TransferOptions(**{"contacts": False, "arms": True} | options)
    tables = [(hand_map_of(armature, hand.side), hand) for hand in hands]
    done = run_to_completion(putting(armature, tables, onto))
    bpy.context.view_layer.update()
    return done


def joints(armature, names, frame):
    """(3, 3) shoulder, elbow and wrist as shown."""
    shown = bones_at(armature, frame)
    return np.array([shown[name].head for name in names])


def names_of(armature, side):
    """Bones that begin at shoulder, elbow and wrist."""
    if "rig_id" in armature.data:
        return [f"ORG-{name}.{side[0].upper()}" for name in ("upper_arm", "forearm", "hand")]
    hand = armature.pose.bones[hand_map_of(armature, side).bones[0]]
    return [hand.parent.parent.name, hand.parent.name, hand.name]


def segments(points):
    steps = np.diff(points, axis=0)
    return steps / np.linalg.norm(steps, axis=-1, keepdims=True)


def captured_segments(hand, frame):
    arm = hand.track.arm
    row = int(np.argmin(np.abs(hand.take.frame_numbers - frame)))
    return segments(world(np.array([arm.shoulder[row], arm.elbow[row], arm.wrist[row]])))


def palm_shown(armature, names, frame):
    """(3, 3) along, across and out of a palm, in the armature's space."""
    rest = armature.data.bones
    turned = (
        bones_at(armature, frame)[names[0]].matrix.to_3x3() @ rest[names[0]].matrix_local.to_3x3().inverted()
    )
    return np.array(turned) @ palm(np.array([rest[name].head_local for name in names]))


def check_as_captured(armature, hands, within=1e-4, frames=FRAMES, carried_by=""):
    for hand in hands:
        hand_map = hand_map_of(armature, hand.side)
        for frame in frames:
            space = np.eye(3)
            if carried_by:
                rest = armature.data.bones[carried_by].matrix_local.to_3x3().inverted()
                space = np.array(bones_at(armature, frame)[carried_by].matrix.to_3x3() @ rest)
            ours = segments(joints(armature, names_of(armature, hand.side), frame))
            np.testing.assert_allclose(ours, captured_segments(hand, frame) @ space.T, atol=within)
            wanted = space @ palm_shown(hand.armature, bone_names(hand.side), frame)
            if "rig_id" in armature.data:
                hand_map = replace(hand_map, bones=(f"ORG-hand.{hand.side[0].upper()}", *hand_map.bones[1:]))
            np.testing.assert_allclose(palm_shown(armature, hand_map.bones, frame), wanted, atol=5 * within)


@pytest.mark.parametrize("down", [0.0, 0.8])
@pytest.mark.parametrize("kind", RIGS)
def test_arms_point_as_captured_by_their_own_bones(hands, kind, down):
    target = character(kind, down)
    placed(target, np.random.default_rng(5), 0.02)
    done = put(target, hands)
    assert [(one.left_alone, one.bones) for one in done] == [((), 18)] * 2
    check_as_captured(target, hands)


@pytest.mark.parametrize("mode", ["fk", "ik", "pole"])
def test_arms_of_rigify_point_as_captured_by_what_acts_and_go_with_the_body(generated, make_take, mode):
    bpy.ops.wm.open_mainfile(filepath=str(generated))
    rig = bpy.data.objects["rig"]
    hands = [hand_of(one.armature) for one in build_take(with_arms(make_take().take)).hands]
    rig.pose.bones["f_index.01_ik.L"]["FK_IK"] = 0.0
    for end in "LR":
        parent = rig.pose.bones[f"upper_arm_parent.{end}"]
        parent["IK_FK"], parent["pole_vector"] = float(mode == "fk"), mode == "pole"
    for name, way in (("torso", (0.3, -0.2, 0.1)), ("chest", (0.0, 0.0, 0.0))):
        bone = rig.pose.bones[name]
        for frame, share in ((3, 0.0), (18, 1.0)):
            bone.rotation_quaternion = Quaternion((0.3, 0.5, 1.0), 0.7 * share)
            bone.location = share * Vector(way)
            bone.keyframe_insert("rotation_quaternion", frame=frame)
            bone.keyframe_insert("location", frame=frame)
    put(rig, hands)
    # Blender's IK shortens bones a little, as Rigify lets it.
    check_as_captured(rig, hands, within=1e-4 if mode == "fk" else 0.03, carried_by="ORG-spine.003")
    assert ("upper_arm_ik_target.L" in keyed_bones(rig)) == (mode == "pole")


def animated(armature):
    """The same with a body that sways, and arms that swing from frame -5 to 40; where its arms are shown."""
    for name, axis in (("mixamorig:Chest", 1), ("mixamorig:LeftArm", 2), ("mixamorig:RightForeArm", 0)):
        bone = armature.pose.bones[name]
        for frame, angle in ((-5, 0.0), (10, 0.6), (25, -0.3), (40, 0.2)):
            bone.rotation_quaternion = Quaternion([1.0 if axis == i else 0.0 for i in range(3)], angle)
            bone.keyframe_insert("rotation_quaternion", frame=frame)
    bpy.context.scene.frame_start, bpy.context.scene.frame_end = -5, 40


def shown_arms(armature, frames):
    return np.array([[joints(armature, names_of(armature, s), f) for s in SIDES] for f in frames])


@pytest.mark.parametrize("into", ["NEW", "STRIP"])
def test_arms_come_and_go_in_a_body_that_moves_and_leave_it_as_it_was(hands, into):
    target, every = character("mixamo"), (-5, 0, 3, 5, 8, 11, 17, 18, 25, 33, 40)
    animated(target)
    if into == "STRIP":  # above all others, while the present action has no keys of these bones
        bpy.context.view_layer.objects.active = target
        data, action = target.animation_data, target.animation_data.action
        data.action = None
        data.nla_tracks.new().strips.new("body", -5, action)
    before = shown_arms(target, every)
    put(target, hands, into=into, arms_influence=0.0)
    np.testing.assert_allclose(shown_arms(target, every), before, atol=1e-5)
    put(target, hands, into=into, arms_ease=4.0)
    after = shown_arms(target, every)
    away = np.abs(after - before).max(axis=(1, 2, 3))
    assert away[[0, 1, 2, 7, 8, 9, 10]].max() < 1e-4  # the first and last frame of the take included
    assert away[3:7].min() > 0.01
    check_as_captured(target, hands, frames=(8, 13), carried_by="mixamorig:Chest")
    put(target, hands, into=into, arms_ease=4.0)
    np.testing.assert_allclose(shown_arms(target, every), after, atol=1e-4)
    data = target.animation_data
    data.action = None
    for track in [track for track in data.nla_tracks if any("hands" in s.action.name for s in track.strips)]:
        data.nla_tracks.remove(track)
    np.testing.assert_allclose(shown_arms(target, every), before, atol=1e-5)


def test_half_of_an_arm_lies_between_and_stays_so_when_it_is_applied_again(hands):
    target = character("vrm")
    rest = shown_arms(target, FRAMES)
    put(target, hands)
    whole = shown_arms(target, FRAMES)
    target = character("vrm")
    put(target, hands, arms_influence=0.5)
    half = shown_arms(target, FRAMES)
    assert 0.02 < np.abs(half - rest).max() < 0.9 * np.abs(whole - rest).max()
    put(target, hands, arms_influence=0.5)
    np.testing.assert_allclose(shown_arms(target, FRAMES), half, atol=1e-5)


def test_a_mirrored_hand_brings_its_arm(hands):
    target, (left, _) = character("mixamo"), hands
    tables = [(hand_map_of(target, "right"), left)]
    run_to_completion(putting(target, tables, TransferOptions(contacts=False, arms=True)))
    for frame in FRAMES:
        ours = segments(joints(target, names_of(target, "right"), frame))
        np.testing.assert_allclose(ours, captured_segments(left, frame) * [-1.0, 1.0, 1.0], atol=1e-4)


def test_what_has_no_arm_or_an_arm_that_is_held_gets_its_fingers_alone(hands):
    done = put(target := character("mixamo", arms=False), hands)
    assert [one.left_alone[0].partition(" of ")[0] for one in done] == [f"the {side} hand" for side in SIDES]
    assert "hangs on no upper arm and forearm" in done[0].left_alone[0]
    assert len(keyed_bones(target)) == 30
    target = character("mixamo")
    target.pose.bones["mixamorig:LeftForeArm"].constraints.new("COPY_ROTATION").target = target
    done = put(target, hands)
    assert "constraint Copy Rotation: that arm was left alone" in done[0].left_alone[0]
    assert done[1].left_alone == ()
    assert keyed_bones(target) & {"mixamorig:LeftArm", "mixamorig:RightArm"} == {"mixamorig:RightArm"}


def skin(armature):
    """A trunk of the chest's, 0.3 m wide and 0.2 m deep."""
    mesh = bpy.data.meshes.new("Skin")
    rng = np.random.default_rng(0)
    points = rng.uniform(-1.0, 1.0, (400, 3)) * [0.15, 0.1, 0.2] + [0.0, 0.02, 1.3]
    mesh.from_pydata(points.tolist(), [], [])
    obj = bpy.data.objects.new("Skin", mesh)
    bpy.context.collection.objects.link(obj)
    obj.vertex_groups.new(name="mixamorig:Chest").add(range(400), 1.0, "REPLACE")
    obj.modifiers.new("Armature", "ARMATURE").object = armature
    return obj


def from_the_trunk(armature):
    """metres of the wrists, on every frame, from the skin's middle"""
    wrists = shown_arms(armature, FRAMES)[:, :, 2]
    aside = np.clip(wrists[..., 0], -0.05, 0.05)
    return np.hypot(wrists[..., 0] - aside, wrists[..., 1] - 0.02)


def test_hands_are_kept_outside_the_chest(make_take):
    take = with_arms(make_take().take, towards=(1.0, 0.1, 0.4))
    hands = [hand_of(one.armature) for one in build_take(take).hands]
    depths = {}
    for outside in (False, True):
        target = character("mixamo")
        skin(target)
        put(target, hands, arms_outside=outside)
        depths[outside] = from_the_trunk(target)
        lengths = np.linalg.norm(np.diff(shown_arms(target, FRAMES), axis=2), axis=-1)
        np.testing.assert_allclose(lengths, lengths[0, 0] + np.zeros_like(lengths), atol=1e-5)
    assert depths[False].min() < 0.07
    assert depths[True].min() > 0.09


def test_the_panel_has_arms_where_the_capture_does(make_take, hands):
    target = chosen(character("mixamo"))
    assert "arms" in drawn(MANIENT_PT_character).rows
    assert "arms_ease" not in drawn(MANIENT_PT_character).rows
    target.manient.character.arms = True
    assert {"arms_influence", "arms_ease"} <= {*drawn(MANIENT_PT_character).rows}
    assert "wrist" not in drawn(MANIENT_PT_character).rows
    assert "arms_outside" not in drawn(MANIENT_PT_character).rows
    skin(target)
    assert "arms_outside" in drawn(MANIENT_PT_character).rows
    assert bpy.ops.manient.apply_to_character() == {"FINISHED"}
    assert {"mixamorig:LeftArm", "mixamorig:RightHand"} <= keyed_bones(target)
    plain = build_take(make_take().take).hands
    for hand in plain:
        own = hand_of(hand.armature)
        getattr(target.manient.character, own.side).source = hand.armature
    assert "arms" not in drawn(MANIENT_PT_character).rows


def test_the_live_link_keys_arms(hands):
    target = character("mixamo")
    target.manient.character.arms = True
    target.manient.character.live = True
    settle()
    assert live_link.trouble(target) is None
    check_as_captured(target, hands)


@pytest.mark.parametrize("arms", [True, pytest.param(False, marks=pytest.mark.slow)])
def test_a_batch_puts_arms_on_characters_where_it_is_asked(make_take, tmp_path, arms):
    take = with_arms(make_take().take, towards=(1.0, 0.1, 0.4))
    clip, hero = take.save(tmp_path / "clip.take.npz"), tmp_path / "hero.blend"
    skin(character("mixamo"))
    bpy.ops.wm.save_as_mainfile(filepath=str(hero))
    out = tmp_path / "out"
    said = ["--arms", "--outside"] if arms else []
    given = ["apply", clip, "--to", hero, *said, "-o", out, "--format", "blend"]
    assert command.main([*map(str, given)]) == 0
    bpy.ops.wm.open_mainfile(filepath=str(out / "clip" / "clip.blend"))
    target = bpy.data.objects["Character"]
    assert ("mixamorig:LeftArm" in keyed_bones(target)) == arms
    if arms:
        assert from_the_trunk(target).min() > 0.09
