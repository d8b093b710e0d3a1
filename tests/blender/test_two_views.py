"""A take of two views in a scene: the second camera, its plate, and what switches between both."""

from __future__ import annotations

from dataclasses import replace

import bpy
import cv2
import numpy as np
import pytest
from bpy_extras.object_utils import world_to_camera_view
from mathutils import Vector

from blender_manient.operators.capture import new_request
from blender_manient.panels.result import MANIENT_PT_result
from blender_manient.scene import captures
from blender_manient.scene.build import build_take
from blender_manient.scene.camera import captured_place
from blender_manient.scene.retime import retime
from blender_manient.session import source_info
from handfit_core.common.errors import OptionError
from handfit_core.geometry.camera import Intrinsics
from handfit_core.geometry.rotations import rotvec_to_rotmat
from handfit_core.take import Take
from handfit_core.take.views import Cameras, Verdict, View
from tests.drawn import drawn

from .conftest import FRAMES, HEIGHT, OFF_CENTRE, WIDTH, blocks, joint_heads, movie
from .test_retiming import shown_offset

pytestmark = pytest.mark.usefixtures("registered")

OFFSET = 0.143
"""seconds from the take's first frame to the second clip's"""
LENS = Intrinsics(fx=150.0, fy=155.0, cx=47.0, cy=60.0)
SIZE = (96, 128)
RATE = 25.0
TURN, MOVE = rotvec_to_rotmat(np.array([0.2, 1.2, -0.1])), np.array([-0.55, 0.1, 0.3])


@pytest.fixture
def take(make_take, tmp_path) -> Take:
    first = make_take(sides=("right",), source=movie(tmp_path / "a.avi", (WIDTH, HEIGHT), 30.0)).take
    view = View(movie(tmp_path / "b.avi", SIZE, RATE), RATE, *SIZE, np.arange(1, 41))
    lenses = np.array([list(vars(lens).values()) for lens in (first.intrinsics, LENS)])
    turns, moves = np.stack([np.eye(3), TURN]), np.stack([np.zeros(3), MOVE])
    cameras = Cameras(turns, moves, lenses, np.array([0.0, OFFSET]), (view,))
    return replace(first, cameras=cameras, verdict=Verdict("good", "Offset 4.3 frames: good."))


def second_of(built) -> bpy.types.Object:
    (second,) = set(captures.cameras_of(built.collection)) - {built.camera}
    return second


@pytest.mark.parametrize("metres_per_unit", [1.0, 0.01])
def test_the_second_camera_sees_the_hand_where_its_own_lens_does(take, metres_per_unit):
    scene = bpy.context.scene
    scene.unit_settings.scale_length = metres_per_unit
    built = build_take(take)
    armature = built.hands[0].armature
    for view, (intrinsics, turn, move, size) in enumerate(
        ((OFF_CENTRE, np.eye(3), np.zeros(3), (WIDTH, HEIGHT)), (LENS, TURN, MOVE, SIZE))
    ):
        assert (scene.render.resolution_x, scene.render.resolution_y) == size
        scene.frame_set(int(FRAMES[2]))
        seen_at = scene.camera.matrix_world.inverted() @ armature.matrix_world
        place = captured_place(take, view, 1.0 / metres_per_unit)
        np.testing.assert_allclose(np.array(place), seen_at, atol=1e-5 / metres_per_unit)
        heads = joint_heads(armature, "right")
        seen = [world_to_camera_view(scene, scene.camera, Vector(head)) for head in heads]
        shown = np.array([[p.x * size[0], (1.0 - p.y) * size[1]] for p in seen])
        metres = heads * metres_per_unit
        points = np.stack([metres[:, 0], -metres[:, 2], metres[:, 1]], axis=1)
        np.testing.assert_allclose(shown, intrinsics.project(points @ turn.T + move), atol=0.02)
        assert bpy.ops.manient.switch_view() == {"FINISHED"}
    assert scene.camera == built.camera
    assert scene.render.resolution_x == WIDTH


@pytest.mark.parametrize("rate", [30.0, 24.0, 25.0])
def test_its_plate_shows_the_same_moment(take, rate):
    scene = bpy.context.scene
    scene.render.fps, scene.render.fps_base = round(rate), 1.0
    scene.frame_set(100)
    built = build_take(take, match_scene=rate == 30.0)
    first = int(FRAMES[0]) if rate == 30.0 else 100

    def nearest(frame: int, played: float) -> bool:
        moment = 1 + ((frame - first) / played - OFFSET) * RATE
        return abs(shown_offset(second_of(built), frame) - moment) <= 0.5 + 1e-6

    assert all(nearest(frame, rate) for frame in range(first + 6, first + 16))
    scene.render.fps = 50
    retime(scene, built.collection)
    assert all(nearest(frame, 50.0) for frame in range(first + 12, first + 30))


