"""Plug-ins: a file in their folder is all that adds one.

The user's own folders lie with Blender's data files: an update or a removal of the add-on leaves them alone,
while the folder that Blender keeps for an extension goes with it.
"""

from __future__ import annotations

import importlib
import pkgutil
import sys
from pathlib import Path
from typing import Any

import bpy

from handfit_core.common.files import shown

KINDS = ("exporters", "rigs")
"""The folders of plug-ins, each with the name of the package that its plug-ins belong to"""

_printed: dict[str, None] = {}
"""Sentences that were printed already, in order"""


def folder() -> Path:
    """Return the user's folder of plug-ins, which need not be there."""
    return Path(bpy.utils.user_resource("DATAFILES", path="manient"))


def troubles() -> list[str]:
    """Return a sentence for each thing that was wrong with plug-ins since the add-on was enabled."""
    return list(_printed)


def find_plugins(
    package: str, kind: type, needed: tuple[str, ...] = (), first: tuple[str, ...] = ()
) -> list[Any]:
    """Return the concrete classes of that kind that a package's modules, and those in the user's folder of
    its name, define: those of the modules `first`, in this order, then the others by their modules' names.

    A module that cannot be imported, and a class that lacks what is `needed`, are named in the console and
    left out: one bad file takes none of the others away.
    """
    found, path = [], sys.modules[package].__path__
    own = str(folder() / package.rpartition(".")[2])
    ours = {module.name for module in pkgutil.iter_modules(path)}
    added = {module.name for module in pkgutil.iter_modules([own])}
    for name in sorted(ours & added):
        print_once(f"{shown(name)}.py is left out: the add-on has a file of this name, choose another one")
    if own not in path:
        path.append(own)
    there = ours | added
    for name in (*first, *sorted(there - {*first})):
        try:
            content = vars(importlib.import_module(f"{package}.{name}"))
        except (Exception, SystemExit) as error:
            print_once(f"{shown(name)}.py is left out: {error}")
            continue
        for value in content.values():
            if not (isinstance(value, type) and issubclass(value, kind)) or value is kind:
                continue
            if value.__module__ != f"{package}.{name}":
                continue
            lacking = [n for n in needed if not hasattr(value, n)] + sorted(value.__abstractmethods__)
            if lacking:
                print_once(f"{shown(name)}.py is left out: {value.__name__} has no {', '.join(lacking)}")
            else:
                found.append(value)
    return found


def failure_sentence(plugin: type, error: BaseException) -> str:
    """Return a sentence about an error in a plug-in's own code."""
    file = shown(plugin.__module__.rpartition(".")[2])
    said = f"{type(error).__name__}: {' '.join(str(error).split())}"
    return f"the plug-in {file}.py failed in {plugin.__name__} ({said}): mend or remove that file"


def print_once(sentence: str) -> None:
    """Print a sentence on the console, once a session."""
    if sentence not in _printed:
        _printed[sentence] = None
        print(f"Hand Capture: {sentence}", file=sys.stderr)
