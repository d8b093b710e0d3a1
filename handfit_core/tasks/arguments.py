"""The options of a batch that do not depend on Blender."""

from __future__ import annotations

import argparse
import math
from collections.abc import Sequence
from typing import Final

from handfit_core.capturing.options import add_options
from handfit_core.common.files import path_of
from handfit_core.common.machine import usable_cores
from handfit_core.tasks.inputs import PAIRS

_MOST_A_CORE: Final = 4
"""Processes that --jobs may ask for: more would only fill the memory and wait for each other"""
STYLES: Final = ("text", "json", "none")


def add_batch_arguments(
    parser: argparse.ArgumentParser, default_inputs: Sequence[str] = (), *, output_required: bool = True
) -> None:
    """Add the inputs, the options of a capture, and how a batch is done.

    `default_inputs` are taken where none are given; without them at least one must be given.
    """
    parser.add_argument(
        "inputs",
        nargs="*" if default_inputs else "+",
        default=default_inputs,
        metavar="INPUT",
        help="photo, video, folder of either, name.%%04d.png or glob pattern, or a take (.npz)",
    )
    parser.add_argument(
        "-o", "--output", type=path_of, required=output_required, metavar="DIR", help="where results go"
    )
    add_options(parser)
    said = "clips NAME_a and NAME_b are two views of one capture, NAME"
    parser.add_argument("--views", dest="view", action="store_const", const=PAIRS, help=said)
    grouping = parser.add_mutually_exclusive_group()
    for name, said in (
        ("sequence", "a folder's photos are one sequence"),
        ("separate", "each photo is an input of its own"),
    ):
        grouping.add_argument(f"--{name}", dest="grouping", action="store_const", const=name, help=said)
    parser.add_argument("--no-sheet", action="store_true", help="no contact sheet of each input")
    parser.add_argument("--overwrite", action="store_true", help="write into result folders that exist")
    parser.add_argument(
        "--flat", action="store_true", help="all results directly in DIR, without a folder per input"
    )
    parser.add_argument(
        "--jobs", type=_jobs, metavar="N", help="inputs at a time (default: by cores and memory)"
    )
    parser.add_argument(
        "--scheduler",
        metavar="ADDRESS",
        help="have the workers of this Dask scheduler capture, tcp://HOST:8786, or local: N workers that are "
        "started here (--jobs)",
    )
    parser.add_argument("--timeout", type=_seconds, metavar="SECONDS", help="longest time for one input")
    parser.add_argument("--again", action="store_true", help="also do what is done already")
    parser.add_argument(
        "--retry-failed", action="store_true", help="also try inputs that failed for reasons of their own"
    )
    parser.add_argument("--dry-run", action="store_true", help="say what would be done, and do nothing")
    parser.add_argument("--progress", choices=STYLES, default="text", help="how to tell (default: text)")


WITH_PARENT: Final = "--with-parent"
"""Has a batch end itself once its stdin ends, as it does with the process that has started it"""
EXPORTS: Final = "--exports"
"""Has a batch make files of its takes, as a JSON object says: fields of `exporting.Exports`"""
EXPORTED: Final = "exported: "
"""Begins the line with which a Blender answers that has made files of a take"""


def _seconds(text: str) -> float:
    """A time of more than 0 seconds."""
    number = float(text)
    if not 0.0 < number < math.inf:
        raise argparse.ArgumentTypeError("more than 0 seconds are needed")
    return number


def _jobs(text: str) -> int:
    """A number of at least 1; more than `_MOST_A_CORE` for each core are as many as these."""
    number = int(text)
    if number < 1:
        raise argparse.ArgumentTypeError("at least 1 is needed")
    return min(number, _MOST_A_CORE * usable_cores())
