"""A captured hand's motion on a character's hand, judged by evaluated bones."""

from __future__ import annotations

from dataclasses import replace

import bmesh
import bpy
import numpy as np
import pytest
from mathutils import Vector

from blender_manient.rigs.captured_hand import bone_names
from blender_manient.rigs.character import bones_of
from blender_manient.scene.build import build_take
from blender_manient.scene.characters import CharacterObjects, keep_map
from blender_manient.scene.onto_character import TransferOptions, applying, putting, reading_motion
from blender_manient.scene.store import hand_of
from handfit_core.common.errors import HandfitError
from handfit_core.common.skeleton import FINGER_JOINTS
from handfit_core.common.slices import run_to_completion
from handfit_core.geometry.rotations import rotmat_to_rotvec
from handfit_core.hand_model import load_model
from handfit_core.hand_model.anatomy import anatomical_axes, rotmats_from_angles
from handfit_core.retarget.contacts import Fingertips
from handfit_core.retarget.transfer import SourceHand, target_hand
from tests.core.retarget.pinches import bends

from .characters import BoneSpec, build_armature, hand_specs, joint_name, map_of, placed
from .conftest import action_curves
from .looking import apart, bones_at, curves_of, directions, directions_apart, keyed_bones

pytestmark = pytest.mark.usefixtures("registered")


def captured(make_take, side="right", **fields):
    return hand_of(build_take(make_take(sides=(side,), **fields).take).hands[0].armature)


def own_hand(side="right", seed=8, **fields):
    """A character's hand, of bones that no table knows."""
    return build_armature(hand_specs(side, np.random.default_rng(seed), **fields))


def put(target, hand, side="right", **options):
    """Put a motion on it, and return what is told of that."""
    onto = TransferOptions(**{"contacts": False} | options)
    (done,) = run_to_completion(putting(target, [(map_of(side), hand)], onto))
    return done


def palm_length(armature, names) -> float:
    bones = armature.data.bones
    return (bones[names[4]].head_local - bones[names[0]].head_local).length


def off(target, hand, frame, side="right", mirrored=False) -> float:
    """How far its fingers are from where the captured hand's point, in degrees."""
    theirs = directions(target, map_of(side).bones, frame)
    ours = directions(hand.armature, bone_names(hand.side), frame)
    # A left palm's axes are left-handed seen from the right: the third axis turns over.
    return directions_apart(theirs, ours * [1.0, 1.0, -1.0 if mirrored else 1.0])


@pytest.mark.parametrize(
    ("side", "mode", "into"),
    [
        ("left", "QUATERNION", "NEW"),
        ("right", "QUATERNION", "STRIP"),
        ("left", "ZYX", "STRIP"),
        ("right", "AXIS_ANGLE", "NEW"),
    ],
)
def test_fingers_point_as_captured(make_take, side, mode, into):
    hand = captured(make_take, side)
    target = own_hand(side, 5, bend=0.7, stretch=0.3, scale=40.0)
    placed(target, np.random.default_rng(5), 0.02)
    for bone in target.pose.bones:
        bone.rotation_mode = mode
    put(target, hand, side, into=into)
    assert (target.animation_data.action is None) == (into == "STRIP")
    assert len(target.animation_data.nla_tracks) == (into == "STRIP")
    assert max(off(target, hand, frame, side) for frame in range(3, 9)) < 0.1


def test_the_other_side_is_mirrored(make_take):
    hand = captured(make_take, "left")
    target = own_hand(bend=0.4, stretch=0.2)
    put(target, hand)
    assert off(target, hand, 3, mirrored=True) < 0.1


