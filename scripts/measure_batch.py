#!/usr/bin/env python3
"""Measure what a batch costs: per hour of footage, per task, and with several processes at a time."""

from __future__ import annotations

import argparse
import json
import os
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from statistics import median
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
if str(ROOT) not in sys.path:
    sys.path.insert(0, str(ROOT))

from handfit_core.errors import HandfitError, OptionError
from handfit_core.farm.collect import Report
from handfit_core.farm.folder import files_in
from handfit_core.farm.inputs import Input
from handfit_core.farm.plan import Plan, make_plan
from handfit_core.farm.pool import Pool
from handfit_core.farm.slot import COMMAND
from handfit_core.files import written_whole
from handfit_core.version import __version__
from handfit_core.worker.protocol import encode
from scripts.speed.memory import MB, write_clip
from scripts.speed.report import Part, machine_facts, machine_text, significant

SAMPLE = str(ROOT / "samples" / "rendered_hand" / "hand.%04d.jpg")
PHOTO = ROOT / "samples" / "mona_lisa" / "mona_lisa.jpg"
PARTS = ("cost", "overhead", "jobs", "memory", "empty")
_LARGEST = 1920
"""pixels; larger clips are made smaller"""
_LOOK = 0.05
"""seconds between two looks at the memory of all processes"""

DESCRIPTION = """\
What a batch costs, each part with its table:

  cost      of an hour of footage: two lengths of CLIP, whose difference is that of their
            frames alone, on one core and with --jobs 1 on all of them
  overhead  of a task: its own process, a warm one, and what is sealed and skipped
  jobs      ten clips with --jobs N against --jobs 1, each process with one thread
  memory    the most that a task's processes hold: a photo, CLIP, and both enlarged
  empty     tasks that only write four small files: planning, doing, skipping, reporting

--with '--scheduler tcp://HOST:8786' has jobs compare Dask's workers with --jobs N, and empty use
them alone. Runs that are compared take turns. Run it on an idle machine, with a Python that has bpy."""


def main(argv: Sequence[str] | None = None) -> int:
    """Run the benchmarks; returns the exit code. User errors are one line on stderr."""
    if argv is None and sys.argv[1:] == [COMMAND]:
        return do_nothing()
    args = parser().parse_args(argv)
    try:
        wanted = [name for name in args.only.split(",") if name]
        for name in wanted:
            if name not in PARTS:
                raise OptionError(f"there is no part '{name}'; choose from {', '.join(PARTS)}")
        facts = machine_facts()
        print(f"input: {args.clip}\n{machine_text(facts)}", flush=True)
        numbers: dict[str, Any] = {"machine": facts, "input": args.clip}
        with tempfile.TemporaryDirectory(prefix="handfit-batch-") as folder:
            for name in wanted:
                part = globals()[f"{name}_part"](args, Path(folder))
                numbers |= part.numbers
                print(f"\n{part.text()}", flush=True)
        if args.output is not None:
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
        description=DESCRIPTION, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add = parser.add_argument
    add("clip", nargs="?", default=SAMPLE, metavar="CLIP", help="default: the bundled pictures of a hand")
    add("--photo", type=Path, default=PHOTO, help="default: the bundled painting")
    add("--only", default="cost,overhead,jobs,memory,empty", metavar="PARTS", help="default: all")
    add("--frames", type=int, default=300, metavar="N", help="of each clip (default: 300)")
    add("--clips", type=int, default=10, metavar="N", help="of the part jobs (default: 10)")
    add("--jobs", type=int, default=2, metavar="N", help="processes to compare with one (default: 2)")
    add("--with", dest="other", metavar="OPTIONS", help="another way to have tasks done")
    add("--tasks", type=int, default=10_000, metavar="N", help="empty ones (default: 10000)")
    add("--rounds", type=int, default=3, metavar="N", help="of runs that take turns (default: 3)")
    add("-o", "--output", type=Path, metavar="OUT.json", help="all measurements as JSON")
    return parser


# Real tasks


def batch(*arguments: str | Path, cores: int | None = None, **environment: str) -> tuple[float, float, float]:
    """Run batch_fit.py with these arguments, on the first `cores` alone. Returns wall and CPU seconds of all
    its processes, and the most memory in MB that all but the first held together. Raises OptionError."""
    command = [sys.executable, str(ROOT / "scripts" / "batch_fit.py"), *map(str, arguments)]
    if cores is not None:
        command = ["taskset", "-c", ",".join(map(str, sorted(os.sched_getaffinity(0))[:cores])), *command]
    surroundings = {k: v for k, v in os.environ.items() if not k.endswith("NUM_THREADS")} | environment
    before, began, peak = _cpu(), time.perf_counter(), 0.0
    with tempfile.TemporaryFile() as said:
        process = subprocess.Popen(command, env=surroundings, stdout=said, stderr=said)
        while process.poll() is None:
            time.sleep(_LOOK)
            peak = max(peak, _memory_below(process.pid))
        seconds = time.perf_counter() - began
        said.seek(0)
        if process.returncode:
            raise OptionError(f"{' '.join(command[1:])}: {said.read().decode(errors='replace')[-500:]}")
    return seconds, _cpu() - before, peak


