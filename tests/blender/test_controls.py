"""Controls on top of a captured hand's keys: at rest they change nothing, used they move it as hands move."""

from __future__ import annotations

import bpy
import numpy as np
import pytest
from mathutils import Matrix

from blender_manient.rigs import rig_of
from blender_manient.rigs.controls import CAPTURED, LIMIT, MARK, ROLES, in_use
from blender_manient.scene.apply import apply_hand
from blender_manient.scene.build import build_take
from blender_manient.scene.keys import read_pose_keys, write_pose_keys
from blender_manient.scene.retake import retaken
from blender_manient.scene.sampling import sampled_pose as sampled_on
from blender_manient.scene.store import hand_of
from handfit_core.hand_model.anatomy import joint_limits
from handfit_core.skeleton import FINGER_JOINTS, FINGERS, SIDES, other_side

from .conftest import FRAMES, action_curves, joint_heads
from .fbx_file import read_fbx
from .importing import imported, read_back

pytestmark = pytest.mark.usefixtures("registered")


def build(make_take, side="right", **fields):
    """The armature of one captured hand, active; its bones stay apart from the capture camera's axes."""
    made = make_take(sides=(side,), **fields)
    armature = build_take(made.take).hands[0].armature
    bpy.context.view_layer.objects.active = armature
    bpy.context.scene.frame_set(int(FRAMES[2]))
    return armature


@pytest.fixture(params=SIDES)
def hand(request, make_take):
    """A captured hand of either side with controls."""
    armature = build(make_take, request.param)
    assert bpy.ops.manient.add_controls() == {"FINISHED"}
    return armature


def control(armature, role) -> bpy.types.PoseBone:
    return armature.pose.bones[rig_of(armature).controls[role]]


def shown(armature) -> np.ndarray:
    """(16, 4, 4) the bones as they are shown now, in the armature's space."""
    bpy.context.view_layer.update()
    evaluated = armature.evaluated_get(bpy.context.evaluated_depsgraph_get())
    return np.array([evaluated.pose.bones[name].matrix for name in rig_of(armature).bones])


def sampled_pose(armature, frames=FRAMES) -> np.ndarray:
    """(N, 16, 4, 4) the same on every frame."""
    found = []
    for frame in frames:
        bpy.context.scene.frame_set(int(frame))
        found.append(shown(armature))
    return np.array(found)


def bends(armature) -> np.ndarray:
    """(15,) by how many degrees each finger joint is bent about its bone's X from its rest."""
    bones = shown(armature)[:, :3, :3]
    rest = rig_of(armature).rest.frames
    found = []
    for finger in sorted(FINGER_JOINTS.values()):
        parent = 0
        for joint in finger:
            local = np.linalg.inv(bones[parent] @ rest[parent].T @ rest[joint]) @ bones[joint]
            found.append(np.degrees(Matrix(local).to_euler("XZY").x))
            parent = joint
    return np.array(found)


def flatten(armature) -> None:
    """Lay the hand flat, without keys and limits."""
    armature.manient.limits = False
    armature.animation_data.action = None
    for bone in armature.pose.bones:
        bone.rotation_quaternion = (1.0, 0.0, 0.0, 0.0)


def everything(armature) -> dict:
    """What adding and removing controls must leave as it was."""
    return {
        "display": armature.data.display_type,
        "bones": [(b.name, b.use_deform, [c.name for c in b.collections]) for b in armature.data.bones],
        "collections": [c.name for c in armature.data.collections_all],
        "properties": [list(b.keys()) for b in armature.data.bones],
        "posed": [
            (b.name, list(b.lock_location), list(b.lock_rotation), [c.name for c in b.constraints])
            for b in armature.pose.bones
        ],
        "drivers": [] if armature.animation_data is None else len(armature.animation_data.drivers),
        "curves": [(c.data_path, c.array_index) for c in action_curves(armature.animation_data.action)],
        "data": {
            kind: sorted(block.name for block in getattr(bpy.data, kind))
            for kind in ("objects", "meshes", "actions", "armatures", "scenes", "collections")
        },
    }


