"""Plug-ins: a file in their folder is all that adds one."""

from __future__ import annotations

import importlib
import pkgutil
import sys
from typing import Any

from handfit_core.files import shown


def found_in(package: str, kind: type, needed: tuple[str, ...] = ()) -> list[Any]:
    """The concrete classes of that kind that a package's modules define, by the modules' names.

    A module that cannot be imported, and a class that lacks what is `needed`, are named in the console and
    left out: one bad file takes none of the others away.
    """
    found = []
    for module in sorted(pkgutil.iter_modules(sys.modules[package].__path__), key=lambda m: m.name):
        try:
            content = vars(importlib.import_module(f"{package}.{module.name}"))
        except (Exception, SystemExit) as error:
            print(f"Hand Capture: {shown(module.name)}.py is left out: {error}", file=sys.stderr)
            continue
        for value in content.values():
            if not (isinstance(value, type) and issubclass(value, kind)) or value is kind:
                continue
            if value.__module__ != f"{package}.{module.name}":
                continue
            lacking = [n for n in needed if not hasattr(value, n)] + sorted(value.__abstractmethods__)
            if lacking:
                what = f"{shown(module.name)}.py is left out: {value.__name__} has no {', '.join(lacking)}"
                print(f"Hand Capture: {what}", file=sys.stderr)
            else:
                found.append(value)
    return found
