"""The command line: `python -m benchmarks [INPUT]`."""

from __future__ import annotations

import os

# Before SciPy loads: its OpenBLAS would solve a clip with as many threads as there are cores, which
# wait for each other and for the detector's: seconds instead of milliseconds on a busy machine.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import argparse
import json
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

from benchmarks.memory import LONG, SHORT, measure_memory
from benchmarks.packages import measure_packages
from benchmarks.report import Results, json_of, text_of
from handfit_core.errors import HandfitError, OptionError
from handfit_core.files import check_writable, written_whole
from handfit_core.media.frame_range import FrameRange
from handfit_core.media.opening import open_media
from handfit_core.solvers import solver_names

ROOT = Path(__file__).resolve().parent.parent
SAMPLE = str(ROOT / "samples" / "rendered_hand" / "hand.%04d.jpg")

DESCRIPTION = """\
How fast the solvers and the whole pipeline are.

Four parts, each with its table:
  solvers   the fast solver on one frame and in batches against the paper's solvers, all on
            the same detections of the hand that INPUT shows most
  pipeline  capturing INPUT, from file to take, against only reading it and detecting
  memory    the peak of a clip of 10 000 frames against one of 300; off unless asked for,
            as it captures all of these frames
  packages  what the packages that a capture loads cost: disk, time to load, memory; with
            --zip their part of an extension's zip; off unless asked for; needs no INPUT

What is compared takes turns in every round, so that another program's load hits all alike;
ratios are taken within rounds. Run it on an idle machine all the same."""

EPILOG = """\
examples:
  python -m benchmarks                               the bundled pictures, about two minutes
  python -m benchmarks clip.mp4 --frames 1-300 -o times.json
  python -m benchmarks --only solvers --slow paper-a --batches 256
  python -m benchmarks clip.mp4 --only memory
  python -m benchmarks --only packages --zip manient-0.1.0-linux_x64.zip"""

PARTS = ("solvers", "pipeline", "memory", "packages")


def main(argv: Sequence[str] | None = None) -> int:
    """Run the benchmarks; returns the exit code. User errors are one line on stderr."""
    args = parser().parse_args(argv)
    try:
        results = run(args)
        print(text_of(results), end="", flush=True)
        if args.output is not None:
            with written_whole(args.output) as beside:
                beside.write_text(json.dumps(json_of(results), indent=1), encoding="utf-8")
    except HandfitError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("error: stopped", file=sys.stderr)
        return 130
    return 0


