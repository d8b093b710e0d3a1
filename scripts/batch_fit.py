"""Fit hands to whole folders without a window: takes, .blend files, exports and previews.

    blender -b -P scripts/batch_fit.py -- INPUT [INPUT ...] --output DIR --format blend,glb,fbx
    python scripts/batch_fit.py INPUT [INPUT ...] --output DIR        # with Blender's bpy wheel

docs/batch.md describes every option, the exit codes and report.json. The installed add-on has the same as
`blender --command manient capture`.
"""

from __future__ import annotations

import argparse
import os
import shutil
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import NoReturn

ROOT = Path(__file__).resolve().parents[1]
if str(ROOT) not in sys.path:
    sys.path.insert(0, str(ROOT))

_NO_BPY = (
    "this Python has no bpy: run the script with 'blender -b -P scripts/batch_fit.py -- ...', or install "
    "Blender's bpy wheel"
)


def main(argv: Sequence[str] | None = None, default_inputs: Sequence[str] = ()) -> int:
    """Run the batch; returns the exit code. `default_inputs` are used where none are given."""
    args = parse_arguments(argv, default_inputs)

    from blender_manient.batch.run import Host, run

    return run(args, Host(_own_command()))


def _own_command() -> tuple[str, ...]:
    """The command that starts this script again: with Python, or with Blender and its options before `--`."""
    import bpy

    if not bpy.app.binary_path:
        return (sys.executable, str(Path(__file__).resolve()))
    told = sys.argv[1 : sys.argv.index("--")] if "--" in sys.argv else ["-b", "-P", __file__]
    full = (str(Path(part).resolve()) if Path(part).is_file() else part for part in told)
    return (bpy.app.binary_path, *full, "--")


def parse_arguments(
    argv: Sequence[str] | None = None, default_inputs: Sequence[str] = ()
) -> argparse.Namespace:
    """The command line: what follows `--` under Blender, everything under Python.

    Exits where it is wrong, and where this Python has no bpy.
    """
    if argv is None:
        argv = sys.argv[sys.argv.index("--") + 1 :] if "--" in sys.argv else sys.argv[1:]
    parser = argparse.ArgumentParser(
        prog="batch_fit.py",
        description="Fit hands to photos, sequences, videos and folders of them. Without a command: capture.",
    )
    try:
        import bpy  # noqa: F401
    except ImportError:  # without it not even the options can be imported
        parser.exit(2, f"error: {_NO_BPY}\n")

    from blender_manient.batch.arguments import add_commands
    from blender_manient.batch.commands import COMMANDS

    # A folder may be called as a command, and no command for people does without another word.
    alone = len(argv) < 2 or argv[1].startswith("-")
    is_command = bool(argv) and argv[0] in COMMANDS and not (alone and Path(argv[0]).exists())
    if not is_command and argv[:1] not in (["--help"], ["-h"]):
        argv = ["capture", *argv]
    commands = parser.add_subparsers(metavar="COMMAND", required=True)
    add_commands(commands, argv[:1], default_inputs)
    return parser.parse_args(argv)


def _leave(code: int) -> NoReturn:
    """End with this code. Blender ends with it too; only an uncaught exception would leave it at 0.

    As a Python module, Blender 4.2 crashes while the interpreter shuts down after a glTF export, which
    would turn a finished run into a failed one: there the process ends without that.
    """
    bpy = sys.modules.get("bpy")
    if bpy is not None and not bpy.app.binary_path:
        shutil.rmtree(bpy.app.tempdir, ignore_errors=True)
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)
    sys.exit(code)


if __name__ == "__main__":
    _leave(main())