@pytest.mark.parametrize("mirrored", [False, True])
def test_renders_show_the_picture_of_the_camera_that_they_look_through(take, tmp_path, mirrored):
    (view,) = take.cameras.views
    take = replace(take, cameras=replace(take.cameras, views=(replace(view, mirrored=mirrored),)))
    scene, built = bpy.context.scene, build_take(take)
    captures.switch_view(scene, built.collection)
    assert second_of(built).data.background_images[0].use_flip_x == mirrored
    built.hands[0].mesh.hide_render = True
    scene.render.engine, scene.cycles.samples = "CYCLES", 1
    scene.render.filepath = str(tmp_path / "render.png")
    scene.frame_set(14)
    bpy.ops.render.render(write_still=True)
    shown = cv2.imread(scene.render.filepath)[64, :, 0].astype(float)
    number = round(1 + ((14 - int(FRAMES[0])) / 30.0 - OFFSET) * RATE)
    black, grey = (shown[-4], shown[4]) if mirrored else (shown[4], shown[-4])
    assert black < 10
    assert grey == pytest.approx(6 * number, abs=3)


def test_it_goes_with_its_capture_and_keeps_it_the_active_one(take, make_take):
    before = blocks()
    scene, built = bpy.context.scene, build_take(take)
    build_take(make_take().take, match_scene=False)
    captures.switch_view(scene, built.collection)
    assert captures.active_capture(scene) == built.collection
    assert captures.in_view(scene)
    captures.leave_other_view(scene, built.camera)
    assert (scene.camera, scene.render.resolution_x) == (built.camera, WIDTH)
    captures.leave_other_view(scene, built.camera)
    assert scene.camera == built.camera
    captures.switch_view(scene, built.collection)
    assert {"Offset 4.3 frames: good.", f"View: {built.camera.name}"} <= set(drawn(MANIENT_PT_result).rows)
    for capture in captures.captures(scene):
        bpy.ops.manient.remove_capture(capture=capture.name)
    assert blocks() == before


def test_what_the_panel_tells_of_a_second_view(take, tmp_path):
    settings = bpy.context.scene.manient
    settings.source, settings.second_view = str(tmp_path / "a.avi"), str(tmp_path / "b.avi")
    settings.offset, settings.use_baseline, settings.baseline = 2.0, True, 0.7
    options = new_request(bpy.context, only_frame=False).options
    assert (options.view, options.offset) == (str(tmp_path / "b.avi"), None)
    assert options.baseline == pytest.approx(0.7)
    settings.cameras = str(tmp_path / "rig.toml")
    told = new_request(bpy.context, only_frame=False).options
    assert (told.cameras, told.baseline) == (str(tmp_path / "rig.toml"), None), "it tells the distance"
    alone = new_request(bpy.context, only_frame=True).options
    assert (alone.view, alone.baseline) == (None, None), "one frame tells no offset"
    settings.source = str(tmp_path / "b.avi")
    assert settings.second_view == "", "it belongs to one source"


def test_a_frame_of_each_view_tells_the_offset(take, tmp_path):
    settings = bpy.context.scene.manient
    settings.source, settings.second_view = str(tmp_path / "a.avi"), str(tmp_path / "b.avi")
    settings.use_offset, settings.use_pair, settings.offset = True, True, 9.0
    settings.pair = 31, 11
    with pytest.raises(OptionError, match="rates"):
        source_info.chosen_offset(settings)
    for field, rate in zip(source_info.VIEWS, (30.0, RATE), strict=True):
        info = source_info.of(settings, field)
        info.fps, info.frames, info.first, info.last = rate, 40, 1, 40
    assert source_info.chosen_offset(settings) == pytest.approx(1.0 - 0.4)
    settings.use_frames, settings.first_frame = True, 16
    assert source_info.chosen_offset(settings) == pytest.approx(0.5 - 0.4), "the used range starts later"
    settings.pair = 99, 0
    assert tuple(settings.pair) == (40, 1)
    settings.second_view = ""
    assert not settings.use_pair
