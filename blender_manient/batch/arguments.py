"""The options of a batch. Standard library only: `--help` also works in a damaged installation."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path


def add_arguments(
    parser: argparse.ArgumentParser, default_inputs: Sequence[str] = (), *, default_python: str = "this one"
) -> None:
    """Add every option of a batch to a parser.

    `default_inputs` are taken where none are given; without them at least one must be given.
    `default_python` is what the help says about the Python that captures when nobody names one.
    """
    parser.add_argument(
        "inputs",
        nargs="*" if default_inputs else "+",
        default=default_inputs,
        metavar="INPUT",
        help="photo, video, folder of either, name.%%04d.png or glob pattern, or a take (.npz)",
    )
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="DIR", help="where results go")
    parser.add_argument(
        "--format", default="blend,glb", help="of blend,glb,fbx,usd,bvh,abc (default: blend,glb)"
    )
    _add_capture_arguments(parser, default_python)
    _add_grouping_arguments(parser)
    parser.add_argument("--preview", action="store_true", help="render a preview picture of each input")
    parser.add_argument("--no-picture", action="store_true", help="no picture behind the hands in the .blend")
    parser.add_argument("--no-correctives", action="store_true", help="no corrective shape keys (MANO)")
    parser.add_argument("--overwrite", action="store_true", help="write into result folders that exist")
    parser.add_argument(
        "--flat", action="store_true", help="all results directly in DIR, without a folder per input"
    )
    parser.add_argument("--debug", action="store_true", help="show tracebacks and Blender's own messages")


def _add_capture_arguments(parser: argparse.ArgumentParser, default_python: str) -> None:
    parser.add_argument("--frames", metavar="A-B:S", help="source frames, as in 10-200:2 (default: all)")
    parser.add_argument("--hands", choices=("auto", "left", "right", "both"), help="default: auto")
    parser.add_argument("--solver", metavar="NAME", help="solver (default: the core's)")
    parser.add_argument("--model", metavar="PATH", help="MANO file or folder (default: the open hand)")
    parser.add_argument("--threshold", type=float, help="detection threshold 0-1 (default: 0.5)")
    parser.add_argument("--intrinsics", metavar="FX,FY,CX,CY", help="the camera in pixels (default: assumed)")
    parser.add_argument(
        "--hand-length",
        type=float,
        metavar="MM",
        help="wrist joint to the tip of the middle finger, in millimetres (default: an average adult's)",
    )
    parser.add_argument("--landmark-model", metavar="PATH", help="MediaPipe's hand_landmarker.task")
    parser.add_argument("--smoothing", type=float, metavar="S", help="0: every frame by itself (default: 1)")
    parser.add_argument("--plain-detection", action="store_true", help="no second looks for missed hands")
    parser.add_argument(
        "--max-megapixels",
        type=float,
        metavar="M",
        help="largest picture or frame that is read (default: as docs/batch.md says)",
    )
    parser.add_argument("--python", metavar="PATH", help=f"Python that captures (default: {default_python})")
    parser.add_argument("--timeout", type=float, metavar="SECONDS", help="longest capture of one input")


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
