"""Controls on top of a captured hand's keys: at rest they change nothing, used they move it as hands move."""

from __future__ import annotations

import bpy
import numpy as np
import pytest
from mathutils import Matrix

from blender_manient.exporters.take import retaken
from blender_manient.rigs import rig_of
from blender_manient.rigs.controls import CAPTURED, LIMIT, MARK, ROLES, in_use
from blender_manient.scene.apply import apply_hand
from blender_manient.scene.build import build_take
from blender_manient.scene.keys import read_pose_keys, write_pose_keys
from blender_manient.scene.store import hand_of
from handfit_core.common.skeleton import FINGER_JOINTS, FINGERS, other_side
from handfit_core.hand_model.anatomy import joint_limits

from .conftest import FRAMES, action_curves, blocks, joint_heads, shown_bones
from .fbx_file import models_of
from .importing import imported, read_back

pytestmark = pytest.mark.usefixtures("registered")


def build(make_take, side="right", **fields):
    """The armature of one captured hand, active; its bones stay apart from the capture camera's axes."""
    armature = build_take(make_take(sides=(side,), **fields).take).hands[0].armature
    bpy.context.view_layer.objects.active = armature
    bpy.context.scene.frame_set(int(FRAMES[2]))
    return armature


@pytest.fixture(params=[pytest.param("left", marks=pytest.mark.slow), "right"])
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
    bones = shown_bones(armature)
    return np.array([bones[name].matrix for name in rig_of(armature).bones])


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
        for parent, joint in zip((0, *finger), finger, strict=False):
            local = np.linalg.inv(bones[parent] @ rest[parent].T @ rest[joint]) @ bones[joint]
            found.append(np.degrees(Matrix(local).to_euler("XZY").x))
    return np.array(found)


def everything(armature) -> dict:
    """What adding and removing controls must leave as it was."""
    return {
        "display": armature.data.display_type,
        "bones": [(b.name, b.use_deform, list(b.keys()), b.collections.keys()) for b in armature.data.bones],
        "collections": armature.data.collections_all.keys(),
        "posed": [
            (b.name, list(b.lock_location), list(b.lock_rotation), b.constraints.keys())
            for b in armature.pose.bones
        ],
        "drivers": len(armature.animation_data.drivers),
        "curves": [(c.data_path, c.array_index) for c in action_curves(armature.animation_data.action)],
        "data": blocks(),
    }


@pytest.mark.parametrize("limits", [True, False])
def test_change_nothing_at_rest(make_take, model, limits):
    armature = build(make_take, model=model)
    armature.manient.limits = limits
    before = sampled_pose(armature)
    assert bpy.ops.manient.add_controls() == {"FINISHED"}
    change = np.abs(sampled_pose(armature) - before)
    assert change[..., 3].max() < 1e-6
    assert change[..., :3].max() < 2e-6  # single precision, three joints after each other
    assert not in_use(armature)
    assert all(c.enabled == limits for b in armature.pose.bones for c in b.constraints if c.name == LIMIT)
    controls = rig_of(armature).controls
    assert (list(controls), controls["index"], controls["hand"]) == (list(ROLES), "index.R", "hand.R")
    for role, name in controls.items():
        bone = armature.pose.bones[name]
        assert not bone.bone.use_deform
        assert bone.bone.collections[0].is_visible == (role != CAPTURED)
        assert (bone.custom_shape is None) == (role == CAPTURED)


def test_curl_bends_joints_in_proportion(hand):
    hand.manient.limits = False
    bpy.context.scene.frame_set(int(FRAMES[0]))
    before, turned = bends(hand), np.zeros(15)
    for finger, joints in FINGER_JOINTS.items():
        control(hand, finger).rotation_euler = np.radians([20.0, 0.0, 0.0])
        at = np.array(joints) - 1
        turned[at] = 20.0 * joint_limits(hand.manient.side).upper[at, 2] / (0.5 * np.pi)
        np.testing.assert_allclose(bends(hand) - before, turned, atol=1e-3)


def test_spread_fans_flat_fingers_out(hand):
    """Neighbouring fingertips come farther apart, and no finger bends."""
    hand.manient.limits = False
    hand.animation_data.action = None
    for bone in hand.pose.bones:
        bone.rotation_quaternion = (1.0, 0.0, 0.0, 0.0)
    bent, distances = bends(hand), []
    tips = [FINGER_JOINTS[finger][2] for finger in ("index", "middle", "ring", "little")]
    for turn in (0.0, 12.0 if hand.manient.side == "right" else -12.0):
        control(hand, "fingers").rotation_euler.z = np.radians(turn)
        distances.append(np.linalg.norm(np.diff(shown(hand)[tips, :3, 3], axis=0), axis=1))
        np.testing.assert_allclose(bends(hand), bent, atol=1e-3)
    assert (distances[1] - distances[0] > 0.004).all()


