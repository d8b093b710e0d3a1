"""Captured fingers on a character that moves already by another tool: found in its time, its own keys as they
were."""

from __future__ import annotations

import json
from dataclasses import replace

import bpy
import numpy as np
import pytest

from blender_manient import command
from blender_manient.panels.character import MANIENT_PT_character
from blender_manient.rigs.captured_hand import bone_names
from blender_manient.scene.build import build_take
from blender_manient.scene.moving_body import moving_range
from blender_manient.scene.onto_character import motion_of
from blender_manient.scene.store import hand_of
from handfit_core.geometry.rotations import rotvec_to_rotmat
from handfit_core.media.source import Source
from handfit_core.take.take import at_rows
from tests.drawn import drawn

from .characters import BoneSpec, build_armature, hand_specs, mixamo_names
from .looking import angles, bones_at, chosen, directions, directions_apart, keyed_bones

NAMES = mixamo_names("right")
AS_BLEND = ("--format", "blend", "--no-contacts")
COUNT, START = 260, 90
"""frames of the filmed movement, and of them before the capture begins"""


def wandering(rng, frames: float) -> np.ndarray:
    """(COUNT, 3) noise that changes within so many frames."""
    knots = np.arange(-frames, COUNT + 2 * frames, frames)
    weights = np.exp(-0.5 * ((np.arange(COUNT)[:, None] - knots) / (0.6 * frames)) ** 2)
    return weights @ rng.normal(size=(len(knots), 3))


@pytest.fixture
def movement(make_take):
    """The whole movement at 30 frames per second, as if all of it had been captured."""
    take, rng = (
        make_take(sides=("right",), frame_numbers=np.arange(1, COUNT + 1)).take,
        np.random.default_rng(4),
    )
    there = take.hands[0].present[:, None]
    turned, placed = 0.5 * wandering(rng, 12.0), 0.1 * wandering(rng, 14.0) + [0.0, 0.0, 0.6]
    track = replace(
        take.hands[0],
        global_orient=np.where(there, turned, np.nan),
        transl=np.where(there, placed, np.nan),
    )
    return replace(take, hands=(track,))


def captured(movement, count: int = 130):
    """A part of the movement, which begins at frame 1 as every clip does."""
    track = at_rows(movement.hands[0], np.arange(START, START + count))
    return replace(movement, frame_numbers=np.arange(1, count + 1), hands=(track,))


def body(movement, rate: float = 30.0, *, fingers: bool = True):
    """A character that another tool has moved, at a scene's rate: its hips go and its hand turns as filmed,
    seen from elsewhere."""
    specs = [
        BoneSpec("mixamorig:Hips", "", (0, 0, 0), (0, 0, 1)),
        BoneSpec("mixamorig:RightArm", "mixamorig:Hips", (-0.2, 0, 1), (-0.6, 0, 1)),
        BoneSpec("mixamorig:RightForeArm", "mixamorig:RightArm", (-0.6, 0, 1), (-1, 0, 1)),
    ]
    rng = np.random.default_rng(3)
    place = np.array([-1.0, 0.0, 1.0])
    specs += hand_specs("right", rng, names=NAMES, parent="mixamorig:RightForeArm", place=place)
    armature = build_armature(specs, "Body")
    motion = motion_of(movement, movement.hands[0])
    camera = rotvec_to_rotmat(np.array([0.3, -1.1, 0.7]))
    hips, hand, finger = (armature.pose.bones[name] for name in ("mixamorig:Hips", NAMES[0], NAMES[2]))
    hand.rotation_mode = "XYZ"
    rests = [np.array(bone.bone.matrix_local.to_3x3()) for bone in (hips, hand)]
    euler = None
    for frame in range(1, int((COUNT - 1) * rate / 30.0) + 2):
        row = (frame - 1) * 30.0 / rate
        before, part = int(row), row % 1.0
        after = min(before + 1, COUNT - 1)
        turn, way = (
            (1 - part) * each[before] + part * each[after] for each in (motion.turns[:, 0], motion.places)
        )
        left, _, right = np.linalg.svd(camera @ turn)
        hips.location = rests[0].T @ camera @ way
        basis = rests[1].T @ left @ right @ rests[1]
        euler = _matrix(basis).to_euler("XYZ", euler) if euler else _matrix(basis).to_euler("XYZ")
        hand.rotation_euler = euler
        hips.keyframe_insert("location", frame=frame)
        hand.keyframe_insert("rotation_euler", frame=frame)
        if fingers:
            finger.rotation_quaternion = (0.8, 0.6, 0.0, 0.0)
            finger.keyframe_insert("rotation_quaternion", frame=frame)
    return armature


