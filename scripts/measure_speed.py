#!/usr/bin/env python3
"""Measure how fast the solvers and the whole pipeline are, and how much memory a long clip takes."""

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

ROOT = Path(__file__).resolve().parents[1]
if str(ROOT) not in sys.path:
    sys.path.insert(0, str(ROOT))

from handfit_core.errors import HandfitError, OptionError
from handfit_core.files import check_writable, written_whole
from handfit_core.media.frame_range import FrameRange
from handfit_core.media.opening import open_media
from handfit_core.solvers import solver_names
from scripts.speed.memory import LONG, SHORT, measure_memory
from scripts.speed.report import Part, machine_facts, machine_text, memory_part, pipeline_part, solvers_part
from scripts.speed.timings import find_hand, time_pipeline, time_solvers

SAMPLE = str(ROOT / "samples" / "rendered_hand" / "hand.%04d.jpg")
PARTS = ("solvers", "pipeline", "memory")

DESCRIPTION = """\
How fast the solvers and the whole pipeline are, each part with its table:

  solvers   the fast solver on one frame and in batches against the paper's solvers, all on
            the same detections of the hand that INPUT shows most
  pipeline  capturing INPUT, from file to take, against only reading it and detecting
  memory    the peak of a clip of 10 000 frames against one of 300; off unless asked for,
            as it captures all of these frames

What is compared takes turns in every round, so that another program's load hits all alike;
ratios are taken within rounds. Run it on an idle machine all the same."""

EPILOG = """\
examples:
  python scripts/measure_speed.py                    the bundled pictures, about two minutes
  python scripts/measure_speed.py clip.mp4 --frames 1-300 -o times.json
  python scripts/measure_speed.py --only solvers --slow paper-a --batches 256
  python scripts/measure_speed.py clip.mp4 --only memory"""


def main(argv: Sequence[str] | None = None) -> int:
    """Run the benchmarks; returns the exit code. User errors are one line on stderr."""
    args = parser().parse_args(argv)
    try:
        facts, source, parts = measure(args)
        texts = [f"input: {source}\n{machine_text(facts)}", *(part.text() for part in parts)]
        print("\n\n".join(texts), flush=True)
        if args.output is not None:
            numbers = {"machine": facts, "input": source}
            for part in parts:
                numbers |= part.numbers
            with written_whole(args.output) as beside:
                beside.write_text(json.dumps(numbers, indent=1), encoding="utf-8")
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
        description=DESCRIPTION, epilog=EPILOG, formatter_class=argparse.RawDescriptionHelpFormatter
    )

    add = parser.add_argument
    text = (
        "a video, a photo, a folder of pictures or a name.%%04d.png pattern (default: the bundled sequence)"
    )
    add("input", nargs="?", default=SAMPLE, metavar="INPUT", help=text)
    add("--frames", metavar="A-B:S", help="source frames, as in 1-300:2 (default: all)")
    text = "a MANO file, or a folder with both sides (default: the open hand)"
    add("--model", metavar="PATH", help=text)
    text = "some of solvers,pipeline,memory (default: solvers,pipeline)"
    add("--only", default="solvers,pipeline", metavar="PARTS", help=text)
    add("-o", "--output", type=Path, metavar="OUT.json", help="all measurements as JSON")
    text = "solvers to compare with; the ratios are to the first (default: paper-a,paper-g)"
    add("--slow", default="paper-a,paper-g", metavar="NAMES", help=text)
    add("--batches", default="1,32,256,4096", metavar="SIZES", help="default: 1,32,256,4096")
    add("--rounds", type=int, default=5, metavar="N", help="of the solvers (default: 5)")
    add("--runs", type=int, default=3, metavar="N", help="of pipeline and detection (default: 3)")
    text = f"of the clips that the memory part makes of INPUT's frames (default: {SHORT},{LONG})"
    add("--lengths", default=f"{SHORT},{LONG}", metavar="FRAMES", help=text)
    return parser


def measure(args: argparse.Namespace) -> tuple[dict, str, list[Part]]:
    """The machine, the input's name, and the parts that `args` (of `parser`) ask for. Raises HandfitError."""
    wanted, slow = ([name for name in text.split(",") if name] for text in (args.only, args.slow))
    for name, known, what in (
        *((part, PARTS, "part") for part in wanted),
        *((solver, solver_names(), "solver") for solver in slow),
    ):
        if name not in known:
            raise OptionError(f"there is no {what} '{name}'; choose from {', '.join(known)}")
    batches, lengths = numbers(args.batches, "--batches"), numbers(args.lengths, "--lengths")
    if min(args.rounds, args.runs) < 1:
        raise OptionError("--rounds and --runs must be at least 1")
    if args.output is not None:
        check_writable(args.output)  # now, not after minutes of measuring
    frames = FrameRange.parse(args.frames) if args.frames else None
    source = open_media(args.input, frames).source.name
    facts, parts = machine_facts(), []
    if "solvers" in wanted:
        hand = find_hand(args.input, frames, args.model)
        timings = time_solvers(hand, slow, batches, args.rounds, told("solvers: round", args.rounds))
        reference = slow[0] if slow else ""
        parts.append(solvers_part(timings, reference, len(hand.detections), *hand.fast_quality()))
    if "pipeline" in wanted:
        run = told("pipeline: run", args.runs)
        parts.append(pipeline_part(*time_pipeline(args.input, frames, args.runs, args.model, run)))
    if "memory" in wanted:
        parts.append(memory_part(measure_memory(args.input, lengths, told("memory: a clip of frames"))))
    return facts, source, parts


def numbers(text: str, option: str) -> tuple[int, ...]:
    """`1,32` as whole numbers above 0. Raises OptionError."""
    try:
        found = tuple(int(part) for part in text.split(",") if part)
    except ValueError:
        found = ()
    if not found or min(found) < 1:
        raise OptionError(f"{option}: '{text}' is no list of whole numbers above 0, as in 1,32,256")
    return found


def told(what: str, total: int | None = None) -> Callable[[int], None]:
    """Say on stderr how far it is."""
    of = "" if total is None else f" of {total}"
    return lambda done: print(f"{what} {done}{of}", file=sys.stderr, flush=True)


if __name__ == "__main__":
    sys.exit(main())
