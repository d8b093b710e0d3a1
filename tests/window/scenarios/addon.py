"""The add-on comes and goes, and the sidebar, the preferences and the time editors draw it."""

from __future__ import annotations

import addon_utils
import bpy
import numpy as np
from stage import ADDON, EDIT_TAB, TAB

from scenarios.capturing import capture, hands, import_take, part
from scenarios.panels import opened_by_default
from scenarios.traces import traces


def disabled_leaves_nothing(stage, take):
    """Enabled, used and disabled, three times over; nothing is left, and nothing is called any more."""
    for _ in range(3):
        if not addon_utils.check(ADDON)[1]:
            addon_utils.enable(ADDON, default_set=True)
        assert "classes" in traces(), "the add-on registered nothing"
        yield from import_take(stage, take)
        yield from stage.open_sidebar()
        addon_utils.disable(ADDON, default_set=True)
        yield 0.5
        stage.meter.reset()
        for area in stage.window.screen.areas:
            area.tag_redraw()
        yield 0.5
        assert traces() == {}
        assert stage.meter.calls == {}


def disabled_in_a_mode(stage, take):
    """Edit Keypoints runs when the add-on is disabled: its line in the status bar goes, and so do its points
    and its hold on the hand."""
    armature = yield from import_take(stage, take)
    armature.location.x = 0.5
    yield 0.2
    place = armature.matrix_world.copy()
    yield from stage.invoke("manient.edit_keypoints")
    yield 1.0
    yield from stage.screenshot("disabled-before")
    assert armature.matrix_world != place
    addon_utils.disable(ADDON, default_set=True)
    yield 0.5
    yield from stage.screenshot("disabled-after")
    assert traces() == {}
    assert armature.matrix_world == place


def survives_reloading_scripts(stage, take):
    """Blender's own Reload Scripts: everything once again, nothing twice."""
    yield from stage.open_sidebar()
    before = traces()
    bpy.ops.script.reload()
    yield 1.0
    assert traces() == before
    yield from stage.open_sidebar()
    yield from import_take(stage, take)


def take_from_the_file_browser(stage, take):
    """File > Import > Hand Take; undo and redo by keys."""
    bpy.context.preferences.view.filebrowser_display_type = "SCREEN"
    yield from stage.invoke("manient.import_take")
    yield from stage.choose_file(take)
    yield from stage.until(hands, 10.0, "the imported hand")
    yield 0.5
    for step, count in ((stage.undo, 0), (stage.redo, 1)):
        yield from step()
        yield from step()
        assert len(hands()) == count


def lens_from_the_file_browser(stage, film):
    """Camera > Measured Lens: its buttons, the film chosen in the browser, measured while the window stays
    free."""
    settings = bpy.context.scene.manient
    settings.camera = "LENS"
    with opened_by_default("MANIENT_PT_advanced"):
        yield from stage.open_sidebar()
        yield from stage.screenshot("lens-none")
        bpy.context.preferences.view.filebrowser_display_type = "SCREEN"
        yield from stage.invoke("manient.measure_lens", lens="my phone")
        yield from stage.choose_file(film)
        yield from stage.until(lambda: settings.measured_lens, 60.0, "the measured lens")
        yield from stage.screenshot("lens-measured")
    assert settings.measured_lens == "my phone"


def all_sections(stage, source):
    """With a captured clip: every section open, the mouse wheel turned through all of them."""
    with opened_by_default():
        yield from stage.open_sidebar()
        yield from capture(stage, source)
        tab = stage.region("UI").active_panel_category
        assert tab == EDIT_TAB, "a finished capture opens it"
        stage.meter.reset()
        for tab in (EDIT_TAB, TAB):
            yield from stage.open_sidebar(tab)
            region = stage.region("UI")
            for number in range(3):
                yield from stage.screenshot(f"{tab}-{number}")
                yield from stage.move_to((region.x + region.width / 2, region.y + region.height / 2))
                for _ in range(12):
                    yield from stage.key("WHEELDOWNMOUSE")
                yield 0.3
    drawn = {name.partition(".")[0] for name in stage.meter.calls if name.endswith(".draw")}
    assert {"capture", "advanced", "live"} <= drawn
    assert {"result", "refine", "poses", "motion", "shape", "export"} <= drawn