@pytest.mark.parametrize("limits", [True, False])
def test_at_rest_they_change_nothing(make_take, model, limits):
    armature = build(make_take, model=model)
    armature.manient.limits = limits
    before = sampled_pose(armature)
    assert bpy.ops.manient.add_controls() == {"FINISHED"}
    change = np.abs(sampled_pose(armature) - before)
    print(f"places change by {change[..., 3].max():.1e} m, axes by {change[..., :3].max():.1e}")
    assert change[..., 3].max() < 1e-6
    assert change[..., :3].max() < 2e-6  # single precision, three joints after each other
    assert not in_use(armature)
    assert all(c.enabled == limits for b in armature.pose.bones for c in b.constraints if c.name == LIMIT)


def test_their_bones_are_named_and_drawn_apart(hand):
    controls = rig_of(hand).controls
    suffix = rig_of(hand).bones[0][-2:]
    assert list(controls) == list(ROLES)
    assert controls["index"] == f"index{suffix}"
    assert controls["hand"] == f"hand{suffix}"
    assert len(hand.data.bones) == 16 + len(ROLES)
    for role, name in controls.items():
        bone = hand.pose.bones[name]
        assert not bone.bone.use_deform
        (collection,) = bone.bone.collections
        assert collection.is_visible == (role != CAPTURED)
        assert (bone.custom_shape is None) == (role == CAPTURED)
    shapes = {hand.pose.bones[controls[finger]].custom_shape for finger in FINGERS}
    assert len(shapes) == 1
    assert all(not shape.users_collection for shape in shapes)


def test_curl_bends_a_fingers_joints_in_proportion(hand):
    hand.manient.limits = False
    bpy.context.scene.frame_set(int(FRAMES[0]))
    before, turned = bends(hand), np.zeros(15)
    for finger, joints in FINGER_JOINTS.items():
        control(hand, finger).rotation_euler = np.radians([20.0, 0.0, 0.0])
        at = np.array(joints) - 1
        turned[at] = 20.0 * joint_limits(hand.manient.side).upper[at, 2] / (0.5 * np.pi)
        np.testing.assert_allclose(bends(hand) - before, turned, atol=1e-3)


def test_spread_fans_the_fingers_out(make_take):
    """Of a flat hand: neighbouring fingertips come farther apart, and no finger bends."""
    apart = {}
    for side in SIDES:
        armature = build(make_take, side)
        bpy.ops.manient.add_controls()
        flatten(armature)
        bent = bends(armature)
        tips = [FINGER_JOINTS[finger][2] for finger in ("index", "middle", "ring", "little")]
        distances = []
        for turn in (0.0, 12.0 if side == "right" else -12.0):
            control(armature, "fingers").rotation_euler.z = np.radians(turn)
            places = shown(armature)[tips, :3, 3]
            distances.append(np.linalg.norm(np.diff(places, axis=0), axis=1))
            np.testing.assert_allclose(bends(armature), bent, atol=1e-3)
        apart[side] = distances[1] - distances[0]
    assert (apart["right"] > 0.004).all()
    np.testing.assert_allclose(apart["left"], apart["right"], atol=1e-3)


def test_limits_stop_joints_and_can_be_switched_off(hand):
    index = np.array(FINGER_JOINTS["index"]) - 1
    most = np.degrees(joint_limits(hand.manient.side).upper[index, 2])
    control(hand, "index").rotation_euler.x = np.radians(120.0)
    assert (bends(hand)[index] < most + 2.0).all()
    hand.manient.limits = False
    assert (bends(hand)[index] > most + 2.0).any()


def test_limits_reach_as_far_as_poses_that_are_keyed(hand):
    """A correction, a re-fit, or another motion: limits never cut off what the keys say."""
    bpy.context.scene.tool_settings.use_keyframe_insert_auto = True
    rig = rig_of(hand)
    keys = read_pose_keys(rig)
    far = np.array([np.cos(-0.6), np.sin(-0.6), 0.0, 0.0])  # 69 degrees the wrong way
    keys.quats[:, 1] = far
    write_pose_keys(rig, keys)
    bpy.context.scene.frame_set(int(FRAMES[0]))
    assert bends(hand)[0] == pytest.approx(-np.degrees(1.2), abs=1e-3)


