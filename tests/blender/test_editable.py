"""What cannot be changed is left alone, and says why: links, overrides, the NLA, locks, shared actions."""

from __future__ import annotations

import bpy
import numpy as np
import pytest

from blender_manient.common.blender_versions import channels
from blender_manient.operators.export import MANIENT_OT_export_hand
from blender_manient.rigs import rig_of
from blender_manient.rigs.captured_hand import bone_names
from blender_manient.scene import corrections, reshape
from blender_manient.scene.apply import apply_track
from blender_manient.scene.build import build_take
from blender_manient.scene.editable import why_not_editable, why_not_keyable
from blender_manient.scene.keys import PoseKeys, displayed_pose, pose_at, read_pose_keys, write_pose_keys
from blender_manient.scene.store import captured_hands, hand_of
from blender_manient.session.refiner import why_not
from handfit_core.errors import HandModelError, OptionError

from .test_corrections import correct, moved_pose, refitted, same_rotations

pytestmark = pytest.mark.usefixtures("registered")


@pytest.fixture
def made(make_take):
    return make_take(sides=("right",))


@pytest.fixture
def armature(made):
    armature = build_take(made.take).hands[0].armature
    bpy.context.view_layer.objects.active = armature
    armature.select_set(True)
    return armature


def shown(armature, frame: int) -> np.ndarray:
    """What the bones show on a frame, from wherever the motion is."""
    bpy.context.scene.frame_set(frame)
    return displayed_pose(rig_of(armature))


def pushed_down(armature) -> bpy.types.Action:
    data = armature.animation_data
    action = data.action
    slot = getattr(data, "action_slot", None)
    strip = data.nla_tracks.new().strips.new("motion", int(action.frame_range[0]), action)
    if slot is not None:
        strip.action_slot = slot
    data.action = None
    return action


def curves(armature):
    data = armature.animation_data
    return channels(data.action, getattr(data, "action_slot", None)).fcurves


def test_motion_in_the_nla_is_not_hidden_by_a_key(armature, made):
    before = [shown(armature, f) for f in (4, 8, 16)]
    pushed_down(armature)
    np.testing.assert_allclose([shown(armature, f) for f in (4, 8, 16)], before, atol=1e-5)
    assert "NLA" in (why_not_keyable(armature) or "")
    assert why_not_editable(armature) is None
    for operator in ("apply_pose", "refit_range", "edit_keypoints"):
        assert not getattr(bpy.ops.manient, operator).poll()
    with pytest.raises(RuntimeError, match="in the NLA"):
        bpy.ops.manient.apply_pose(pose="Relaxed")
    for change in (
        lambda: correct(armature),
        lambda: refitted(armature, [5, 6]),
        lambda: apply_track(armature, made.take, made.take.hands[0], "POSE", 8.0),
    ):
        with pytest.raises(OptionError, match="in the NLA"):
            change()
    assert armature.animation_data.action is None
    np.testing.assert_allclose([shown(armature, f) for f in (4, 8, 16)], before, atol=1e-5)
    # A whole motion may lie over the strips.
    assert apply_track(armature, made.take, made.take.hands[0], "ANIMATION", 1.0) == 11
    assert why_not_keyable(armature) is None


def test_clearing_all_while_the_motion_is_in_the_nla_only_forgets(armature):
    correct(armature)
    before = shown(armature, 6)
    pushed_down(armature)
    with pytest.raises(RuntimeError, match="cannot be changed: the motion is in the NLA"):
        bpy.ops.manient.clear_corrections(scope="RANGE")
    assert bpy.ops.manient.clear_corrections(scope="ALL") == {"FINISHED"}
    assert armature.manient.corrections == ""
    np.testing.assert_allclose(shown(armature, 6), before, atol=1e-5)


def test_tweak_mode(armature):
    pushed_down(armature)
    data = armature.animation_data
    data.nla_tracks[0].select = data.nla_tracks[0].strips[0].select = True
    data.nla_tracks.active = data.nla_tracks[0]
    data.use_tweak_mode = True
    assert data.use_tweak_mode
    assert "tweak mode" in (why_not_keyable(armature) or "")
    with pytest.raises(OptionError, match="tweak mode"):
        correct(armature)


