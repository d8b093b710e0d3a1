"""What this session knows about the installation; needs no handfit_core, which may be what is missing."""

from __future__ import annotations

import importlib
import importlib.util
import sys
from pathlib import Path

import bpy

from . import installation
from .installation import CORE, Place, Problem

CORE_MODULE = "handfit_core"

_known: list[Problem] = []


def place() -> Place:
    """This copy, in this Blender."""
    return installation.this_place(Path(bpy.utils.user_resource("EXTENSIONS")))


def problems() -> tuple[Problem, ...]:
    """What is known to be wrong, causes before consequences. Costs nothing."""
    return tuple(_known)


def is_refused() -> bool:
    """Whether something keeps the add-on from running."""
    return any(problem.stops == "add-on" for problem in _known)


def examine() -> None:
    """Examine the installation anew: names, sizes and versions."""
    examined = installation.examine(place())
    importlib.invalidate_caches()  # Blender may just have unpacked it
    _known[:] = installation.causes_first([*examined, *_module_problems(examined)])


def refuse(problem: Problem) -> None:
    """Add a reason why the add-on does not run."""
    _known[:] = installation.causes_first([problem, *_known])


def capture_problem() -> Problem | None:
    """The first of what keeps Blender's own Python from capturing, as far as is known. Costs nothing."""
    return next((problem for problem in _known if problem.stops != "nothing"), None)


def report() -> str:
    """The installation's state, for a bug report."""
    return installation.report(place(), _known)


def print_sentence(sentence: str) -> None:
    """Print a sentence on the console."""
    print(f"Manient Hand Capture: {sentence}", file=sys.stderr)


def core_problem() -> Problem | None:
    """Whether the handfit_core that is loaded belongs to another version of the add-on."""
    if not installation.is_installed():
        return None
    loaded = getattr(sys.modules.get(CORE_MODULE), "__version__", None)
    version = installation.read_contents().version
    return None if loaded in (None, version) else installation.core_version_problem(version, str(loaded))


def forget_core() -> None:
    """Have handfit_core imported anew."""
    for name in [n for n in sys.modules if n == CORE_MODULE or n.startswith(f"{CORE_MODULE}.")]:
        del sys.modules[name]


_NEEDED = {
    "numpy": "this Blender's Python lacks NumPy, which Blender brings along: use Blender from blender.org, "
    "or install your system's package for it (python3-numpy)",
    CORE_MODULE: "the add-on's other half, handfit_core, is not there: remove the add-on, restart Blender "
    "and install the zip again",
}
"""What the add-on's own half imports -> what is said where Python does not find it"""


def _module_problems(already: list[Problem]) -> list[Problem]:
    """Problems of needed modules that cannot be imported, without those whose reason is known already."""
    told = any(problem.wheel == CORE and problem.stops == "add-on" for problem in already)
    return [
        Problem("module", sentence, CORE if name == CORE_MODULE else name, "add-on")
        for name, sentence in _NEEDED.items()
        if not _is_importable(name) and not (told and name == CORE_MODULE)
    ]


def _is_importable(name: str) -> bool:
    """Whether a package can be imported; an empty folder of its name is none."""
    try:
        spec = importlib.util.find_spec(name)
    except (ImportError, ValueError):
        return False
    return spec is not None and spec.origin is not None


def register() -> None:
    """Say on the console why the add-on cannot run; what follows the first reason are consequences of it."""
    if is_refused():
        print_sentence(_known[0].sentence)


def unregister() -> None:
    """Forget everything."""
    _known.clear()
