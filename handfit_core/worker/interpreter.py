"""The Python that captures: which one, how the worker is started with it, and what its process inherits.

The Python that runs here, Blender's own, finds everything in the folder that handfit_core lies in. A Python
of the user's own brings NumPy, MediaPipe and the others itself, and gets nothing but handfit_core: packages
for the one need not fit the other.
"""

from __future__ import annotations

import os
import shutil
import sys
from pathlib import Path

PYTHON_VARIABLE = "HANDFIT_PYTHON"
"""The environment variable that names the Python that captures, when it is not the one that is running"""

EXIT_UNFIT = 77
"""The exit code with which launch.py ends in a Python that cannot capture, after it has said so"""


def find_python(python: str | None = None) -> str:
    """Return the interpreter to capture with: the argument, $HANDFIT_PYTHON, else the running one."""
    typed = unquoted(python or "") or unquoted(os.environ.get(PYTHON_VARIABLE, ""))
    return os.path.expanduser(typed) or sys.executable  # noqa: PTH111


def unquoted(text: str) -> str:
    """Return the text without the spaces and quotes around it that come with a copied path."""
    text = text.strip()
    if len(text) > 1 and text[0] == text[-1] and text[0] in "\"'":
        text = text[1:-1].strip()
    return text


def is_current_interpreter(python: str) -> bool:
    """Return whether a path names this process's interpreter. Links count as others: a virtual environment's
    interpreter often is one, and has packages of its own."""
    return _normalised(shutil.which(python) or python) == _normalised(sys.executable)


def worker_command(python: str, *words: str) -> list[str]:
    """Return the command that starts the worker, or another command of the core, with this interpreter, as
    `find_python` gives it."""
    words = words or ("worker",)
    if is_current_interpreter(python) and not _brought_by_launcher():
        # -s: as Blender, nothing from the folder where pip puts packages for one user; -P: nothing from the
        # folder in which Blender happens to have been started.
        user = ["-s"] if sys.flags.no_user_site else []
        return [python, *user, "-P", "-u", "-m", "handfit_core", *words]
    return [python, "-u", str(_core_folder() / "worker" / "launch.py"), *words]


def worker_environment(python: str, bytecode: Path | None = None) -> dict[str, str]:
    """Return the environment of the process: nothing that is meant for the Python that runs here, except for
    that one itself. `bytecode`: the folder in which it keeps what it compiles; None: nowhere."""
    environment = {k: v for k, v in os.environ.items() if not k.startswith("PYTHON")}
    if is_current_interpreter(python) and not _brought_by_launcher():
        environment["PYTHONPATH"] = str(_core_folder().parent)
    environment["PYTHONIOENCODING"] = "utf-8"
    if bytecode is None:
        environment["PYTHONDONTWRITEBYTECODE"] = "1"
    else:
        environment["PYTHONPYCACHEPREFIX"] = str(bytecode)
    return environment


def _core_folder() -> Path:
    return Path(__file__).resolve().parents[1]


def _brought_by_launcher() -> bool:
    """Return whether the launcher has brought handfit_core to the Python that runs here, which has packages
    of its own: those beside handfit_core must not shadow them."""
    return getattr(sys.modules["handfit_core"], "brought_by_launcher", False)


def _normalised(python: str) -> str:
    """Return the absolute path without "..", with links kept, unlike Path.resolve."""
    return os.path.normcase(os.path.abspath(python))  # noqa: PTH100
