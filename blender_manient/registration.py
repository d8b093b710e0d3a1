"""Registration of all modules of the add-on, or of the panel that says why they cannot run."""

from __future__ import annotations

import atexit
import contextlib
import importlib
import sys
import traceback
from collections.abc import Iterable
from types import ModuleType
from typing import Any

import bpy

from . import command, unusable
from .common import installation

PACKAGE = __package__ or ""
SECOND_COPY = (
    "Another copy of this add-on is enabled already: disable or remove one of the two and restart Blender"
)

_WITHOUT_CORE = frozenset(name for name in sys.modules if name.startswith(f"{PACKAGE}."))
"""Names of the modules that can be imported where handfit_core cannot"""
_registered: list[Any] = []
"""The registered modules, in the order of their registration"""
_core: ModuleType | None = None
"""The handfit_core with which the modules were imported"""


def register() -> None:
    """Register every module of the add-on, or only the panel that says why it cannot run."""
    # Blender refuses a command of which it knows two.
    modules = _refused(SECOND_COPY) if _is_second_copy() else (*_addon_modules(), command)
    try:
        for module in modules:
            _registered.append(module)  # before: where it fails, half of it may be registered
            module.register()
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
    installation.why_not = installation.details = ""
    if errors:
        raise errors[0]


def _addon_modules() -> tuple[Any, ...]:
    """Return the modules to register, or the one that says that they cannot be imported."""
    global _core
    if installation.is_installed() and (_core is None or _core is not sys.modules.get("handfit_core")):
        # What is loaded may be of an earlier zip, or of another copy that has run meanwhile.
        _unload(name for name in sys.modules if name.partition(".")[0] == "handfit_core")
        _unload(name for name in sys.modules if name.startswith(f"{PACKAGE}.") and name not in _WITHOUT_CORE)
    importlib.invalidate_caches()  # Blender may just have unpacked it
    try:
        # Needs handfit_core, which may be missing.
        from . import modules

        _core = sys.modules["handfit_core"]
        if (version := installation.addon_version()) != _core.__version__:
            raise ImportError(f"handfit_core is version {vars(_core)['__version__']}, the add-on {version}")
    except Exception as error:
        if not installation.is_installed():
            raise
        _core = None
        return _refused(installation.NOT_WHOLE, f" ({type(error).__name__}: {error})")
    return modules.MODULES


def _refused(sentence: str, reason: str = "") -> tuple[Any, ...]:
    """Return the module to register where the add-on cannot run; `reason` is for the console."""
    installation.why_not = sentence
    installation.details = traceback.format_exc() if reason else ""
    print(f"Manient Hand Capture: {sentence}{reason}", file=sys.stderr)
    return (unusable,)


def _unload(names: Iterable[str]) -> None:
    """Forget these modules, so that they are imported anew. Each is taken out of its package too, where `from
    . import` would still find it."""
    for name in list(names):
        sys.modules.pop(name, None)
        package, _, leaf = name.rpartition(".")
        if package in sys.modules:
            vars(sys.modules[package]).pop(leaf, None)


def _is_second_copy() -> bool:
    """True if a copy of the add-on from another one of Blender's repositories is registered."""
    ending = f".{PACKAGE.rpartition('.')[2]}.registration"
    others = [n for n in sys.modules if n.startswith("bl_ext.") and n.endswith(ending) and n != __name__]
    return any(getattr(sys.modules[name], "_registered", None) for name in others)
