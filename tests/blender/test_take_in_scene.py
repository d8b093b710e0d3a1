"""Keys, properties, timing and tidiness of what `build_take` leaves in a scene."""

from __future__ import annotations

from dataclasses import replace

import bpy
import numpy as np
import pytest
from bpy_extras.object_utils import world_to_camera_view
from mathutils import Vector

from blender_manient.rigs.captured_hand import bone_names
from blender_manient.scene.build import build_take
from blender_manient.scene.keys import CURVES
from blender_manient.scene.store import is_of_other_model
from handfit_core.geometry.camera import Intrinsics
from handfit_core.hand_model import load_model
from handfit_core.media.source import Source

from .conftest import FRAMES, HEIGHT, UNSEEN, WIDTH, action_curves, evaluated_vertices, joint_heads, world


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
        assert len(curves) == CURVES == 16 * 4 + 3
        assert all(c.data_path.startswith("pose.bones[") for c in curves)
        assert {c.group.name for c in curves} == set(bone_names(hand.side))
        for curve in curves:
            np.testing.assert_array_equal(keys_of(curve)[:, 0], expected)
            assert all(k.interpolation == "LINEAR" for k in curve.keyframe_points)
            assert not np.isnan(keys_of(curve)).any()
        assert hand.armature.animation_data.action == hand.action


def test_filled_frames_are_keyed(make_take):
    """The pose of a bridged gap is animated."""
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
        np.testing.assert_array_equal(keys_of(curve)[:, 0], FRAMES)
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


def test_armature_says_where_it_comes_from(make_take):
    made = make_take(sides=("right",))
    armature = build_take(made.take).hands[0].armature
    track = made.take.hands[0]
    assert armature["side"] == "right"
    assert armature["model"] == "open-hand"
    assert armature["solver"] == "paper-a"
    assert armature["source"] == made.take.source.files[0]
    np.testing.assert_allclose(list(armature["betas"]), track.betas)


@pytest.mark.parametrize("fps", [24.0, 25.0, 30.0, 30000 / 1001, 24000 / 1001, 59.94, 12.5, 240.0, 0.5])
def test_frame_rate(make_take, fps):
    build_take(make_take(sides=("left",), fps=fps).take)
    render = bpy.context.scene.render
    assert render.fps / render.fps_base == pytest.approx(fps, rel=1e-6)
    if fps == 30000 / 1001:
        assert (render.fps, render.fps_base) == (30, pytest.approx(1.001))


def test_scene_gets_range_size_and_camera(make_take):
    built = build_take(make_take().take, render_setup=False)
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
    take = make_take(model_digests={"left": "0" * 16, "right": "0" * 16}).take
    models = [load_model(take.model, hand.side) for hand in take.hands]
    assert not build_take(take).warnings, "its joints are where they were; only the skin can differ"
    assert not any(map(is_of_other_model, [take] * 2, take.hands, models))
    larger = tuple(replace(hand, joints_3d=1.01 * hand.joints_3d) for hand in take.hands)
    warnings = build_take(replace(take, hands=larger)).warnings
    assert len(warnings) == 2
    assert all("another version" in w for w in warnings)
    assert all(map(is_of_other_model, [take] * 2, larger, models)), "the panel goes by it"


def test_a_single_picture_leaves_the_timeline_as_it_is(make_take):
    scene = bpy.context.scene
    scene.frame_end, scene.render.fps = 120, 50
    made = make_take(frame_numbers=np.array([7]))
    built = build_take(made.take)
    assert (scene.frame_start, scene.frame_end, scene.render.fps, scene.frame_current) == (1, 120, 50, 7)
    assert all(len(c.keyframe_points) == 1 for c in action_curves(built.hands[0].action))


def picture_error(made, built, frames) -> float:
    """Largest distance in pixels of the picture between where the scene's camera sees a joint, with the
    picture's full width over the frame's, and where the take has it. `frames`: scene frame of each row, NaN
    for those that are passed over."""
    scene = bpy.context.scene
    render, k = scene.render, made.take.intrinsics
    aspect = render.resolution_x * render.pixel_aspect_x / (render.resolution_y * render.pixel_aspect_y)
    worst = 0.0
    for row in (row for row, _ in made.seen if np.isfinite(frames[row])):
        scene.frame_set(int(frames[row]), subframe=float(frames[row] % 1.0))
        for hand in built.hands:
            expected = k.project(made.joints[hand.side][row])
            for head, pixel in zip(joint_heads(hand.armature, hand.side), expected, strict=True):
                view = world_to_camera_view(scene, built.camera, Vector(head))
                # Heights in square pixels are picture heights times fx / fy.
                up = (view.y - 0.5) * WIDTH / aspect * k.fy / k.fx
                found = np.array([view.x * WIDTH, HEIGHT / 2 - up])
                worst = max(worst, float(np.linalg.norm(found - pixel)))
    print(f"worst projection error {worst:.5f} px")
    return worst


def settings() -> tuple:
    scene, render = bpy.context.scene, bpy.context.scene.render
    return (
        (scene.frame_start, scene.frame_end, scene.frame_current, scene.camera, render.fps, render.fps_base),
        (render.resolution_x, render.resolution_y, render.pixel_aspect_x, render.pixel_aspect_y),
    )


