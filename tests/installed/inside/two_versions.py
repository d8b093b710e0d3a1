"""Two versions of the add-on in two of Blender's repositories, which share one folder of unpacked wheels."""

from __future__ import annotations

import sys
from pathlib import Path

import bpy

sys.path.insert(0, str(Path(__file__).resolve().parent))

import steps
from steps import Facts

SECOND = "second"


def main() -> None:
    """Stage by stage."""
    facts = Facts()
    facts.add("first", **steps.install(facts.asked["first"]), core=core())
    done = bpy.ops.preferences.extension_repo_add(name=SECOND, type="LOCAL")
    facts.add(
        "repository", said=sorted(done), all=[r.module for r in bpy.context.preferences.extensions.repos]
    )
    facts.add("second", **steps.install(facts.asked["second"], SECOND), core=core())
    facts.add("panels", said=steps.panels())
    facts.add("button", said=steps.press_capture(facts.asked["photo"]))
    facts.add("check", **steps.command("check"))
    facts.add("loaded", **steps.loaded())
    facts.add("second removed", said=steps.uninstall(SECOND), core=core(), enabled=steps.enabled())
    name = steps.module().__name__
    steps.attempt(bpy.ops.preferences.addon_disable, module=name)
    steps.attempt(bpy.ops.preferences.addon_enable, module=name)
    facts.add("panels of the first alone", said=steps.panels())
    steps.uninstall()
    facts.add("removed", enabled=steps.enabled())


def core() -> list[str]:
    """Which versions of handfit_core are unpacked."""
    folder = Path(bpy.utils.user_resource("EXTENSIONS")) / ".local"
    return sorted(path.name for path in folder.rglob("handfit_core-*.dist-info"))


main()
