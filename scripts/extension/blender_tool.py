"""Blender's own extension tool: `build` and `validate`, of a Blender or of an installed bpy wheel."""

from __future__ import annotations

import importlib.util
import shutil
import subprocess
import sys
from pathlib import Path

from scripts.extension.errors import BuildError

_SCRIPT = "*/scripts/addons_core/bl_pkg/cli/blender_ext.py"


def tool_command(blender: Path | None = None) -> list[str]:
    """How to call the tool: through the given Blender, else the script inside this Python's bpy wheel.

    Raises BuildError.
    """
    if blender is not None:
        executable = shutil.which(str(blender))
        if executable is None:
            raise BuildError(f"{blender}: there is no such Blender; give its executable with --blender")
        return [executable, "--command", "extension"]
    spec = importlib.util.find_spec("bpy")
    for folder in (spec.submodule_search_locations or ()) if spec else ():
        if scripts := sorted(Path(folder).glob(_SCRIPT)):
            return [sys.executable, "-I", str(scripts[-1])]
    raise BuildError(
        f"{sys.executable}: this Python has no bpy wheel, whose extension tool makes the zip; "
        "run `nox -s build`, or name a Blender with --blender"
    )


def run_build(tool: list[str], folder: Path, path: Path) -> None:
    """Make the zip `path` of a staged folder. Raises BuildError with what the tool says."""
    command = [*tool, "build", "--source-dir", str(folder), "--output-filepath", str(path)]
    _run(command)
    if not path.is_file():
        raise BuildError(f"{command[0]}: this made no zip; give the executable of a Blender 4.2 or newer")


def run_validate(tool: list[str], path: Path) -> None:
    """Raises BuildError with what the tool says against the zip."""
    _run([*tool, "validate", str(path)])


def _run(command: list[str]) -> None:
    try:
        done = subprocess.run(command, capture_output=True, text=True, errors="replace", check=False)
    except OSError as error:
        raise BuildError(
            f"{command[0]}: this cannot be run ({error.strerror}); give a Blender with --blender"
        ) from error
    if done.returncode:
        said = (done.stdout + done.stderr).strip() or f"it ended with {done.returncode} and said nothing"
        raise BuildError(f"Blender's extension tool refused ({' '.join(command)}):\n{said}")
