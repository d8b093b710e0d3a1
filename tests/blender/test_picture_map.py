"""Handles lie where Blender draws the picture: the map agrees with the camera's own projection."""

from __future__ import annotations

import bpy
import numpy as np
import pytest
from bpy_extras.object_utils import world_to_camera_view
from mathutils import Euler, Matrix, Vector

from blender_manient.scene.build import build_take
from handfit_core.geometry.picture_map import mapped, picture_to_region
from handfit_core.skeleton import FINGER_JOINTS

from .conftest import HEIGHT, WIDTH, joint_heads


@pytest.fixture
def seen(make_take):
    made = make_take(sides=("right",))
    built = build_take(made.take)
    bpy.context.scene.frame_set(made.seen[3][1])
    return made, built


def perspective(camera) -> np.ndarray:
    """What RegionView3D.perspective_matrix is in a region that shows just the picture."""
    render = bpy.context.scene.render
    projection = camera.calc_matrix_camera(
        bpy.context.evaluated_depsgraph_get(),
        x=render.resolution_x,
        y=render.resolution_y,
        scale_x=render.pixel_aspect_x,
        scale_y=render.pixel_aspect_y,
    )
    return np.array(projection @ camera.matrix_world.normalized().inverted())


PLACEMENTS = (
    Matrix.Identity(4),
    Matrix.LocRotScale(Vector((0.3, -2.0, 1.1)), Euler((0.4, -0.2, 2.1)), Vector((2.0, 2.0, 2.0))),
)


@pytest.mark.parametrize("placement", PLACEMENTS, ids=("as built", "moved"))
def test_the_picture_fills_a_region_of_its_size(seen, placement):
    made, built = seen
    built.camera.matrix_world = placement @ built.camera.matrix_world
    bpy.context.view_layer.update()
    matrix = picture_to_region(
        made.take.intrinsics, np.array(built.camera.matrix_world), perspective(built.camera), (WIDTH, HEIGHT)
    )
    pixels = np.array([[0.0, 0.0], [WIDTH, 0.0], [WIDTH, HEIGHT], [31.0, 47.5]])
    expected = np.stack([pixels[:, 0], HEIGHT - pixels[:, 1]], axis=-1)
    np.testing.assert_allclose(mapped(matrix, pixels), expected, atol=0.02)
    np.testing.assert_allclose(mapped(np.linalg.inv(matrix), expected), pixels, atol=0.02)


def test_a_joint_is_drawn_where_its_pixel_is(seen):
    """In a region twice as large, by Blender's projection of the bone's head."""
    made, built = seen
    row, _ = made.seen[3]
    matrix = picture_to_region(
        made.take.intrinsics,
        np.array(built.camera.matrix_world),
        perspective(built.camera),
        (2 * WIDTH, 2 * HEIGHT),
    )
    joint = FINGER_JOINTS["index"][1]
    pixel = made.take.intrinsics.project(made.joints["right"][row][joint])
    head = joint_heads(built.hands[0].armature, "right")[joint]
    view = world_to_camera_view(bpy.context.scene, built.camera, Vector(head))
    np.testing.assert_allclose(mapped(matrix, pixel), [view.x * 2 * WIDTH, view.y * 2 * HEIGHT], atol=0.1)
