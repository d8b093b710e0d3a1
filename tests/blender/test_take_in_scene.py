"""Keys, properties, timing and tidiness of what `build_take` leaves in a scene."""

from __future__ import annotations

from dataclasses import replace

import bpy
import numpy as np
import pytest

from blender_manient.scene.animation import ERROR_PROPERTY, action_curves
from blender_manient.scene.armature import bone_names
from blender_manient.scene.build import build_take
from handfit_core.errors import HandModelError, OptionError
from handfit_core.hand_model import load_model

from .conftest import FRAMES, UNSEEN, joint_heads, world


def keys_of(curve) -> np.ndarray:
    """(N, 2) frame and value of each key."""
    co = np.empty((len(curve.keyframe_points), 2), dtype=np.float32)
    curve.keyframe_points.foreach_get("co", co.ravel())
    return co


def test_keys_lie_on_the_sources_frames(make_take):
    built = build_take(make_take().take)
    expected = np.delete(FRAMES, UNSEEN)
    for hand in built.hands:
        curves = action_curves(hand.action)
        assert len(curves) == 16 * 4 + 3 + 1
        for curve in curves:
            np.testing.assert_array_equal(keys_of(curve)[:, 0], expected)
            assert all(k.interpolation == "LINEAR" for k in curve.keyframe_points)
            assert not np.isnan(keys_of(curve)).any()
        assert hand.armature.animation_data.action == hand.action


def test_filled_frames_are_keyed_but_have_no_error(make_take):
    """The pose of a bridged gap is animated; there is nothing that it could be measured against."""
    made = make_take(sides=("right",))
    track = made.take.hands[0]
    pose = {}
    for name in ("global_orient", "hand_pose", "transl", "joints_3d"):
        values = np.array(getattr(track, name))
        values[UNSEEN] = (values[UNSEEN - 1] + values[UNSEEN + 1]) / 2
        pose[name] = values
    filled = np.arange(len(FRAMES)) == UNSEEN
    bridged = replace(made.take, hands=(replace(track, **pose, filled=filled),))
    (hand,) = build_take(bridged).hands
    for curve in action_curves(hand.action):
        measured = curve.data_path == f'["{ERROR_PROPERTY}"]'
        expected = np.delete(FRAMES, UNSEEN) if measured else FRAMES
        np.testing.assert_array_equal(keys_of(curve)[:, 0], expected)
        assert not np.isnan(keys_of(curve)).any()
    # The wrist stands there where the take says.
    bpy.context.scene.frame_set(int(FRAMES[UNSEEN]))
    model = load_model("open-hand", "right")
    wrist = model.shaped(track.betas).joints[0] + pose["transl"][UNSEEN]
    np.testing.assert_allclose(joint_heads(hand.armature, "right")[0], world(wrist), atol=1e-5)


def test_quaternions_never_flip(make_take):
    built = build_take(make_take().take)
    for hand in built.hands:
        for bone in bone_names(hand.side):
            path = f'pose.bones["{bone}"].rotation_quaternion'
            curves = sorted(
                (c for c in action_curves(hand.action) if c.data_path == path), key=lambda c: c.array_index
            )
            quats = np.stack([keys_of(c)[:, 1] for c in curves], axis=-1)
            np.testing.assert_allclose(np.linalg.norm(quats, axis=-1), 1.0, atol=1e-5)
            assert (np.sum(quats[1:] * quats[:-1], axis=-1) >= 0).all()


def test_curves_are_grouped_by_bone(make_take):
    hand = build_take(make_take(sides=("left",)).take).hands[0]
    groups = {c.group.name for c in action_curves(hand.action)}
    assert groups == {*bone_names("left"), "Capture"}


def test_armature_says_where_it_comes_from(make_take):
    made = make_take(sides=("right",))
    armature = build_take(made.take).hands[0].armature
    track = made.take.hands[0]
    assert armature["side"] == "right"
    assert armature["model"] == "open-hand"
    assert armature["solver"] == "paper-a"
    assert armature["source"] == made.take.source.files[0]
    np.testing.assert_allclose(list(armature["betas"]), track.betas)
    row, frame = made.seen[2]
    bpy.context.scene.frame_set(frame)
    assert armature["reprojection_error_px"] == pytest.approx(track.reprojection_error[row], abs=1e-5)


@pytest.mark.parametrize("fps", [24.0, 25.0, 30.0, 30000 / 1001, 24000 / 1001, 59.94, 12.5, 240.0, 0.5])
def test_frame_rate(make_take, fps):
    build_take(make_take(sides=("left",), fps=fps).take)
    render = bpy.context.scene.render
    assert render.fps / render.fps_base == pytest.approx(fps, rel=1e-6)
    if fps == 30000 / 1001:
        assert (render.fps, render.fps_base) == (30, pytest.approx(1.001))


def test_scene_gets_range_size_and_camera(make_take):
    built = build_take(make_take().take)
    scene = bpy.context.scene
    assert (scene.frame_start, scene.frame_end, scene.frame_current) == (3, 18, 3)
    assert (scene.render.resolution_x, scene.render.resolution_y) == (160, 120)
    assert scene.camera == built.camera
    assert set(built.collection.all_objects) == {
        built.camera,
        *(h.armature for h in built.hands),
        *(h.mesh for h in built.hands),
    }


def test_building_twice_disturbs_nothing(make_take):
    bpy.ops.mesh.primitive_cube_add()
    cube = bpy.context.object
    made = make_take()
    first = build_take(made.take)
    snapshot = _snapshot(first)
    second = build_take(made.take)
    assert first.collection.name == "photo of a hand"
    assert second.collection.name == "photo of a hand.001"
    assert not set(first.collection.all_objects) & set(second.collection.all_objects)
    assert {h.action for h in first.hands}.isdisjoint(h.action for h in second.hands)
    assert _snapshot(first) == snapshot
    assert bpy.context.view_layer.objects.active == cube
    assert cube.select_get()
    assert bpy.context.mode == "OBJECT"


def _snapshot(built) -> list:
    return [
        (o.name, o.data.name, o.parent and o.parent.name, [list(row) for row in o.matrix_world])
        for o in built.collection.all_objects
    ] + [(h.action.name, [keys_of(c).tolist() for c in action_curves(h.action)]) for h in built.hands]


def test_other_model_version_is_a_warning(make_take):
    made = make_take(model_digests={"left": "0" * 16, "right": "0" * 16})
    warnings = build_take(made.take).warnings
    assert len(warnings) == 2
    assert all("another version" in w for w in warnings)


def test_a_missing_model_leaves_nothing_behind(make_take, tmp_path):
    made = make_take()
    with pytest.raises(HandModelError):
        build_take(made.take, model=str(tmp_path / "nowhere"))
    assert not bpy.data.objects
    assert not bpy.data.collections


def test_a_scene_that_is_not_open_is_refused(make_take):
    other = bpy.data.scenes.new("Other")
    with pytest.raises(OptionError, match="Other"):
        build_take(make_take().take, scene=other)


def test_single_photo(make_take):
    made = make_take(frame_numbers=np.array([1]))
    built = build_take(made.take)
    assert (bpy.context.scene.frame_start, bpy.context.scene.frame_end) == (1, 1)
    assert all(len(c.keyframe_points) == 1 for c in action_curves(built.hands[0].action))
