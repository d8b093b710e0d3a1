"""File > Import > Hand Take."""

from __future__ import annotations

import bpy
from stage import armatures


def through_the_file_browser(stage, take):
    """The menu's entry opens the file browser; a file is chosen; undo and redo by keys."""
    bpy.context.preferences.view.filebrowser_display_type = "SCREEN"
    with stage.override():
        bpy.ops.wm.call_menu("INVOKE_DEFAULT", name="TOPBAR_MT_file_import")
    yield from stage.screenshot("import-menu")
    yield from stage.key("ESC")
    yield from stage.invoke("manient.import_take")
    yield from stage.choose_file(take, "import-browser")
    yield from stage.until(armatures, 10.0, "the imported hand")
    yield 0.5
    yield from stage.look_through_camera()
    yield from stage.open_sidebar()
    yield from stage.screenshot("imported")
    counts = [len(armatures())]
    yield from stage.undo()
    yield from stage.undo()
    counts.append(len(armatures()))
    yield from stage.redo()
    yield from stage.redo()
    counts.append(len(armatures()))
    return counts
