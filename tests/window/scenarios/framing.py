"""The picture in the camera view, as a capture leaves it, in several layouts of the window."""

from __future__ import annotations

import bpy
import numpy as np

from scenarios.capturing import capture, hands, part


def whole_picture(stage, source):
    """A capture with the sidebar closed, open, in a quad view, and from within another camera view that was
    zoomed into; what Shift Home in Edit Keypoints makes of a view from elsewhere. Pixels of the window of
    each."""
    found = {}
    yield from capture(stage, source)
    yield 0.3
    yield from stage.screenshot("framed-without-sidebar")
    found["without sidebar"] = _seen(stage)

    yield from stage.open_sidebar()
    view = stage.area().spaces[0].region_3d
    _zoom_into(view)
    yield from capture(stage, source)
    yield 0.3
    yield from stage.screenshot("framed-with-sidebar")
    found["with sidebar"] = _seen(stage)

    _zoom_into(view)
    view.view_perspective = "PERSP"
    bpy.context.view_layer.objects.active = hands()[-1]
    operator = part("operators.edit_keypoints")
    yield from stage.invoke("manient.edit_keypoints")
    yield from stage.until(operator.running, 5.0, "the mode to begin")
    yield from stage.key("HOME", shift=True)
    yield 0.5
    found["edit keypoints"] = _seen(stage)
    yield from stage.key("ESC")
    yield from stage.until(lambda: not operator.running(), 5.0, "the mode to end")

    stage.area().spaces[0].show_region_ui = False  # it is as wide as a quarter of a small window
    with stage.override():
        bpy.ops.screen.region_quadview()
    yield 0.5
    yield from capture(stage, source)
    yield 0.3
    yield from stage.screenshot("framed-in-quad-view")
    found["quad view"] = _seen(stage)
    return found


def _zoom_into(view: bpy.types.RegionView3D) -> None:
    view.view_camera_zoom, view.view_camera_offset = 50.0, (0.3, 0.2)


def _seen(stage) -> dict:
    """Where the picture, its view, and what lies over that are, each as left, bottom, right, top."""
    from handfit_core.geometry.picture_map import mapped, picture_to_region

    area, camera = stage.area(), bpy.context.scene.camera
    hand = part("scene.store").hand_of(hands()[-1])
    space, region = area.spaces[0], [r for r in area.regions if r.type == "WINDOW"][-1]
    assert space.region_3d.view_perspective == "CAMERA"
    matrix = picture_to_region(
        hand.take.intrinsics,
        np.array(camera.matrix_world),
        np.array(space.region_3d.perspective_matrix),
        (region.width, region.height),
    )
    corners = mapped(matrix, np.array([(0, 0), (hand.take.width, hand.take.height)]))
    corners += [region.x, region.y]
    over = [r for r in area.regions if r.type in ("HEADER", "TOOL_HEADER", "TOOLS", "UI") and r.width > 1]
    return {
        "picture": [*corners.min(axis=0), *corners.max(axis=0)],
        "view": _box(region),
        "over": [_box(r) for r in over],
    }


def _box(region: bpy.types.Region) -> list[int]:
    return [region.x, region.y, region.x + region.width, region.y + region.height]