def test_the_hands_control_stands_at_the_captured_wrist_and_moves_the_hand(hand):
    for frame in FRAMES[[0, 5, 9]]:
        bpy.context.scene.frame_set(int(frame))
        before = shown(hand)
        bone = control(hand, "hand")
        np.testing.assert_allclose(np.array(bone.matrix), before[0], atol=1e-6)
        bone.location, bone.rotation_euler = (0.01, 0.02, -0.03), (0.2, -0.1, 0.3)
        bpy.context.view_layer.update()
        moved = np.array(bone.matrix)
        np.testing.assert_allclose(shown(hand), moved @ np.linalg.inv(before[0]) @ before, atol=1e-6)
        bone.location, bone.rotation_euler = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)


@pytest.mark.parametrize("mode", ["XYZ", "AXIS_ANGLE"])
def test_it_does_so_in_every_rotation_mode_of_the_wrist(hand, mode):
    wrist = hand.pose.bones[rig_of(hand).bones[0]]
    wrist.rotation_mode = mode
    if mode == "XYZ":
        wrist.rotation_euler = (0.3, 0.2, -0.4)
    else:
        wrist.rotation_axis_angle = (0.7, 0.0, 0.6, 0.8)
    matrix = shown(hand)[0]
    np.testing.assert_allclose(np.array(control(hand, "hand").matrix), matrix, atol=1e-6)


def test_a_constraint_on_the_hands_control_holds_the_hand(hand):
    cup = bpy.data.objects.new("cup", None)
    bpy.context.scene.collection.objects.link(cup)
    cup.location = (0.1, 0.2, 0.3)
    holding = control(hand, "hand").constraints.new("COPY_LOCATION")
    holding.target = cup
    assert in_use(hand)
    bpy.context.scene.frame_set(int(FRAMES[7]))
    np.testing.assert_allclose(shown(hand)[0, :3, 3], cup.location, atol=1e-6)
    frames = FRAMES.astype(float)
    before = sampled_pose(hand)
    assert bpy.ops.manient.bake_controls() == {"FINISHED"}
    assert not in_use(hand)
    np.testing.assert_allclose(sampled_pose(hand), before, atol=2e-6)
    assert set(frames) <= set(read_pose_keys(rig_of(hand)).frames)


def test_controls_can_be_switched_off(hand):
    before = shown(hand)
    control(hand, "fingers").rotation_euler.x = 0.5
    assert np.abs(shown(hand) - before).max() > 0.1
    hand.manient.use_controls = False
    assert not in_use(hand)
    np.testing.assert_allclose(shown(hand), before, atol=1e-6)
    hand.manient.use_controls = True
    assert np.abs(shown(hand) - before).max() > 0.1


@pytest.mark.parametrize("animated", [False, True])
def test_bake_writes_what_is_shown_into_the_keys(hand, animated):
    """On every frame that has keys, what limits cut off stays cut off, too."""
    rig = rig_of(hand)
    untouched = read_pose_keys(rig)
    index, place = control(hand, "index"), control(hand, "hand")
    for frame, turn in ((3, 0.0), (9, 0.4), (18, 0.1)):
        index.rotation_euler = (turn if animated else 1.8, 0.0, 0.1)
        place.rotation_euler.z = turn if animated else 0.3
        if animated:
            index.keyframe_insert("rotation_euler", frame=frame)
            place.keyframe_insert("rotation_euler", frame=frame)
    frames = range(3, 19) if animated else untouched.frames
    before = sampled_pose(hand, frames)
    assert bpy.ops.manient.bake_controls() == {"FINISHED"}
    assert not in_use(hand)
    np.testing.assert_allclose(sampled_pose(hand, frames), before, atol=5e-6)
    keys = read_pose_keys(rig)
    alone = [joint for joint in range(1, 16) if joint not in FINGER_JOINTS["index"]]
    same = np.isin(keys.frames, untouched.frames)
    assert (keys.rotation_keyed[~same][:, alone]).sum() == 0
    np.testing.assert_array_equal(keys.quats[same][:, alone], untouched.quats[:, alone])
    assert keys.rotation_keyed[~same][:, [0, 1]].any() == animated
    assert not any("index." in c.data_path for c in action_curves(hand.animation_data.action))


