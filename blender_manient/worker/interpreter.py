"""The Python that captures: which one, how the worker is started with it, and what its process inherits.

With Blender's own Python everything comes from the extension's wheels. A Python of the user's own brings
torch and the others itself, and gets nothing but handfit_core: wheels for Blender's Python need not fit it.
"""

from __future__ import annotations

import os
import shutil
import sys
from functools import lru_cache
from pathlib import Path

import bpy

import handfit_core
from handfit_core.worker.checking import BUNDLED_VARIABLE, LEFT_OUT_VARIABLE

from .. import verification
from ..installation import is_installed, left_out
from ..preferences import ADDON, unquoted

PYTHON_VARIABLE = "HANDFIT_PYTHON"
"""Names the Python that has torch, MediaPipe and OpenCV, when it is not the one that is running"""

LAUNCHER = Path(__file__).with_name("launch.py")


def find_python(python: str | None = None) -> str:
    """The interpreter to capture with: the argument, $HANDFIT_PYTHON, else the running one."""
    typed = unquoted(python or "") or unquoted(os.environ.get(PYTHON_VARIABLE, ""))
    return os.path.expanduser(typed) or sys.executable  # noqa: PTH111


@lru_cache(maxsize=16)
def is_blenders_own(python: str) -> bool:
    """Whether it is the interpreter that runs here, maybe by another name, with the same packages."""
    python = shutil.which(python) or python
    if _plain(python) == _plain(sys.executable):
        return True
    # A virtual environment's interpreter is often only a link, and has packages of its own all the same.
    if _environment(python) or _environment(sys.executable):
        return False
    try:
        return Path(python).samefile(sys.executable)
    except OSError:
        return False


def worker_command(python: str) -> list[str]:
    """What starts the worker with this interpreter, as `find_python` gives it."""
    if is_blenders_own(python):
        # -P: not from the folder in which Blender happens to have been started.
        return [python, *_own_flags(), "-P", "-u", "-m", "handfit_core", "worker"]
    return [python, "-u", str(LAUNCHER), str(_core_folder()), "worker"]


def worker_environment(python: str) -> dict[str, str]:
    """The process's environment: nothing that is meant for Blender's Python, except for that one itself."""
    environment = {k: v for k, v in os.environ.items() if not k.startswith("PYTHON")}
    for name in (BUNDLED_VARIABLE, LEFT_OUT_VARIABLE):
        environment.pop(name, None)
    if is_blenders_own(python):
        environment["PYTHONPATH"] = str(_core_folder().parent)
        if is_installed():
            environment[BUNDLED_VARIABLE] = "1"
            if missing := left_out(verification.place()):
                environment[LEFT_OUT_VARIABLE] = ",".join(missing)
    environment["PYTHONIOENCODING"] = "utf-8"
    bytecode = _bytecode_folder(python)
    if bytecode is None:
        environment["PYTHONDONTWRITEBYTECODE"] = "1"
    else:
        environment["PYTHONPYCACHEPREFIX"] = str(bytecode)
    return environment


def _own_flags() -> list[str]:
    """Blender takes nothing from the folder where pip puts packages for one user; nor does its worker."""
    return ["-s"] if sys.flags.no_user_site else []


def _bytecode_folder(python: str) -> Path | None:
    """Where the worker keeps what it compiles; compiling torch anew costs each start some two seconds.

    Blender unpacks wheels without compiling them, and what lay beside them would be left behind when it
    removes them; so a folder that goes with the extension. In it whole paths are repeated, which Windows
    finds too long.
    """
    if sys.platform == "win32" or not (
        is_installed() and ADDON.startswith("bl_ext.") and is_blenders_own(python)
    ):
        return None
    return Path(bpy.utils.extension_path_user(ADDON, path="bytecode"))


def _core_folder() -> Path:
    return Path(handfit_core.__file__).resolve().parent


def _plain(python: str) -> str:
    """Without ".." and the like, and with links kept, unlike Path.resolve."""
    return os.path.normcase(os.path.abspath(python))  # noqa: PTH100


def _environment(python: str) -> bool:
    """Whether it belongs to a virtual environment."""
    return any((folder / "pyvenv.cfg").is_file() for folder in list(Path(_plain(python)).parents)[:2])
