"""What this session knows about the installation, and finding out more without blocking the window.

A look at names and sizes comes with registration. Once after each installation every byte is checked, in
slices by a timer, or at once where there is no window; what was found in order is remembered in the
extension's own folder. Works without handfit_core, which may be what is missing.
"""

from __future__ import annotations

import importlib
import importlib.util
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import bpy

from . import installation, screen
from .installation import CORE, Place, Problem

MEMORY = "verified.json"
CORE_MODULE = "handfit_core"

_FIRST = 3.0
"""seconds after registration until the timer begins"""
_PAUSE = 0.02
"""seconds between two slices"""
_SLICE = 0.004
"""seconds after which a slice ends"""

_known: list[Problem] = []
_steps: Iterator[Problem | None] | None = None
"""The deep look that is under way"""
_verified = False
"""Whether a deep look of this session has come to its end, or an earlier one still holds"""


def place() -> Place:
    """This copy, in this Blender."""
    return installation.this_place(Path(bpy.utils.user_resource("EXTENSIONS")))


def problems() -> tuple[Problem, ...]:
    """What is known to be wrong, causes before consequences. Costs nothing."""
    return tuple(_known)


def refusal() -> Problem | None:
    """Look at the installation; returns why the add-on cannot run at all, None where it can."""
    examined = _examine()
    _known[:] = installation.in_order([*examined, *_module_problems(examined)])
    # Of several, the cause: a wheel that Blender cannot open keeps it from unpacking all others.
    return _known[0] if _refused() else None


def refuse(problem: Problem) -> None:
    """Add a reason why the add-on does not run."""
    _known[:] = installation.in_order([problem, *_known])


def capture_sentence() -> str:
    """Why Blender's own Python cannot capture, as far as is known; empty where nothing is. Costs nothing."""
    problem = capture_problem()
    return problem.sentence if problem is not None else ""


def capture_problem() -> Problem | None:
    """The first of what keeps Blender's own Python from capturing, as far as is known. Costs nothing."""
    return next((problem for problem in _known if problem.stops != "nothing"), None)


def before_capture() -> str:
    """The same, after a deep look where there is no window and none was taken yet."""
    if bpy.app.background:
        verify()
    return capture_sentence()


def explanation() -> str:
    """What explains that Blender's own Python has failed to load a part; empty where all files are there.

    Looks for them, which takes some tenths of a second.
    """
    if installation.is_installed():
        _take(installation.examine(place()))
        for found in installation.examine_unpacked(place()):
            _take([found] if found else [])
    return next((problem.sentence for problem in _known), "")


def verify(anew: bool = False) -> None:
    """Take the deep look at once; again where one was taken already only with `anew`."""
    begin(anew)
    while not step(1.0):
        pass


def begin(anew: bool = False) -> None:
    """Have the next steps take the deep look."""
    global _steps, _verified
    if anew:
        _verified = False
        if not _refused():
            _known.clear()
            _take(_examine())
    if _verified or not installation.is_installed():
        return
    memory = _memory()
    if not anew and memory is not None and _seems_whole() and installation.is_verified(place(), memory):
        _verified = True
    elif _steps is None or anew:
        _steps = installation.examine_deeply(place())


def step(seconds: float = _SLICE) -> bool:
    """Go on with the deep look for that long; returns whether it is over."""
    global _steps, _verified
    until = time.perf_counter() + seconds
    while _steps is not None:
        try:
            found = next(_steps)
        except StopIteration:
            _steps, _verified = None, True
            memory = _memory()
            if memory is not None and _seems_whole():
                installation.remember_verified(place(), memory)
            break
        if found is not None:
            _take([found])
            _tell(found)
        if time.perf_counter() > until:
            return False
    return True


def report() -> str:
    """The installation's state, for a bug report."""
    return installation.report(place(), _known)


def print_sentence(sentence: str) -> None:
    """On the console."""
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


def _examine() -> list[Problem]:
    """A look at names and sizes. What the zip lacks on purpose is no problem where this Python has it from
    elsewhere, as from a Linux distribution's package."""
    examined = installation.examine(place())
    importlib.invalidate_caches()  # Blender may just have unpacked it
    names = [installation.REQUIRED.get(n, n.replace("-", "_")) for n in installation.left_out(place())]
    if all(_is_there(name) for name in names):
        examined = [problem for problem in examined if problem.kind != "left-out"]
    return examined


def _seems_whole() -> bool:
    """Whether nothing is known that a deep look finds; other problems do not change its verdict."""
    return not any(problem.kind in installation.DEEP for problem in _known)


def _module_problems(already: Sequence[Problem]) -> list[Problem]:
    """What the add-on's own half needs and Python does not find, unless the reason is known already."""
    found: list[Problem] = []
    if not _is_there("numpy"):
        found.append(
            Problem(
                "module",
                "this Blender's Python lacks NumPy, which Blender brings along: use Blender from "
                "blender.org, or install your system's package for it (python3-numpy)",
                "numpy",
                "add-on",
            )
        )
    told = any(problem.wheel == CORE and problem.stops == "add-on" for problem in already)
    if not told and not _is_there(CORE_MODULE):
        found.append(
            Problem(
                "module",
                "the add-on's other half, handfit_core, is not there: remove the add-on, restart Blender and "
                "install the zip again",
                CORE,
                "add-on",
            )
        )
    return found


def _is_there(name: str) -> bool:
    """Whether a package can be imported; an empty folder of its name is none."""
    try:
        spec = importlib.util.find_spec(name)
    except (ImportError, ValueError):
        return False
    return spec is not None and spec.origin is not None


def _take(found: Sequence[Problem]) -> None:
    """Keep what was found; the same is kept once."""
    for problem in found:
        # What comes to light later no longer keeps the add-on from running.
        if problem.stops == "add-on" and not _refused():
            problem = replace(problem, stops="capture")
        same = [known for known in _known if (known.kind, known.wheel) == (problem.kind, problem.wheel)]
        if not same:
            _known[:] = installation.in_order([*_known, problem])


def _refused() -> bool:
    """Whether something was found at registration that keeps the add-on from running."""
    return any(problem.stops == "add-on" for problem in _known)


def _tell(problem: Problem) -> None:
    if bpy.app.background:
        return  # who had it looked for reports it
    print_sentence(problem.sentence)
    screen.redraw_sidebars(bpy.context)


def _memory() -> Path | None:
    """Where the verdict is remembered: in a folder that Blender removes together with the extension."""
    name = __package__ or ""
    return Path(bpy.utils.extension_path_user(name, path=MEMORY)) if name.startswith("bl_ext.") else None


def _slice() -> float | None:
    """What the timer calls; returns seconds until the next time, None when it is done."""
    begin()
    return None if step() else _PAUSE


def register() -> None:
    """Have the deep look begin soon, where there is a window; `refusal` comes before."""
    if _refused() and bpy.app.background:
        verify()  # the cause of what was found may lie inside a file
    if _refused():  # what follows the first reason are consequences of it
        print_sentence(_known[0].sentence)
    if installation.is_installed() and not bpy.app.background:
        bpy.app.timers.register(_slice, first_interval=_FIRST, persistent=True)


def unregister() -> None:
    """Stop looking and forget everything."""
    global _steps, _verified
    if bpy.app.timers.is_registered(_slice):
        bpy.app.timers.unregister(_slice)
    _known.clear()
    _steps, _verified = None, False
