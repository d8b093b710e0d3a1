#!/usr/bin/env python3
"""Measure what a batch costs beside its captures: photos one by one and with several processes, and tasks in
which nothing is captured."""

from __future__ import annotations

import argparse
import json
import logging
import shutil
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
if str(ROOT) not in sys.path:
    sys.path.insert(0, str(ROOT))

from handfit_core.errors import HandfitError
from handfit_core.files import written_whole
from handfit_core.options import CaptureOptions
from handfit_core.pipeline import capture
from handfit_core.sheet import write_sheet
from handfit_core.tasks.capture import Settings, note_failure
from handfit_core.tasks.record import Result, attempt
from handfit_core.tasks.report import read_results, write_report
from handfit_core.tasks.run import run_tasks
from handfit_core.tasks.task import Task, make_tasks
from handfit_core.tasks.workers import DaskWorkers, LocalProcesses, Workers
from scripts.speed.report import Part, machine_facts, machine_text, significant

PHOTO = ROOT / "samples" / "rendered_hand" / "hand.0012.jpg"

DESCRIPTION = """\
What a batch costs beside its captures:

  photos  COUNT copies of a photo: captured in a loop, and by batches with 1 and 2 processes
  empty   tasks in which nothing is captured, each with its record: planning, doing with 2
          processes (--scheduler: with Dask's workers), looking at what is done, reporting

Run it on an idle machine."""


def main(argv: Sequence[str] | None = None) -> int:
    """Run the benchmarks; returns the exit code. User errors are one line on stderr."""
    parser = argparse.ArgumentParser(
        description=DESCRIPTION, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--photo", type=Path, default=PHOTO, help="default: one of the samples")
    parser.add_argument("--count", type=int, default=100, metavar="N", help="photos (default: 100)")
    parser.add_argument("--tasks", type=int, default=2000, metavar="N", help="empty tasks (default: 2000)")
    parser.add_argument("--scheduler", metavar="ADDRESS", help="who does the empty tasks, as in a batch")
    parser.add_argument("-o", "--output", type=Path, metavar="FILE.json", help="also write the numbers")
    args = parser.parse_args(argv)
    logging.getLogger("handfit").setLevel(logging.ERROR)
    facts = machine_facts()
    print(machine_text(facts), flush=True)
    numbers: dict[str, Any] = {"machine": facts}
    try:
        for measure in (photos_part, empty_part):
            with tempfile.TemporaryDirectory(prefix="handfit-batch-") as folder:
                part = measure(args, Path(folder))
            numbers |= part.numbers
            print(f"\n{part.text()}", flush=True)
        if args.output is not None:
            with written_whole(args.output) as beside:
                beside.write_text(json.dumps(numbers, indent=1), encoding="utf-8")
    except HandfitError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    return 0


def photos_part(args: argparse.Namespace, folder: Path) -> Part:
    """Captures alone, and batches of them."""
    if args.count < 1:
        return Part("No photos", ("",), (), (), {})
    inputs = folder / "in"
    inputs.mkdir()
    for number in range(args.count):
        shutil.copy(args.photo, inputs / f"{number:05}-{args.photo.name}")
    sources, options = sorted(map(str, inputs.iterdir())), CaptureOptions(processes=1)
    capture(sources[0], options)  # loads what all need
    began = time.perf_counter()
    for source in sources:
        take = capture(source, options)
        take.save(folder / "take.npz")
        write_sheet(take, folder / "sheet.jpg")
    seconds = {"captures alone": time.perf_counter() - began}
    workers: dict[str, Workers] = {"--jobs 1": Workers(), "--jobs 2": LocalProcesses(2)}
    for name, those in workers.items():
        began = time.perf_counter()
        output = folder / name
        tasks = make_tasks([str(inputs)], options, output, grouping="separate")
        for _ in run_tasks(tasks, output, Settings(options.to_message(), run=name), those):
            pass
        write_report(output, read_results(output, tasks))
        seconds[name] = time.perf_counter() - began
    alone = seconds["captures alone"]
    rows = [
        (name, f"{took:.1f}", significant(args.count / took), f"{1000.0 * (took - alone) / args.count:.1f}")
        for name, took in seconds.items()
    ]
    header = ("", "seconds", "photos/s", "ms a photo more than alone")
    return Part(f"{args.count} photos", header, rows, (), {"photos": {"count": args.count, **seconds}})


def empty_task(task: Task, output: Path, settings: Settings) -> Result:
    """A task in which nothing is done but writing its record."""
    return note_failure(task, output, settings, [attempt("nothing was captured", "Nothing", 0.0)])


def empty_part(args: argparse.Namespace, folder: Path) -> Part:
    """What a tenth of the tasks and all of them cost each."""
    rows, numbers = [], []
    for count in (max(1, args.tasks // 10), args.tasks):
        inputs, output = folder / f"in{count}", folder / f"out{count}"
        inputs.mkdir()
        for number in range(count):
            (inputs / f"{number:06}.jpg").write_bytes(b"%d" % number)
        times = [time.perf_counter()]
        tasks = make_tasks([str(inputs)], CaptureOptions(), output, grouping="separate")
        times.append(time.perf_counter())
        for _ in run_tasks(tasks, output, Settings(run="now"), _empty_workers(args.scheduler)):
            pass
        times.append(time.perf_counter())
        results = read_results(output, [replace(task) for task in tasks])
        times.append(time.perf_counter())
        write_report(output, results)
        times.append(time.perf_counter())
        each = [1000.0 * (b - a) / count for a, b in pairwise(times)]
        rows.append((str(count), *map(significant, each)))
        names = ("planning", "doing", "looking", "reporting")
        numbers.append({"tasks": count, **dict(zip(names, each, strict=True))})
    header = ("tasks", "ms: planning", "doing", "looking", "reporting")
    return Part("Tasks in which nothing is captured", header, rows, (), {"empty": numbers})


def _empty_workers(scheduler: str | None) -> Workers:
    workers = LocalProcesses(2) if scheduler is None else DaskWorkers(scheduler, 2)
    workers.run = empty_task
    return workers


if __name__ == "__main__":
    sys.exit(main())
