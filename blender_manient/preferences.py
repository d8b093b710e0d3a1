"""The add-on's preferences: where MANO, the capturing Python and the cache are, and a few habits."""

import os
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import bpy
from bpy.props import BoolProperty, EnumProperty, FloatProperty, IntProperty, StringProperty

from handfit_core.options import OPTIONS

from .properties import PRESETS

ADDON = ".".join(__name__.split(".")[: 3 if __name__.startswith("bl_ext.") else 1])
"""The name of the add-on in Blender's preferences; of an extension it is bl_ext.REPOSITORY.ID"""

# The annotations are read below, so this file does without `from __future__ import annotations`.


def _forget_check(_self, _context) -> None:
    """What was checked is another Python."""
    from .operators import check_installation

    check_installation.forget()


class ManientPreferences(bpy.types.AddonPreferences):
    """Edit > Preferences > Add-ons > Manient Hand Capture."""

    bl_idname = ADDON

    mano_folder: StringProperty(  # type: ignore
        name="MANO Files",
        description="Folder with your MANO_RIGHT and MANO_LEFT files, or one of these files",
        subtype="FILE_PATH",
    )
    python: StringProperty(  # type: ignore
        name="Python",
        description="A Python of your own that captures; it needs torch, SciPy, MediaPipe and OpenCV. "
        "Empty: the one in $HANDFIT_PYTHON, else Blender's own with what this extension brings",
        subtype="FILE_PATH",
    )
    threads: IntProperty(  # type: ignore
        name="Threads",
        description="How many processor threads a capture may use. 0: as many as are useful",
        default=0,
        min=0,
        soft_max=32,
        max=256,
    )
    max_megapixels: IntProperty(  # type: ignore
        name="Largest Picture",
        description="Megapixels that any picture, and any frame of a video, may have; larger ones are "
        f"refused before they fill the memory. 0: {OPTIONS['max_megapixels'].by_default}",
        default=0,
        min=0,
        soft_max=500,
        max=4000,
    )
    cache_folder: StringProperty(  # type: ignore
        name="Cache",
        description="Folder for temporary files; a folder of the add-on's own is made in it. "
        "Empty: Blender's folder for the extension",
        subtype="DIR_PATH",
    )
    default_preset: EnumProperty(  # type: ignore
        name="Quality",
        description="Quality of captures in scenes where none has been chosen yet",
        items=PRESETS,
        default="BEST",
        update=lambda _self, _context: _apply_default_preset(),
    )
    drop_captures: BoolProperty(  # type: ignore
        name="Drag and Drop Captures Hands",
        description="Offer to capture hands when a picture or video is dropped onto the 3D viewport",
        default=True,
    )
    hand_opacity: FloatProperty(  # type: ignore
        name="Hand Opacity",
        description="How opaque the hand over the picture is while keypoints are edited. H makes it solid "
        "and see-through again",
        default=0.5,
        min=0.0,
        max=1.0,
        subtype="FACTOR",
        update=lambda _self, _context: _opacity_changed(),
    )

    def draw(self, context):
        """One block per subject."""
        layout = self.layout
        assert layout is not None
        layout.use_property_split = True
        layout.use_property_decorate = False
        for draw in (_draw_worker, _draw_mano, _draw_cache, _draw_habits):
            draw(self, layout.column(), context)


# What is drawn imports late: all of it needs the preferences.


