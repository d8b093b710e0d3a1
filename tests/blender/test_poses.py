"""Poses put on captured hands and on characters, and kept as assets for both."""

from __future__ import annotations

import bpy
import numpy as np
import pytest

from blender_manient.panels.poses import MANIENT_PT_poses
from blender_manient.rigs import rig_of
from blender_manient.rigs.captured_hand import bone_names
from blender_manient.scene import corrections
from blender_manient.scene.build import build_take
from blender_manient.scene.characters import keep_map
from blender_manient.scene.keys import PoseKeys, displayed_pose, pose_at, read_pose_keys, remove_pose_keys
from blender_manient.scene.poses import PROPERTY, kept_pose, posable_hands, pose_items
from handfit_core.common.skeleton import FINGER_JOINTS, SIDES, other_side
from handfit_core.edit.corrections import correction_between
from handfit_core.geometry.rotations import quat_to_rotmat, rotvec_to_rotmat
from handfit_core.hand_model import axes, load_model
from handfit_core.hand_model.poses import Pose, ready_poses
from tests.drawn import drawn

from .characters import BoneSpec, build_armature, hand_specs, joint_name, map_of, one_handed, placed
from .conftest import action_curves
from .looking import angles, apart, curves_of, directions_apart, keyed_bones, select_bones
from .test_keys import contents

pytestmark = pytest.mark.usefixtures("registered")

REST = np.tile(np.eye(3), (15, 1, 1))


@pytest.fixture(params=[pytest.param("right open-hand", marks=pytest.mark.slow), "left imitation-mano"])
def hand(request, make_take, imitation_mano):
    """A captured hand, active, on a frame with keys."""
    side, model = request.param.split()
    model = model if model == "open-hand" else str(imitation_mano)
    armature = build_take(make_take(sides=(side,), model=model).take).hands[0].armature
    bpy.context.view_layer.objects.active = armature
    bpy.context.scene.frame_set(6)
    return armature, side


def apply(pose: str = "", **fields) -> None:
    """Apply a pose as the button does."""
    fields |= {"pose": pose} if pose else {}
    assert bpy.ops.manient.apply_pose(**fields) == {"FINISHED"}
    bpy.context.view_layer.update()


def turns(pose: Pose, side) -> np.ndarray:
    """(15, 3, 3) joint rotations of a pose, in the model's axes."""
    return rotvec_to_rotmat(pose.on(side).reshape(15, 3))


def ready(name: str, side) -> np.ndarray:
    return turns(ready_poses()[name].pose, side)


def shown(armature, frame: int | None = None) -> np.ndarray:
    """(15, 3, 3) joint rotations in the model's axes, from what the bones of a captured hand show."""
    if frame is not None:
        bpy.context.scene.frame_set(frame)
    frames = rig_of(armature).rest.frames
    turned = frames @ quat_to_rotmat(displayed_pose(rig_of(armature))) @ np.swapaxes(frames, -1, -2)
    return (axes.REST_FROM_MODEL.T @ turned @ axes.REST_FROM_MODEL)[1:]


def is_pose(armature, side, name: str, frames) -> list[bool]:
    return [apart(shown(armature, frame), ready(name, side)) < 0.06 for frame in frames]


def turned(before: PoseKeys, after: PoseKeys) -> np.ndarray:
    """(N, 16) radians by which the keys differ on the frames that both have."""
    both = np.isin(after.frames, before.frames)
    return np.linalg.norm(correction_between(before.quats, after.quats[both]), axis=-1)