def test_a_library_override_says_so(armature, tmp_path):
    correct(armature)
    collection = armature.manient.capture.name
    path = str(tmp_path / "library.blend")
    bpy.ops.wm.save_as_mainfile(filepath=path)
    bpy.ops.wm.read_factory_settings(use_empty=True)
    with bpy.data.libraries.load(path, link=True) as (_, wanted):
        wanted.collections = [collection]
    linked = wanted.collections[0]
    bpy.context.scene.collection.children.link(linked)
    hand = captured_hands(bpy.context.scene)[0]
    assert "linked" in (why_not_editable(hand) or "")
    linked.override_hierarchy_create(bpy.context.scene, bpy.context.view_layer, do_fully_editable=True)
    hand = next(o for o in bpy.context.scene.objects if o.type == "ARMATURE" and o.override_library)
    bpy.context.view_layer.objects.active = hand
    assert "library override" in (why_not_editable(hand) or "")
    for operator in ("apply_pose", "lock_joints", "clear_corrections", "mirror_hand", "apply_take"):
        assert not getattr(bpy.ops.manient, operator).poll(), operator
    assert "library override" in (why_not(bpy.context, hand_of(hand)) or "")
    assert bpy.ops.manient.save_pose_asset() == {"FINISHED"}
    with pytest.raises(OptionError, match="library override"):
        correct(hand)
    hand.manient.betas[0] += 1.0
    assert "library override" in (reshape.trouble(hand) or "")


def test_a_linked_action_says_so(armature, tmp_path):
    name = armature.animation_data.action.name
    path = str(tmp_path / "library.blend")
    bpy.data.libraries.write(path, {armature.animation_data.action})
    with bpy.data.libraries.load(path, link=True) as (_, wanted):
        wanted.actions = [name]
    armature.animation_data.action = wanted.actions[0]
    assert "make the action local" in (why_not_keyable(armature) or "")
    assert not bpy.ops.manient.apply_pose.poll()
    assert bpy.ops.manient.lock_joints.poll()


def test_locked_channels_are_not_overwritten(armature, made):
    before = read_pose_keys(rig_of(armature))
    bone = bone_names("right")[5]
    for curve in curves(armature):
        if f'"{bone}"' in curve.data_path:
            curve.lock = True
    bpy.context.scene.frame_set(6)
    with pytest.raises(RuntimeError, match=f"bone {bone} .* are locked"):
        bpy.ops.manient.apply_pose(pose="Relaxed")
    for change in (
        lambda: correct(armature),
        lambda: refitted(armature, [5, 6]),
        lambda: apply_track(armature, made.take, made.take.hands[0], "ANIMATION", 1.0),
        lambda: write_pose_keys(rig_of(armature), PoseKeys.everywhere(np.array([6.0]), before.quats[:1])),
    ):
        with pytest.raises(OptionError, match=f"bone {bone} .* are locked"):
            change()
    after = read_pose_keys(rig_of(armature))
    np.testing.assert_array_equal(after.quats, before.quats)
    np.testing.assert_array_equal(after.locations, before.locations)
    assert armature.manient.corrections == ""
    # Its neighbours may be written.
    chosen = np.zeros((1, 16), dtype=bool)
    chosen[0, 6] = True
    keys = PoseKeys(np.array([6.0]), before.quats[:1], np.zeros((1, 3)), chosen, np.zeros(1, dtype=bool))
    write_pose_keys(rig_of(armature), keys)


def test_a_locked_group_counts_too(armature):
    curves(armature)[0].group.lock = True
    with pytest.raises(OptionError, match="are locked"):
        correct(armature)


def test_renamed_bones_are_one_sentence(armature, made):
    bone = bone_names("right")[8]
    armature.data.bones[bone].name = "pinky"
    for operator in ("apply_pose", "mirror_hand", "save_pose_asset", "apply_take", "refit_range"):
        assert not getattr(bpy.ops.manient, operator).poll(), operator
    with pytest.raises(RuntimeError, match=f"lacks the bone {bone}"):
        bpy.ops.manient.apply_pose(pose="Relaxed")
    with pytest.raises(HandModelError, match=f"lacks the bone {bone}"):
        pose_at(rig_of(armature), np.array([4.0]))
    with pytest.raises(HandModelError, match="give its bones their names back"):
        apply_track(armature, made.take, made.take.hands[0], "POSE", 8.0)

    # Those that only read, as exports, say so too.
    assert bone in (MANIENT_OT_export_hand.lacks(bpy.context) or "")


def test_linked_duplicates_do_not_move_each_other(armature, made):
    before = read_pose_keys(rig_of(armature))
    bpy.ops.object.duplicate(linked=True)
    twin = bpy.context.view_layer.objects.active
    assert twin.animation_data.action == armature.animation_data.action
    bpy.context.scene.frame_set(6)
    assert bpy.ops.manient.apply_pose(pose="Relaxed") == {"FINISHED"}
    assert twin.animation_data.action != armature.animation_data.action
    np.testing.assert_array_equal(read_pose_keys(rig_of(armature)).quats, before.quats)
    assert same_rotations(read_pose_keys(rig_of(twin)).quats, before.quats) > 0.05