def _draw_worker(self, layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    from .operators import check_installation
    from .section import sentence
    from .worker import shared

    layout.prop(self, "python")
    text = shared.capture_sentence()
    if text:
        sentence(layout, context, text, "ERROR", alert=True)
    layout.prop(self, "threads")
    layout.prop(self, "max_megapixels")
    row = layout.row(align=True)
    row.operator("manient.check_installation", icon="CHECKMARK")
    if check_installation.running():
        layout.label(text="Checking, which takes up to half a minute", icon="TIME")
        return
    result = check_installation.last_result()
    if result is not None:
        show = row.operator("manient.show_details", text="Show", icon="TEXT")
        copy = row.operator("manient.copy_details", text="Copy", icon="COPYDOWN")
        show.text = copy.text = check_installation.TEXT_NAME
        if result.sentence != text:
            icon = "CHECKMARK" if result.ok else "ERROR"
            sentence(layout, context, result.sentence, icon, alert=not result.ok)


def _draw_mano(self, layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    from .operators import check_mano
    from .section import sentence

    layout.separator()
    layout.prop(self, "mano_folder")
    row = layout.row()
    row.enabled = bool(self.mano_folder)
    row.operator("manient.check_mano", icon="CHECKMARK").path = self.mano_folder
    for result in check_mano.results(self.mano_folder):
        sentence(layout, context, result.sentence, "CHECKMARK" if result.ok else "ERROR", alert=not result.ok)


def _draw_cache(self, layout: bpy.types.UILayout, _context: bpy.types.Context) -> None:
    from . import cache

    layout.separator()
    layout.prop(self, "cache_folder")
    size = cache.shown_size()
    row = layout.row()
    row.label(text="..." if size is None else f"{size / 1e6:.1f} MB in use", icon="BLANK1", translate=False)
    row.operator("manient.clear_cache", icon="TRASH")


def _draw_habits(self, layout: bpy.types.UILayout, _context: bpy.types.Context) -> None:
    layout.separator()
    layout.prop(self, "default_preset")
    layout.prop(self, "drop_captures")
    layout.prop(self, "hand_opacity")


def get(context: bpy.types.Context | None = None) -> Any:
    """The preferences; where the add-on was registered by a script instead of enabled, an object with the
    same fields and their defaults, which lasts until the add-on is unregistered."""
    addon = (context or bpy.context).preferences.addons.get(ADDON)
    return getattr(addon, "preferences", None) or _without_entry


def full_path(text: str) -> str:
    """A path as typed into the preferences, made absolute; empty stays empty."""
    text = unquoted(text)
    return str(Path(os.path.expanduser(bpy.path.abspath(text)))) if text else ""  # noqa: PTH111


def unquoted(text: str) -> str:
    """Without the spaces and quotes around it that come with a copied path."""
    text = text.strip()
    if len(text) > 1 and text[0] == text[-1] and text[0] in "\"'":
        text = text[1:-1].strip()
    return text


def _opacity_changed() -> None:
    from .scene import see_through

    see_through.opacity_changed()


def redraw() -> None:
    """Draw all Preferences editors again."""
    manager = bpy.context.window_manager
    for window in manager.windows if manager else ():
        for area in window.screen.areas:
            if area.type == "PREFERENCES":
                area.tag_redraw()


def _defaults() -> SimpleNamespace:
    properties = ManientPreferences.__annotations__
    # What Blender takes where a definition names no default.
    empty = {"StringProperty": "", "IntProperty": 0, "BoolProperty": False}
    return SimpleNamespace(
        **{
            name: deferred.keywords.get("default", empty.get(deferred.function.__name__))
            for name, deferred in properties.items()
        }
    )


_without_entry = _defaults()


@bpy.app.handlers.persistent
def _apply_default_preset(*_: object) -> None:
    """Give the preferred quality to scenes in which nobody has chosen one."""
    preset = get().default_preset
    for scene in bpy.data.scenes:
        settings = getattr(scene, "manient", None)
        if settings is None or not scene.is_editable or settings.is_property_set("preset"):
            continue
        if settings.preset != preset:
            settings.preset = preset


def register() -> None:
    """Give the preferred quality to every file that is opened."""
    bpy.app.handlers.load_post.append(_apply_default_preset)


def unregister() -> None:
    """Follow no file any more; Blender keeps what was chosen until the add-on is removed."""
    global _without_entry
    bpy.app.handlers.load_post.remove(_apply_default_preset)
    _without_entry = _defaults()
