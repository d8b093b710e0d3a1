"""Every section of the sidebar, open."""

from __future__ import annotations

import types
from contextlib import contextmanager
from pathlib import Path

import addon_utils
import bpy
from stage import ADDON

from scenarios.capturing import capture, hands, part


def all_sections(stage, source, shot="sections"):
    """With a captured clip: every section open, the mouse wheel turned through all of them."""
    with opened_by_default():
        yield from capture(stage, source)
        (armature, *_) = hands()
        bpy.context.view_layer.objects.active = armature
        yield from stage.look_through_camera()
        yield from stage.open_sidebar()
        stage.meter.reset()
        region = stage.region("UI")
        for number in range(1, 4):
            yield from stage.screenshot(f"{shot}-{number}")
            yield from stage.move_to((region.x + region.width / 2, region.y + region.height / 2))
            for _ in range(12):
                yield from stage.key("WHEELDOWNMOUSE")
            yield 0.3
        drawn = [name for name in stage.meter.calls if name.endswith(".draw")]
    return sorted(drawn)


def preferences(stage):
    """The add-on's preferences, as the artist finds them."""
    addon_utils.modules_refresh()
    if ADDON == "blender_manient":
        addon_utils.addons_fake_modules[ADDON] = _listed()
    bpy.context.preferences.active_section = "ADDONS"
    bpy.context.window_manager.addon_search = "manient"
    area = stage.area()
    area.type = "PREFERENCES"

    def drawn() -> bool:
        # Blender forgets both when it looks through its folders once more.
        if ADDON == "blender_manient":
            addon_utils.addons_fake_modules.setdefault(ADDON, _listed())
        for module in addon_utils.modules(refresh=False):
            if module.__name__ == ADDON:
                addon_utils.module_bl_info(module)["show_expanded"] = True
        area.tag_redraw()
        return any(name.startswith("preferences.") and name.endswith(".draw") for name in stage.meter.calls)

    yield from stage.until(drawn, 100.0, "the preferences to be drawn")
    yield from stage.screenshot("preferences")
    area.type = "VIEW_3D"
    addon_utils.addons_fake_modules.pop("blender_manient", None)
    bpy.context.window_manager.addon_search = ""
    yield 0.2


def _listed() -> types.ModuleType:
    """What Blender shows of the repository, where no manifest names it."""
    listed = types.ModuleType(ADDON)
    listed.bl_info = {"name": "Manient Hand Capture", "category": "Animation", "blender": (4, 2, 0)}
    listed.bl_info |= {"author": "", "version": (0, 1, 0), "location": "", "description": "", "warning": ""}
    listed.bl_info |= {"doc_url": "", "tracker_url": "", "support": "COMMUNITY", "show_expanded": True}
    listed.__file__ = str(Path(bpy.utils.script_path_user()) / "addons" / ADDON / "__init__.py")
    listed.__time__ = Path(listed.__file__).stat().st_mtime
    return listed


def sections() -> list[type]:
    """All sections of the sidebar, parents before children."""
    registered = part("modules").MODULES
    return [c for one in registered for c in one.classes if issubclass(c, bpy.types.Panel)]


@contextmanager
def opened_by_default(*only: str):
    """Meanwhile all sections of new files are open, or `only` these are: a section's state comes from its
    class when it is first drawn."""
    before = {cls: set(getattr(cls, "bl_options", ())) for cls in sections()}
    _register_with(
        {
            cls: options - {"DEFAULT_CLOSED"}
            if not only or any(name in cls.__name__ for name in only)
            else options | {"DEFAULT_CLOSED"}
            for cls, options in before.items()
        }
    )
    try:
        yield
    finally:
        _register_with(before)


def _register_with(options: dict[type, set[str]]) -> None:
    for cls in reversed(list(options)):
        bpy.utils.unregister_class(cls)
    for cls, wanted in options.items():
        cls.bl_options = wanted
        bpy.utils.register_class(cls)