def test_only_mapped_bones_are_touched_and_the_present_action_goes_on(hand):
    """Its cycles, too, also where it had been mixed in otherwise."""
    target = own_hand(names={j: f'b"{j}\\"' for j in range(16)})
    names = tuple(bone.name for bone in target.pose.bones)
    wrist = target.pose.bones[names[0]]
    for frame, place in ((1, 0.0), (3, 1.0), (5, 0.0)):
        wrist.location.x = place
        wrist.keyframe_insert("location", frame=frame)
    data = target.animation_data
    for curve in action_curves(data.action):
        curve.modifiers.new("CYCLES")
    data.action_blend_type, data.action_influence = "REPLACE", 0.5
    body, values = data.action, [tuple(k.co) for c in curves_of(target) for k in c.keyframe_points]
    before = [bones_at(target, frame)[wrist.name].location.x for frame in (3, 7, 11, 15)]
    named = map_of("right", dict(enumerate(names)))
    run_to_completion(putting(target, [(named, hand)], TransferOptions(contacts=False)))
    assert data.action is not body
    assert len(curves_of(target)) == 4 * 15
    assert [tuple(k.co) for c in action_curves(body) for k in c.keyframe_points] == values
    after = [bones_at(target, frame)[wrist.name].location.x for frame in (3, 7, 11, 15)]
    assert after == pytest.approx(before, abs=1e-5)
    assert data.action_influence == 1.0
    ours = directions(hand.armature, bone_names("right"), 5)
    assert directions_apart(directions(target, names, 5), ours) < 0.1


def test_the_present_action_loses_the_same_bones_keys_in_the_range_alone(hand):
    target = own_hand()
    bone = target.pose.bones[joint_name(1, "right")]
    for frame in (-20, 4.5, 90):
        bone.keyframe_insert("rotation_quaternion", frame=frame)
    action = target.animation_data.action
    put(target, hand, into="ACTION")
    assert target.animation_data.action is action
    curve = next(c for c in curves_of(target) if c.data_path.split('"')[1] == bone.name)
    frames = [k.co.x for k in curve.keyframe_points]
    assert (frames[0], frames[-1]) == (-20, 90)
    assert 4.5 not in frames
    assert set(hand.armature.animation_data.action.frame_range) <= set(frames)


def test_what_turns_a_bone_otherwise_is_left_alone_and_named(hand):
    target = own_hand()
    bones = [target.pose.bones[joint_name(j, "right")] for j in range(16)]
    bones[1].constraints.new("COPY_ROTATION").target = target
    bones[2].constraints.new("LIMIT_ROTATION")
    bones[3].driver_add("rotation_quaternion", 0)
    bones[4].lock_rotation = (True, True, True)
    bones[4].rotation_mode = "XYZ"
    bones[5].constraints.new("COPY_ROTATION").mute = True
    applied = put(target, hand)
    assert applied.bones == 12
    assert len(applied.left_alone) == 3
    told = " ".join(applied.left_alone)
    assert all(word in told for word in ("constraint", "driver", "locked"))
    keyed = keyed_bones(target)
    assert not keyed & {bones[1].name, bones[3].name, bones[4].name}
    assert {bones[2].name, bones[5].name} <= keyed


@pytest.mark.parametrize(("mode", "present"), [("XYZ", 0.25), ("QUATERNION", 0.0)])
def test_locked_axes_stay_what_they_are(hand, mode, present):
    target = own_hand()
    bone = target.pose.bones[joint_name(2, "right")]
    bone.rotation_mode, bone.lock_rotation = mode, (False, True, False)
    bone.rotation_euler.y = present
    put(target, hand)
    for frame in (3, 6, 9):
        turned = bones_at(target, frame)[bone.name].matrix_basis.to_euler("XYZ")
        assert turned.y == pytest.approx(present, abs=1e-4)
        assert abs(turned.x) + abs(turned.z) > 0.01


