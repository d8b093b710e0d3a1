"""What is done to a hand that is there: its shape, poses and keys by the panel, and its export."""

from __future__ import annotations

from pathlib import Path

import bpy
import numpy as np
from stage import EDIT_TAB

from scenarios.capturing import capture, hands, import_take, keys_of, mesh_of, part
from scenarios.panels import opened_by_default

PICTURE = 155
"""pixels from the sidebar's top to the middle of a pose's picture, with all sections above closed"""
FIST = (-161, -121)
"""pixels from there to the fist among the pictures that open"""
FORMATS = ("fbx", "glb", "bvh", "vrma", "npz")
"""What Debian's Blender can write"""


def proportions(stage, source):
    """A slider that moves: the mesh follows while the main loop runs; one undo step puts all of it back."""
    yield from stage.open_sidebar()
    yield from capture(stage, source)
    (armature,) = hands()
    before = mesh_of(armature)
    for step in range(1, 11):
        armature.manient.betas[0] = 0.2 * step
        yield 0.03
    yield 1.0
    bpy.ops.ed.undo_push(message="Shape")
    assert np.abs(mesh_of(armature) - before).max() > 1e-3
    yield from stage.undo()
    yield 1.0
    (armature,) = hands()
    assert np.abs(mesh_of(armature) - before).max() < 1e-6


def pose_of_the_library(stage, take):
    """The picture is clicked, the fist in what opens, then the button; undone."""
    with opened_by_default("MANIENT_PT_poses"):
        yield from import_take(stage, take)
        yield from stage.open_sidebar(EDIT_TAB)
    region, poses = stage.region("UI"), part("scene.poses")
    shown = (region.x + region.width / 2, region.y + region.height - PICTURE)
    yield from stage.click(shown)
    yield 0.5
    yield from stage.click((shown[0] + FIST[0], shown[1] + FIST[1]))
    yield 0.5
    assert bpy.context.scene.manient.pose == "Fist"
    fist, before = poses.pose_named("Fist").hand_pose, _fingers()
    assert np.abs(before - fist).max() > 0.5
    yield from stage.press("bpy.ops.manient.apply_pose", along=0.7)
    np.testing.assert_allclose(_fingers(), fist, atol=1e-4)
    yield from stage.undo()
    np.testing.assert_allclose(_fingers(), before, atol=1e-5)
    icons = [icon for _, _, _, icon, _ in poses.pose_items(None, bpy.context)]
    assert min(icons) > 0
    assert len(set(icons)) == len(icons)


def pose_of_the_asset_browser(stage, take):
    """An own pose in the asset browser: chosen by a click, and put on the hand from its menu."""
    yield from import_take(stage, take)
    with stage.override():
        bpy.ops.manient.apply_pose(pose="Horns")
        bpy.ops.manient.save_pose_asset(asset_name="Concert")
        bpy.ops.manient.apply_pose(pose="Spread")
    area = stage.area("PROPERTIES")
    area.ui_type = "ASSETS"
    yield 1.0
    area.spaces[0].params.asset_library_reference = "LOCAL"
    area.spaces[0].show_region_toolbar = False  # there is no room for both
    yield 1.0
    region = next(r for r in area.regions if r.type == "WINDOW")
    yield from stage.click((region.x + 50, region.y + region.height - 50))
    yield 0.5
    yield from stage.key("RIGHTMOUSE")
    yield 0.5
    yield from stage.key("LEFTMOUSE")  # Blender opens a menu with its first entry under the mouse
    yield 0.5
    np.testing.assert_allclose(_fingers(), part("scene.poses").pose_named("Concert").hand_pose, atol=1e-4)


def _fingers() -> np.ndarray:
    poses = part("scene.poses")
    (hand,) = poses.posable_hands(bpy.context)
    return hand.read().hand_pose


