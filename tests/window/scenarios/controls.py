"""Controls of a captured hand: added from the panel, seen, grabbed by mouse, turned, baked."""

from __future__ import annotations

import bpy
import numpy as np
from bpy_extras.view3d_utils import location_3d_to_region_2d
from mathutils import Quaternion, Vector

from scenarios.capturing import hands, part


def animated(stage, take):
    """A finger is grabbed at its control's ball and curled; undo and redo by keys; the panel bakes it."""
    yield from stage.open_sidebar()
    with stage.override():
        bpy.ops.manient.import_take(filepath=take)
    (armature,) = yield from stage.until(hands, 10.0, "the imported hand")
    yield 0.5
    yield from stage.look_through_camera()
    bpy.context.view_layer.objects.active = armature
    with stage.override():
        bpy.ops.object.mode_set(mode="POSE")
        bpy.ops.pose.select_all(action="DESELECT")
        bpy.ops.ed.undo_push(message="Pose Mode")
    yield from stage.invoke("manient.add_controls")
    yield from stage.undo()
    without = len(hands()[0].data.bones)
    yield from stage.redo()
    (armature,) = hands()
    yield from stage.screenshot("controls-in-camera")
    _look_at_back(stage, armature)
    yield from stage.screenshot("controls-from-back")
    rest = _heads(armature)
    ball = _ball(stage, armature, "index")
    yield from stage.click(ball)
    yield 0.2
    picked = bpy.context.active_pose_bone.name if bpy.context.active_pose_bone else ""
    for key in ("R", "X", "X"):
        yield from stage.key(key)
        yield 0.05
    for step in range(1, 6):  # around the knuckle
        yield from stage.move_to((ball[0] - 12 * step, ball[1] - 12 * step))
        yield 0.05
    yield from stage.key("RET")
    yield 0.1
    curled = _heads(armature)
    yield from stage.screenshot("controls-index-curled")
    yield from stage.undo()
    (armature,) = hands()
    undone = _heads(armature)
    yield from stage.redo()
    (armature,) = hands()
    yield from stage.invoke("manient.bake_controls")
    (armature,) = hands()
    baked = _heads(armature)
    for place in (0, 1):
        _look_from_side(stage, armature, place)
        yield from stage.screenshot(f"controls-side-{place}")
    fingers = armature.pose.bones[part("rigs").rig_of(armature).controls["fingers"]]
    fingers.rotation_euler = (0.9, 0.0, 0.0)
    yield from stage.screenshot("controls-fist")
    _look_at_back(stage, armature)
    fingers.rotation_euler = (-0.1, 0.0, 0.3)
    yield from stage.screenshot("controls-fan")
    return {
        "bones": (without, len(armature.data.bones)),
        "picked": picked,
        "curled": float(np.abs(curled - rest).max()),
        "undone": float(np.abs(undone - rest).max()),
        "baked": float(np.abs(baked - curled).max()),
    }


def _heads(armature) -> np.ndarray:
    """(16, 3) metres in the armature's space."""
    bpy.context.view_layer.update()
    return np.array([armature.pose.bones[name].head for name in part("rigs").rig_of(armature).bones])


def _ball(stage, armature, finger: str) -> tuple[float, float]:
    """Where a finger's control is drawn, in the window's pixels."""
    bone = armature.pose.bones[part("rigs").rig_of(armature).controls[finger]]
    at, shape = bone.custom_shape_transform, bone.custom_shape
    top = max((v.co for v in shape.data.vertices), key=lambda co: -co.z)
    place = armature.matrix_world @ at.matrix @ Vector(top * at.length)
    region = stage.region()
    x, y = location_3d_to_region_2d(region, stage.area().spaces[0].region_3d, place)
    return region.x + x, region.y + y


def _look(stage, armature, turn: Quaternion) -> None:
    view = stage.area().spaces[0].region_3d
    wrist = armature.pose.bones[part("rigs").rig_of(armature).bones[0]]
    view.view_perspective = "PERSP"
    view.view_location = armature.matrix_world @ wrist.tail
    view.view_distance = 0.33
    view.view_rotation = (armature.matrix_world @ wrist.matrix).to_quaternion() @ turn


def _look_at_back(stage, armature) -> None:
    """A view onto the back of the hand, from a little aside, fingers up."""
    _look(
        stage, armature, Quaternion((0, 1, 0), np.radians(180 - 25)) @ Quaternion((1, 0, 0), np.radians(25))
    )


def _look_from_side(stage, armature, place: int) -> None:
    _look(stage, armature, Quaternion((0, 1, 0), np.radians((100, -60)[place])))
