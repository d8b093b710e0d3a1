"""Hands of characters as other programs build them: found, posed, judged by where evaluated bones point."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import bpy
import numpy as np
import pytest

from blender_manient.panels.character import MANIENT_PT_character, MANIENT_PT_character_bones
from blender_manient.rigs import found_hand, troubles
from blender_manient.rigs.captured_hand import bone_names
from blender_manient.rigs.character import bones_of
from blender_manient.rigs.vrm import VrmCharacter
from blender_manient.scene.build import build_take
from blender_manient.scene.characters import keep_map, sure_map_of, table_of, without_keys
from blender_manient.scene.onto_character import TransferOptions, putting, shortcomings
from blender_manient.scene.store import captured_hands, hand_of
from handfit_core.common.errors import HandModelError
from handfit_core.common.skeleton import FINGER_JOINTS, NUM_JOINTS, SIDES
from handfit_core.common.slices import run_to_completion
from handfit_core.retarget.hand_map import HandMap
from handfit_core.retarget.recognition import UNKNOWN
from handfit_core.retarget.transfer import SourceHand, target_hand
from tests.core.retarget.rigs import OTHERS, Built, add_hand, body, names_of
from tests.drawn import drawn

from .characters import BoneSpec, build_armature
from .looking import angles, bones_at, directions, directions_apart, keyed_bones


@pytest.fixture
def check(registered, make_take):
    """check(armature, side, label) -> the table of its hand, whose fingers follow a captured one."""

    def follows(armature, side, label: str, sure: float = 0.9) -> HandMap:
        found = found_hand(armature, side)
        assert found.hand_map.rig == label
        assert found.sure > sure
        assert troubles(armature, found.hand_map) == []
        hand = hand_of(build_take(make_take(sides=(side,)).take).hands[0].armature)
        onto = TransferOptions(contacts=False)
        run_to_completion(putting(armature, [(found.hand_map, hand)], onto))
        for frame in (3, 8):
            theirs = directions(armature, found.hand_map.bones, frame)
            assert directions_apart(theirs, directions(hand.armature, bone_names(side), frame)) < 0.1
        return found.hand_map

    return follows


def opened(path: Path, name: str) -> bpy.types.Object:
    bpy.ops.wm.open_mainfile(filepath=str(path))
    return bpy.data.objects[name]


@pytest.mark.parametrize("side", SIDES)
def test_rigify_generated(check, generated, side):
    rig = opened(generated, "rig")
    hand = check(rig, side, "Rigify", sure=0.99)
    end = side[0].upper()
    assert hand.bones[1:4] == (f"f_index.01.{end}", f"f_index.02.{end}", f"f_index.03.{end}")
    assert hand.control == f"hand_ik.{end}"
    assert UNKNOWN not in without_keys(rig, hand)
    rig.pose.bones[f"upper_arm_parent.{end}"]["IK_FK"] = 1.0
    assert found_hand(rig, side).hand_map.control == f"hand_fk.{end}"
    # The skin follows what deforms: it is to point as the controls do.
    rig.update_tag()
    shown = bones_at(rig, 8)
    for name in hand.bones[1:]:
        turned = np.array((shown[name].matrix.inverted() @ shown[f"DEF-{name}"].matrix).to_3x3())
        bones = rig.data.bones
        rest = np.array((bones[name].matrix_local.inverted() @ bones[f"DEF-{name}"].matrix_local).to_3x3())
        assert np.degrees(np.arccos((turned.T @ rest)[1, 1].clip(-1.0, 1.0))) < 0.2, name


def test_rigify_tells_what_would_spoil_the_fingers(generated):
    rig = opened(generated, "rig")
    hand = found_hand(rig, "left").hand_map
    assert troubles(rig, hand) == []
    pose, arm = rig.pose.bones, rig.pose.bones["upper_arm_parent.L"]
    master = pose["f_ring.01_master.L"]
    for frame, scale in ((1, 1.0), (5, 1.0)):  # keys at rest do no harm, as those of a whole character
        master.scale.y = scale
        master.keyframe_insert("scale", frame=frame)
    assert troubles(rig, hand) == []
    master.scale.y = 0.5
    assert [said.partition(" would")[0] for said in troubles(rig, hand)] == [master.name]
    master.keyframe_insert("scale", frame=9)
    master.scale.y = 1.0
    assert [said.partition(" would")[0] for said in troubles(rig, hand)] == [master.name]
    data, action = rig.animation_data, rig.animation_data.action
    data.action, track = None, data.nla_tracks.new()
    strip = track.strips.new("bent", 1, action)
    assert len(troubles(rig, hand)) == 1
    for muted in (strip, track):
        muted.mute = True
        assert troubles(rig, hand) == []
        muted.mute = False
    rig.animation_data_clear()
    pose["f_index.01_ik.L"]["FK_IK"] = 1.0
    assert troubles(rig, hand)[0].startswith("fingers follow IK by f_index.01_ik.L: set Finger IK")
    pose["f_index.01_ik.L"]["FK_IK"] = 0.0
    for value, said in (
        (0.5, "changes between IK and FK"),
        (1.0, "choose hand_fk.L in the table, or set it to 0"),
    ):
        arm["IK_FK"] = value
        assert [said in sentence for sentence in troubles(rig, hand)] == [True]


def test_a_switch_of_rigify_is_said_and_refused_before_anything_is_changed(generated, registered, make_take):
    rig = opened(generated, "rig")
    build_take(make_take(sides=("left",)).take)
    bpy.context.view_layer.objects.active = rig
    before = set(bpy.data.actions)
    chain = rig.pose.bones["f_index.01_ik.L"]
    chain["FK_IK"] = 1.0
    assert "Fingers follow IK by f_index.01_ik.L" in drawn(MANIENT_PT_character).said
    with pytest.raises(RuntimeError, match="fingers follow IK"):
        bpy.ops.manient.apply_to_character()
    assert set(bpy.data.actions) == before
    chain["FK_IK"] = 0.0
    # The control is recognised anew, though no bone has changed.
    character = rig.manient.character
    character.wrist, character.reference = "TURNED", 3
    rig.pose.bones["upper_arm_parent.L"]["IK_FK"] = 1.0
    assert "Fingers follow" not in drawn(MANIENT_PT_character).said
    assert "does not move the hand" not in drawn(MANIENT_PT_character).said
    assert bpy.ops.manient.apply_to_character() == {"FINISHED"}
    assert {"hand_fk.L", "f_index.01.L"} <= keyed_bones(rig)


@pytest.mark.parametrize("by_fk", [0.0, 1.0])
def test_the_hand_of_rigify_moves_as_captured(registered, make_take, generated, by_fk):
    """By the control that acts. How far it turns and goes does not depend on how spaces are laid over."""
    rig = opened(generated, "rig")
    rig.pose.bones["upper_arm_parent.L"]["IK_FK"] = by_fk
    hand = hand_of(build_take(make_take(sides=("left",)).take).hands[0].armature)
    hand_map = found_hand(rig, "left").hand_map
    onto = TransferOptions(wrist="TURNED" if by_fk else "PLACED", reference=3.0, contacts=False)
    run_to_completion(putting(rig, [(hand_map, hand)], onto))
    scale = target_hand(bones_of(rig), hand_map, SourceHand.of(hand.shaped(), "left")).scale
    wrists = ((rig, "DEF-hand.L"), (hand.armature, bone_names("left")[0]))
    first: list = []
    for frame in (3, 5, 8):
        now = [np.array(bones_at(armature, frame)[name].matrix) for armature, name in wrists]
        first = first or now
        turned = [angles(then[:3, :3], at[:3, :3]) for then, at in zip(first, now, strict=True)]
        assert turned[0] == pytest.approx(turned[1], abs=0.05)
        gone = [np.linalg.norm(at[:3, 3] - then[:3, 3]) for then, at in zip(first, now, strict=True)]
        assert by_fk or gone[0] == pytest.approx(scale * gone[1], abs=1e-3)
    assert turned[1] > 18.0  # else it would show nothing


def test_bones_of_rigify_without_controls(check, generated):
    """The metarig, and what game exports leave: the deforming bones alone."""
    hand = check(opened(generated, "metarig"), "right", "Rigify bones")
    assert hand.palm == ("palm.01.R", "palm.02.R", "palm.03.R", "palm.04.R")
    rig = opened(generated, "rig")
    bpy.context.view_layer.objects.active = rig
    bpy.ops.object.mode_set(mode="EDIT")
    edit = rig.data.edit_bones
    for bone in [bone for bone in edit if bone.name.startswith("DEF-")]:
        above = bone.parent
        while above is not None and not above.name.startswith("DEF-"):
            above = edit.get(f"DEF-{above.name.removeprefix('ORG-')}") or above.parent
        bone.parent = above
    for name in [bone.name for bone in edit if not bone.name.startswith("DEF-")]:
        edit.remove(edit[name])
    bpy.ops.object.mode_set(mode="OBJECT")
    for bone in rig.pose.bones:
        bone.lock_rotation, bone.lock_rotation_w = (False, False, False), False
        for constraint in list(bone.constraints):
            bone.constraints.remove(constraint)
    assert check(rig, "left", "Rigify bones").bones[1] == "DEF-f_index.01.L"


@pytest.mark.parametrize("version", ["1.0", "0.0"])
def test_what_the_vrm_addon_has_noted_is_believed(version):
    """Properties of the shape that the add-on has, whatever the bones are called."""
    others, thumb = ("proximal", "intermediate", "distal"), ("metacarpal", "proximal", "distal")
    names, parts = {slot: f"q{slot}" for slot in range(NUM_JOINTS)}, {"hand": "q0"}
    for finger, joints in FINGER_JOINTS.items():
        own = thumb if finger == "thumb" and version == "1.0" else others
        parts |= {f"{finger}_{part}": names[joint] for part, joint in zip(own, joints, strict=True)}

    def called(part: str) -> str:
        return f"left_{part}" if version == "1.0" else "left" + part.title().replace("_", "")

    nodes = {called(part): SimpleNamespace(bone_name=name) for part, name in parts.items()}
    older = [SimpleNamespace(bone=bone, node=node) for bone, node in nodes.items()]
    newer = SimpleNamespace(**{bone: SimpleNamespace(node=node) for bone, node in nodes.items()})
    vrm0, vrm1 = (SimpleNamespace(humanoid=SimpleNamespace(human_bones=each)) for each in (older, newer))
    noted = SimpleNamespace(spec_version=version, vrm0=vrm0, vrm1=vrm1)
    built = Built()
    fore, place = body(built, "left")
    add_hand(built, "left", names, np.random.default_rng(1), parent=fore, place=place)
    armature: Any = SimpleNamespace(data=SimpleNamespace(vrm_addon_extension=noted))
    found = VrmCharacter.find(armature, built.bones(), "left")
    assert (found.hand_map.bones, found.hand_map.rig, found.sure) == (tuple(names.values()), "VRM", 1.0)
    nodes[called("hand")].bone_name = ""
    assert VrmCharacter.find(armature, built.bones(), "left") is None


def built_armature(built: Built) -> bpy.types.Object:
    specs = []
    for name, parent, head in zip(built.names, built.parents, built.heads, strict=True):
        specs.append(
            BoneSpec(name, built.names[parent] if parent >= 0 else "", head, head + [0.0, 0.0, 0.01])
        )
    return build_armature(specs)


def test_bones_without_keys_are_named(registered, make_take):
    """What is no finger's wherever keys are written, metacarpals and tips in the table."""
    maya = next(rig for rig in OTHERS if rig.palm == "{}_01_L")
    built = Built()
    fore, place = body(built, "left")
    add_hand(
        built, "left", names_of(maya, "left"), np.random.default_rng(1), parent=fore, place=place, tips=True
    )
    hand = built.names.index("Wrist_L")
    blade = built.add("weapon", hand, place - [0.0, 0.1, 0.0])
    built.add("weapon_blade", blade, place - [0.0, 0.4, 0.0])
    armature = built_armature(built)
    build_take(make_take(sides=("left",)).take)
    bpy.context.view_layer.objects.active = armature
    said = "No keys for 2 bones not known as a finger's (weapon, weapon_blade)"
    assert said in drawn(MANIENT_PT_character).said
    bpy.context.scene.manient.hand_table.side = "left"
    told = drawn(MANIENT_PT_character_bones).said
    assert "4 bones between hand and fingers (Index_01_L, Middle_01_L, Ring_01_L, ...)" in told
    assert "5 bones at the tips" in told
    found = found_hand(armature, "left").hand_map
    hand = hand_of(next(iter(captured_hands(bpy.context.scene))))
    applied = run_to_completion(putting(armature, [(found, hand)], TransferOptions(contacts=False)))
    assert [said.lower() in sentence.lower() for sentence in shortcomings(applied)] == [True]


def test_what_may_be_no_hand_is_asked_for(registered):
    """The end of a tail in five tips, say: an artist is asked, and a batch refuses."""
    built = Built()
    for part in range(4):
        built.add(f"t{part}", part - 1, np.array([0.0, 0.2 * part, 1.0]))
    for end in range(5):
        at, last = 2.0 * np.pi * end / 5.0, 3
        for part in range(3):
            out = 0.1 * (part + 1) * np.array([np.cos(at), 0.0, np.sin(at)])
            last = built.add(f"e{end}{part}", last, out + [0.0, 0.7 + 0.03 * part, 1.0])
    armature = built_armature(built)
    bpy.context.view_layer.objects.active = armature
    assert "This may be no hand" in drawn(MANIENT_PT_character).said
    (side,) = (side for side in SIDES if table_of(armature, side).mapped)
    with pytest.raises(HandModelError, match=r"may be no (left|right) hand: name its bones"):
        sure_map_of(armature, side)
    keep_map(armature, table_of(armature, side))
    assert sure_map_of(armature, side).mapped
