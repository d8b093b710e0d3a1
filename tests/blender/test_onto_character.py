"""A captured hand's motion on a character's hand, judged by evaluated bones."""

from __future__ import annotations

from dataclasses import replace

import bpy
import numpy as np
import pytest

from blender_manient.rigs.captured_hand import bone_names
from blender_manient.scene.build import build_take
from blender_manient.scene.characters import keep_map
from blender_manient.scene.keys import pose_at
from blender_manient.scene.onto_character import TransferOptions, applying, putting, reading_motion
from blender_manient.scene.store import hand_of
from handfit_core.errors import HandfitError
from handfit_core.geometry.rotations import rotmat_to_rotvec
from handfit_core.hand_model import load_model
from handfit_core.hand_model.anatomy import anatomical_axes, rotmats_from_angles
from handfit_core.retarget.hand_map import HandMap
from handfit_core.retarget.transfer import SourceHand
from handfit_core.skeleton import FINGER_JOINTS, FINGERS, PARENTS, other_side
from handfit_core.slices import run_to_completion
from tests.core.retarget.pinches import bends

from .characters import BoneSpec, build_armature, hand_specs, joint_name, map_of, placed
from .conftest import action_curves

pytestmark = pytest.mark.usefixtures("registered")

PLAIN = TransferOptions(contacts=False)


def captured(make_take, side="right", **fields):
    built = build_take(make_take(sides=(side,), **fields).take)
    hand = hand_of(built.hands[0].armature)
    assert hand is not None
    return hand


def shown(armature, frame):
    bpy.context.scene.frame_set(int(np.floor(frame)), subframe=float(frame % 1.0))
    return armature.evaluated_get(bpy.context.evaluated_depsgraph_get()).pose.bones


def palm(points):
    along = points[4] - points[0]
    along = along / np.linalg.norm(along)
    toward = points[1] - points[7]
    toward = toward - along * (along @ toward)
    toward /= np.linalg.norm(toward)
    return np.stack([along, toward, np.cross(along, toward)], axis=-1)


def palm_length(armature, wrist, knuckle):
    bones = armature.data.bones
    return (bones[knuckle].head_local - bones[wrist].head_local).length


def directions(armature, names, frame):
    """(10, 3) where two segments of each finger point, in the axes of the hand's own palm at that frame."""
    bones = shown(armature, frame)
    points = np.array([bones[name].head for name in names])
    rest = np.array([armature.data.bones[name].head_local for name in names])
    # The palm as a rigid body, which fingers do not turn.
    hand = np.array(bones[names[0]].matrix.to_3x3()) @ np.linalg.inv(
        np.array(armature.data.bones[names[0]].matrix_local.to_3x3())
    )
    frame_of = hand @ palm(rest)
    found = []
    for finger in FINGERS:
        first, second, third = FINGER_JOINTS[finger]
        for a, b in ((first, second), (second, third)):
            d = frame_of.T @ (points[b] - points[a])
            found.append(d / np.linalg.norm(d))
    return np.array(found)


def angles(a, b):
    return np.degrees(np.arccos(np.clip(np.sum(a * b, axis=-1), -1.0, 1.0)))


@pytest.mark.parametrize("side", ["left", "right"])
@pytest.mark.parametrize("mode", ["QUATERNION", "XYZ", "ZYX", "AXIS_ANGLE"])
def test_fingers_point_as_captured(make_take, side, mode):
    rng = np.random.default_rng(5)
    hand = captured(make_take, side)
    target = build_armature(hand_specs(side, rng, bend=0.7, stretch=0.3, scale=40.0))
    placed(target, rng, 0.02)
    for bone in target.pose.bones:
        bone.rotation_mode = mode
    run_to_completion(putting(target, [(map_of(side), hand)], PLAIN))
    names = [joint_name(j, side) for j in range(16)]
    own = bone_names(side)
    frames = pose_at(hand.rig, np.array([0.0]))  # the rig is asked, not only its name
    assert frames[0].shape == (1, 16, 4)
    for frame in np.arange(3, 9):
        error = angles(directions(target, names, frame), directions(hand.armature, own, frame))
        assert error.max() < 0.1