def parser() -> argparse.ArgumentParser:
    """The command's options."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks",
        description=DESCRIPTION,
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument(
        "input",
        nargs="?",
        metavar="INPUT",
        help="a video, a photo, a folder of pictures or a name.%%04d.png pattern "
        "(default: the bundled sequence)",
    )
    parser.add_argument("--frames", metavar="A-B:S", help="source frames, as in 1-300:2 (default: all)")
    parser.add_argument(
        "--model", metavar="PATH", help="a MANO file, or a folder with both sides (default: the open hand)"
    )
    parser.add_argument(
        "--only", metavar="PARTS", help="some of solvers,pipeline,memory,packages (default: solvers,pipeline)"
    )
    parser.add_argument("--memory", action="store_true", help="the memory part, too")
    parser.add_argument("-o", "--output", type=Path, metavar="OUT.json", help="all measurements as JSON")

    solvers = parser.add_argument_group("solvers")
    solvers.add_argument(
        "--slow",
        default="paper-a,paper-g",
        metavar="NAMES",
        help="solvers to compare with; the ratios are to the first (default: paper-a,paper-g)",
    )
    solvers.add_argument("--batches", default="1,32,256,4096", metavar="SIZES", help="default: 1,32,256,4096")
    solvers.add_argument(
        "--rounds",
        type=int,
        default=5,
        metavar="N",
        help="each fits one frame with each slow solver (default: 5)",
    )
    pipeline = parser.add_argument_group("pipeline")
    pipeline.add_argument("--runs", type=int, default=3, metavar="N", help="of each of both (default: 3)")
    memory = parser.add_argument_group("memory")
    memory.add_argument(
        "--lengths",
        default=f"{SHORT},{LONG}",
        metavar="FRAMES",
        help=f"of the clips made of INPUT's frames (default: {SHORT},{LONG})",
    )
    packages = parser.add_argument_group("packages")
    packages.add_argument("--zip", type=Path, metavar="FILE.zip", help="an extension's zip, to compare with")
    packages.add_argument(
        "--starts", type=int, default=5, metavar="N", help="processes that load each package (default: 5)"
    )
    return parser


def run(args: argparse.Namespace) -> Results:
    """Measure what `args` (of `parser`) ask for. Raises HandfitError."""
    parts = chosen_parts(args.only, memory=args.memory)
    slow = [name for name in args.slow.split(",") if name]
    unknown = [name for name in slow if name not in solver_names()]
    if unknown:
        raise OptionError(f"there is no solver '{unknown[0]}'; choose from {', '.join(solver_names())}")
    batches, lengths = numbers(args.batches, "--batches"), numbers(args.lengths, "--lengths")
    if min(args.rounds, args.runs, args.starts) < 1:
        raise OptionError("--rounds, --runs and --starts must be at least 1")
    if args.output is not None:
        check_writable(args.output)  # now, not after minutes of measuring
    source = args.input or SAMPLE
    frames = FrameRange.parse(args.frames) if args.frames else None
    name = open_media(source, frames).source.name

    # Torch loads here, not for --help.
    from benchmarks.detections import find_hand
    from benchmarks.machine import machine_facts
    from benchmarks.pipeline import time_pipeline
    from benchmarks.solvers import time_solvers

    facts = machine_facts()
    detections = solvers = pipeline = memory = packages = None
    if "solvers" in parts:
        hand = find_hand(source, frames, args.model)
        detections = len(hand.detections)
        solvers = time_solvers(hand, slow, batches, args.rounds, told("solvers: round", args.rounds))
    if "pipeline" in parts:
        pipeline = time_pipeline(
            source, frames, args.runs, model=args.model, on_round=told("pipeline: run", args.runs)
        )
    if "memory" in parts:
        memory = measure_memory(
            source, lengths, on_clip=lambda n: print(f"memory: a clip of {n} frames", file=sys.stderr)
        )
    if "packages" in parts:
        told_start = told("packages: start", args.starts)
        packages = measure_packages(args.starts, extension=args.zip, on_round=told_start)
    return Results(
        machine=facts,
        source=name,
        detections=detections,
        solvers=solvers,
        reference=slow[0] if slow else "",
        pipeline=pipeline,
        memory=memory,
        packages=packages,
    )


def chosen_parts(only: str | None, *, memory: bool) -> tuple[str, ...]:
    """The parts that `--only` and `--memory` ask for. Raises OptionError."""
    parts = PARTS[:2] if only is None else tuple(part for part in only.split(",") if part)
    for part in parts:
        if part not in PARTS:
            raise OptionError(f"--only: there is no part '{part}'; choose from {', '.join(PARTS)}")
    return (*parts, "memory") if memory and "memory" not in parts else parts


def numbers(text: str, option: str) -> tuple[int, ...]:
    """`1,32` as whole numbers above 0. Raises OptionError."""
    try:
        found = tuple(int(part) for part in text.split(",") if part)
    except ValueError:
        found = ()
    if not found or min(found) < 1:
        raise OptionError(f"{option}: '{text}' is no list of whole numbers above 0, as in 1,32,256")
    return found


def told(what: str, total: int) -> Callable[[int], None]:
    """Say on stderr how far it is."""
    return lambda done: print(f"{what} {done} of {total}", file=sys.stderr, flush=True)


if __name__ == "__main__":
    sys.exit(main())
