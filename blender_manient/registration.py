"""Registration of all modules of the add-on, or of the one that says why they cannot run.

Nothing of handfit_core is imported before the installation was looked at.
"""

from __future__ import annotations

import atexit
import contextlib
import importlib
import importlib.util
import sys
import traceback
from collections.abc import Iterable, Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import bpy

from . import command, unusable
from .common import installation

PACKAGE = __package__ or ""


def _unload(names: Iterable[str]) -> None:
    """Have modules imported anew. Where the package holds one as an attribute, `from . import` finds it."""
    for name in list(names):
        sys.modules.pop(name, None)
        package, _, leaf = name.rpartition(".")
        if package in sys.modules:
            vars(sys.modules[package]).pop(leaf, None)


def _loaded_modules() -> list[str]:
    """The names of this package's modules that are loaded."""
    return [name for name in sys.modules if name.startswith(f"{PACKAGE}.")]


_WITHOUT_CORE = frozenset(_loaded_modules())
"""Modules that can be imported where handfit_core cannot"""
_registered: list[Any] = []
"""In the order of registration"""
_core: ModuleType | None = None
"""The handfit_core with which the modules were imported"""


def register() -> None:
    """Register every module of the add-on, or only the panel that says why it cannot run."""
    modules = _addon_modules() if _can_run() else (unusable,)
    found = installation.fault()
    if found is not None and not found.runs:
        installation.print_sentence(found.sentence)
    try:
        for module in modules:
            _registered.append(module)  # before: where it fails, half of it may be registered
            module.register()
        _register_command()
    except Exception:
        with contextlib.suppress(Exception):
            unregister()
        raise
    if not bpy.app.binary_path:
        # Blender disables its add-ons when it quits; as a Python module it does not, and can then hang.
        atexit.register(unregister)


def unregister() -> None:
    """Undo `register`, in reverse; all of it, whatever a module raises. Raises the first such error then."""
    atexit.unregister(unregister)
    errors: list[Exception] = []
    while _registered:
        try:
            _registered.pop().unregister()
        except Exception as error:
            errors.append(error)
    installation.note(None)
    if errors:
        _unregister_classes()
        raise errors[0]


def runs() -> bool:
    """Whether the add-on is registered with all its modules."""
    return bool(_registered) and unusable not in _registered


def _can_run() -> bool:
    installation.note(installation.examine(Path(bpy.utils.user_resource("EXTENSIONS"))))
    importlib.invalidate_caches()  # Blender may just have unpacked it
    for name in ("numpy", "handfit_core"):
        if not installation.is_refused() and not _is_importable(name):
            missing = ModuleNotFoundError(f"no module named {name}", name=name)
            installation.note(installation.import_fault(missing))
    other = _running_copy()
    if other and not installation.is_refused():
        installation.note(installation.second_copy(other))
    return not installation.is_refused()


def _is_importable(name: str) -> bool:
    """Whether a package can be imported; an empty folder of its name is none."""
    try:
        spec = importlib.util.find_spec(name)
    except (ImportError, ValueError):
        return False
    return spec is not None and spec.origin is not None


def _register_command() -> None:
    """Register the command, of which Blender knows one of a name: the copy's that runs, else the first's."""
    others = [module for _, module in _copies() if isinstance(getattr(module, "command", None), ModuleType)]
    if runs():
        for other in others:
            other.command.unregister()
    elif any(getattr(other.command, "_handle", None) is not None for other in others):
        return
    _registered.append(command)
    command.register()


def _copies() -> Iterator[tuple[str, ModuleType]]:
    """Other copies of the add-on that are loaded, from others of Blender's repositories."""
    leaf = PACKAGE.rpartition(".")[2]
    for name, module in list(sys.modules.items()):
        if name.startswith("bl_ext.") and name.endswith(f".{leaf}") and name != PACKAGE:
            yield name, module


def _running_copy() -> str:
    """The name of another copy that runs."""
    for name, module in _copies():
        running = getattr(module, "runs", None)
        if callable(running) and running():
            return name
    return ""


def _addon_modules() -> tuple[Any, ...]:
    """The modules to register, or the one that says why they cannot be imported."""
    global _core
    installed = installation.is_installed()
    if installed and _other_core() is not None:
        _forget_core()
    if installed and _core is not None and _core is not sys.modules.get("handfit_core"):
        # Another copy of the add-on has run meanwhile, with a handfit_core of its own.
        _unload(name for name in _loaded_modules() if name not in _WITHOUT_CORE)
    before = set(sys.modules)
    try:
        # Needs handfit_core, which must be looked at before it is imported.
        from . import modules
    except Exception as error:
        if not installed:
            raise
        traceback.print_exc()
        # Half of them would be met again.
        _unload(n for n in set(sys.modules) - before if n.startswith((f"{PACKAGE}.", "handfit_core")))
        installation.note(installation.import_fault(error))
        return (unusable,)
    _core = sys.modules.get("handfit_core")
    if installed and (other := _other_core()) is not None:
        installation.note(other)
        return (unusable,)
    return modules.MODULES


def _other_core() -> installation.Fault | None:
    """Whether the handfit_core that is loaded belongs to another version of the add-on."""
    loaded = getattr(sys.modules.get("handfit_core"), "__version__", None)
    version = installation.installed_version()
    return None if loaded in (None, version) else installation.other_core(version, str(loaded))


def _forget_core() -> None:
    """Have handfit_core imported anew."""
    _unload(n for n in list(sys.modules) if n == "handfit_core" or n.startswith("handfit_core."))


def _unregister_classes() -> None:
    """Take away what modules that failed have left with Blender: it would refuse them the next time."""
    modules = [sys.modules[name] for name in _loaded_modules()]
    classes = {cls for module in modules for cls in vars(module).values() if isinstance(cls, type)}
    for cls in classes:
        if cls.__module__.startswith(f"{PACKAGE}.") and "bl_rna" in vars(cls):
            with contextlib.suppress(RuntimeError, ValueError):
                bpy.utils.unregister_class(cls)


if installation.is_installed() and not _running_copy():
    # The one that is loaded may be of another zip: the add-on was replaced in a running Blender.
    _forget_core()