def preferences(stage):
    """The installed add-on's preferences, as the artist finds them; Blender lists no checkout."""
    if ADDON == "blender_manient":
        return
    addon_utils.modules_refresh()
    bpy.context.preferences.active_section = "ADDONS"
    bpy.context.window_manager.addon_search = "manient"
    area = stage.area()
    area.type = "PREFERENCES"

    def drawn() -> bool:
        # Blender forgets it when it looks through its folders once more.
        for module in addon_utils.modules(refresh=False):
            if module.__name__ == ADDON:
                addon_utils.module_bl_info(module)["show_expanded"] = True
        area.tag_redraw()
        return any(name.startswith("preferences.") and name.endswith(".draw") for name in stage.meter.calls)

    yield from stage.until(drawn, 100.0, "the preferences to be drawn")
    bpy.context.window_manager.addon_search = ""


def whole_picture(stage, source):
    """The picture is in sight, all of it: after a capture with the sidebar closed, open, in a quad view, and
    from within another camera view that was zoomed into; after Shift Home in Edit Keypoints."""
    yield from capture(stage, source)
    _assert_framed(stage, "without sidebar")
    yield from stage.open_sidebar()
    view = stage.area().spaces[0].region_3d
    _zoom_into(view)
    yield from capture(stage, source)
    _assert_framed(stage, "with sidebar")

    _zoom_into(view)
    view.view_perspective = "PERSP"
    bpy.context.view_layer.objects.active = hands()[-1]
    operator = part("operators.edit_keypoints").MANIENT_OT_edit_keypoints
    yield from stage.invoke("manient.edit_keypoints")
    yield from stage.until(lambda: operator.current is not None, 5.0, "the mode to begin")
    yield from stage.key("HOME", shift=True)
    yield 0.5
    _assert_framed(stage, "in Edit Keypoints")
    yield from stage.key("ESC")
    yield from stage.until(lambda: operator.current is None, 5.0, "the mode to end")

    stage.area().spaces[0].show_region_ui = False  # it is as wide as a quarter of a small window
    with stage.override():
        bpy.ops.screen.region_quadview()
    yield 0.5
    yield from capture(stage, source)
    _assert_framed(stage, "in a quad view")


def _zoom_into(view: bpy.types.RegionView3D) -> None:
    view.view_camera_zoom, view.view_camera_offset = 50.0, (0.3, 0.2)


def _assert_framed(stage, layout: str) -> None:
    """All of the portrait is in the free part of its view, and no smaller than need be: in a small window the
    sidebar leaves little width."""
    from handfit_core.geometry.picture_map import mapped, picture_to_region

    area, camera = stage.area(), bpy.context.scene.camera
    take = part("scene.store").hand_of(hands()[-1]).take
    space, region = area.spaces[0], [r for r in area.regions if r.type == "WINDOW"][-1]
    assert space.region_3d.view_perspective == "CAMERA"
    size, eye = (region.width, region.height), np.array(space.region_3d.perspective_matrix)
    matrix = picture_to_region(take.intrinsics, np.array(camera.matrix_world), eye, size)
    corners = mapped(matrix, np.array([(0, 0), (take.width, take.height)])) + [region.x, region.y]
    (left, bottom), (right, top) = corners.min(axis=0), corners.max(axis=0)
    width, height = right - left, top - bottom
    assert abs(height / width - 480 / 300) < 0.02, layout
    assert region.x <= left, layout
    assert right <= region.x + region.width, layout
    assert region.y <= bottom, layout
    assert top <= region.y + region.height, layout
    for over in (
        r for r in area.regions if r.type in ("HEADER", "TOOL_HEADER", "TOOLS", "UI") and r.width > 1
    ):
        beside = over.x >= right - 1 or over.x + over.width <= left + 1
        assert beside or over.y >= top - 1 or over.y + over.height <= bottom + 1, (layout, over.type)
    assert height > 0.75 * region.height or width > 0.3 * region.width, layout