def test_the_other_side_is_mirrored(make_take):
    rng = np.random.default_rng(6)
    hand = captured(make_take, "left")
    target = build_armature(hand_specs("right", rng, bend=0.4, stretch=0.2))
    run_to_completion(putting(target, [(map_of("right"), hand)], PLAIN))
    names = [joint_name(j, "right") for j in range(16)]
    # A left palm's axes are left-handed seen from the right: the third axis turns over.
    ours = directions(hand.armature, bone_names("left"), 3) * [1.0, 1.0, -1.0]
    assert angles(directions(target, names, 3), ours).max() < 0.1


@pytest.mark.parametrize("side", ["left", "right"])
def test_our_own_second_hand_gets_the_same_pose(make_take, side):
    hand = captured(make_take, side)
    second = hand.armature.copy()
    second.data = hand.armature.data.copy()
    second.animation_data_clear()
    second.manient.is_hand = False
    bpy.context.collection.objects.link(second)
    run_to_completion(putting(second, [(HandMap(side, tuple(bone_names(side))), hand)], PLAIN))
    for frame in (3, 8):
        bones, ours = shown(second, frame), shown(hand.armature, frame)
        for name in bone_names(side)[1:]:
            assert np.abs(np.array(bones[name].matrix_basis) - np.array(ours[name].matrix_basis)).max() < 1e-5


def test_only_mapped_bones_are_touched_and_the_present_action_goes_on(make_take):
    rng = np.random.default_rng(7)
    hand = captured(make_take)
    specs = hand_specs("right", rng)
    target = build_armature(specs)
    wrist = target.pose.bones[joint_name(0, "right")]
    wrist.rotation_mode = "XYZ"
    for frame, angle in ((1, 0.0), (5, 1.0)):
        wrist.rotation_euler.x = angle
        wrist.keyframe_insert("rotation_euler", frame=frame)
    body = target.animation_data.action
    values = [tuple(k.co) for c in action_curves(body) for k in c.keyframe_points]
    run_to_completion(putting(target, [(map_of("right"), hand)], PLAIN))
    own = target.animation_data.action
    assert own is not body
    keyed = {curve.data_path.split('"')[1] for curve in action_curves(own)}
    assert keyed == {joint_name(j, "right") for j in range(1, 16)}
    assert [tuple(k.co) for c in action_curves(body) for k in c.keyframe_points] == values
    bones = shown(target, 5)
    assert bones[wrist.name].matrix_basis.to_euler().x == pytest.approx(1.0, abs=1e-5)


def test_bones_with_quotes_in_their_names(make_take):
    hand = captured(make_take)
    names = {j: f'b"{j}\\"' for j in range(16)}
    target = build_armature(hand_specs("right", np.random.default_rng(18), bend=0.3, names=names))
    run_to_completion(putting(target, [(map_of("right", names), hand)], PLAIN))
    error = angles(
        directions(target, list(names.values()), 5), directions(hand.armature, bone_names("right"), 5)
    )
    assert error.max() < 0.1


def test_a_strip_above_all_others(make_take):
    hand = captured(make_take)
    target = build_armature(hand_specs("right", np.random.default_rng(8), bend=0.3))
    run_to_completion(
        putting(target, [(map_of("right"), hand)], TransferOptions(into="STRIP", contacts=False))
    )
    data = target.animation_data
    assert data.action is None
    assert len(data.nla_tracks) == 1
    names = [joint_name(j, "right") for j in range(16)]
    for frame in (3, 5, 8):
        error = angles(
            directions(target, names, frame), directions(hand.armature, bone_names("right"), frame)
        )
        assert error.max() < 0.1


