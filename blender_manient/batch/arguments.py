"""The options of a batch on the command line: those of the core, and those for the files that are made of the
takes."""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Sequence
from typing import Any

from handfit_core.tasks.arguments import add_batch_arguments

from .commands import COMMANDS, EXPORT


def add_arguments(
    parser: argparse.ArgumentParser,
    default_inputs: Sequence[str] = (),
    *,
    default_python: str = "this one",
    command: str = "capture",
) -> None:
    """Add every option of a batch to a parser.

    `default_inputs` are taken where none are given; without them at least one must be given.
    `default_python` is what the help says about the Python that captures when nobody names one.
    `command`: capture, or apply, for which a character must be named.
    """
    from ..exporters import EXPORTERS  # which needs Blender
    from .character import add_character_arguments

    add_batch_arguments(parser, default_inputs)
    parser.add_argument("--python", metavar="PATH", help=f"Python that captures (default: {default_python})")
    parser.add_argument("--debug", action="store_true", help="show tracebacks and Blender's own messages")
    formats = ",".join(name for name, e in EXPORTERS.items() if e.writes != "captured")
    said = "blend,glb; onto a character of another program, its own"
    parser.add_argument("--format", help=f"of {formats} (default: {said})")
    parser.add_argument("--preview", action="store_true", help="render a preview picture of each input")
    parser.add_argument("--no-picture", action="store_true", help="no picture behind the hands in the .blend")
    parser.add_argument("--no-correctives", action="store_true", help="no corrective shape keys")
    add_character_arguments(parser, required=command == "apply")


def add_commands(
    commands: Any,
    names: Iterable[str],
    default_inputs: Sequence[str] = (),
    *,
    default_python: str = "this one",
) -> None:
    """Add the commands of a batch to a parser; only the commands in `names` get their options, which need
    Blender."""
    for name, said in COMMANDS.items():
        parser = commands.add_parser(name, help=said, description=f"{said[0].upper()}{said[1:]}.")
        parser.set_defaults(command=name, debug=False)
        if name in names and name != EXPORT:
            add_arguments(parser, default_inputs, default_python=default_python, command=name)