def _cpu() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def _memory_below(pid: int) -> float:
    """MB of all descendants of a process; what several share counts once."""
    parents = {}
    for path in Path("/proc").glob("[0-9]*/stat"):
        try:
            parents[int(path.parent.name)] = int(path.read_text().rpartition(")")[2].split()[1])
        except (OSError, ValueError):
            continue
    below, size = {pid}, 0
    while len(below) > size:
        size = len(below)
        below |= {child for child, parent in parents.items() if parent in below}
    total = 0
    for child in below - {pid}:
        try:
            lines = Path(f"/proc/{child}/smaps_rollup").read_text().splitlines()
            total += next(int(line.split()[1]) for line in lines if line.startswith("Pss:"))
        except (OSError, StopIteration):
            continue
    return total * 1024 / MB


def clips_of(clip: str, folder: Path, frames: int, count: int = 1) -> list[Path]:
    """Clips of so many frames, each in a file of its own. Raises HandfitError."""
    folder.mkdir(parents=True)
    first = write_clip(clip, folder / "clip_01.mp4", frames, _LARGEST)
    return [first, *(Path(shutil.copy(first, folder / f"clip_{i:02}.mp4")) for i in range(2, count + 1))]


def cost_part(args: argparse.Namespace, folder: Path) -> Part:
    """What an hour of footage costs, on one core and on as many as there are."""
    lengths = (args.frames, 4 * args.frames)
    clips = {n: clips_of(args.clip, folder / f"cost{n}", n)[0] for n in lengths}
    runs: dict[str, list[dict[int, tuple[float, float, float]]]] = {"1 core": [], "all cores": []}
    sizes = {}
    for number in range(args.rounds):
        for name, found in runs.items():
            measured = {}
            for n, clip in clips.items():
                out = folder / f"cost-out-{number}-{name[0]}-{n}"
                measured[n] = batch(clip, "-o", out, "--jobs", "1", cores=1 if name == "1 core" else None)
                sizes[n] = sum(path.stat().st_size for path in (out / clip.stem).iterdir())
            found.append(measured)
    frames = lengths[1] - lengths[0]
    disk = (sizes[lengths[1]] - sizes[lengths[0]]) / frames
    read = clips[lengths[1]].stat().st_size / lengths[1]
    rows, numbers = [], {"frames": lengths, "disk_per_frame": disk, "read_per_frame": read}
    for name, found in runs.items():
        wall, cpu = (median((r[lengths[1]][i] - r[lengths[0]][i]) / frames for r in found) for i in (0, 1))
        peak = max(r[lengths[1]][2] for r in found)
        hours = [f"{108_000 * each / 3600:.2f} h" for each in (wall, cpu)]
        rows.append([name, f"{1000 * wall:.1f} ms", f"{1000 * cpu:.1f} ms", *hours, f"{peak:.0f} MB"])
        numbers[name] = {"wall_per_frame": wall, "cpu_per_frame": cpu, "peak_mb": peak, "runs": found}
    header = ["", "wall a frame", "CPU a frame", "wall an hour at 30/s", "CPU an hour", "memory"]
    notes = [
        f"results: {disk / 1000:.1f} kB a frame on disk, {disk * 0.108:.0f} MB an hour; the clip itself has "
        f"{read / 1000:.1f} kB a frame"
    ]
    return Part("What an hour of footage costs", header, rows, notes, {"cost": numbers})


def overhead_part(args: argparse.Namespace, folder: Path) -> Part:
    """What a task costs beside its work."""
    photos = folder / "photos"
    photos.mkdir()
    for i in range(args.clips):
        shutil.copy(args.photo, photos / f"photo_{i:02}{args.photo.suffix}")
    found: dict[str, list[float]] = {"a process for each": [], "one warm process": [], "nothing to do": []}
    for number in range(args.rounds):
        out = folder / f"overhead{number}"
        batch("plan", photos, "-o", out)
        for name in list(found):
            if name == "a process for each":
                ids = [task["id"] for task in _plan_in(out)["tasks"]]
                seconds = sum(batch("task", out, id, "--jobs", "1")[0] for id in ids)
            else:
                again = ["--again"] if name == "one warm process" else []
                seconds = batch("work", out, "--jobs", "1", *again)[0]
            found[name].append(seconds / args.clips)
    header = ["", "seconds a task", "range"]
    rows = [
        [name, significant(median(each)), f"{significant(min(each))}-{significant(max(each))}"]
        for name, each in found.items()
    ]
    notes = [
        f"{args.clips} photos, {args.rounds} rounds; the last is the start of the command, shared by all"
    ]
    return Part("What a task costs", header, rows, notes, {"overhead": found})


def _plan_in(folder: Path) -> dict[str, Any]:
    (path,) = (folder / "plans").iterdir()
    return json.loads(path.read_text())


