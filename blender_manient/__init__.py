"""Manient Hand Capture: photos and videos of hands become rigged, animated hands in Blender.

Importing this package needs neither handfit_core nor NumPy: where they are missing or wrong, the add-on
comes up with a sentence about it instead of an error.
"""

from __future__ import annotations

import atexit
import sys
import traceback
from types import ModuleType

import bpy

from . import command, installation, unusable, verification

_registered: list[ModuleType] = []
"""In the order of registration"""


def register() -> None:
    """Register every part of the add-on, or only what tells why it cannot run."""
    parts = _parts() if _can_run() else (unusable,)
    for part in (verification, *parts, command):
        part.register()
        _registered.append(part)
    if not bpy.app.binary_path:
        # Blender disables its add-ons when it quits; as a Python module it does not, and can then hang.
        atexit.register(unregister)


def unregister() -> None:
    """Undo `register`, in reverse."""
    atexit.unregister(unregister)
    while _registered:
        _registered.pop().unregister()


def runs() -> bool:
    """Whether the add-on is registered with all its parts."""
    return bool(_registered) and unusable not in _registered


def _can_run() -> bool:
    if verification.refusal() is not None:
        return False
    other = _running_copy()
    if other:
        verification.refuse(installation.second_copy_problem(other))
    return not other


def _running_copy() -> str:
    """The name of another copy of the add-on that runs, from another of Blender's repositories."""
    leaf = __name__.rpartition(".")[2]
    for name, module in list(sys.modules.items()):
        if name.startswith("bl_ext.") and name.endswith(f".{leaf}") and name != __name__:
            running = getattr(module, "runs", None)
            if callable(running) and running():
                return name
    return ""


def _parts() -> tuple[ModuleType, ...]:
    """All parts, or the one that says why they cannot be imported."""
    if f"{__name__}.parts" not in sys.modules:
        verification.forget_other_core()
    before = set(sys.modules)
    try:
        from . import parts
    except Exception as error:
        if not installation.is_installed():
            raise
        traceback.print_exc()
        for name in set(sys.modules) - before:  # half of them would be met again
            if name.startswith((f"{__name__}.", "handfit_core")):
                del sys.modules[name]
        verification.refuse(installation.import_problem(error))
        return (unusable,)
    problem = verification.core_problem()
    if problem is not None:
        verification.refuse(problem)
        return (unusable,)
    return parts.PARTS