def test_reshaping_a_duplicate_leaves_strips_of_the_other_alone(armature):
    pushed_down(armature)
    bpy.ops.object.duplicate(linked=True)
    twin = bpy.context.view_layer.objects.active
    strips = [o.animation_data.nla_tracks[0].strips[0] for o in (armature, twin)]
    assert strips[0].action == strips[1].action
    before = [shown(armature, f) for f in (4, 14)]
    span = strips[1].frame_start, strips[1].frame_end
    twin.manient.betas = [2.0, -2.0, 1.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]
    assert reshape.trouble(twin) is None
    strips = [o.animation_data.nla_tracks[0].strips[0] for o in (armature, twin)]
    assert strips[0].action != strips[1].action
    assert (strips[1].frame_start, strips[1].frame_end) == span
    np.testing.assert_array_equal([shown(armature, f) for f in (4, 14)], before)
    assert np.abs(shown(twin, 4) - before[0]).max() > 1e-4


def test_a_relaxed_pose_beside_a_correction_outlives_it(armature):
    captured = read_pose_keys(rig_of(armature))
    correct(armature, 6)
    wrist = pose_at(rig_of(armature), np.array([8.0]))
    bpy.context.scene.frame_set(8)
    assert bpy.ops.manient.apply_pose(pose="Relaxed") == {"FINISHED"}
    relaxed, place = pose_at(rig_of(armature), np.array([8.0]))
    assert same_rotations(relaxed[:, 0], wrist[0][:, 0]) < 1e-5
    np.testing.assert_allclose(place, wrist[1], atol=1e-6)
    corrections.clear_corrections(armature, [6])
    # As with every correction, its frame stays what it was when that was made.
    now, there = pose_at(rig_of(armature), np.array([8.0]))
    assert same_rotations(now, relaxed) < 1e-5
    np.testing.assert_allclose(there, place, atol=1e-6)
    assert corrections.corrected_frames(armature) == [8]
    corrections.clear_corrections(armature)
    assert same_rotations(read_pose_keys(rig_of(armature)).quats, captured.quats) < 1e-5
    assert armature.manient.corrections == ""


@pytest.mark.parametrize("frame", [8.0, 9.5])
def test_an_applied_pose_beside_a_correction_outlives_it(armature, made, frame):
    captured = read_pose_keys(rig_of(armature))
    correct(armature, 6)
    apply_track(armature, made.take, made.take.hands[0], "POSE", frame, source_frame=16)
    applied, place = pose_at(rig_of(armature), np.array([frame]))
    corrections.clear_corrections(armature)
    now, there = pose_at(rig_of(armature), np.array([frame]))
    assert same_rotations(now, applied) < 1e-5
    np.testing.assert_allclose(there, place, atol=1e-6)
    keys = read_pose_keys(rig_of(armature))
    same = np.isin(keys.frames, captured.frames) & (keys.frames != frame)
    assert (
        same_rotations(keys.quats[same], captured.quats[np.isin(captured.frames, keys.frames[same])]) < 1e-5
    )


def test_unreadable_corrections_change_no_shape(armature):
    mesh = hand_of(armature).mesh

    def vertices() -> np.ndarray:
        return np.array([v.co[:] for v in mesh.data.vertices])

    before, heads = vertices(), [tuple(b.head_local) for b in armature.data.bones]
    armature.manient.corrections = "{bad"
    for step in (0.5, 1.0):
        armature.manient.betas[0] += step
        np.testing.assert_array_equal(vertices(), before)
        assert [tuple(b.head_local) for b in armature.data.bones] == heads
        assert "corrections" in (reshape.trouble(armature) or "")
    corrections.forget_corrections(armature)
    armature.manient.betas[0] += 0.1
    assert np.abs(vertices() - before).max() > 1e-4


def test_reshaping_turns_what_pins_began_with(armature):
    """A second correction still starts from the same pose of the fingers."""
    correct(armature, 5)
    quats, location = moved_pose(armature, 6, seed=3, size=0.4)
    corrections.correct_frames(armature, [6], quats[None], location[None], 6.0, pins=[{4: (1.0, 2.0)}])
    before = corrections.corrections_of(armature).corrections[6]

    old = rig_of(armature).rest.frames
    armature.manient.betas = [3.0, -3.0, 2.0, 2.0, -2.0, 0.0, 0.0, 0.0, 0.0, 0.0]
    turn = np.swapaxes(rig_of(armature).rest.frames, -1, -2) @ old
    after = corrections.corrections_of(armature).corrections[6]
    assert np.abs(before.start_rotation).max() > 0.01
    expected = (turn @ before.start_rotation[..., None])[..., 0]
    np.testing.assert_allclose(after.start_rotation, expected, atol=1e-6)
    np.testing.assert_allclose(after.start_location, turn[0] @ before.start_location, atol=1e-6)
    np.testing.assert_allclose(after.rotation, (turn @ before.rotation[..., None])[..., 0], atol=1e-6)
    np.testing.assert_allclose(after.location, turn[0] @ before.location, atol=1e-6)
    assert corrections.why_elsewhere(armature) is None