@pytest.mark.parametrize("size", [(1920, 1080, 1.0, 1.0), (1080, 1920, 1.0, 1.0), (720, 576, 1.0, 1.5)])
def test_an_unmatched_scene_stays_as_it_is(make_take, size):
    scene, render = bpy.context.scene, bpy.context.scene.render
    scene.frame_start, scene.frame_end, scene.frame_current = 50, 90, 61
    render.fps = 30
    render.resolution_x, render.resolution_y, render.pixel_aspect_x, render.pixel_aspect_y = size
    before = settings()
    made = make_take(fps=24.0)  # a photo has no rate of its own
    built = build_take(made.take, match_scene=False)
    assert settings() == before
    assert built.warnings == ()
    frames = 61 + FRAMES - FRAMES[0]
    for hand in built.hands:
        for curve in action_curves(hand.action):
            np.testing.assert_allclose(keys_of(curve)[:, 0], np.delete(frames, UNSEEN))
    assert picture_error(made, built, frames) < 0.05

    background = built.camera.data.background_images[0]
    k = made.take.intrinsics
    picture = WIDTH / (HEIGHT * k.fx / k.fy)
    frame = size[0] * size[2] / (size[1] * size[3])
    # FIT lets the longer side touch the frame, CROP the shorter: the picture must touch left and right.
    assert background.frame_method == ("FIT" if picture > frame else "CROP")
    assert background.image.display_aspect[1] / background.image.display_aspect[0] == pytest.approx(
        k.fx / k.fy
    )


def test_a_video_is_retimed_to_the_scenes_rate(make_take, picture):
    scene = bpy.context.scene
    scene.render.fps = 24
    scene.frame_set(101)
    made = make_take(source=Source("video", (str(picture),)), fps=30.0)
    built = build_take(made.take, match_scene=False, picture=False)
    frames = np.arange(101, 101 + int((FRAMES[-1] - FRAMES[0]) * 24 / 30) + 1)
    pictures = np.floor(FRAMES[0] + (frames - 101) * 30 / 24 + 0.5)
    keyed = frames[np.isin(pictures, np.delete(FRAMES, UNSEEN))]
    for curve in action_curves(built.hands[0].action):
        np.testing.assert_array_equal(keys_of(curve)[:, 0], keyed)
    # Every fifth picture falls on a whole frame.
    on = np.flatnonzero((FRAMES - FRAMES[0]) % 5 == 0)
    every = np.full(len(FRAMES), np.nan)
    every[on] = 101 + (FRAMES[on] - FRAMES[0]) * 24 / 30
    assert picture_error(made, built, every) < 0.05


def test_an_unmatched_sequence_shows_its_first_file_at_the_first_keys(make_take, tmp_path, picture):
    numbers = np.array([8, 9, 11, 12])
    files = []
    for number in range(8, 13):
        path = tmp_path / f"shot.{number:04d}.png"
        path.write_bytes(picture.read_bytes())
        files += [str(path)] if number in numbers else []
    bpy.context.scene.frame_set(108)
    made = make_take(source=Source("sequence", tuple(files)), frame_numbers=numbers)
    built = build_take(made.take, match_scene=False)
    assert built.warnings == ()
    user = built.camera.data.background_images[0].image_user
    # Blender shows file (scene frame - start + 1 + offset): 108 shows 8.
    assert (user.frame_start, user.frame_offset, user.frame_duration) == (108, 7, 5)


@pytest.mark.parametrize("metres_per_unit", [0.01, 1.0, 0.0254, 1000.0])
def test_hands_are_life_size_in_any_unit(make_take, model, metres_per_unit):
    bpy.context.scene.unit_settings.scale_length = metres_per_unit
    made = make_take(model=model)
    built = build_take(made.take)
    row, frame = made.seen[2]
    bpy.context.scene.frame_set(frame)
    for hand in built.hands:
        metres = joint_heads(hand.armature, hand.side) * metres_per_unit
        np.testing.assert_allclose(metres, world(made.joints[hand.side][row]), atol=1e-5)
        vertices = evaluated_vertices(hand.mesh) * metres_per_unit
        np.testing.assert_allclose(vertices, world(made.vertices[hand.side][row]), atol=1e-4)
        depth = vertices[:, 1] / metres_per_unit
        assert built.camera.data.clip_start < depth.min() < depth.max() < built.camera.data.clip_end
    assert picture_error(made, built, FRAMES) < 0.05


@pytest.mark.parametrize("metres_per_unit", [1.0, 0.01])
def test_hands_hang_on_a_camera_that_is_there(make_take, metres_per_unit):
    """Moved, turned and scaled; its lens is what the take was captured with, as `lens_of_camera` tells."""
    scene = bpy.context.scene
    scene.unit_settings.scale_length = metres_per_unit
    scene.render.resolution_x, scene.render.resolution_y = WIDTH, HEIGHT
    camera = bpy.data.objects.new("Artist's", bpy.data.cameras.new("Artist's"))
    scene.collection.objects.link(camera)
    camera.location, camera.rotation_euler, camera.scale = (3.0, -2.0, 1.5), (1.2, 0.1, -0.7), (2.0, 2.0, 2.0)
    bpy.context.view_layer.update()
    focal = camera.data.lens / camera.data.sensor_width * WIDTH
    made = make_take(intrinsics=Intrinsics(focal, focal, WIDTH / 2, HEIGHT / 2))
    built = build_take(made.take, camera=camera)
    assert built.camera == camera
    assert [o for o in bpy.data.objects if o.type == "CAMERA"] == [camera]
    assert scene.camera is None
    assert len(camera.data.background_images) == 1
    assert picture_error(made, built, FRAMES) < 0.05
    camera.location.x += 5.0
    assert picture_error(made, built, FRAMES) < 0.05
    build_take(made.take, camera=camera)
    assert len(camera.data.background_images) == 1, "the same picture is not shown twice"
    assert len(bpy.data.images) == 1
