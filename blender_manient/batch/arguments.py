"""The options of a batch: those of a capture, and what is made of the takes."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from handfit_core.options import add_options


def add_arguments(
    parser: argparse.ArgumentParser,
    default_inputs: Sequence[str] = (),
    *,
    default_python: str = "this one",
    onto_character: bool = False,
) -> None:
    """Add every option of a batch to a parser.

    `default_inputs` are taken where none are given; without them at least one must be given.
    `default_python` is what the help says about the Python that captures when nobody names one.
    `onto_character`: whether a character must be named.
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
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="DIR", help="where results go")
    formats = ",".join(name for name, e in EXPORTERS.items() if e.writes != "captured")
    parser.add_argument("--format", default="blend,glb", help=f"of {formats} (default: blend,glb)")
    add_options(parser)
    parser.add_argument("--python", metavar="PATH", help=f"Python that captures (default: {default_python})")
    parser.add_argument("--timeout", type=float, metavar="SECONDS", help="longest capture of one input")
    _add_grouping_arguments(parser)
    parser.add_argument("--preview", action="store_true", help="render a preview picture of each input")
    parser.add_argument("--no-picture", action="store_true", help="no picture behind the hands in the .blend")
    parser.add_argument("--no-correctives", action="store_true", help="no corrective shape keys")
    parser.add_argument("--overwrite", action="store_true", help="write into result folders that exist")
    parser.add_argument(
        "--flat", action="store_true", help="all results directly in DIR, without a folder per input"
    )
    parser.add_argument("--debug", action="store_true", help="show tracebacks and Blender's own messages")
    add_character_arguments(parser, required=onto_character)


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
