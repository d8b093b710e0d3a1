#!/usr/bin/env python3
"""Measure what a batch costs beside its captures: photos one by one and with several processes, and tasks in
which nothing is captured (planning, doing, looking at what is done, reporting). Run it on an idle machine."""

from __future__ import annotations

import argparse
import logging
import shutil
import sys
import tempfile
import time
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
if str(ROOT) not in sys.path:
    sys.path.insert(0, str(ROOT))

from handfit_core.capturing.options import CaptureOptions
from handfit_core.capturing.pipeline import capture
from handfit_core.common.errors import HandfitError
from handfit_core.take.sheet import write_sheet
from handfit_core.tasks.capture import Settings, note_failure
from handfit_core.tasks.record import Attempt, Result
from handfit_core.tasks.report import read_results, write_report
from handfit_core.tasks.run import run_tasks
from handfit_core.tasks.task import Task, make_tasks
from handfit_core.tasks.workers import DaskWorkers, LocalProcesses, Workers

PHOTO = ROOT / "samples" / "rendered_hand" / "hand.0012.jpg"


def main(argv: Sequence[str] | None = None) -> int:
    """Run the benchmarks; returns the exit code. User errors are one line on stderr."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--photo", type=Path, default=PHOTO, help="default: one of the samples")
    parser.add_argument("--count", type=int, default=100, metavar="N", help="photos (default: 100)")
    parser.add_argument("--tasks", type=int, default=2000, metavar="N", help="empty tasks (default: 2000)")
    parser.add_argument("--scheduler", metavar="ADDRESS", help="who does the empty tasks, as in a batch")
    args = parser.parse_args(argv)
    logging.getLogger("handfit").setLevel(logging.ERROR)
    try:
        for measure in (measure_photos, measure_empty_tasks):
            with tempfile.TemporaryDirectory(prefix="handfit-batch-") as folder:
                measure(args, Path(folder))
    except HandfitError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    return 0


def measure_photos(args: argparse.Namespace, folder: Path) -> None:
    """Captures alone, and batches of them."""
    if args.count < 1:
        return
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
    for jobs in (1, 2):
        began, name = time.perf_counter(), f"--jobs {jobs}"
        output, settings = folder / name, Settings(options.to_message(), run=name)
        tasks = make_tasks([str(inputs)], options, output, grouping="separate")
        workers = LocalProcesses(output, settings, jobs) if jobs > 1 else Workers(output, settings)
        for _ in run_tasks(tasks, workers):
            pass
        write_report(output, read_results(output, tasks))
        seconds[name] = time.perf_counter() - began
    print(f"{args.count} photos     seconds  photos/s  ms a photo more than alone")
    for name, took in seconds.items():
        more = 1000.0 * (took - seconds["captures alone"]) / args.count
        print(f"{name:<15} {took:8.1f} {args.count / took:9.2f} {more:8.1f}", flush=True)


def empty_task(task: Task, output: Path, settings: Settings) -> Result:
    """A task in which nothing is done but writing its record."""
    return note_failure(task, output, settings, [Attempt.now("nothing was captured", "Nothing")])


def measure_empty_tasks(args: argparse.Namespace, folder: Path) -> None:
    """Time of each task, of a tenth of the tasks and of all."""
    print("empty tasks, ms each: planning     doing   looking reporting")
    for count in (max(1, args.tasks // 10), args.tasks):
        inputs, output = folder / f"in{count}", folder / f"out{count}"
        inputs.mkdir()
        for number in range(count):
            (inputs / f"{number:06}.jpg").write_bytes(b"%d" % number)
        workers = LocalProcesses(output, Settings(run="now"), 2)
        if args.scheduler is not None:
            workers = DaskWorkers(output, Settings(run="now"), args.scheduler, 2)
        workers.run = empty_task
        times = [time.perf_counter()]
        tasks = make_tasks([str(inputs)], CaptureOptions(), output, grouping="separate")
        times.append(time.perf_counter())
        for _ in run_tasks(tasks, workers):
            pass
        times.append(time.perf_counter())
        results = read_results(output, tasks)
        times.append(time.perf_counter())
        write_report(output, results)
        times.append(time.perf_counter())
        each = [1000.0 * (after - before) / count for before, after in pairwise(times)]
        print(f"{count:<20} " + " ".join(f"{one:9.3f}" for one in each), flush=True)


if __name__ == "__main__":
    sys.exit(main())