def test_limits_stop_joints_and_reach_as_far_as_keys(hand):
    index = np.array(FINGER_JOINTS["index"]) - 1
    most = np.degrees(joint_limits(hand.manient.side).upper[index, 2])
    control(hand, "index").rotation_euler.x = np.radians(120.0)
    assert (bends(hand)[index] < most + 2.0).all()
    hand.manient.limits = False
    assert (bends(hand)[index] > most + 2.0).any()
    # A correction, a re-fit, or another motion: limits never cut off what the keys say.
    hand.manient.limits, control(hand, "index").rotation_euler.x = True, 0.0
    keys = read_pose_keys(rig_of(hand))
    keys.quats[:, 1] = [np.cos(-0.6), np.sin(-0.6), 0.0, 0.0]  # 69 degrees the wrong way
    write_pose_keys(rig_of(hand), keys)
    bpy.context.scene.frame_set(int(FRAMES[0]))
    assert bends(hand)[0] == pytest.approx(-np.degrees(1.2), abs=1e-3)


@pytest.mark.parametrize("mode", ["QUATERNION", "XYZ", "AXIS_ANGLE"])
def test_the_hands_control_stands_at_the_wrist_and_moves_it(hand, mode):
    wrist, bone = hand.pose.bones[rig_of(hand).bones[0]], control(hand, "hand")
    wrist.rotation_mode = mode
    wrist.rotation_euler, wrist.rotation_axis_angle = (0.3, 0.2, -0.4), (0.7, 0.0, 0.6, 0.8)
    for frame in FRAMES[[0, 9]]:
        bpy.context.scene.frame_set(int(frame))
        before = shown(hand)
        np.testing.assert_allclose(np.array(bone.matrix), before[0], atol=1e-6)
        bone.location, bone.rotation_euler = (0.01, 0.02, -0.03), (0.2, -0.1, 0.3)
        bpy.context.view_layer.update()
        moved = np.array(bone.matrix)
        np.testing.assert_allclose(shown(hand), moved @ np.linalg.inv(before[0]) @ before, atol=1e-6)
        bone.location, bone.rotation_euler = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)


@pytest.mark.parametrize("how", ["still", "animated", "held"])
def test_bake_writes_what_is_shown(hand, how):
    """On every frame that has keys; what limits cut off stays cut off, too. Nobody's unkeyed pose is lost."""
    rig, unkeyed = rig_of(hand), bpy.data.objects.new("unkeyed", None)
    bpy.context.scene.collection.objects.link(unkeyed)
    unkeyed.keyframe_insert("location", frame=1)
    untouched = read_pose_keys(rig)
    index, place = control(hand, "index"), control(hand, "hand")
    if how == "held":
        cup = bpy.data.objects.new("cup", None)
        bpy.context.scene.collection.objects.link(cup)
        cup.location = (0.1, 0.2, 0.3)
        place.constraints.new("COPY_LOCATION").target = cup
    for frame, turn in ((3, 0.0), (9, 0.4), (18, 0.1)):
        index.rotation_euler = (turn if how == "animated" else 1.8, 0.0, 0.1)
        place.rotation_euler.z = turn if how == "animated" else 0.3
        if how == "animated":
            index.keyframe_insert("rotation_euler", frame=frame)
            place.keyframe_insert("rotation_euler", frame=frame)
    frames = untouched.frames if how == "still" else range(3, 19)
    before = sampled_pose(hand, frames)
    if how == "held":
        np.testing.assert_allclose(before[7, 0, :3, 3], cup.location, atol=1e-6)
    unkeyed.location.x = 5.0
    assert in_use(hand)
    assert bpy.ops.manient.bake_controls() == {"FINISHED"}
    assert not in_use(hand)
    assert unkeyed.location.x == 5.0
    np.testing.assert_allclose(sampled_pose(hand, frames), before, atol=5e-6)
    keys = read_pose_keys(rig)
    alone = [joint for joint in range(1, 16) if joint not in FINGER_JOINTS["index"]]
    same = np.isin(keys.frames, untouched.frames)
    assert not keys.rotation_keyed[~same][:, alone].any()
    np.testing.assert_array_equal(keys.quats[same][:, alone], untouched.quats[:, alone])
    assert keys.rotation_keyed[~same][:, [0, 1]].any() == (how != "still")
    assert not any("index." in c.data_path for c in action_curves(hand.animation_data.action))


def test_a_used_control_asks_for_bake_unless_switched_off(hand):
    before = shown(hand)
    control(hand, "ring").rotation_euler.x = 0.3
    assert np.abs(shown(hand) - before).max() > 0.1
    with pytest.raises(RuntimeError, match="Controls move this hand on top of its keys: bake them"):
        bpy.ops.manient.apply_pose(pose="Relaxed")
    hand.manient.use_controls = False
    np.testing.assert_allclose(shown(hand), before, atol=1e-6)
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
        del before["curves"], after["curves"]
    else:
        np.testing.assert_array_equal(read_pose_keys(rig_of(armature)).quats, keys.quats)
        np.testing.assert_allclose(sampled_pose(armature), plain, atol=1e-6)
    assert after == before


