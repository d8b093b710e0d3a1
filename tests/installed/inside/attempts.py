"""A zip that cannot capture, for some reason: what the artist reads, in the panel and on the command line."""

from __future__ import annotations

import sys
from pathlib import Path

import bpy

sys.path.insert(0, str(Path(__file__).resolve().parent))

import steps
from steps import Facts
from traces import traces


def main() -> None:
    """Stage by stage."""
    facts = Facts()
    facts.add("installed", **steps.install(facts.asked["zip"]))
    if steps.enabled():
        facts.add("panels", said=steps.panels())
        facts.add("check", **steps.command("check"))
        facts.add("batch", **steps.command("capture", facts.asked["photo"], "-o", facts.asked["made"]))
        if hasattr(bpy.context.scene, "manient"):
            facts.add("button", said=steps.press_capture(facts.asked["photo"]))
        steps.uninstall()
    facts.add("left", traces=traces(), enabled=steps.enabled())


main()