def test_bake_evaluates_in_a_scene_that_no_window_opens(hand):
    """To exchange the open one would exchange what all editors draw, below an operator that runs in one."""
    own, window = bpy.context.scene, bpy.context.window_manager.windows[0]
    control(hand, "index").rotation_euler.x = 0.3
    unkeyed = bpy.data.objects.new("unkeyed", None)
    own.collection.objects.link(unkeyed)
    for frame in (1, 9):
        unkeyed.location.x = float(frame)
        unkeyed.keyframe_insert("location", frame=frame)
    unkeyed.location.x = 5.0
    stepped, opened = set(), {window.scene}

    def notice(scene, *_):
        stepped.add(scene.name)
        opened.add(window.scene)

    bpy.app.handlers.frame_change_pre.append(notice)
    try:
        assert bpy.ops.manient.bake_controls() == {"FINISHED"}
    finally:
        bpy.app.handlers.frame_change_pre.remove(notice)
    assert stepped
    assert own.name not in stepped
    assert opened == {own}
    assert (own.frame_current, unkeyed.location.x) == (int(FRAMES[2]), 5.0)
    assert list(bpy.data.scenes) == [own]


def test_what_is_sampled_is_not_written_back(hand):
    """A pose without keys stays, whatever frames are looked at."""
    rig = rig_of(hand)
    bone = hand.pose.bones[rig.bones[1]]
    before = (0.8, 0.6, 0.0, 0.0)
    bone.rotation_quaternion = before
    quats, _ = sampled_on(rig, FRAMES)
    assert np.abs(np.diff(quats[:, 1], axis=0)).max() > 1e-4
    np.testing.assert_allclose(bone.rotation_quaternion, before, atol=1e-7)


def test_a_used_control_asks_for_bake_before_keys_are_changed(hand):
    control(hand, "ring").rotation_euler.x = 0.3
    with pytest.raises(RuntimeError, match="Controls move this hand on top of its keys: bake them"):
        bpy.ops.manient.apply_pose(pose="Relaxed")
    hand.manient.use_controls = False
    assert bpy.ops.manient.apply_pose(pose="Relaxed") == {"FINISHED"}
    hand.manient.use_controls = True
    bpy.ops.manient.bake_controls()
    assert bpy.ops.manient.apply_pose(pose="Relaxed") == {"FINISHED"}
    with pytest.raises(RuntimeError, match="at rest: there is nothing to bake"):
        bpy.ops.manient.bake_controls()


@pytest.mark.parametrize("bake", [True, False])
def test_remove_leaves_nothing_behind(make_take, bake):
    armature = build(make_take)
    armature.pose.bones["index_middle.R"].lock_location = (True, False, False)
    before, keys, plain = everything(armature), read_pose_keys(rig_of(armature)), sampled_pose(armature)
    bpy.ops.manient.add_controls()
    with pytest.raises(RuntimeError, match="has its controls"):
        bpy.ops.manient.add_controls()
    armature.data.bones[rig_of(armature).controls["thumb"]].name = "my thumb"  # which stays a control
    bone = control(armature, "thumb")
    assert (bone.name, bone.bone[MARK]) == ("my thumb", "thumb")
    bone.rotation_euler.x = 0.3
    bone.keyframe_insert("rotation_euler", frame=5)
    used = sampled_pose(armature)
    assert bpy.ops.manient.remove_controls(bake=bake) == {"FINISHED"}
    after = everything(armature)
    if bake:
        np.testing.assert_allclose(sampled_pose(armature), used, atol=5e-6)
        for each in (before, after):
            each.pop("curves")
    else:
        np.testing.assert_array_equal(read_pose_keys(rig_of(armature)).quats, keys.quats)
        np.testing.assert_allclose(sampled_pose(armature), plain, atol=1e-6)
    assert after == before


