"""Export from the panel and through the file browser; what it must leave alone."""

from __future__ import annotations

from pathlib import Path

import bpy
import numpy as np

from scenarios.capturing import capture, hands, part, pixels_of
from scenarios.panels import opened_by_default

FORMATS = ("fbx", "glb", "usd", "bvh", "abc", "vrma", "npz")
COLUMNS = (0.2, 0.5, 0.8)
"""Where buttons that stand three in a row are, as parts of the sidebar's width"""


def leaves_all_as_it_is(stage, source):
    """Every format that this Blender writes, by the file browser, with the view through the camera and a bone
    that was moved and not keyed; beside it a local view through a camera of its own."""
    with opened_by_default("MANIENT_PT_export"):
        yield from capture(stage, source)
        (armature, *_) = hands()
        armature.select_set(True)
        bpy.context.view_layer.objects.active = armature
        yield from stage.look_through_camera()
        yield from _second_view(stage, armature)
        yield from stage.open_sidebar()
        with stage.override():
            bpy.ops.object.mode_set(mode="POSE")
        armature.pose.bones[2].rotation_quaternion = (0.5, 0.5, 0.5, 0.5)
        stage.area().spaces[0].shading.light = "FLAT"
        stage.area().spaces[0].region_3d.view_camera_zoom = 8.0
        bpy.ops.ed.undo_push(message="Before the export")
        yield from stage.leave_popups()
        yield from stage.screenshot("export-before")
        seen = {"before": _state(armature), "written": {}, "after": {}, "pixels": {}}
        for fmt in FORMATS:
            path = Path(source).with_name(f"exported-{fmt}")
            files = yield from _export(stage, path, fmt)
            if not files:
                continue
            yield from stage.leave_popups()
            yield from stage.screenshot(f"export-after-{fmt}")
            seen["written"][fmt] = files
            seen["after"][fmt] = _state(armature)
            seen["pixels"][fmt] = _difference(stage, "export-before", f"export-after-{fmt}")
        yield from stage.invoke("manient.apply_pose")
        yield 0.3
        yield from stage.undo()
        yield 0.3
        (armature, *_) = hands()
        seen["undone"] = _state(armature)
    return seen


def formats(stage, source):
    """Every place of the format buttons clicked, in the sidebar; then the file browser's own."""
    with opened_by_default("MANIENT_PT_export"):
        yield from capture(stage, source)
        (armature, *_) = hands()
        bpy.context.view_layer.objects.active = armature
        yield from stage.look_through_camera()
        yield from stage.open_sidebar()
        yield 0.3
        settings = bpy.context.scene.manient
        region = stage.region("UI")
        place = yield from stage.find_button("bpy.ops.manient.export_hand(")
        assert place is not None, "the sidebar has no button Export"
        yield from stage.leave_popups()
        yield from stage.screenshot("export-panel")
        chosen = {settings.export_format}
        for y in range(place[1], min(place[1] + 260, region.y + region.height - 10), 8):
            for part in COLUMNS:
                yield from stage.move_to((region.x + region.width * part, y))
                yield 0.02
                if not _over_formats(stage):
                    continue
                yield from stage.key("LEFTMOUSE")
                yield 0.05
                chosen.add(settings.export_format)
        bpy.context.preferences.view.filebrowser_display_type = "SCREEN"
        yield from stage.invoke("manient.export_hand")
        browser = yield from stage.file_browser()
        yield 1.0
        yield from stage.screenshot("export-browser")
        stage.in_browser(browser, bpy.ops.file.cancel)
        yield 0.5
    return sorted(chosen)


def _over_formats(stage) -> bool:
    """Whether the mouse is over a button that is no operator's, as the formats' are none."""
    bpy.context.window_manager.clipboard = ""
    with stage.override(region="UI"):
        if bpy.ops.ui.copy_data_path_button.poll():
            bpy.ops.ui.copy_data_path_button(full_path=True)
    return bpy.context.window_manager.clipboard.endswith("manient.export_format")


def _second_view(stage, armature):
    """The outliner's place becomes a view of the hand alone, through another camera of its own."""
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


def _export(stage, path: Path, fmt: str):
    """The files that were written; none where this Blender lacks the format."""
    if part("exporters").EXPORTERS[fmt].why_not():
        return []
    bpy.context.preferences.view.filebrowser_display_type = "SCREEN"
    yield from stage.invoke("manient.export_hand", file_format=fmt)
    yield from stage.choose_file(str(path))
    yield from stage.until(lambda: list(path.parent.glob(f"{path.name}*")), 20.0, f"the {fmt} file")
    yield 0.5
    return sorted(p.name for p in path.parent.glob(f"{path.name}*"))


def _state(armature) -> dict:
    """All that is shown, and what is selected and posed."""
    views = []
    for window in bpy.context.window_manager.windows:
        views.append([window.scene.name, window.view_layer.name, window.scene.camera.name])
        for area in window.screen.areas:
            space = area.spaces[0]
            if area.type != "VIEW_3D":
                continue
            view = space.region_3d
            views.append(
                [
                    space.camera.name,
                    space.use_local_camera,
                    space.local_view is not None,
                    [space.shading.type, space.shading.light],
                    view.view_perspective,
                    round(view.view_camera_zoom, 4),
                    [round(v, 5) for row in view.view_matrix for v in row],
                ]
            )
    scene = bpy.context.scene
    return {
        "views": views,
        "scene": [scene.name, len(bpy.data.scenes), scene.frame_current],
        "pose": [list(bone.rotation_quaternion) for bone in armature.pose.bones],
        "active": [scene.view_layers[0].objects.active.name, armature.mode],
        "selected": sorted(obj.name for obj in scene.view_layers[0].objects.selected),
        "objects": sorted(obj.name for obj in bpy.data.objects),
    }


def _difference(stage, one: str, other: str) -> int:
    """How many squares of the 3D views differ between two screenshots. Of squares, since edges are drawn a
    little otherwise each time."""
    pixels = [pixels_of(stage.screenshots / f"{name}.png") for name in (one, other)]
    side, count = 8, 0
    for area in stage.window.screen.areas:
        if area.type == "VIEW_3D":
            region = next(r for r in area.regions if r.type == "WINDOW")
            rows, columns = region.height // side, region.width // side
            before, after = (
                shown[region.y : region.y + rows * side, region.x : region.x + columns * side]
                .reshape(rows, side, columns, side, 4)
                .mean(axis=(1, 3))
                for shown in pixels
            )
            count += int((np.abs(before - after).max(axis=-1) > 0.1).sum())
    return count