def jobs_part(args: argparse.Namespace, folder: Path) -> Part:
    """Clips with several processes against one, or another way to have them done against several."""
    clips = clips_of(args.clip, folder / "jobs", args.frames, args.clips)
    single = ["--processes", "1"]
    several = ["--jobs", str(args.jobs), *single]
    first, second = (
        (several, [*args.other.split(), *single]) if args.other else (["--jobs", "1", *single], several)
    )
    found: list[tuple[float, float]] = []
    for number in range(args.rounds):
        pair = [
            batch(*clips, "-o", folder / f"jobs-{number}-{i}", *each, OMP_NUM_THREADS="1")[0]
            for i, each in enumerate((first, second))
        ]
        found.append((pair[0], pair[1]))
    header = ["", "seconds", "range", "frames/s"]
    rows = []
    for i, each in enumerate((first, second)):
        seconds = [pair[i] for pair in found]
        rate = args.frames * args.clips / median(seconds)
        rows.append(
            [
                " ".join(each),
                f"{median(seconds):.1f}",
                f"{min(seconds):.1f}-{max(seconds):.1f}",
                f"{rate:.1f}",
            ]
        )
    ratios = [a / b for a, b in found]
    notes = [
        f"{args.clips} clips of {args.frames} frames, {args.rounds} rounds: the second is "
        f"{median(ratios):.2f} times as fast ({min(ratios):.2f}-{max(ratios):.2f})"
    ]
    return Part("Throughput", header, rows, notes, {"jobs": {"seconds": found, "ratios": ratios}})


def memory_part(args: argparse.Namespace, folder: Path) -> Part:
    """The most that Blender and the capturing process of one task hold together."""
    import cv2

    (clip,) = clips_of(args.clip, folder / "memory", args.frames)
    picture = cv2.imread(str(args.photo))
    scale = (12e6 / (picture.shape[0] * picture.shape[1])) ** 0.5
    large = folder / "memory" / "photo_12.jpg"
    cv2.imwrite(str(large), cv2.resize(picture, None, fx=scale, fy=scale, interpolation=cv2.INTER_CUBIC))
    wide = write_clip(str(clip), folder / "memory" / "clip_1080.mp4", args.frames, _LARGEST, scale=9.0)
    inputs = {
        "a photo": args.photo,
        "a photo of 12 megapixels": large,
        f"a clip of {args.frames} frames": clip,
        "the same, 1920 pixels wide or high": wide,
    }
    rows = []
    for i, (name, path) in enumerate(inputs.items()):
        _, _, peak = batch(path, "-o", folder / f"memory-out{i}", "--jobs", "1", "--processes", "1")
        rows.append([name, f"{peak:.0f}"])
    numbers = {"task_memory_mb": {name: float(peak) for name, peak in rows}}
    return Part("The most memory that a task's processes hold", ["", "MB"], rows, (), numbers)


# Empty tasks


def do_nothing() -> int:
    """Be a process that does tasks (handfit_core/farm/slot.py) which only write four small files."""
    out = sys.stdout.buffer

    def say(event: str, **fields: Any) -> None:
        out.write(encode({"event": event, **fields}))
        out.flush()

    say("ready", version=__version__, pid=os.getpid())
    for line in sys.stdin:
        request = json.loads(line)
        task, folder = request["task"], Path(request["folder"])
        for suffix in ("take.npz", "sheet.jpg", "blend", "glb"):
            name = f"{task['name']}.{suffix}"
            (folder / name).write_bytes(bytes(1000))
            say("file", name=name, **files_in(folder, [name])[name])
        say("done", result={"input": task["shown"], "name": task["name"], "status": "ok", "id": task["id"]})
    return 0


def empty_part(args: argparse.Namespace, folder: Path) -> Part:
    """What a task costs beside its work: planning, doing, skipping what is sealed, reporting."""
    rows, numbers = [], []
    for count in (args.tasks // 10, args.tasks):
        out = folder / f"empty{count}"
        inputs = [Input(f"clip_{i}.mp4", f"clip_{i}", (f"clip_{i}.mp4",)) for i in range(count)]
        began = time.perf_counter()
        plan = make_plan(inputs, out, {}, command=[sys.executable, str(Path(__file__).resolve())])
        plan.save()
        took = {"planning": time.perf_counter() - began}
        for name in ("doing", "skipping"):
            began = time.perf_counter()
            if args.other:
                work = [sys.executable, "-m", "handfit_core", "work", str(plan.path), "--progress", "none"]
                subprocess.run([*work, *args.other.split()], cwd=ROOT, check=True)
            else:
                with Pool(plan.command, jobs=args.jobs) as pool:
                    pool.run(plan, plan.tasks)
            took[name] = time.perf_counter() - began
        began = time.perf_counter()
        report = Report([Plan.load(plan.path)])
        report.look()
        report.write()
        took["reporting"] = time.perf_counter() - began
        rows.append([f"{count}", *(f"{1000 * seconds / count:.2f}" for seconds in took.values())])
        numbers.append({"tasks": count, **took})
    title = (
        f"Tasks that only write four small files, {args.other or f'--jobs {args.jobs}'}: milliseconds a task"
    )
    header = ["tasks", "planning", "doing", "skipping", "reporting"]
    return Part(title, header, rows, (), {"empty": numbers})


if __name__ == "__main__":
    sys.exit(main())