def test_the_present_action_loses_the_same_bones_keys_in_the_range_alone(make_take):
    hand = captured(make_take)
    target = build_armature(hand_specs("right", np.random.default_rng(9)))
    bone = target.pose.bones[joint_name(1, "right")]
    for frame in (-20, 4.5, 90):
        bone.keyframe_insert("rotation_quaternion", frame=frame)
    action = target.animation_data.action
    run_to_completion(
        putting(target, [(map_of("right"), hand)], TransferOptions(into="ACTION", contacts=False))
    )
    assert target.animation_data.action is action
    keyed = hand.armature.animation_data.action.frame_range
    curve = next(c for c in action_curves(action) if c.data_path.split('"')[1] == bone.name)
    frames = [k.co.x for k in curve.keyframe_points]
    assert frames[0] == -20
    assert frames[-1] == 90
    assert 4.5 not in frames
    assert keyed[0] in frames
    assert keyed[1] in frames


def test_what_turns_a_bone_otherwise_is_left_alone_and_named(make_take):
    hand = captured(make_take)
    target = build_armature(hand_specs("right", np.random.default_rng(10)))
    bones = [target.pose.bones[joint_name(j, "right")] for j in range(16)]
    bones[1].constraints.new("COPY_ROTATION").target = target
    bones[2].constraints.new("LIMIT_ROTATION")
    bones[3].driver_add("rotation_quaternion", 0)
    bones[4].lock_rotation = (True, True, True)
    bones[4].rotation_mode = "XYZ"
    bones[5].constraints.new("COPY_ROTATION").mute = True
    (applied,) = run_to_completion(putting(target, [(map_of("right"), hand)], PLAIN))
    assert applied.bones == 12
    assert len(applied.left_alone) == 3
    told = " ".join(applied.left_alone)
    assert "constraint" in told
    assert "driver" in told
    assert "locked" in told
    keyed = {c.data_path.split('"')[1] for c in action_curves(target.animation_data.action)}
    assert not keyed & {bones[1].name, bones[3].name, bones[4].name}
    assert {bones[2].name, bones[5].name} <= keyed


@pytest.mark.parametrize(("mode", "present"), [("XYZ", 0.25), ("QUATERNION", 0.0)])
def test_locked_axes_stay_what_they_are(make_take, mode, present):
    hand = captured(make_take)
    target = build_armature(hand_specs("right", np.random.default_rng(11)))
    bone = target.pose.bones[joint_name(2, "right")]
    bone.rotation_mode, bone.lock_rotation = mode, (False, True, False)
    bone.rotation_euler.y = present
    run_to_completion(putting(target, [(map_of("right"), hand)], PLAIN))
    for frame in (3, 6, 9):
        turned = shown(target, frame)[bone.name].matrix_basis.to_euler("XYZ")
        assert turned.y == pytest.approx(present, abs=1e-4)
        assert abs(turned.x) + abs(turned.z) > 0.01


