"""Exported files read back into an empty Blender, and how far their hands are from where they belong."""

from __future__ import annotations

from pathlib import Path

import bpy
import numpy as np

from blender_manient.rigs.captured_hand import bone_names
from handfit_core.take import Take

from .conftest import UNSEEN, evaluated_vertices, joint_heads, world


def read_back(*files: Path, first: int = 1, fps: int = 30) -> None:
    """Import files of one format into an empty file of so many frames per second; BVH has no frame numbers,
    and begins at `first`."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.context.scene.render.fps = fps
    for file in map(str, files):
        match Path(file).suffix:
            case ".fbx":
                bpy.ops.import_scene.fbx(filepath=file, anim_offset=0.0)
            case ".glb":
                bpy.ops.import_scene.gltf(filepath=file, bone_heuristic="BLENDER")
                for shape in [o for o in bpy.data.objects if o.type == "MESH" and "hand" not in o.name]:
                    bpy.data.objects.remove(shape)  # the importer's own, of bones
            case ".usdc":
                bpy.ops.wm.usd_import(filepath=file)
            case ".abc":
                bpy.ops.wm.alembic_import(filepath=file, as_background_job=False)
            case ".bvh":
                bpy.ops.import_anim.bvh(filepath=file, axis_forward="Y", axis_up="Z", frame_start=first)
            case ".blend":
                bpy.ops.wm.open_mainfile(filepath=file)


def imported(side) -> bpy.types.Object:
    """The one armature with a hand of that side."""
    name = bone_names(side)[0]
    (found,) = [o for o in bpy.data.objects if o.type == "ARMATURE" and name in o.pose.bones]
    return found


def joint_error(made) -> float:
    """Largest distance in metres between imported bone heads and the take's joints."""
    worst = 0.0
    for row, frame in made.seen:
        bpy.context.scene.frame_set(frame)
        for side, joints in made.joints.items():
            error = np.linalg.norm(joint_heads(imported(side), side) - world(joints[row]), axis=-1)
            worst = max(worst, error.max())
    return worst


def vertex_error(made) -> float:
    """Largest distance in metres from an imported vertex to the model's vertex nearest to it."""
    for mesh in bpy.data.meshes:  # files hold values outside 0..1, but Blender's importers leave the sliders
        for key in mesh.shape_keys.key_blocks if mesh.shape_keys else ():
            key.slider_min, key.slider_max = -2.0, 2.0
    worst = 0.0
    meshes = [o for o in bpy.data.objects if o.type == "MESH" and not o.hide_viewport]
    assert len(meshes) == len(made.vertices)
    for row, frame in made.seen:
        bpy.context.scene.frame_set(frame)
        clouds = [evaluated_vertices(o) for o in meshes]
        for vertices in made.vertices.values():
            expected = world(vertices[row])
            cloud = min(clouds, key=lambda c, e=expected: np.linalg.norm(c.mean(0) - e.mean(0)))
            if len(cloud) == len(expected):
                error = np.linalg.norm(cloud - expected, axis=-1)
            else:  # split along texture seams: same places, more vertices
                error = np.array([np.linalg.norm(expected - p, axis=-1).min() for p in cloud[::5]])
            worst = max(worst, error.max())
    return worst


def assert_same_take(found: Take, expected: Take) -> None:
    """The same frames and hands, as nearly as keys and .blend files hold them."""
    np.testing.assert_array_equal(found.frame_numbers, expected.frame_numbers)
    assert (found.source, found.intrinsics) == (expected.source, expected.intrinsics)
    for one, other in zip(found.hands, expected.hands, strict=True):
        assert one.side == other.side
        np.testing.assert_array_equal(one.detected, other.detected)
        np.testing.assert_allclose(one.betas, other.betas, atol=1e-5)
        np.testing.assert_allclose(one.transl, other.transl, atol=1e-5)
        np.testing.assert_allclose(one.joints_3d, other.joints_3d, atol=2e-5)
        np.testing.assert_allclose(one.hand_pose, other.hand_pose, atol=1e-4)
        np.testing.assert_allclose(one.keypoints_2d, other.keypoints_2d, atol=1e-3)
        np.testing.assert_allclose(one.reprojection_error, other.reprojection_error, atol=2e-2)
        assert np.isnan(one.transl[UNSEEN]).all()
