"""The add-on comes and goes."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import addon_utils
import bpy
from stage import ADDON, HOVER, SETTLE

from scenarios.traces import traces


def disabled_leaves_nothing(stage, take):
    """Enabled, used, disabled, three times over; then what is left."""
    left = []
    for _ in range(3):
        if not addon_utils.check(ADDON)[1]:
            addon_utils.enable(ADDON, default_set=True)
        assert "classes" in traces(), "the add-on registered nothing"
        assert bpy.ops.manient.import_take(filepath=take) == {"FINISHED"}
        yield from stage.open_sidebar()
        addon_utils.disable(ADDON, default_set=True)
        yield 0.5
        stage.meter.reset()
        for area in stage.window.screen.areas:
            area.tag_redraw()
        yield 0.5
        left.append({**traces(), **{name: ["still called"] for name in stage.meter.calls}})
    return left


def survives_reloading_scripts(stage, take):
    """Blender's own Reload Scripts: everything once again, nothing twice."""
    yield from stage.open_sidebar()
    before = traces()
    bpy.ops.script.reload()
    yield 1.0
    after = traces()
    yield from stage.open_sidebar()
    assert bpy.ops.manient.import_take(filepath=take) == {"FINISHED"}
    yield 0.2
    return before, after


def the_plug_in_folder_is_opened(stage, desktop):
    """The last button of the add-on's preferences, found by hovering. `desktop`: a folder for what stands for
    the desktop's program that opens folders, and for the name of what that is given."""
    opener = Path(desktop) / "xdg-open"
    opener.write_text(f'#!/bin/sh\necho "$1" >> {desktop}/opened\n')
    opener.chmod(0o755)
    path = os.environ["PATH"]
    os.environ["PATH"] = f"{desktop}:{path}"
    area = stage.area()
    area.type = "PREFERENCES"
    bpy.context.preferences.active_section = "ADDONS"
    listed = {each.__name__: each for each in addon_utils.modules()}
    if ADDON not in listed:
        # Blender lists no checkout, which has a manifest in place of what older add-ons tell of themselves.
        listed = addon_utils.addons_fake_modules
        listed[ADDON] = sys.modules[ADDON]
        sys.modules[ADDON].bl_info = {"name": "Manient Hand Capture", "category": "Animation"}
    content = addon_utils.module_bl_info(listed[ADDON])
    content["show_expanded"] = True
    bpy.context.window_manager.addon_search = content["name"]
    yield SETTLE
    with bpy.context.temp_override(window=stage.window, area=area, region=area.regions[-1]):
        bpy.ops.screen.screen_full_area()
    yield SETTLE
    (area,) = (each for each in stage.window.screen.areas if each.type == "PREFERENCES")
    region = next(each for each in area.regions if each.type == "WINDOW")
    folder = Path(bpy.utils.user_resource("DATAFILES", path="manient"))
    place = yield from _hovered(stage, area, region, "bpy.ops.manient.open_plugins(")
    yield 1.5
    yield from stage.screenshot("preferences-hovered")
    yield from stage.key("LEFTMOUSE")
    opened = Path(desktop) / "opened"
    yield from stage.until(opened.is_file, 5.0, f"the folder to be opened by the button at {place}")
    yield from stage.screenshot("preferences-opened")
    os.environ["PATH"] = path
    return {
        "folders": sorted(each.name for each in folder.iterdir()),
        "opened": Path(opened.read_text().strip()) == folder,
    }


def _hovered(stage, area, region, command):
    """The place of a button of a region whose tooltip's Python command begins so, the mouse left there."""
    for y in range(region.y + 6, region.y + region.height, 12):
        yield from stage.move_to((region.x + region.width / 2, y))
        yield HOVER
        bpy.context.window_manager.clipboard = ""
        with bpy.context.temp_override(window=stage.window, area=area, region=region):
            if bpy.ops.ui.copy_python_command_button.poll():
                bpy.ops.ui.copy_python_command_button()
        if bpy.context.window_manager.clipboard.startswith(command):
            return stage.mouse
    return None