@pytest.mark.parametrize("wrist", ["TURNED", "PLACED"])
@pytest.mark.parametrize("moved", [False, True])
def test_the_hand_turns_and_moves_as_captured_from_the_marked_frame(make_take, wrist, moved):
    """Also where the arm that carries it moves by itself."""
    rng = np.random.default_rng(12)
    hand = captured(make_take, seed=4)
    specs = hand_specs("right", rng, stretch=0.0, parent="arm", scale=3.0)
    target = build_armature([BoneSpec("arm", "", (0.5, 0, 0), (0.1, 0, 0)), *specs])
    if moved:
        arm = target.pose.bones["arm"]
        arm.rotation_mode = "XYZ"
        for frame, angle in ((1, 0.0), (5, 0.8)):
            arm.rotation_euler.z = angle
            arm.keyframe_insert("rotation_euler", frame=frame)
    own, names = bone_names("right")[0], joint_name(0, "right")
    larger = palm_length(target, names, joint_name(4, "right")) / palm_length(
        hand.armature, own, bone_names("right")[4]
    )
    before = shown(target, 3)[names].matrix.copy()
    run_to_completion(
        putting(
            target, [(map_of("right"), hand)], TransferOptions(wrist=wrist, reference=3.0, contacts=False)
        )
    )
    assert np.abs(np.array(shown(target, 3)[names].matrix) - np.array(before)).max() < 1e-4
    for frame in (4, 5, 8):
        ours, theirs = [], []
        for at in (3, frame):
            ours.append(np.array(shown(hand.armature, at)[own].matrix))
            theirs.append(np.array(shown(target, at)[names].matrix))
        turned = [m[1][:3, :3] @ m[0][:3, :3].T for m in (ours, theirs)]
        spun = [np.degrees(np.arccos(np.clip((np.trace(t) - 1.0) / 2.0, -1, 1))) for t in turned]
        assert spun[0] == pytest.approx(spun[1], abs=0.05)
        if wrist == "PLACED":
            gone = [np.linalg.norm(m[1][:3, 3] - m[0][:3, 3]) for m in (ours, theirs)]
            assert gone[1] == pytest.approx(larger * gone[0], rel=2e-3)


def test_a_marked_frame_outside_is_refused(make_take):
    hand = captured(make_take)
    target = build_armature(hand_specs("right", np.random.default_rng(13)))
    with pytest.raises(HandfitError, match="marked frame"):
        run_to_completion(
            putting(target, [(map_of("right"), hand)], TransferOptions(wrist="TURNED", reference=500.0))
        )
    assert target.animation_data is None


def test_a_stop_loses_no_keys_of_the_present_action(make_take):
    hand = captured(make_take)
    target = build_armature(hand_specs("right", np.random.default_rng(19)))
    run_to_completion(putting(target, [(map_of("right"), hand)], PLAIN))
    action = target.animation_data.action
    count = sum(len(c.keyframe_points) for c in action_curves(action))
    steps = putting(target, [(map_of("right"), hand)], TransferOptions(into="ACTION", contacts=False))
    while True:
        try:
            next(steps)
        except StopIteration:
            break
        assert sum(len(c.keyframe_points) for c in action_curves(action)) == count


def test_a_cycle_goes_on_below(make_take):
    hand = captured(make_take)
    target = build_armature(hand_specs("right", np.random.default_rng(20)))
    wrist = target.pose.bones[joint_name(0, "right")]
    for frame, place in ((1, 0.0), (3, 1.0), (5, 0.0)):
        wrist.location.x = place
        wrist.keyframe_insert("location", frame=frame)
    for curve in action_curves(target.animation_data.action):
        curve.modifiers.new("CYCLES")
    target.animation_data.action_blend_type = "REPLACE"
    target.animation_data.action_influence = 0.5
    frames = (3, 7, 11, 15)
    before = [shown(target, frame)[wrist.name].location.x for frame in frames]
    run_to_completion(putting(target, [(map_of("right"), hand)], PLAIN))
    assert [shown(target, frame)[wrist.name].location.x for frame in frames] == pytest.approx(
        before, abs=1e-5
    )
    assert target.animation_data.action_influence == 1.0


def _layered(target):
    target.animation_data.action_blend_type = "COMBINE"


def _solo(target):
    track = target.animation_data.nla_tracks.new()
    track.is_solo = True


def _nla_off(target):
    target.animation_data.use_nla = False