def test_a_second_hand_keeps_the_shapes(make_take):
    one, other = build(make_take), build(make_take, "left")
    for armature in (one, other):
        bpy.context.view_layer.objects.active = armature
        bpy.ops.manient.add_controls()
    assert control(one, "index").custom_shape == control(other, "ring").custom_shape
    bpy.ops.manient.remove_controls()
    assert control(one, "index").custom_shape.data.vertices
    bpy.context.view_layer.objects.active = one
    bpy.ops.manient.remove_controls()
    assert not [o for o in bpy.data.objects if "control" in o.name]


@pytest.mark.parametrize("fmt", ["fbx", "glb", "usdc", "bvh"])
def test_exports_have_16_bones_and_the_shown_motion(make_take, tmp_path, fmt):
    armature = build(make_take)
    bpy.ops.manient.add_controls()
    control(armature, "fingers").rotation_euler.x = 0.4
    control(armature, "hand").location = (0.02, 0.01, 0.0)
    heads = []
    for frame in FRAMES:
        bpy.context.scene.frame_set(int(frame))
        heads.append(joint_heads(armature, "right"))
    before = [o.name for o in bpy.data.objects], len(armature.data.bones)
    path = tmp_path / f"a.{fmt}"
    name = {"usdc": "usd"}.get(fmt, fmt)
    assert bpy.ops.manient.export_hand(filepath=str(path), file_format=name) == {"FINISHED"}
    assert before == ([o.name for o in bpy.data.objects], len(armature.data.bones))
    if fmt == "fbx":
        nodes = read_fbx(path).first("Objects").all("Model")
        assert sum(node.values[2] == "LimbNode" for node in nodes) == 16
    first = bpy.context.scene.frame_start
    read_back(path, first=first)
    found = next(o for o in bpy.data.objects if o.type == "ARMATURE")
    assert len(found.data.bones) == 16
    if fmt == "usdc":
        return  # Blender's importer names bones otherwise
    for frame, wanted in zip(FRAMES, heads, strict=True):
        bpy.context.scene.frame_set(int(frame))
        np.testing.assert_allclose(joint_heads(imported("right"), "right"), wanted, atol=2e-4)


def test_a_take_of_the_hand_has_the_shown_motion(hand):
    control(hand, "index").rotation_euler.x = 0.3
    bpy.context.scene.frame_set(int(FRAMES[3]))
    heads = joint_heads(hand, hand.manient.side)
    track = retaken([hand_of(hand)]).hands[0]
    points = track.joints_3d[3]  # the camera's frame, to the world's
    knuckle, joint = points[5], points[6]
    for point, bone in ((knuckle, 1), (joint, 2)):
        np.testing.assert_allclose([point[0], point[2], -point[1]], heads[bone], atol=2e-3)


def test_controls_follow_the_shape(hand):
    control(hand, "index").rotation_euler.x = 0.2
    control(hand, "hand").rotation_euler.y = 0.1
    hand.manient.betas[0] = 2.0
    rig = rig_of(hand)
    bones = hand.data.bones
    for finger in FINGERS:
        base = bones[rig.bones[FINGER_JOINTS[finger][0]]]
        np.testing.assert_allclose(bones[rig.controls[finger]].matrix_local, base.matrix_local, atol=1e-6)
    for role in (CAPTURED, "hand"):
        np.testing.assert_allclose(
            bones[rig.controls[role]].matrix_local, bones[rig.bones[0]].matrix_local, atol=1e-6
        )
    assert control(hand, "index").rotation_euler.x == pytest.approx(0.2)


def test_the_mirrored_hand_has_mirrored_controls(hand):
    side = hand.manient.side
    for role, turn in (("index", (0.3, 0.0, 0.1)), ("fingers", (0.1, 0.0, 0.1)), ("hand", (0.1, 0.2, 0.3))):
        bone = control(hand, role)
        bone.rotation_euler = turn
        bone.keyframe_insert("rotation_euler", frame=4)
        bone.rotation_euler.x = 0.5
        bone.keyframe_insert("rotation_euler", frame=14)
    place = control(hand, "hand")
    place.location = (0.01, 0.02, 0.03)
    assert bpy.ops.manient.mirror_hand() == {"FINISHED"}
    mirrored = bpy.context.view_layer.objects.active
    assert mirrored != hand
    for frame in (4, 9, 14):
        bpy.context.scene.frame_set(frame)
        own, other = joint_heads(hand, side), joint_heads(mirrored, other_side(side))
        own, other = own - own[0], (other - other[0]) * (-1.0, 1.0, 1.0)
        assert np.linalg.norm(own - other, axis=-1).max() < 2e-3