@pytest.mark.parametrize("wrist", ["TURNED", "PLACED"])
@pytest.mark.parametrize("moved", [False, True])
def test_the_hand_turns_and_moves_as_captured_from_the_marked_frame(make_take, wrist, moved):
    """Also where the arm that carries it moves by itself."""
    hand = captured(make_take, seed=4)
    specs = hand_specs("right", np.random.default_rng(12), parent="arm", scale=3.0)
    target = build_armature([BoneSpec("arm", "", (0.5, 0, 0), (0.1, 0, 0)), *specs])
    if moved:
        arm = target.pose.bones["arm"]
        arm.rotation_mode = "XYZ"
        for frame, angle in ((1, 0.0), (5, 0.8)):
            arm.rotation_euler.z = angle
            arm.keyframe_insert("rotation_euler", frame=frame)
    hands = ((hand.armature, bone_names("right")), (target, map_of("right").bones))
    larger = palm_length(*hands[1]) / palm_length(*hands[0])

    def places(frame):
        return [np.array(bones_at(armature, frame)[names[0]].matrix) for armature, names in hands]

    first = places(3)
    put(target, hand, wrist=wrist, reference=3.0)
    assert np.abs(places(3)[1] - first[1]).max() < 1e-4
    for frame in (4, 5, 8):
        now = places(frame)
        spun = [apart(m[:3, :3], at[:3, :3]) for m, at in zip(now, first, strict=True)]
        assert spun[0] == pytest.approx(spun[1], abs=0.05)
        if wrist == "PLACED":
            gone = [np.linalg.norm(m[:3, 3] - at[:3, 3]) for m, at in zip(now, first, strict=True)]
            assert gone[1] == pytest.approx(larger * gone[0], rel=2e-3)


def test_a_stop_leaves_what_there_was(hand):
    """No keys of the present action are lost before the last step, and a new action goes."""
    target = own_hand()
    motion, count = run_to_completion(reading_motion(hand)), len(bpy.data.actions)
    steps = applying(target, [(map_of("right"), motion)], TransferOptions(contacts=False))
    while len(bpy.data.actions) == count:
        next(steps)
    steps.close()
    assert len(bpy.data.actions) == count
    assert target.animation_data is None
    put(target, hand)
    keys = sum(len(c.keyframe_points) for c in curves_of(target))
    onto = TransferOptions(into="ACTION", contacts=False)
    counts = [
        sum(len(c.keyframe_points) for c in curves_of(target))
        for _ in putting(target, [(map_of("right"), hand)], onto)
    ]
    assert set(counts) == {keys}


def _solo(target):
    target.animation_data.nla_tracks.new().is_solo = True


def _setting(owner: str, name: str, value):
    return lambda target: setattr(getattr(target, owner) if owner else target, name, value)


@pytest.mark.parametrize(
    ("spoil", "options", "said"),
    [
        (_setting("animation_data", "action_blend_type", "COMBINE"), {"into": "ACTION"}, "layer"),
        (_solo, {"into": "NEW"}, "solo"),
        (_solo, {"into": "STRIP"}, "solo"),
        (_setting("animation_data", "use_nla", False), {"into": "NEW"}, "switched off"),
        (lambda _: None, {"into": "STRIP"}, "above every strip"),
        (lambda _: None, {"wrist": "TURNED", "reference": 500.0}, "marked frame"),
        (_setting("", "scale", (-1.0, 1.0, 1.0)), {}, "negative scale"),
        (_setting("data", "pose_position", "REST"), {}, "rest position"),
        (lambda _: bpy.ops.object.mode_set(mode="EDIT"), {}, "Edit Mode"),
    ],
)
def test_what_would_not_be_shown_is_refused(hand, spoil, options, said):
    target = own_hand()
    target.pose.bones[joint_name(5, "right")].keyframe_insert("rotation_quaternion", frame=4)
    data = target.animation_data
    action = data.action
    spoil(target)
    bpy.context.view_layer.update()
    tracks = len(data.nla_tracks)
    with pytest.raises(HandfitError, match=said):
        put(target, hand, **options)
    bpy.ops.object.mode_set(mode="OBJECT")
    assert (data.action, len(data.nla_tracks), len(bpy.data.actions)) == (action, tracks, 2)


