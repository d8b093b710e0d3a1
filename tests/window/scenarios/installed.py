"""An extension that was installed from the zip, in the window."""

from __future__ import annotations

import sys

import bpy
from stage import ADDON

from scenarios.capturing import done, finish, press_capture, summary
from scenarios.traces import workers


def photo_by_the_button(stage, source):
    """In the scene that Blender starts with: the panel, the button Capture, the hand; and where all of it
    came from."""
    bpy.ops.wm.read_homefile()
    yield 0.5
    begun_with = set(bpy.data.objects.keys())
    yield from stage.open_sidebar()
    yield from stage.screenshot("installed-panel")
    job = yield from press_capture(stage, source)
    yield from finish(stage, job, timeout=120.0)
    done(job)
    yield from stage.look_through_camera()
    yield from stage.screenshot("installed-photo")
    modules = {name: module for name, module in list(sys.modules.items()) if _is_ours(name)}
    return {
        "addons": [name for name in bpy.context.preferences.addons.keys() if "manient" in name],  # noqa: SIM118
        "hands": summary(),
        "begun_with": sorted(begun_with),
        "in_the_way": [
            o.name for o in bpy.data.objects if o.name in begun_with and o.type == "MESH" and o.visible_get()
        ],
        "workers": len(workers()),
        "files": sorted({str(getattr(module, "__file__", None)) for module in modules.values()}),
    }


def _is_ours(name: str) -> bool:
    return name.startswith((ADDON, "handfit_core"))