def test_copies_saved_files_and_undo(hand, tmp_path):
    control(hand, "index").rotation_euler.x = 0.4
    name, frames = hand.name, FRAMES[:3]
    wanted = sampled_pose(hand, frames)
    copy = hand.copy()
    bpy.context.scene.collection.objects.link(copy)
    np.testing.assert_allclose(sampled_pose(copy, frames), wanted, atol=1e-6)
    control(hand, "index").rotation_euler.x = 0.0
    assert np.abs(sampled_pose(copy, frames) - wanted).max() < 1e-6  # on its own
    control(hand, "index").rotation_euler.x = 0.4
    bpy.data.objects.remove(copy)
    path = str(tmp_path / "a.blend")
    bpy.ops.wm.save_as_mainfile(filepath=path)
    bpy.ops.wm.open_mainfile(filepath=path)
    np.testing.assert_allclose(sampled_pose(bpy.data.objects[name], frames), wanted, atol=1e-6)
    bpy.ops.wm.read_factory_settings(use_empty=True)
    with bpy.data.libraries.load(path) as (there, wanted_blocks):
        wanted_blocks.objects = [name]
        assert name in there.objects
    appended = bpy.data.objects[name]
    bpy.context.scene.collection.objects.link(appended)
    np.testing.assert_allclose(sampled_pose(appended, frames), wanted, atol=1e-6)
    assert control(appended, "index").custom_shape is not None


def test_another_hand_gets_the_shown_motion(make_take):
    source, target = build(make_take), build(make_take, seed=4)
    bpy.context.view_layer.objects.active = source
    bpy.ops.manient.add_controls()
    control(source, "index").rotation_euler.x = 0.4
    bpy.context.view_layer.objects.active = target
    apply_hand(target, source, "ANIMATION", 1.0)
    # They are of two shapes, between which the thumb's bones lie a little differently to each other.
    within = np.repeat([0.1, 0.3], [12, 3])
    for frame in FRAMES[:3]:
        bpy.context.scene.frame_set(int(frame))
        assert (np.abs(bends(target) - bends(source)) < within).all()
    apply_hand(target, source, "POSE", 7.0)
    bpy.context.scene.frame_set(7)
    assert (np.abs(bends(target) - bends(source)) < within).all()


def test_a_pose_asset_has_the_shown_pose(hand):
    control(hand, "little").rotation_euler.x = 0.4
    shown(hand)
    assert bpy.ops.manient.save_pose_asset(asset_name="Pinky") == {"FINISHED"}
    wanted = bends(hand)
    bpy.ops.manient.remove_controls(bake=False)
    hand.animation_data.action = bpy.data.actions["Pinky"]
    bpy.context.scene.frame_set(1)
    np.testing.assert_allclose(bends(hand), wanted, atol=1e-3)


def test_a_selected_control_means_the_joints_that_it_moves(hand):
    bpy.ops.object.mode_set(mode="POSE")
    for bone in hand.pose.bones:
        chosen = bone if hasattr(bone, "select") else bone.bone  # up to Blender 4.5
        chosen.select = bone.name == rig_of(hand).controls["index"]
    assert bpy.ops.manient.lock_joints() == {"FINISHED"}
    assert np.flatnonzero(hand.manient.locked).tolist() == list(FINGER_JOINTS["index"])
    before = bends(hand)
    assert bpy.ops.manient.apply_pose(pose="Fist") == {"FINISHED"}
    changed = np.flatnonzero(np.abs(bends(hand) - before) > 1.0) + 1
    assert changed.tolist() == list(FINGER_JOINTS["index"])