@pytest.mark.parametrize("name", ["Relaxed", "Fist", "Letter N"])
def test_a_captured_hand_gets_exactly_the_angles(hand, name):
    """Between its keys, and in Pose Mode. The wrist stays; a bone without curves in its mode gets no key."""
    armature, side = hand
    rig, own = rig_of(armature), armature.name
    armature.pose.bones[bone_names(side)[8]].rotation_mode = "XZY"
    bpy.context.scene.frame_set(9)
    bpy.ops.object.mode_set(mode="POSE")
    bpy.ops.ed.undo_push(message="before")
    before, keys = displayed_pose(rig), read_pose_keys(rig)
    apply(name)
    np.testing.assert_allclose(shown(armature, 9), ready(name, side), atol=1e-5)
    assert apart(displayed_pose(rig)[0], before[0]) < 0.1
    after = read_pose_keys(rig)
    here = after.frames == 9
    assert after.rotation_keyed[here].tolist() == [[joint not in (0, 8) for joint in range(16)]]
    assert not after.location_keyed[here].any()
    np.testing.assert_array_equal(after.frames[~here], keys.frames)
    (found,) = posable_hands(bpy.context)
    assert found.read().side == side
    np.testing.assert_allclose(turns(found.read(), side), ready(name, side), atol=1e-5)
    assert bpy.context.mode == "POSE"
    bpy.ops.ed.undo_push(message="posed")
    bpy.ops.ed.undo()
    bpy.context.view_layer.update()
    assert apart(displayed_pose(rig_of(bpy.data.objects[own])), before) < 0.1


@pytest.mark.parametrize(
    ("fields", "frames"), [({}, [6]), ({"scope": "RANGE", "first": 8, "last": 12}, [8, 9, 10, 11, 12])]
)
def test_it_fades_out_over_spread_and_clear_takes_it_back(hand, fields, frames):
    armature, side = hand
    scene = bpy.context.scene
    scene.manient.spread = 3
    before = read_pose_keys(rig_of(armature))
    apply("Fist", **fields)
    assert is_pose(armature, side, "Fist", frames) == [True] * len(frames)
    after = read_pose_keys(rig_of(armature))
    change = turned(before, after).max(axis=1)
    away = np.maximum(frames[0] - before.frames, before.frames - frames[-1])
    np.testing.assert_array_equal(change > 1e-4, away < 3)
    largest = [change[away == distance].max() for distance in (0, 1, 2)]
    assert largest[0] > largest[1] > largest[2] > 0.0
    assert turned(before, after)[:, 0].max() == 0.0
    np.testing.assert_array_equal(after.locations[np.isin(after.frames, before.frames)], before.locations)
    assert corrections.corrected_frames(armature) == frames
    scene.use_preview_range, scene.frame_preview_start, scene.frame_preview_end = True, 6, 12
    scene.frame_set(20)
    with pytest.raises(RuntimeError, match="no correction in this frame"):
        bpy.ops.manient.clear_corrections(scope="FRAME")
    scene.frame_set(6)
    scope = "RANGE" if fields else "FRAME"
    assert bpy.ops.manient.clear_corrections(scope=scope) == {"FINISHED"}
    assert turned(before, read_pose_keys(rig_of(armature))).max() < 1e-5


@pytest.mark.parametrize("keys", ["of other bones", "none", "auto"])
def test_bones_without_keys_are_posed_and_keyed_by_auto_keying_alone(hand, keys):
    armature, side = hand
    bpy.context.scene.tool_settings.use_keyframe_insert_auto = keys == "auto"
    if keys == "of other bones":
        remove_pose_keys(rig_of(armature), -100, 100, joints=[4, 5, 6])
    else:
        armature.animation_data_clear()
    apply("Relaxed")
    after = read_pose_keys(rig_of(armature))
    if keys == "of other bones":
        assert not after.rotation_keyed[:, [4, 5, 6]].any()
    else:
        assert after.frames.tolist() == [6.0] * (keys == "auto")
        assert after.rotation_keyed.tolist() == [[False] + [True] * 15] * (keys == "auto")
    np.testing.assert_allclose(shown(armature), ready("Relaxed", side), atol=1e-4)


BACKWARDS = {"pose": "Fist", "scope": "RANGE", "first": 12, "last": 8}


