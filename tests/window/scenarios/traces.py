"""What an add-on leaves in Blender while it is enabled, and must not leave after it."""

from __future__ import annotations

import os
import sys
import threading
from pathlib import Path

import bpy

NAME = "manient"


def traces() -> dict[str, list[str]]:
    """Everything of the add-on's that Blender knows, kind by kind; kinds without any are left out."""
    addons = bpy.context.window_manager.keyconfigs.addon  # None without a window, in some versions
    found = {
        "classes": [name for name in dir(bpy.types) if NAME in name.lower()],
        "operators": list(dir(bpy.ops.manient)) if NAME in dir(bpy.ops) else [],
        "properties": [
            f"{name}.{key}"
            for name in ("Scene", "Object", "Collection", "WindowManager", "Armature", "PoseBone", "Bone")
            for key in getattr(bpy.types, name).bl_rna.properties.keys()  # noqa: SIM118
            if NAME in key
        ],
        "menu entries": [
            f"{menu}.{function.__name__}"
            for menu in dir(bpy.types)
            for function in getattr(getattr(getattr(bpy.types, menu), "draw", None), "_draw_funcs", ())
            if _ours(function)
        ],
        "handlers": [
            f"{name}.{function.__name__}"
            for name in dir(bpy.app.handlers)
            if isinstance(handlers := getattr(bpy.app.handlers, name), list)
            for function in handlers
            if _ours(function)
        ],
        "timers": [
            f"{module}.{name}"
            for module, contents in list(sys.modules.items())
            if NAME in module and contents is not None
            for name, function in vars(contents).items()
            if callable(function)
            and not isinstance(function, type)
            and bpy.app.timers.is_registered(function)
        ],
        "shortcuts": [
            f"{keymap.name}: {item.idname}"
            for keymap in (addons.keymaps if addons else ())
            for item in keymap.keymap_items
            if item.idname.startswith(f"{NAME}.")
        ],
        "processes": [command for _, command in workers()],
        "threads": [t.name for t in threading.enumerate() if t is not threading.main_thread()],
    }
    return {kind: names for kind, names in found.items() if names}


def _ours(function) -> bool:
    return NAME in str(getattr(function, "__module__", ""))


def workers() -> list[tuple[int, str]]:
    """(process id, command line) of this Blender's child processes that run handfit_core."""
    found = []
    for folder in Path("/proc").iterdir():
        if not folder.name.isdigit():
            continue
        try:
            stat = (folder / "stat").read_text()
            command = (folder / "cmdline").read_bytes().replace(b"\0", b" ").decode(errors="replace")
        except OSError:
            continue  # ended meanwhile
        state, parent = stat.rpartition(")")[2].split()[:2]
        if int(parent) == os.getpid() and state != "Z" and "handfit_core" in command:
            found.append((int(folder.name), command.strip()))
    return found
