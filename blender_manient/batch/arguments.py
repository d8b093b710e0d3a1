"""The options of a batch: those of a capture, and what is made of the takes."""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Sequence
from typing import Any

from handfit_core.farm.commands import (
    add_cluster_arguments,
    add_map,
    add_plan,
    add_running_arguments,
    count,
    seconds,
)
from handfit_core.farm.templates import KINDS, MOST_JOBS
from handfit_core.files import path_of
from handfit_core.options import OPTIONS, add_options

from .commands import COMMANDS, SLOT


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
    `command`: capture, apply, for which a character must be named, or plan, which does nothing yet.
    """
    from ..exporters import EXPORTERS  # which needs Blender
    from .character import add_character_arguments

    parser.add_argument(
        "inputs",
        nargs="*" if default_inputs else "+",
        default=default_inputs,
        metavar="INPUT",
        help="photo, video, folder of either, name.%%04d.png or glob pattern, or a take (.npz)",
    )
    parser.add_argument("-o", "--output", type=path_of, required=True, metavar="DIR", help="where results go")
    formats = ",".join(name for name, e in EXPORTERS.items() if e.writes != "captured")
    parser.add_argument("--format", default="blend,glb", help=f"of {formats} (default: blend,glb)")
    add_options(parser)
    _add_grouping_arguments(parser)
    parser.add_argument(
        "--split",
        type=count,
        metavar="FRAMES",
        help="have the hands of clips with more frames found in parts of so many, each a task of its own",
    )
    parser.add_argument("--preview", action="store_true", help="render a preview picture of each input")
    parser.add_argument("--no-sheet", action="store_true", help="no contact sheet of each input")
    parser.add_argument("--no-picture", action="store_true", help="no picture behind the hands in the .blend")
    parser.add_argument("--no-correctives", action="store_true", help="no corrective shape keys")
    parser.add_argument("--overwrite", action="store_true", help="write into result folders that exist")
    parser.add_argument(
        "--flat", action="store_true", help="all results directly in DIR, without a folder per input"
    )
    if command != "plan":
        _add_python(parser, default_python)
        add_running_arguments(parser)
        add_cluster_arguments(parser)
        parser.add_argument("--dry-run", action="store_true", help="say what would be done, and do nothing")
    else:
        _add_python(parser, default_python)
    add_character_arguments(parser, required=command == "apply")


def add_commands(
    commands: Any,
    names: Iterable[str],
    default_inputs: Sequence[str] = (),
    *,
    default_python: str = "this one",
) -> None:
    """Add the commands of a batch; only those of these `names` with their options, which need Blender."""
    for name, said in COMMANDS.items():
        parser = commands.add_parser(name, help=said, description=f"{said[0].upper()}{said[1:]}.")
        parser.set_defaults(command=name)
        if name not in names:
            continue
        if name in ("capture", "apply", "plan"):
            add_arguments(parser, default_inputs, default_python=default_python, command=name)
            continue
        if name == "farm-template":
            parser.add_argument("kind", choices=KINDS, help="of the farm")
        if name != SLOT:
            add_plan(parser)
        if name == "task":
            parser.add_argument("id", metavar="ID", help="of the task, its name, or numbers, as #3 or #3-7")
            parser.add_argument(
                "--accept-failed",
                action="store_true",
                help="end with 0 also where the input is why it failed: collect tells",
            )
        if name in ("task", "work", "farm-template"):
            add_map(parser)
        if name == "farm-template":
            _add_template_arguments(parser)
        elif name in ("task", "work"):
            _add_python(parser, default_python)
            add_running_arguments(parser)
            OPTIONS["processes"].add_to(parser)
        else:
            _add_debug(parser)
        if name == "work":
            add_cluster_arguments(parser)


def _add_template_arguments(parser: argparse.ArgumentParser) -> None:
    """Add what says how a farm's job file is made."""
    parser.add_argument("-o", "--output", type=path_of, metavar="FILE", help="default: beside the plan")
    parser.add_argument("--timeout", type=seconds, metavar="SECONDS", help="longest time for one input")
    parser.add_argument(
        "--jobs",
        type=count,
        default=MOST_JOBS,
        metavar="N",
        help=f"share the tasks out among at most N jobs of the farm (default: {MOST_JOBS})",
    )
    _add_debug(parser)


def _add_python(parser: argparse.ArgumentParser, default_python: str) -> None:
    parser.add_argument("--python", metavar="PATH", help=f"Python that captures (default: {default_python})")
    _add_debug(parser)


def _add_debug(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--debug", action="store_true", help="show tracebacks and Blender's own messages")


def _add_grouping_arguments(parser: argparse.ArgumentParser) -> None:
    grouping = parser.add_mutually_exclusive_group()
    grouping.add_argument(
        "--sequence",
        dest="grouping",
        action="store_const",
        const="sequence",
        help="a folder's photos are one sequence",
    )
    grouping.add_argument(
        "--separate",
        dest="grouping",
        action="store_const",
        const="separate",
        help="each photo is an input of its own",
    )
