"""What the add-on's preferences hold: where MANO, the capturing Python and the cache are, and habits."""

import os
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import bpy
from bpy.props import BoolProperty, EnumProperty, FloatProperty, IntProperty, StringProperty

from handfit_core.capturing.options import OPTIONS
from handfit_core.worker.interpreter import unquoted

ADDON = ".".join(__name__.split(".")[: 3 if __name__.startswith("bl_ext.") else 1])
"""The name of the add-on in Blender's preferences; of an extension it is bl_ext.REPOSITORY.ID"""

# A .blend and the preferences keep the numbers.
PRESETS = (
    (
        "DRAFT",
        "Draft",
        "To try things out, and for clear shots. Each hand is looked at once, by a smaller network: hands "
        "are found in less than half the time, but fingers are rougher, and small or half hidden ones missed",
        "NONE",
        0,
    ),
    (
        "STANDARD",
        "Standard",
        "For most work. Two networks look at each hand, and again where they do not agree; small and half "
        "hidden hands are searched for",
        "NONE",
        1,
    ),
    (
        "BEST",
        "Best",
        "For final shots. Each hand of a clip is looked at six times in every frame, turned and mirrored: a "
        "little more exact and calmer, and hands take four times as long to find. Photos are as in Standard",
        "NONE",
        3,
    ),
    ("PAPER", "Paper", "The experiments of the published method, for comparison. Slow", "NONE", 2),
)

listeners: dict[str, Callable[[Any], None]] = {}
"""For each notifier's name, the function that it calls with the property group that has changed; modules'
LISTENERS"""


def notifier(name: str) -> Callable[[Any, bpy.types.Context], None]:
    """Make a property's `update` function, which calls the listener of that name."""
    return lambda group, _context: listeners[name](group) if name in listeners else None


# The annotations are read below, so this file does without `from __future__ import annotations`.


class Values:
    """The settings that the user keeps for all files; panels/preferences.py shows them."""

    mano_folder: StringProperty(  # type: ignore
        name="MANO Files",
        description="Folder with your MANO_RIGHT and MANO_LEFT files, or one of these files",
        subtype="FILE_PATH",
    )
    python: StringProperty(  # type: ignore
        name="Python",
        description="A Python of your own that captures; it needs SciPy, MediaPipe and OpenCV. "
        "Empty: the one in $HANDFIT_PYTHON, else Blender's own with what this extension brings",
        subtype="FILE_PATH",
    )
    threads: IntProperty(  # type: ignore
        name="Threads",
        description="How many processor threads a capture may use. 0: as many as are useful",
        min=0,
        soft_max=32,
        max=256,
    )
    max_megapixels: IntProperty(  # type: ignore
        name="Largest Picture",
        description="Megapixels that any picture, and any frame of a video, may have; larger ones are "
        f"refused before they fill the memory. 0: {OPTIONS['max_megapixels'].by_default}",
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
        default="STANDARD",
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
        update=notifier("hand_opacity"),
    )


def get(context: bpy.types.Context | None = None) -> Any:
    """Return the preferences; where the add-on was registered by a script instead of enabled, an object with
    the same fields and their defaults, which lasts until the add-on is unregistered."""
    addon = (context or bpy.context).preferences.addons.get(ADDON)
    return getattr(addon, "preferences", None) or _without_entry


def full_path(text: str) -> str:
    """Return a path as typed into the preferences, made absolute; empty stays empty."""
    text = unquoted(text)
    return str(Path(os.path.expanduser(bpy.path.abspath(text)))) if text else ""  # noqa: PTH111


def _defaults() -> SimpleNamespace:
    properties = Values.__annotations__
    # What Blender takes where a definition names no default.
    empty = {"StringProperty": "", "IntProperty": 0, "BoolProperty": False}
    return SimpleNamespace(
        **{
            name: deferred.keywords.get("default", empty.get(deferred.function.__name__))
            for name, deferred in properties.items()
        }
    )


_without_entry = _defaults()


def _apply_default_preset(*_: object) -> None:
    """Give the preferred quality to scenes in which nobody has chosen one."""
    preset = get().default_preset
    for scene in bpy.data.scenes:
        settings = getattr(scene, "manient", None)
        if settings is None or not scene.is_editable or settings.is_property_set("preset"):
            continue
        if settings.preset != preset:
            settings.preset = preset


HANDLERS = {"load_post": _apply_default_preset}


def unregister() -> None:
    """Forget what was chosen without an entry; an entry Blender keeps until the add-on is removed."""
    global _without_entry
    _without_entry = _defaults()