@pytest.mark.parametrize(
    ("spoil", "into", "said"),
    [
        (_layered, "NEW", "layer"),
        (_layered, "ACTION", "layer"),
        (_solo, "NEW", "solo"),
        (_solo, "STRIP", "solo"),
        (_nla_off, "NEW", "switched off"),
        (lambda _t: None, "STRIP", "above every strip"),
    ],
)
def test_what_would_not_be_shown_is_refused(make_take, spoil, into, said):
    hand = captured(make_take)
    target = build_armature(hand_specs("right", np.random.default_rng(21)))
    bone = target.pose.bones[joint_name(5, "right")]
    bone.keyframe_insert("rotation_quaternion", frame=4)
    action = target.animation_data.action
    spoil(target)
    tracks = len(target.animation_data.nla_tracks)
    with pytest.raises(HandfitError, match=said):
        run_to_completion(
            putting(target, [(map_of("right"), hand)], TransferOptions(into=into, contacts=False))
        )
    assert target.animation_data.action == action
    assert len(target.animation_data.nla_tracks) == tracks
    assert len(bpy.data.actions) == 2


@pytest.mark.parametrize("how", ["driver", "muted", "modifier"])
def test_what_else_moves_the_captured_hand_counts(make_take, how):
    hand = captured(make_take)
    name = bone_names("right")[1]
    curves = [c for c in action_curves(hand.armature.animation_data.action) if name in c.data_path]
    if how == "driver":
        for curve in curves:
            curve.keyframe_points.clear()
        hand.armature.pose.bones[name].driver_add("rotation_quaternion", 1).driver.expression = "0.5"
    for curve in curves:
        if how == "muted":
            curve.mute = True
        if how == "modifier":
            curve.modifiers.new("NOISE").strength = 0.3
    target = build_armature(hand_specs("right", np.random.default_rng(22)))
    run_to_completion(putting(target, [(map_of("right"), hand)], PLAIN))
    names = [joint_name(j, "right") for j in range(16)]
    error = angles(directions(target, names, 6), directions(hand.armature, bone_names("right"), 6))
    assert error.max() < 0.1


def test_what_is_stopped_leaves_nothing(make_take):
    hand = captured(make_take)
    target = build_armature(hand_specs("right", np.random.default_rng(14)))
    count = len(bpy.data.actions)
    motion = run_to_completion(reading_motion(hand))
    steps = applying(target, [(map_of("right"), motion)], PLAIN)
    while len(bpy.data.actions) == count:
        next(steps)
    steps.close()
    assert len(bpy.data.actions) == count
    assert target.animation_data is None


def test_layers_and_constraints_of_the_captured_hand_count(make_take):
    """Keys do not tell what is shown then."""
    hand = captured(make_take)
    name = bone_names("right")[1]
    limit = hand.armature.pose.bones[name].constraints.new("LIMIT_ROTATION")
    limit.owner_space, limit.use_limit_x, limit.min_x, limit.max_x = "LOCAL", True, 0.3, 0.3
    target = build_armature(hand_specs("right", np.random.default_rng(15)))
    frame = bpy.context.scene.frame_current
    run_to_completion(putting(target, [(map_of("right"), hand)], PLAIN))
    assert bpy.context.scene.frame_current == frame
    names = [joint_name(j, "right") for j in range(16)]
    error = angles(directions(target, names, 4), directions(hand.armature, bone_names("right"), 4))
    assert error.max() < 0.1
    assert PARENTS[2] == 1  # so that the limit shows in the second segment


@pytest.mark.parametrize(
    ("spoil", "said"),
    [
        (lambda o: setattr(o, "scale", (-1.0, 1.0, 1.0)), "negative scale"),
        (lambda o: setattr(o.data, "pose_position", "REST"), "rest position"),
        (lambda _o: bpy.ops.object.mode_set(mode="EDIT"), "Edit Mode"),
    ],
)
def test_characters_that_cannot_be_keyed(make_take, spoil, said):
    hand = captured(make_take)
    target = build_armature(hand_specs("right", np.random.default_rng(16)))
    spoil(target)
    bpy.context.view_layer.update()
    with pytest.raises(HandfitError, match=said):
        run_to_completion(putting(target, [(map_of("right"), hand)], PLAIN))
    bpy.ops.object.mode_set(mode="OBJECT")
    assert target.animation_data is None