def _matrix(rows: np.ndarray):
    return bpy.data.armatures[0].bones[0].matrix.__class__(rows.tolist())


def of_body(armature, frames) -> np.ndarray:
    """Where all bones but the fingers stand."""
    names = ["mixamorig:Hips", "mixamorig:RightForeArm", NAMES[0]]
    return np.array([[np.array(bones_at(armature, f)[name].matrix) for name in names] for f in frames])


def fingers_off(armature, hand, frame: int, captured_frame: int) -> float:
    """How far fingers are from where the captured ones point, in degrees."""
    theirs = directions(armature, [NAMES[joint] for joint in range(16)], frame)
    return directions_apart(theirs, directions(hand.armature, bone_names("right"), captured_frame))


def pressed(operator, match: str | None = None):
    if match is None:
        assert operator() == {"FINISHED"}
        return
    before = len(bpy.data.actions)
    with pytest.raises(RuntimeError, match=match):
        operator()
    assert len(bpy.data.actions) == before


@pytest.mark.usefixtures("registered")
@pytest.mark.parametrize("into", ["NEW", "STRIP", "ACTION"])
def test_fingers_come_onto_a_body_in_its_own_time(movement, into):
    armature = body(movement, fingers=into != "STRIP")
    hand = hand_of(build_take(captured(movement)).hands[0].armature)
    character = chosen(armature).manient.character
    character.contacts, character.into = False, into
    assert moving_range(armature) == (1.0, COUNT)
    frames = (-5, 1, 40.5, START + 1, START + 77, COUNT, COUNT + 20)
    before = of_body(armature, frames)
    pressed(bpy.ops.manient.find_offset)
    assert character.time_offset == START
    assert "time_offset" in drawn(MANIENT_PT_character).said
    pressed(bpy.ops.manient.apply_to_character)
    np.testing.assert_allclose(of_body(armature, frames), before, atol=1e-6)
    for frame in (3, 50, 130):
        assert fingers_off(armature, hand, frame + START, frame) < 0.1
    if into != "ACTION":
        user = armature.animation_data
        action = user.action if into == "NEW" else user.nla_tracks[-1].strips[0].action
        assert tuple(action.curve_frame_range) == (START + 1, START + 130)
    assert moving_range(armature) == (1.0, COUNT)


@pytest.mark.usefixtures("registered")
@pytest.mark.parametrize("kind", ["fbx", "bvh"])
def test_a_body_of_another_program(movement, tmp_path, kind):
    """As a file of it is imported, with its own axes, size, rotation modes and unit."""
    chosen(body(movement))
    bpy.context.scene.render.fps, bpy.context.scene.frame_end = 30, COUNT
    path = str(tmp_path / f"body.{kind}")
    if kind == "fbx":
        bpy.ops.export_scene.fbx(filepath=path, object_types={"ARMATURE"}, bake_anim_simplify_factor=0.0)
    else:
        bpy.ops.export_anim.bvh(filepath=path, frame_start=1, frame_end=COUNT)
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    bpy.context.scene.render.fps = 30
    (bpy.ops.import_scene.fbx if kind == "fbx" else bpy.ops.import_anim.bvh)(filepath=path)
    (armature,) = (one for one in bpy.data.objects if one.type == "ARMATURE")
    hand = hand_of(build_take(captured(movement)).hands[0].armature)
    chosen(armature).manient.character.contacts = False
    before = of_body(armature, range(1, COUNT, 9))
    pressed(bpy.ops.manient.find_offset)
    offset = armature.manient.character.time_offset
    assert abs(offset - START) <= 1
    pressed(bpy.ops.manient.apply_to_character)
    np.testing.assert_allclose(
        of_body(armature, range(1, COUNT, 9)), before, atol=1e-5 * np.abs(before).max()
    )
    assert fingers_off(armature, hand, 50 + offset, 50) < 0.1