@pytest.mark.parametrize(
    ("kind", "fields", "said"),
    [
        ("captured", {"pose": "Vulcan"}, "there is no pose 'Vulcan': ready ones are Relaxed, Flat"),
        ("captured", {"source": "OTHER"}, "there are 0 captured left hands"),
        ("captured", BACKWARDS | {"first": 400, "last": 410}, "none of the frames 400 to 410 has a hand"),
        ("captured", BACKWARDS, "range runs backwards, from frame 12 to 8"),
        ("character", BACKWARDS, "range runs backwards, from frame 12 to 8"),
    ],
)
def test_what_cannot_be_applied_changes_nothing(armature, kind, fields, said):
    armature = armature if kind == "captured" else character("right")
    bpy.context.view_layer.objects.active = armature
    apply("Flat")
    before, kept = contents(armature), corrections.corrections_text(armature)
    with pytest.raises(RuntimeError, match=said):
        bpy.ops.manient.apply_pose(**fields)
    assert contents(armature) == before
    assert corrections.corrections_text(armature) == kept


def test_selected_bones_choose_fingers_half_of_the_way_and_other_points_stay(hand):
    armature, side = hand
    here = pose_at(rig_of(armature), np.array([6.0]))
    pins = {4: (1.0, 2.0), 8: (10.0, 20.0)}
    corrections.correct_frames(armature, [6], *here, 4, pins=[pins], touches=[{16: 12, 8: 4}])
    before, wanted = shown(armature), ready("Fist", side)
    select_bones(armature, [bone_names(side)[FINGER_JOINTS["index"][1]]])
    apply("Fist", blend=0.5)
    way = angles(before, wanted) * np.isin(np.arange(1, 16), FINGER_JOINTS["index"])
    np.testing.assert_allclose(angles(before, shown(armature)), way / 2, atol=0.2)
    field = corrections.corrections_of(armature)
    assert set(field.pins(6)) == {4}  # the index finger's own is gone
    assert dict(field.touching(6)) == {16: 12}


def test_the_panel_offers_pictures_and_the_range(hand):
    armature, side = hand
    settings, scene = bpy.context.scene.manient, bpy.context.scene
    items = pose_items(settings, bpy.context)
    assert [item[0] for item in items] == list(ready_poses())
    assert len({item[4] for item in items}) == len(items)
    assert settings.pose == "Relaxed"
    settings.pose = "Horns"
    apply()
    assert is_pose(armature, side, "Horns", [6]) == [True]
    scene.use_preview_range, scene.frame_preview_start, scene.frame_preview_end = True, 7, 9
    settings.pose_scope = "RANGE"
    assert (settings.pose_first, settings.pose_last) == (7, 9)
    assert "Mirrored Reset" in drawn(MANIENT_PT_poses).said


def test_this_pose_is_held_reset_is_rest_and_mirrored_the_other_hands(make_take, model):
    built = build_take(make_take(model=model).take)
    bpy.context.scene.manient.spread = 0
    left, right = (hand.armature for hand in built.hands)
    bpy.context.view_layer.objects.active = left
    own = shown(left, 7)
    apply(source="OWN", scope="HOLD")
    for frame in (7, 12, 18):
        np.testing.assert_allclose(shown(left, frame), own, atol=1e-4)
    apply(source="REST", scope="RANGE", first=9, last=10)
    np.testing.assert_allclose(shown(left, 10), REST, atol=1e-4)
    bpy.context.scene.frame_set(6)
    apply("Horns")
    bpy.context.view_layer.objects.active = right
    apply(source="OTHER", scope="RANGE", first=10, last=14)
    assert all(is_pose(right, "right", "Horns", range(10, 15)))


def test_a_held_pose_ends_where_the_next_one_begins(hand):
    """Captured frames are no keys of the artist's; poses one after the other are, whatever their order."""
    armature, side = hand
    bpy.context.scene.manient.spread = 0
    last = int(read_pose_keys(rig_of(armature)).frames[-1])
    held = {}
    for frame, name in ((14, "Fist"), (6, "Flat"), (9, "Point"), (16, "Horns")):
        bpy.context.scene.frame_set(frame)
        apply(name, scope="HOLD")
        held[frame] = name
        first = sorted(held)
        for start, end in zip(first, [*first[1:], last + 1], strict=True):
            assert all(is_pose(armature, side, held[start], range(start, end)))