@pytest.mark.parametrize("fmt", ["fbx", "glb", "bvh"])
def test_exports_have_16_bones_and_the_shown_motion(make_take, tmp_path, fmt):
    armature = build(make_take)
    bpy.ops.manient.add_controls()
    control(armature, "fingers").rotation_euler.x = 0.4
    control(armature, "hand").location = (0.02, 0.01, 0.0)
    heads = []
    for frame in FRAMES:
        bpy.context.scene.frame_set(int(frame))
        heads.append(joint_heads(armature, "right"))
    path = tmp_path / f"a.{fmt}"
    assert bpy.ops.manient.export_hand(filepath=str(path), file_format=fmt) == {"FINISHED"}
    if fmt == "fbx":
        assert sum(kind == "LimbNode" for kind, _ in models_of(path).values()) == 16
    read_back(path, first=bpy.context.scene.frame_start)
    (found,) = (o for o in bpy.data.objects if o.type == "ARMATURE")
    assert len(found.data.bones) == 16
    for frame, wanted in zip(FRAMES, heads, strict=True):
        bpy.context.scene.frame_set(int(frame))
        np.testing.assert_allclose(joint_heads(imported("right"), "right"), wanted, atol=2e-4)


def test_takes_other_hands_and_pose_assets_get_the_shown_motion(hand, make_take):
    control(hand, "index").rotation_euler.x = 0.3
    bpy.context.scene.frame_set(int(FRAMES[3]))
    points = retaken([hand_of(hand)]).hands[0].joints_3d[3, [5, 6]]  # the camera's frame, to the world's
    places = points[:, [0, 2, 1]] * [1.0, 1.0, -1.0]
    np.testing.assert_allclose(places, joint_heads(hand, hand.manient.side)[[1, 2]], atol=2e-3)

    target = build(make_take, hand.manient.side, seed=4)
    # They are of two shapes, between which the thumb's bones lie a little differently to each other.
    within = np.repeat([0.1, 0.3], [12, 3])
    for mode, place, frames in (("ANIMATION", 1.0, FRAMES[:3]), ("POSE", 7.0, [7])):
        apply_hand(target, hand, mode, place)
        for frame in frames:
            bpy.context.scene.frame_set(int(frame))
            assert (np.abs(bends(target) - bends(hand)) < within).all()

    bpy.context.view_layer.objects.active = hand
    assert bpy.ops.manient.save_pose_asset(asset_name="Pinch") == {"FINISHED"}
    wanted = bends(hand)
    bpy.ops.manient.remove_controls(bake=False)
    hand.animation_data.action = bpy.data.actions["Pinch"]
    bpy.context.scene.frame_set(1)
    np.testing.assert_allclose(bends(hand), wanted, atol=1e-3)


def test_controls_follow_the_shape(hand):
    control(hand, "index").rotation_euler.x = 0.2
    hand.manient.betas[0] = 2.0
    rig, bones = rig_of(hand), hand.data.bones
    bases = {finger: rig.bones[FINGER_JOINTS[finger][0]] for finger in FINGERS}
    for role, base in {**bases, CAPTURED: rig.bones[0], "hand": rig.bones[0]}.items():
        matrix = bones[rig.controls[role]].matrix_local
        np.testing.assert_allclose(matrix, bones[base].matrix_local, atol=1e-6)
    assert control(hand, "index").rotation_euler.x == pytest.approx(0.2)


def test_the_mirrored_hand_has_mirrored_controls(hand):
    side = hand.manient.side
    for role, turn in (("index", (0.3, 0.0, 0.1)), ("fingers", (0.1, 0.0, 0.1)), ("hand", (0.1, 0.2, 0.3))):
        bone = control(hand, role)
        bone.rotation_euler = turn
        bone.keyframe_insert("rotation_euler", frame=4)
        bone.rotation_euler.x = 0.5
        bone.keyframe_insert("rotation_euler", frame=14)
    control(hand, "hand").location = (0.01, 0.02, 0.03)
    assert bpy.ops.manient.mirror_hand() == {"FINISHED"}
    mirrored = bpy.context.view_layer.objects.active
    assert mirrored != hand
    for frame in (4, 9, 14):
        bpy.context.scene.frame_set(frame)
        own, other = joint_heads(hand, side), joint_heads(mirrored, other_side(side))
        own, other = own - own[0], (other - other[0]) * (-1.0, 1.0, 1.0)
        assert np.linalg.norm(own - other, axis=-1).max() < 2e-3
