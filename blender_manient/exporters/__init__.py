"""File formats for other programs, found by themselves. A line here runs in Blender, asks rigs and the scene,
and writes files; it knows of no operator and no panel."""

from __future__ import annotations

from handfit_core.common.errors import OptionError

from ..common.plugins import find_plugins, print_once
from .exporter import Exporter

PRESETS = (
    ("PLAIN", "Plain", "Blender's axes and metres"),
    ("UNITY", "Unity", "Axes and scale that Unity imports without changes"),
    ("UNREAL", "Unreal", "Axes and scale that Unreal Engine imports without changes"),
)
"""The name, label and description of each program that formats know"""

_REQUIRED = ("name", "label", "description", "suffix")
_BUILT_IN = ("blend", "blender_formats", "vrma", "take")
"""The files of this folder that have formats, in the order of the buttons"""

_TAKEN = (".json", ".export.json", ".sheet.jpg", ".preview.png")
"""Endings of the other files that a batch writes beside an input's exports"""

EXPORTERS: dict[str, Exporter] = {}
"""Every format by its name, in the order of the buttons; a later one takes away no name and no suffix"""


def find_exporter(name: str) -> Exporter:
    """Return the format of that name (case and a leading dot do not matter). Raises OptionError."""
    chosen = EXPORTERS.get(name.lower().lstrip("."))
    if chosen is None:
        known = ", ".join(known for known, e in EXPORTERS.items() if e.writes != "captured")
        raise OptionError(f"there is no export format {name!r}; choose from {known}")
    return chosen


# Files of this folder ask for what stands above, and are imported here.
for _kind in find_plugins(__name__, Exporter, _REQUIRED, _BUILT_IN):
    _why = ""
    if _kind.name in EXPORTERS:
        _why = f"there is a format {_kind.name!r} already"
    elif _kind.suffix in (*_TAKEN, *(each.suffix for each in EXPORTERS.values())):
        _why = f"other files end with {_kind.suffix} already, choose another suffix"
    if _why:
        _file = _kind.__module__.rpartition(".")[2]
        print_once(f"{_kind.__name__} of {_file}.py is left out: {_why}")
    else:
        EXPORTERS[_kind.name] = _kind()