def test_a_held_pose_leads_into_a_key_of_ones_own(hand):
    armature, side = hand
    bpy.context.scene.manient.spread = 4
    bone = armature.pose.bones[bone_names(side)[FINGER_JOINTS["index"][0]]]
    bone.rotation_quaternion = (0.8, 0.6, 0.0, 0.0)
    bone.keyframe_insert("rotation_quaternion", frame=14)
    own = pose_at(rig_of(armature), np.array([14.0]))[0]
    bpy.context.scene.frame_set(6)
    apply("Fist", scope="HOLD")
    assert is_pose(armature, side, "Fist", range(5, 12)) == [False] + [True] * 5 + [False]
    np.testing.assert_allclose(pose_at(rig_of(armature), np.array([14.0]))[0], own, atol=1e-6)


# Characters


def character(side, seed=3):
    armature = one_handed(side, seed, bend=0.6, stretch=0.3)
    placed(armature, np.random.default_rng(seed), 0.1)
    return armature


def two_hands():
    rng = np.random.default_rng(5)
    specs = [BoneSpec("chest", "", (0, 0, 0), (0, 0, 0.2))]
    for side, x in (("left", 0.5), ("right", -0.5)):
        specs += hand_specs(side, rng, parent="chest", place=np.array([x, 0, 0]))
    armature = build_armature(specs)
    for side in SIDES:
        keep_map(armature, map_of(side))
    return armature


def target():
    (hand,) = posable_hands(bpy.context)
    return hand._target


def fingers_point_as(armature, side, pose: Pose) -> bool:
    """Whether two segments of each finger point, in their hand's rest space, as those of our own hand do."""
    bpy.context.view_layer.update()
    bones = armature.evaluated_get(bpy.context.evaluated_depsgraph_get()).pose.bones
    own = np.array(bones[joint_name(0, side)].matrix.to_3x3())
    rest = np.array(armature.data.bones[joint_name(0, side)].matrix_local.to_3x3())
    theirs = np.array([bones[joint_name(j, side)].head for j in range(16)]) @ own @ rest.T
    still = np.zeros(3)
    ours = axes.points_to_rest(load_model(None, side).posed(None, still, pose.on(side), still).joints)
    found = []
    for points in (theirs, ours @ target().aligned.T):
        chains = points[list(FINGER_JOINTS.values())]
        steps = np.diff(chains, axis=1)
        found.append(steps / np.linalg.norm(steps, axis=-1, keepdims=True))
    return directions_apart(*found) < 0.1


def bent(armature, side, frame: int) -> np.ndarray:
    """(15, 4) the character's finger bones on a frame, by their channels."""
    bpy.context.scene.frame_set(frame)
    return np.array([armature.pose.bones[joint_name(j, side)].rotation_quaternion for j in range(1, 16)])


@pytest.mark.parametrize("side", SIDES)
@pytest.mark.parametrize("name", ["Fist", "Pinch", "Letter K, P"])
def test_a_ready_pose_points_a_characters_fingers_as_ours(name, side):
    armature = character(side)
    bpy.context.scene.frame_set(12)
    apply(name)
    bpy.context.scene.frame_set(12)
    pose = ready_poses()[name].pose
    assert fingers_point_as(armature, side, pose)
    assert len(curves_of(armature)) == 4 * 15
    assert all([p.co[0] for p in c.keyframe_points] == [12.0] for c in curves_of(armature))
    (hand,) = posable_hands(bpy.context)
    assert hand.read().side == side
    np.testing.assert_allclose(hand.read().on("right"), pose.on("right"), atol=1e-4)
    apply(source="REST")
    np.testing.assert_allclose(bent(armature, side, 12), np.tile([1, 0, 0, 0], (15, 1)), atol=1e-6)