@pytest.mark.parametrize("how", ["driver", "muted", "modifier", "constraint"])
def test_what_else_moves_the_captured_hand_counts(hand, how):
    """Keys do not tell what is shown then."""
    bone = hand.armature.pose.bones[bone_names("right")[1]]
    for curve in [c for c in curves_of(hand.armature) if bone.name in c.data_path]:
        if how == "driver":
            curve.keyframe_points.clear()
        elif how == "muted":
            curve.mute = True
        elif how == "modifier":
            curve.modifiers.new("NOISE").strength = 0.3
    if how == "driver":
        bone.driver_add("rotation_quaternion", 1).driver.expression = "0.5"
    elif how == "constraint":
        limit = bone.constraints.new("LIMIT_ROTATION")
        limit.owner_space, limit.use_limit_x, limit.min_x, limit.max_x = "LOCAL", True, 0.3, 0.3
    target, frame = own_hand(), bpy.context.scene.frame_current
    put(target, hand)
    assert bpy.context.scene.frame_current == frame
    assert off(target, hand, 6) < 0.1


def pinched(make_take, side):
    """A captured hand whose thumb and index finger touch in every frame."""
    made = make_take(sides=(side,)).take
    angles = bends(side, "index")
    pose = rotmat_to_rotvec(rotmats_from_angles(angles, anatomical_axes(load_model(None, side)))).ravel()
    track = made.hands[0]
    shape = np.zeros_like(track.betas)
    still = replace(track, hand_pose=np.where(np.isnan(track.hand_pose), np.nan, pose), betas=shape)
    return hand_of(build_take(replace(made, hands=(still,))).hands[0].armature)


def tips_apart(target, side, frame):
    """metres of the captured hand from the thumb's tip to the index finger's, by evaluated bones"""
    bones = bones_at(target, frame)
    ends = [np.array(bones[joint_name(FINGER_JOINTS[f][2], side)].tail) for f in ("thumb", "index")]
    own = SourceHand.of(load_model(None, side).shaped(), side).joints
    smaller = np.linalg.norm(own[4] - own[0]) / palm_length(target, map_of(side).bones)
    return np.linalg.norm(ends[0] - ends[1]) * smaller


@pytest.mark.parametrize("side", ["left", "right"])
def test_fingertips_that_touch_do_so_on_the_character(make_take, side):
    hand = pinched(make_take, side)
    motion = run_to_completion(reading_motion(hand))
    tips = motion.source.points(motion.turns[:1])[1][0]
    wanted = np.linalg.norm(tips[0] - tips[1])
    wrong = {True: [], False: []}
    for seed in range(3):
        for contacts in wrong:
            target = own_hand(side, seed, stretch=0.25)
            done = put(target, hand, side, contacts=contacts)
            wrong[contacts].append(abs(tips_apart(target, side, 3) - wanted))
            assert done.apart < 0.002
            assert done.missed == 0
    assert min(wrong[False]) > 0.004
    assert max(wrong[True]) < 0.001


def test_fingertips_that_cannot_meet_are_told(make_take, capfd):
    hand = pinched(make_take, "right")
    specs = hand_specs("right", np.random.default_rng(0))
    names = [joint_name(joint, "right") for joint in FINGER_JOINTS["thumb"]]
    root = np.array(next(spec.head for spec in specs if spec.name == names[0]))
    for at, spec in enumerate(specs):
        if spec.name in names:
            head, tail = (root + 0.35 * (np.array(point) - root) for point in (spec.head, spec.tail))
            specs[at] = replace(spec, head=head.tolist(), tail=tail.tolist())
    target = build_armature(specs)
    done = put(target, hand, contacts=True)
    assert done.apart > 0.005
    assert done.missed == done.frames
    keep_map(target, map_of("right"))
    target.manient.character.right.source = hand.armature
    assert bpy.ops.manient.apply_to_character() == {"FINISHED"}
    assert f"In {done.frames} frames fingertips that touch do not meet as captured" in capfd.readouterr().out


