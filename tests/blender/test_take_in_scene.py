"""Keys, properties, timing and tidiness of what `build_take` leaves in a scene."""

from __future__ import annotations

from dataclasses import replace

import bpy
import numpy as np
import pytest
from bpy_extras.object_utils import world_to_camera_view
from mathutils import Quaternion, Vector

from blender_manient.rigs import rig_of
from blender_manient.rigs.captured_hand import bone_names
from blender_manient.scene.build import build_take
from blender_manient.scene.keys import CURVES, read_pose_keys
from handfit_core.common.skeleton import FINGER_JOINTS, JOINT_NAMES, NUM_JOINTS
from handfit_core.geometry.camera import Intrinsics
from handfit_core.hand_model import load_model

from .conftest import FRAMES, HEIGHT, UNSEEN, WIDTH, evaluated_vertices, joint_heads, world
from .looking import curves_of, keyed_bones


def key_frames(armature) -> list[list[float]]:
    """The frames of the keys of each curve."""
    return [[key.co[0] for key in curve.keyframe_points] for curve in curves_of(armature)]


def test_keys_lie_on_the_sources_frames(make_take):
    """Linear, with quaternions that never flip."""
    for hand in build_take(make_take().take).hands:
        curves = curves_of(hand.armature)
        assert len(curves) == CURVES == 16 * 4 + 3
        assert key_frames(hand.armature) == [np.delete(FRAMES, UNSEEN).tolist()] * CURVES
        assert {c.group.name for c in curves} == keyed_bones(hand.armature) == set(bone_names(hand.side))
        assert {key.interpolation for curve in curves for key in curve.keyframe_points} == {"LINEAR"}
        quats = read_pose_keys(rig_of(hand.armature)).quats
        np.testing.assert_allclose(np.linalg.norm(quats, axis=-1), 1.0, atol=1e-5)
        assert (np.sum(quats[1:] * quats[:-1], axis=-1) >= 0).all()
        assert hand.armature.animation_data.action == hand.action


def test_filled_frames_are_keyed(make_take):
    """The pose of a bridged gap is animated."""
    made = make_take(sides=("right",))
    track, around = made.take.hands[0], [UNSEEN - 1, UNSEEN + 1]
    pose = {n: np.array(getattr(track, n)) for n in ("global_orient", "hand_pose", "transl", "joints_3d")}
    for values in pose.values():
        values[UNSEEN] = values[around].mean(axis=0)
    filled = np.arange(len(FRAMES)) == UNSEEN
    (hand,) = build_take(replace(made.take, hands=(replace(track, **pose, filled=filled),))).hands
    assert key_frames(hand.armature) == [FRAMES.tolist()] * CURVES
    # The wrist stands there where the take says.
    bpy.context.scene.frame_set(int(FRAMES[UNSEEN]))
    wrist = load_model("open-hand", "right").shaped(track.betas).joints[0] + pose["transl"][UNSEEN]
    np.testing.assert_allclose(joint_heads(hand.armature, "right")[0], world(wrist), atol=1e-5)


@pytest.mark.parametrize("fps", [30000 / 1001, 59.94, 240.0, 0.5])
def test_frame_rate(make_take, fps):
    build_take(make_take(sides=("left",), fps=fps).take)
    render = bpy.context.scene.render
    assert render.fps / render.fps_base == pytest.approx(fps, rel=1e-6)
    if fps == 30000 / 1001:
        assert (render.fps, render.fps_base) == (30, pytest.approx(1.001))


def test_a_scene_gets_range_size_camera_and_nothing_else(make_take):
    """Also the second time."""
    bpy.ops.mesh.primitive_cube_add()
    cube, scene, take = bpy.context.object, bpy.context.scene, make_take().take
    captures, before = [], []
    for _ in range(2):
        built = build_take(take, render_setup=False)
        captures.append(built)
        before.append([(o.name, o.matrix_world.copy()) for o in captures[0].collection.all_objects])
        assert (scene.frame_start, scene.frame_end, scene.frame_current) == (3, 18, 3)
        assert (scene.render.resolution_x, scene.render.resolution_y) == (160, 120)
        assert scene.camera == built.camera
        own = [built.camera, *(hand.armature for hand in built.hands), *(hand.mesh for hand in built.hands)]
        assert set(built.collection.all_objects) == set(own)
        for hand in built.hands:
            assert hand.armature["side"] == hand.side
            assert hand.armature["model"] == "open-hand"
            assert hand.armature["solver"] == "paper-a"
            assert hand.armature["source"] == take.source.files[0]
            track = next(track for track in take.hands if track.side == hand.side)
            np.testing.assert_allclose(hand.armature["betas"], track.betas)
    first, second = captures
    assert [c.collection.name for c in captures] == ["photo of a hand", "photo of a hand.001"]
    assert not set(first.collection.all_objects) & set(second.collection.all_objects)
    assert {h.action for h in first.hands}.isdisjoint(h.action for h in second.hands)
    assert before[0] == before[1]
    assert bpy.context.view_layer.objects.active == cube
    assert cube.select_get()
    assert bpy.context.mode == "OBJECT"


def test_other_model_version_is_a_warning(make_take):
    take = make_take(model_digests={"left": "0" * 16, "right": "0" * 16}).take
    assert not build_take(take).warnings, "its joints are where they were; only the skin can differ"
    larger = replace(take, hands=tuple(replace(h, joints_3d=1.01 * h.joints_3d) for h in take.hands))
    warnings = build_take(larger).warnings
    assert len(warnings) == 2
    assert all("another version" in warning for warning in warnings)