@pytest.mark.parametrize("kind", ["CONSTANT", "BEZIER"])
def test_a_characters_range_and_hold_end_at_its_own_keys(kind):
    """Of the hand with selected bones; its other hand can have the pose mirrored."""
    armature, scene = two_hands(), bpy.context.scene
    armature.manient.character.contacts = False
    scene.manient.spread, scene.frame_end = 5, 60
    select_bones(armature, [joint_name(0, "left")])
    for frame, name in ((1, "Flat"), (40, "Flat")):
        scene.frame_set(frame)
        apply(name)
    for point in (point for curve in curves_of(armature) for point in curve.keyframe_points):
        point.interpolation = kind
        point.handle_left_type = point.handle_right_type = "ALIGNED"
    flat = bent(armature, "left", 40)
    apply("Fist", scope="RANGE", first=10, last=20)
    fist = bent(armature, "left", 10)
    assert apart(bent(armature, "left", 15), fist) < 1.7
    assert apart(bent(armature, "left", 26), fist) > 1.7
    scene.frame_set(25)
    apply("Fist", scope="HOLD")
    assert apart(bent(armature, "left", 35), fist) < 1.7
    assert (apart(bent(armature, "left", 37), fist) > 1.7) == (kind == "BEZIER")
    for frame in (1, 40):
        np.testing.assert_allclose(bent(armature, "left", frame), flat, atol=1e-5)
    scene.frame_set(30)
    select_bones(armature, [joint_name(0, "right")])
    apply(source="OTHER", scope="HOLD")
    keyed = {p.co[0] for c in curves_of(armature) if "_r" in c.data_path for p in c.keyframe_points}
    assert keyed == {25.0, 30.0, 60.0}
    scene.frame_set(50)
    (hand,) = posable_hands(bpy.context)
    assert apart(turns(hand.read(), "right"), ready("Fist", "right")) < 0.6


def test_both_hands_of_a_character_or_what_is_selected():
    """A hand that cannot take a pose keeps the other from it."""
    armature = two_hands()
    armature.data.pose_position = "REST"
    assert not bpy.ops.manient.apply_pose.poll()
    armature.data.pose_position = "POSE"
    thumb = FINGER_JOINTS["thumb"]
    for selected, joints in ((thumb[2], thumb), (0, range(1, 16))):
        select_bones(armature, [joint_name(selected, "right")])
        apply("Point")
        assert keyed_bones(armature) == {joint_name(j, "right") for j in joints}
    select_bones(armature, [])
    apply("Point")
    assert keyed_bones(armature) == {joint_name(j, side) for side in SIDES for j in range(1, 16)}
    with pytest.raises(RuntimeError, match="two hands: select a bone"):
        bpy.ops.manient.save_pose_asset(asset_name="Both")
    next(c for c in curves_of(armature) if joint_name(4, "right") in c.data_path).lock = True
    bpy.context.scene.frame_set(7)
    before = contents(armature), [tuple(bone.rotation_quaternion) for bone in armature.pose.bones]
    with pytest.raises(RuntimeError, match="locked"):
        bpy.ops.manient.apply_pose(pose="Spread")
    assert (contents(armature), [tuple(bone.rotation_quaternion) for bone in armature.pose.bones]) == before
    select_bones(armature, [joint_name(1, "left")])
    apply("Spread")
    assert kept_pose(save("Mine").asset_data).side == "left"


# Assets for every rig


def save(name: str, **fields) -> bpy.types.Action:
    assert bpy.ops.manient.save_pose_asset(asset_name=name, **fields) == {"FINISHED"}
    return bpy.data.actions[name]