def test_both_hands_are_in_one_action(make_take):
    built = build_take(make_take(sides=("left", "right")).take)
    hands = {h.side: h for h in (hand_of(one.armature) for one in built.hands) if h is not None}
    rng = np.random.default_rng(17)
    specs = [*hand_specs("left", rng), *hand_specs("right", rng)]
    target = build_armature(specs)
    run_to_completion(putting(target, [(map_of(side), hands[side]) for side in hands], PLAIN))
    keyed = {c.data_path.split('"')[1] for c in action_curves(target.animation_data.action)}
    assert len(keyed) == 30
    assert other_side("left") == "right"


def pinched(make_take, side):
    """A captured hand whose thumb and index finger touch in every frame."""
    made = make_take(sides=(side,)).take
    angles = bends(side, "index")
    pose = rotmat_to_rotvec(rotmats_from_angles(angles, anatomical_axes(load_model(None, side)))).ravel()
    track = made.hands[0]
    shape = np.zeros_like(track.betas)
    still = replace(track, hand_pose=np.where(np.isnan(track.hand_pose), np.nan, pose), betas=shape)
    hand = hand_of(build_take(replace(made, hands=(still,))).hands[0].armature)
    assert hand is not None
    return hand


def tips_apart(target, side, frame):
    """metres of the captured hand from the thumb's tip to the index finger's, by evaluated bones"""
    bones, rest = shown(target, frame), target.data.bones
    ends = [np.array(bones[joint_name(FINGER_JOINTS[f][2], side)].tail) for f in ("thumb", "index")]
    palm_of = (rest[joint_name(4, side)].head_local - rest[joint_name(0, side)].head_local).length
    own = SourceHand.of(load_model(None, side).shaped(), side).joints
    return np.linalg.norm(ends[0] - ends[1]) / palm_of * np.linalg.norm(own[4] - own[0])


@pytest.mark.parametrize("side", ["left", "right"])
def test_fingertips_that_touch_do_so_on_the_character(make_take, side):
    hand = pinched(make_take, side)
    motion = run_to_completion(reading_motion(hand))
    tips = motion.source.points(motion.turns[:1])[1][0]
    wanted = np.linalg.norm(tips[0] - tips[1])
    off = {True: [], False: []}
    for seed in range(3):
        for contacts in off:
            target = build_armature(hand_specs(side, np.random.default_rng(seed), stretch=0.25))
            (done,) = run_to_completion(
                putting(target, [(map_of(side), hand)], TransferOptions(contacts=contacts))
            )
            off[contacts].append(abs(tips_apart(target, side, 3) - wanted))
            assert done.apart < 0.002
            assert done.missed == 0
    assert min(off[False]) > 0.004
    assert max(off[True]) < 0.001


def test_fingertips_that_cannot_meet_are_told(make_take, capfd):
    hand = pinched(make_take, "right")
    specs = hand_specs("right", np.random.default_rng(0))
    names = [joint_name(joint, "right") for joint in FINGER_JOINTS["thumb"]]
    root = np.array(next(spec.head for spec in specs if spec.name == names[0]))

    def short(point):
        return (root + 0.35 * (np.array(point) - root)).tolist()

    specs = [
        replace(spec, head=short(spec.head), tail=short(spec.tail)) if spec.name in names else spec
        for spec in specs
    ]
    target = build_armature(specs)
    (done,) = run_to_completion(putting(target, [(map_of("right"), hand)], TransferOptions()))
    assert done.apart > 0.005
    assert done.missed == done.frames
    keep_map(target, map_of("right"))
    target.manient.character.right.source = hand.armature
    assert bpy.ops.manient.apply_to_character() == {"FINISHED"}
    assert f"In {done.frames} frames fingertips that touch do not meet as captured" in capfd.readouterr().out