@pytest.mark.usefixtures("registered")
def test_hands_that_were_moved_too_keep_their_time_when_they_are_adjusted(movement):
    """Another offset counts from the next Apply on."""
    from blender_manient.scene.characters import hands_to_move
    from blender_manient.scene.onto_character import adjusting
    from handfit_core.common.slices import run_to_completion

    armature = body(movement)
    build_take(captured(movement))
    character = chosen(armature).manient.character
    character.contacts, character.wrist, character.time_offset = False, "TURNED", 20
    character.reference = 30
    pressed(bpy.ops.manient.apply_to_character)
    before = of_body(armature, (21, 60, 150))
    character.time_offset = 50
    run_to_completion(adjusting(armature, hands_to_move(armature, bpy.context)))
    np.testing.assert_allclose(of_body(armature, (21, 60, 150)), before, atol=1e-5)


@pytest.mark.usefixtures("registered")
def test_offsets_that_cannot_be_are_refused(movement):
    armature = body(movement)
    build_take(captured(movement))
    character = chosen(armature).manient.character
    apply, find = bpy.ops.manient.apply_to_character, bpy.ops.manient.find_offset
    for offset, why in ((1_000_000_000, "timeline ends at"), (5000, "moves in 1 to 260: choose another")):
        character.time_offset = offset
        pressed(apply, f"with an offset of {offset} frames the hands would move in frames .* {why}")
    character.time_offset = 0
    armature.pose.bones[NAMES[0]].scale = (0.0, 0.0, 0.0)
    pressed(find, "is nowhere in some frames")
    armature.pose.bones[NAMES[0]].scale = (1.0, 1.0, 1.0)
    armature.animation_data_clear()
    pressed(find, "the character's hand does not move")
    assert moving_range(armature) is None
    assert character.time_offset == 0


@pytest.mark.usefixtures("registered")
def test_another_movement_is_told_from_the_same(movement):
    armature = body(movement)
    rng = np.random.default_rng(99)
    track = replace(
        movement.hands[0], global_orient=0.5 * wandering(rng, 12.0), transl=0.1 * wandering(rng, 14.0)
    )
    build_take(captured(replace(movement, hands=(track,))))
    chosen(armature)
    pressed(bpy.ops.manient.find_offset, "no offset was found .* as that of 'Body': type it")