def test_a_single_picture_leaves_the_timeline_as_it_is(make_take):
    scene = bpy.context.scene
    scene.frame_end, scene.render.fps = 120, 50
    built = build_take(make_take(frame_numbers=np.array([7])).take)
    assert (scene.frame_start, scene.frame_end, scene.render.fps, scene.frame_current) == (1, 120, 50, 7)
    assert key_frames(built.hands[0].armature) == [[7.0]] * CURVES


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
    return worst


@pytest.mark.parametrize("metres_per_unit", [0.01, 1000.0])
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


@pytest.mark.parametrize("size", [(1920, 1080, 1.0, 1.0), (1080, 1920, 1.0, 1.0), (720, 576, 1.0, 1.5)])
def test_an_unmatched_scene_stays_as_it_is(make_take, size):
    scene, render = bpy.context.scene, bpy.context.scene.render
    scene.frame_start, scene.frame_end, scene.frame_current, render.fps = 50, 90, 61, 30
    render.resolution_x, render.resolution_y, render.pixel_aspect_x, render.pixel_aspect_y = size
    names = {scene: ("frame_start", "frame_end", "frame_current", "camera"), render: ("fps", "fps_base")}
    names[render] += ("resolution_x", "resolution_y", "pixel_aspect_x", "pixel_aspect_y")
    before = [getattr(owner, name) for owner in names for name in names[owner]]
    made = make_take(fps=24.0)  # a photo has no rate of its own
    built = build_take(made.take, match_scene=False)
    assert [getattr(owner, name) for owner in names for name in names[owner]] == before
    assert built.warnings == ()
    frames = 61 + FRAMES - FRAMES[0]
    for hand in built.hands:
        assert key_frames(hand.armature) == [np.delete(frames, UNSEEN).tolist()] * CURVES
    assert picture_error(made, built, frames) < 0.05

    background, k = built.camera.data.background_images[0], made.take.intrinsics
    picture = WIDTH / (HEIGHT * k.fx / k.fy)
    frame = size[0] * size[2] / (size[1] * size[3])
    # FIT lets the longer side touch the frame, CROP the shorter: the picture must touch left and right.
    assert background.frame_method == ("FIT" if picture > frame else "CROP")
    aspect = background.image.display_aspect
    assert aspect[1] / aspect[0] == pytest.approx(k.fx / k.fy)


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
    assert [o for o in bpy.data.objects if o.type == "CAMERA"] == [camera] == [built.camera]
    assert scene.camera is None
    for _ in range(2):
        assert picture_error(made, built, FRAMES) < 0.05
        camera.location.x += 5.0
    build_take(made.take, camera=camera)
    assert len(camera.data.background_images) == 1, "the same picture is not shown twice"
    assert len(bpy.data.images) == 1


# The rig is the model: vertices, joints, bones, names


def test_evaluated_mesh_is_the_posed_model(make_take, model):
    """Without its correctives it is not."""
    made = make_take(model=model)
    worst = {}
    for correctives in (True, False):
        built = build_take(made.take, pose_correctives=correctives)
        worst[correctives] = 0.0
        for row, frame in made.seen:
            bpy.context.scene.frame_set(frame)
            for hand in built.hands:
                error = np.abs(evaluated_vertices(hand.mesh) - world(made.vertices[hand.side][row]))
                worst[correctives] = max(worst[correctives], error.max())
    assert worst[True] < 1e-4
    assert worst[False] > 1e-3
    assert built.hands[0].mesh.data.shape_keys is None


def test_correctives_need_no_scripts(make_take, model):
    for hand in build_take(make_take(model=model).take).hands:
        keys = hand.mesh.data.shape_keys
        drivers = keys.animation_data.drivers
        assert 0 < len(drivers) == len(keys.key_blocks) - 1 <= 135
        assert all(curve.driver.is_simple_expression and curve.driver.is_valid for curve in drivers)


@pytest.mark.parametrize("side", ["right", "left"])
def test_positive_turn_about_x_bends_to_the_palm(make_take, side):
    """The thumb across it."""
    armature, names = build_take(make_take(sides=(side,)).take).hands[0].armature, bone_names(side)
    armature.animation_data.action = None
    little = np.array(armature.data.bones[names[FINGER_JOINTS["little"][0]]].head_local)

    def tail(joint: int, angle: float) -> np.ndarray:
        for bone in armature.pose.bones:
            bone.location = (0, 0, 0)
            bone.rotation_quaternion = Quaternion((1, 0, 0), angle if bone.name == names[joint] else 0.0)
        bpy.context.view_layer.update()
        return np.array(armature.pose.bones[names[joint]].tail)

    for joint in range(1, NUM_JOINTS):
        flat = tail(joint, 0.0)
        move = tail(joint, 0.7) - flat
        if joint in FINGER_JOINTS["thumb"]:
            assert move @ (little - [0.0, 0.0, 0.03] - flat) > 0, JOINT_NAMES[joint]
        else:  # the palm faces -Z in rest space
            assert move[2] < 0, JOINT_NAMES[joint]
            assert abs(move[1]) < 0.35 * np.linalg.norm(move), JOINT_NAMES[joint]


def test_mesh_has_uvs_smooth_faces_and_skin(make_take, model):
    mesh = build_take(make_take(model=model, sides=("right",)).take).hands[0].mesh.data
    assert all(p.use_smooth for p in mesh.polygons)
    uv = np.empty((len(mesh.loops), 2), dtype=np.float32)
    mesh.uv_layers[0].data.foreach_get("uv", uv.ravel())
    assert 0.0 <= uv.min() <= uv.max() <= 1.0
    assert np.ptp(uv, axis=0).min() > 0.1
    assert mesh.validate() is False, "Blender found nothing to repair"
