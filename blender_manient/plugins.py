"""Plug-ins: a file in their folder is all that adds one."""

from __future__ import annotations

import importlib
import inspect
import pkgutil
import sys
from typing import Any

from handfit_core.files import shown


def found_in(package: str, kind: type) -> list[Any]:
    """The concrete classes of that kind that a package's modules define, by the modules' names.

    A module that cannot be imported is named in the console and left out: one bad file takes none of the
    others away.
    """
    found = []
    for module in sorted(pkgutil.iter_modules(sys.modules[package].__path__), key=lambda m: m.name):
        try:
            content = vars(importlib.import_module(f"{package}.{module.name}"))
        except Exception as error:
            print(f"Hand Capture: {shown(module.name)}.py is left out: {error}", file=sys.stderr)
            continue
        found += [
            value
            for value in content.values()
            if isinstance(value, type)
            and issubclass(value, kind)
            and value.__module__ == f"{package}.{module.name}"
            and not inspect.isabstract(value)
        ]
    return found