@pytest.mark.parametrize("onto", ["captured", "character"])
def test_a_pose_saved_on_one_rig_is_the_same_on_another(hand, onto, tmp_path):
    """Saved to a file, appended from it, and put on a hand of the other side."""
    armature, side = hand
    own = shown(armature, 9)
    action = save("Wave")
    pixels = picture_of(action)
    assert pixels.shape == (128, 128, 4)
    assert 0.2 < (pixels[..., 3] > 0.5).mean() < 0.9
    path = str(tmp_path / "poses.blend")
    bpy.data.libraries.write(path, {action}, fake_user=True)
    bpy.data.actions.remove(action)
    with bpy.data.libraries.load(path) as (there, here):
        here.actions = list(there.actions)
    np.testing.assert_allclose(picture_of(bpy.data.actions["Wave"]), pixels, atol=0.01)
    assert "Wave" in [item[0] for item in pose_items(None, bpy.context)]

    other = other_side(side)
    pose = kept_pose(bpy.data.actions["Wave"].asset_data)
    np.testing.assert_allclose(turns(pose, side), own, atol=1e-5)
    if onto == "character":
        armature = character(other, seed=11)
        apply("Wave")
        assert fingers_point_as(armature, other, pose)
    else:
        assert bpy.ops.manient.mirror_hand() == {"FINISHED"}
        armature = bpy.context.active_object
        assert armature.manient.side == other
        apply("Fist")
        apply("Wave")
        np.testing.assert_allclose(shown(armature), turns(pose, other), atol=1e-5)


def picture_of(action) -> np.ndarray:
    preview = action.preview
    pixels = np.empty(4 * preview.image_size[0] * preview.image_size[1], dtype=np.float32)
    preview.image_pixels_float.foreach_get(pixels)
    return pixels.reshape(preview.image_size[1], preview.image_size[0], 4)


@pytest.mark.parametrize("wrist", [False, True])
def test_blenders_pose_library_applies_it(hand, make_take, wrist):
    """One key a bone; `Pose.apply_pose_from_action` is what poselib.apply_pose_asset calls, slots and all."""
    armature, side = hand
    own = armature.animation_data.action
    wanted = displayed_pose(rig_of(armature))
    action = save("Wave", wrist=wrist)
    assert action.use_fake_user
    assert {tag.name for tag in action.asset_data.tags} == {"hand", side}
    assert armature.animation_data.action == own
    first = 0 if wrist else 1
    curves = list(action_curves(action))
    paths = [f'pose.bones["{name}"].rotation_quaternion' for name in bone_names(side)[first:]]
    assert {curve.data_path for curve in curves} == set(paths)
    assert [len(curve.keyframe_points) for curve in curves] == [1] * 4 * len(paths)
    second = build_take(make_take(sides=(side,), seed=8).take).hands[0].armature
    bpy.context.scene.frame_set(7)
    before = displayed_pose(rig_of(second))
    second.animation_data_clear()
    second.pose.apply_pose_from_action(action, evaluation_time=0.0)
    bpy.context.view_layer.update()
    found = displayed_pose(rig_of(second))
    assert apart(found[1:], wanted[1:]) < 0.5
    assert apart(found[0], (wanted if wrist else before)[0]) < 0.5


def test_ones_own_pose_takes_the_place_of_a_ready_one(hand):
    """Which blanks do not name."""
    armature, _ = hand
    own = shown(armature, 3)
    bpy.ops.manient.save_pose_asset(asset_name="  ")
    bpy.data.actions.remove(bpy.data.actions["Hand Pose"])
    save("Fist")
    bpy.context.scene.frame_set(9)
    apply("Fist")
    np.testing.assert_allclose(shown(armature), own, atol=1e-5)
    names = [item[0] for item in pose_items(None, bpy.context)]
    assert len(names) == len(set(names)) == len(ready_poses())


@pytest.mark.parametrize(
    "value",
    ["right", 5, [1.0, 2.0], {"side": "right"}, {"side": "right", "hand_pose": [1e9] * 45}, {"side": 3}],
)
def test_a_damaged_pose_asset_ends_in_a_sentence(hand, value):
    armature, _ = hand
    save("Bad").asset_data[PROPERTY] = value
    before = shown(armature)
    assert "Bad" in [item[0] for item in pose_items(None, bpy.context)]
    with pytest.raises(RuntimeError, match="pose of a hand"):
        bpy.ops.manient.apply_pose(pose="Bad")
    np.testing.assert_array_equal(shown(armature), before)
