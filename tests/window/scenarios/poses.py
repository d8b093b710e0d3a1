"""The library of poses in the window: its pictures, one of them clicked, and put on the hand."""

from __future__ import annotations

import bpy

from scenarios.capturing import hands, part
from scenarios.panels import opened_by_default

PICTURE = 265
"""pixels from the sidebar's top to the middle of the picture, with all sections above closed"""
FIST = (-161, -121)
"""pixels from there to the fist among the pictures that open"""


def library(stage, take):
    """The picture is clicked, the fist in what opens, then its button; undone, and an own pose saved."""
    with opened_by_default("MANIENT_PT_poses"):
        with stage.override():
            bpy.ops.manient.import_take(filepath=take)
        (armature,) = yield from stage.until(hands, 10.0, "the imported hand")
        bpy.context.view_layer.objects.active = armature
        stage.meter.reset()
        yield from stage.open_sidebar()
        yield from stage.screenshot("poses")
    region, settings = stage.region("UI"), bpy.context.scene.manient
    shown = (region.x + region.width / 2, region.y + region.height - PICTURE)
    yield from stage.click(shown)
    yield 0.5
    yield from stage.screenshot("poses-open")
    yield from stage.click((shown[0] + FIST[0], shown[1] + FIST[1]))
    yield 0.5
    chosen, before = settings.pose, _read()
    button = yield from stage.find_button("bpy.ops.manient.apply_pose", along=0.7)
    yield from stage.click(button)
    yield 0.5
    applied = _read()
    yield from stage.screenshot("poses-applied")
    yield from stage.undo()
    undone = _read()
    yield from stage.redo()
    bpy.context.scene.manient.pose_scope = "RANGE"
    yield 0.5
    yield from stage.screenshot("poses-range")
    bpy.context.scene.manient.pose_scope = "HOLD"
    yield 0.5
    button = yield from stage.find_button("bpy.ops.manient.apply_pose", along=0.7)
    yield from stage.click(button)
    yield 0.5
    held = []
    for frame in (10, 20):
        bpy.context.scene.frame_set(frame)
        held.append(_read())
    yield from stage.screenshot("poses-held")
    yield from stage.undo()
    bpy.context.scene.frame_set(20)
    released = _read()
    bpy.context.scene.frame_set(1)
    yield from stage.invoke("manient.save_pose_asset")
    yield 0.5
    yield from stage.screenshot("poses-save")
    yield from stage.key("RET")
    yield 0.5
    bpy.context.scene.manient.pose = "Hand Pose"
    yield 0.3
    yield from stage.screenshot("poses-own")
    items = part("scene.poses").pose_items(None, bpy.context)
    return {
        "chosen": chosen,
        "before": before,
        "applied": applied,
        "undone": undone,
        "held": held,
        "released": released,
        "fist": part("scene.poses").pose_named("Fist").hand_pose.tolist(),
        "own": part("scene.poses").pose_named("Hand Pose").hand_pose.tolist(),
        "icons": [icon for _, _, _, icon, _ in items],
    }


def _read() -> list[float]:
    (hand,) = part("scene.poses").posable_hands(bpy.context)
    return hand.read().hand_pose.tolist()


def from_the_asset_browser(stage, take):
    """An own pose in the asset browser: chosen by a click, and put on the hand from its menu."""
    with stage.override():
        bpy.ops.manient.import_take(filepath=take)
    (armature,) = yield from stage.until(hands, 10.0, "the imported hand")
    bpy.context.view_layer.objects.active = armature
    with stage.override():
        bpy.ops.manient.apply_pose(pose="Horns")
        bpy.ops.manient.save_pose_asset(asset_name="Concert")
        bpy.ops.manient.apply_pose(pose="Spread")
    before = _read()
    area = stage.area("PROPERTIES")
    area.ui_type = "ASSETS"
    yield 1.0
    area.spaces[0].params.asset_library_reference = "LOCAL"
    area.spaces[0].show_region_toolbar = False  # there is no room for both
    yield 1.0
    region = next(r for r in area.regions if r.type == "WINDOW")
    place = (region.x + 50, region.y + region.height - 50)
    yield from stage.click(place)
    yield 0.5
    yield from stage.key("RIGHTMOUSE")
    yield 0.5
    yield from stage.screenshot("poses-asset-menu")
    yield from stage.key("LEFTMOUSE")  # Blender opens a menu with its first entry under the mouse
    yield 0.5
    yield from stage.screenshot("poses-asset-applied")
    area.ui_type = "PROPERTIES"
    saved = part("scene.poses").pose_named("Concert").hand_pose.tolist()
    return {"before": before, "after": _read(), "saved": saved}