def keys_simplified(stage, take):
    """The preview follows a slider; Simplify and All Keys are pressed and undone, a layer is put on top and
    ended."""
    armature = yield from import_take(stage, take)
    with opened_by_default("MANIENT_PT_motion"):
        yield from stage.open_sidebar(EDIT_TAB)
        every, left = keys_of(armature), []
        for degrees in (1.0, 4.0):
            bpy.context.scene.manient.keys_degrees = degrees
            yield 0.2
            left.append((yield from stage.until(_previewed, 60.0, "the preview")))
        assert left[1] < left[0] < every
        bpy.ops.ed.undo_push(message="Degrees")
        for button, keys, before in (("simplify_keys", left[1], every), ("restore_keys", every, left[1])):
            yield from stage.press(f"bpy.ops.manient.{button}(", along=0.4)
            assert keys_of(hands()[0]) == keys
            yield from stage.undo()
            assert keys_of(hands()[0]) == before
            if button == "simplify_keys":
                yield from stage.redo()
        assert keys_of(hands()[0]) == left[1]
        for button, layers in (("add_key_layer", 1), ("end_key_layer", 0)):
            yield from stage.press(f"bpy.ops.manient.{button}(", along=0.4)
            assert len(hands()[0].animation_data.nla_tracks) == layers
        assert keys_of(hands()[0]) == left[1]


def _previewed() -> int | None:
    with bpy.context.temp_override(window=bpy.context.window_manager.windows[0]):
        found = part("session.key_preview").preview(bpy.context)
    return sum(one.after for one in found) if isinstance(found, list) else None


def exported(stage, source):
    """Every format by the file browser changes nothing that is shown: the view through the camera with a bone
    that was moved and not keyed, and beside it a local view through a camera of its own."""
    yield from capture(stage, source)
    (armature,) = hands()
    armature.select_set(True)
    yield from stage.look_through_camera()
    yield from _second_view(stage)
    with stage.override():
        bpy.ops.object.mode_set(mode="POSE")
    armature.pose.bones[2].rotation_quaternion = (0.5, 0.5, 0.5, 0.5)
    stage.area().spaces[0].shading.light = "FLAT"
    stage.area().spaces[0].region_3d.view_camera_zoom = 8.0
    bpy.ops.ed.undo_push(message="Before the export")
    before = _state()
    bpy.context.preferences.view.filebrowser_display_type = "SCREEN"
    for name in FORMATS:
        path = Path(source).with_name(f"exported-{name}")
        yield from stage.invoke("manient.export_hand", file_format=name)
        yield from stage.choose_file(str(path))
        there = lambda: list(path.parent.glob(f"{path.name}*"))  # noqa: B023, E731
        yield from stage.until(there, 20.0, f"the {name} file")
        yield 0.5
        assert len(there()) == 1, "nothing else is left beside the file"
        assert _state() == before, name
    yield from stage.invoke("manient.apply_pose")
    yield 0.3
    yield from stage.undo()
    # The pose that has no keys is not Blender's to bring back.
    assert {**_state(), "pose": None} == {**before, "pose": None}


def _second_view(stage):
    """The properties' place becomes a view of the hand alone, through another camera of its own."""
    other = bpy.data.objects.new("Other camera", bpy.data.cameras.new("Other camera"))
    bpy.context.scene.collection.objects.link(other)
    other.location, other.rotation_euler = (0.1, -0.3, 0.1), (1.4, 0.0, 0.1)
    area = stage.area("PROPERTIES")
    area.type = "VIEW_3D"
    yield 0.3
    space = area.spaces[0]
    with bpy.context.temp_override(window=stage.window, area=area, region=area.regions[-1]):
        bpy.ops.view3d.localview()
    space.use_local_camera = True
    space.camera = other
    space.region_3d.view_perspective = "CAMERA"
    yield 0.3


def _state() -> dict:
    """All that is shown, and what is selected and posed."""
    (window,), scene, armature = bpy.context.window_manager.windows, bpy.context.scene, hands()[0]
    spaces = [area.spaces[0] for area in window.screen.areas if area.type == "VIEW_3D"]
    return {
        "views": [
            (
                *(space.camera.name, space.use_local_camera, space.local_view is not None),
                *(space.shading.type, space.shading.light, space.region_3d.view_perspective),
                round(space.region_3d.view_camera_zoom, 4),
                np.round(space.region_3d.view_matrix, 5).tolist(),
            )
            for space in spaces
        ],
        "scene": [window.scene.name, window.view_layer.name, scene.camera.name, scene.frame_current],
        "scenes": len(bpy.data.scenes),
        "pose": [list(bone.rotation_quaternion) for bone in armature.pose.bones],
        "active": [scene.view_layers[0].objects.active.name, armature.mode],
        "selected": sorted(obj.name for obj in scene.view_layers[0].objects.selected),
        "objects": sorted(obj.name for obj in bpy.data.objects),
    }