def index_tip(target, hand, frame: int) -> tuple[np.ndarray, np.ndarray]:
    """Spheres that fill the tip of a character's index finger: their centres (50, 3) and radii (50,) in the
    world's units."""
    bpy.context.scene.frame_set(frame)
    source = SourceHand.of(hand.shaped(), "right", hand.model().name)
    own = target_hand(bones_of(target), map_of("right"), source)
    skins, last = Fingertips.of(hand.model(), hand.betas), own.last("index")
    posed = np.array(target.pose.bones[own.bones[last]].matrix)
    turn = posed[:3, :3] @ own.rest[last].T
    share = np.linspace(0.0, 1.0, 50)[:, None]
    from_tip = (1.0 - share) * skins.ends[1, 0] + share * skins.ends[1, 1] - source.tips[1]
    reach = own.tips[1] - own.heads[last] + own.scale * from_tip @ (own.corrected[last].T @ own.aligned).T
    centres = posed[:3, 3] + reach @ turn.T
    size = own.scale * target.matrix_world.median_scale
    radii = size * ((1.0 - share) * skins.radii[1, 0] + share * skins.radii[1, 1])
    return np.array([target.matrix_world @ Vector(each) for each in centres]), radii[:, 0]


def hung(target, centre, radius: float) -> bpy.types.Object:
    """A ball that a character's hand holds."""
    bpy.ops.mesh.primitive_ico_sphere_add(subdivisions=5, location=centre, rotation=(1.0, 2.0, 3.0))
    ball = bpy.context.object
    ball.scale = [-radius, radius, radius]
    child = ball.constraints.new("CHILD_OF")
    child.target, child.subtarget = target, joint_name(0, "right")
    bone = target.pose.bones[child.subtarget]
    child.inverse_matrix = (target.matrix_world @ bone.matrix).inverted()
    bpy.context.view_layer.update()
    return ball


@pytest.mark.parametrize(("gap", "is_open"), [(0.004, False), (-0.005, False), (0.004, True)])
def test_fingertips_lie_on_what_the_hand_holds(make_take, gap, is_open):
    """From the frame on in which it takes it; the rest stays bit for bit."""
    hand, target = captured(make_take), own_hand(stretch=0.1)
    placed(target, np.random.default_rng(4), 30.0)
    put(target, hand, contacts=True)
    before, alone = ([curve.evaluate(frame) for curve in curves_of(target)] for frame in (8, 14))
    centres, radii = index_tip(target, hand, 14)
    size = radii[25] / Fingertips.of(hand.model(), hand.betas).radii[1].mean()
    palm = np.array(target.matrix_world @ target.pose.bones[joint_name(0, "right")].center)
    towards = (palm - centres[25]) / np.linalg.norm(palm - centres[25])
    ball = hung(target, centres[25] + towards * (radii[25] + (0.02 + gap) * size), 0.02 * size)
    child = ball.constraints[0]
    for frame, influence in ((11, 0.0), (12, 1.0)):
        child.influence = influence
        child.keyframe_insert("influence", frame=frame)

    def gap_now() -> float:
        centres, radii = index_tip(target, hand, 14)
        away = np.linalg.norm(centres - np.array(ball.matrix_world.translation), axis=1)
        return (away - radii).min() / size - 0.02

    if is_open:
        mesh = bmesh.new()
        mesh.from_mesh(ball.data)
        bmesh.ops.delete(mesh, geom=mesh.faces[:1], context="FACES_ONLY")
        mesh.to_mesh(ball.data)
    assert abs(gap_now()) > 0.002
    put(target, hand, contacts=True)
    assert abs(gap_now()) < 0.001
    assert [curve.evaluate(8) for curve in curves_of(target)] == before
    assert ball in CharacterObjects.of(target).meshes
    for child.mute, bone in ((True, 0), (False, FINGER_JOINTS["index"][0])):
        child.subtarget = joint_name(bone, "right")
        put(target, hand, contacts=True)
        assert [curve.evaluate(14) for curve in curves_of(target)] == alone
    child.subtarget = joint_name(0, "right")
    ball.data.clear_geometry()
    put(target, hand, contacts=True)
    assert [curve.evaluate(14) for curve in curves_of(target)] == alone
