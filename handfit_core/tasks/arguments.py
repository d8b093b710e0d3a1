"""The options of a batch that do not depend on Blender."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from handfit_core.capturing.options import (
    Options,
    add_options,
    as_flag,
    as_positive,
    as_text,
    as_whole,
    option,
)
from handfit_core.common.files import path_of
from handfit_core.tasks.inputs import PAIRS

STYLES: Final = ("text", "json", "none")


@dataclass(frozen=True)
class BatchOptions(Options):
    """How a batch is done. Raises OptionError."""

    whose = "a batch"
    no_sheet: bool = option(False, as_flag, "no contact sheet of each input")
    overwrite: bool = option(False, as_flag, "write into result folders that exist")
    flat: bool = option(False, as_flag, "all results directly in DIR, without a folder per input")
    jobs: int | None = option(
        None, as_whole, "inputs at a time", "N", least=1, by_default="by cores and memory"
    )
    scheduler: str | None = option(
        None,
        as_text,
        "have the workers of this Dask scheduler capture, tcp://HOST:8786, or local: N workers that are "
        "started here (--jobs)",
        "ADDRESS",
        by_default="processes of this machine",
    )
    timeout: float | None = option(
        None, as_positive, "longest time for one input", "SECONDS", by_default="none"
    )
    again: bool = option(False, as_flag, "also do what is done already")
    retry_failed: bool = option(False, as_flag, "also try inputs that failed for reasons of their own")
    dry_run: bool = option(False, as_flag, "say what would be done, and do nothing")


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
    add_options(parser, of=BatchOptions)
    parser.add_argument("--progress", choices=STYLES, default="text", help="how to tell (default: text)")


WITH_PARENT: Final = "--with-parent"
"""Has a batch end itself once its stdin ends, as it does with the process that has started it"""
EXPORTS: Final = "--exports"
"""Has a batch make files of its takes, as a JSON object says: fields of `exporting.Exports`"""
EXPORTED: Final = "exported: "
"""Prefix of the line by which a Blender process reports that it has exported a take"""
