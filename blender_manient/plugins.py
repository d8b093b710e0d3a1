"""Plug-ins: a file in their folder is all that adds one."""

from __future__ import annotations

import importlib
import pkgutil
import sys
from typing import Any

from handfit_core.files import shown

_named: set[str] = set()
"""What the console has been told already"""


def found_in(
    package: str, kind: type, needed: tuple[str, ...] = (), first: tuple[str, ...] = ()
) -> list[Any]:
    """The concrete classes of that kind that a package's modules define: those of the modules `first`, in
    this order, then the others by their modules' names.

    A module that cannot be imported, and a class that lacks what is `needed`, are named in the console and
    left out: one bad file takes none of the others away.
    """
    found = []
    there = {module.name for module in pkgutil.iter_modules(sys.modules[package].__path__)}
    for name in (*first, *sorted(there - {*first})):
        try:
            content = vars(importlib.import_module(f"{package}.{name}"))
        except (Exception, SystemExit) as error:
            tell_once(f"{shown(name)}.py is left out: {error}")
            continue
        for value in content.values():
            if not (isinstance(value, type) and issubclass(value, kind)) or value is kind:
                continue
            if value.__module__ != f"{package}.{name}":
                continue
            lacking = [n for n in needed if not hasattr(value, n)] + sorted(value.__abstractmethods__)
            if lacking:
                tell_once(f"{shown(name)}.py is left out: {value.__name__} has no {', '.join(lacking)}")
            else:
                found.append(value)
    return found


def failed(plugin: type, error: BaseException) -> str:
    """A sentence about an error in a plug-in's own code."""
    file = shown(plugin.__module__.rpartition(".")[2])
    said = f"{type(error).__name__}: {' '.join(str(error).split())}"
    return f"the plug-in {file}.py failed in {plugin.__name__} ({said}): mend or remove that file"


def tell_once(sentence: str) -> None:
    """Say something on the console, the first time that it is to be said."""
    if sentence not in _named:
        _named.add(sentence)
        print(f"Hand Capture: {sentence}", file=sys.stderr)
