"""Captured arms on characters' arms, judged by evaluated bones."""

from __future__ import annotations

from dataclasses import replace

import bpy
import numpy as np
import pytest

from blender_manient.rigs.captured_hand import bone_names
from blender_manient.scene.build import build_take
from blender_manient.scene.characters import hand_map_of
from blender_manient.scene.onto_character import TransferOptions, putting
from blender_manient.scene.store import hand_of
from handfit_core.hand_model.arm import ArmMotion
from handfit_core.skeleton import SIDES
from handfit_core.slices import run_to_completion

from .characters import BoneSpec, build_armature, hand_specs, mixamo_names, placed
from .conftest import world
from .looking import bones_at, palm

pytestmark = pytest.mark.usefixtures("registered")

RIGS = {"mixamo": ("LeftArm", "LeftForeArm"), "vrm": ("leftUpperArm", "leftLowerArm")}
FRAMES = (3, 5, 8, 17)
"""Of takes, whose first is 3 and whose last is 18"""


def vrm_names(side):
    """As mixamo_names."""
    parts = ("Proximal", "Intermediate", "Distal")
    thumb = ("Metacarpal", "Proximal", "Distal")
    names = {0: f"{side}Hand"}
    for finger, joints in zip(
        ("Index", "Middle", "Little", "Ring", "Thumb"),
        ((1, 2, 3), (4, 5, 6), (7, 8, 9), (10, 11, 12), (13, 14, 15)),
        strict=True,
    ):
        own = thumb if finger == "Thumb" else parts
        names |= {joint: f"{side}{finger}{part}" for joint, part in zip(joints, own, strict=True)}
    return names


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
        names = mixamo_names(side) if kind == "mixamo" else vrm_names(side)
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


def check_as_captured(armature, hands, within=1e-4, space=np.eye(3)):
    for hand in hands:
        hand_map = hand_map_of(armature, hand.side)
        for frame in FRAMES:
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
    assert all(one.left_alone == () for one in done)
    check_as_captured(target, hands)


@pytest.mark.parametrize("mode", ["fk", "ik", "pole"])
def test_arms_of_rigify_point_as_captured_by_what_acts(generated, make_take, mode):
    bpy.ops.wm.open_mainfile(filepath=str(generated))
    rig = bpy.data.objects["rig"]
    hands = [hand_of(one.armature) for one in build_take(with_arms(make_take().take)).hands]
    rig.pose.bones["f_index.01_ik.L"]["FK_IK"] = 0.0
    for end in "LR":
        parent = rig.pose.bones[f"upper_arm_parent.{end}"]
        parent["IK_FK"], parent["pole_vector"] = float(mode == "fk"), mode == "pole"
    rig.update_tag()
    put(rig, hands)
    print("ELBOW", [np.abs(segments(joints(rig, names_of(rig, h.side), f)) - captured_segments(h, f)).max() for h in hands for f in FRAMES])
    check_as_captured(rig, hands, within=1e-4 if mode == "fk" else 0.02)