@pytest.mark.parametrize(("said", "rate"), [("auto", 24.0), ("auto", 30.0), ("72", 24.0)])
def test_batches_leave_a_body_in_its_time(movement, tmp_path, said, rate):
    """Neither its scene's rate nor its range changes, also where the clip has another rate."""
    scene = bpy.context.scene
    scene.render.fps, scene.render.fps_base = int(rate), 1.0
    scene.frame_start, scene.frame_end = 1, 230
    armature = body(movement, rate)
    frames, start = range(-5, 240, 7), int(START * rate / 30.0)
    before = of_body(armature, frames)
    path, clip = str(tmp_path / "body.blend"), tmp_path / "clip.take.npz"
    replace(captured(movement), source=Source("data", ("a clip",))).save(clip)
    bpy.ops.wm.save_as_mainfile(filepath=path)
    words = ["apply", str(clip), "--to", path, "-o", str(tmp_path / "out"), *AS_BLEND]
    assert command.main([*words, "--time-offset", said]) == 0
    (entry,) = json.loads((tmp_path / "out" / "report.json").read_text())["inputs"]
    if said == "auto":
        assert abs(entry["character"]["offset"]["frames"] - start) <= 1
        assert entry["character"]["offset"]["sure"] > 0.5
        start = entry["character"]["offset"]["frames"]
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "out" / "clip" / "clip.blend"))
    armature, scene = bpy.data.objects["Body"], bpy.context.scene
    assert (scene.render.fps, scene.frame_start, scene.frame_end) == (rate, 1, 230)
    np.testing.assert_allclose(of_body(armature, frames), before, atol=1e-6)
    assert keyed_bones(armature) == {NAMES[joint] for joint in range(1, 16)}
    hand = hand_of(build_take(captured(movement)).hands[0].armature) if rate == 30.0 else None
    if hand is not None:
        assert fingers_off(armature, hand, start + 50, 50) < 0.1
    first, last = armature.animation_data.action.curve_frame_range
    assert (first, last - first) == (start + 1, int(129 * rate / 30.0))


def test_batches_find_the_offset_in_a_file_of_another_program(movement, tmp_path):
    """Its whole movement comes out again, with the fingers in their time."""
    armature = chosen(body(movement))
    bpy.context.scene.render.fps, bpy.context.scene.frame_end = 30, COUNT
    path, clip = str(tmp_path / "body.fbx"), tmp_path / "clip.take.npz"
    replace(captured(movement), source=Source("data", ("a clip",))).save(clip)
    bpy.ops.export_scene.fbx(filepath=path, object_types={"ARMATURE"}, bake_anim_simplify_factor=0.0)
    before = [np.array(bones_at(armature, f)[NAMES[0]].matrix.to_quaternion()) for f in (1, 100, COUNT)]
    words = ["apply", str(clip), "--to", path, "-o", str(tmp_path / "out"), *AS_BLEND]
    assert command.main([*words, "--time-offset", "auto"]) == 0
    (entry,) = json.loads((tmp_path / "out" / "report.json").read_text())["inputs"]
    offset = entry["character"]["offset"]["frames"]
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "out" / "clip" / "clip.blend"))
    scene = bpy.context.scene
    (armature,) = (one for one in bpy.data.objects if one.type == "ARMATURE")
    first = scene.frame_start
    assert abs(offset + 1 - first - START) <= 1
    assert scene.frame_end - first == COUNT - 1
    assert (scene.render.fps, keyed_bones(armature)) == (30, {NAMES[joint] for joint in range(1, 16)})
    after = [
        np.array(bones_at(armature, first + f - 1)[NAMES[0]].matrix.to_quaternion()) for f in (1, 100, COUNT)
    ]
    for number in (1, 2):  # the file has other axes
        wanted, found = (float(angles(turns[0], turns[number])) for turns in (before, after))
        assert found == pytest.approx(wanted, abs=0.05)


@pytest.mark.parametrize(
    ("offset", "why"),
    [("2000000", "timeline ends at"), ("900", "moves in 1 to 260"), ("soon", "a number of frames")],
)
def test_batches_refuse_offsets_that_cannot_be(movement, tmp_path, capfd, offset, why):
    body(movement)
    path, clip = str(tmp_path / "body.blend"), captured(movement).save(tmp_path / "clip.take.npz")
    bpy.ops.wm.save_as_mainfile(filepath=path)
    words = ["apply", str(clip), "--to", path, "-o", str(tmp_path / "out"), "--format", "blend"]
    assert command.main([*words, "--time-offset", offset]) in (1, 2)
    output = capfd.readouterr()
    assert why in output.out + output.err
    assert not (tmp_path / "out" / "clip" / "clip.blend").exists()
