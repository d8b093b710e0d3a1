"""Fit hands to whole folders without a window: takes, .blend files, exports and previews.

    blender -b -P scripts/batch_fit.py -- INPUT [INPUT ...] --output DIR --format blend,glb,fbx
    python scripts/batch_fit.py INPUT [INPUT ...] --output DIR        # with Blender's bpy wheel

docs/batch.md describes every option, the exit codes and report.json.
"""

from __future__ import annotations

import argparse
import contextlib
import glob
import io
import json
import os
import shutil
import signal
import sys
import time
import traceback
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

ROOT = Path(__file__).resolve().parents[1]
if str(ROOT) not in sys.path:
    sys.path.insert(0, str(ROOT))

from handfit_core.__main__ import parse_intrinsics
from handfit_core.errors import HandfitError, InputError, OptionError
from handfit_core.files import written_whole
from handfit_core.frame_range import FrameRange
from handfit_core.media import (
    PHOTO_SUFFIXES,
    VIDEO_SUFFIXES,
    is_pattern,
    pictures_in,
    sequence_numbers,
)
from handfit_core.solvers import DEFAULT_SOLVER, get_solver
from handfit_core.take import Take

if TYPE_CHECKING:  # without bpy these cannot be imported, which is told in a sentence
    from blender_manient.worker.client import CaptureOptions, Worker

EXIT_OK, EXIT_SOME_FAILED, EXIT_USAGE, EXIT_INTERRUPTED = 0, 1, 2, 130
TAKE_SUFFIX = ".take.npz"


@dataclass(frozen=True)
class Job:
    """One input: what to capture (or the take to use), and the name of its results."""

    shown: str
    name: str
    source: tuple[str, ...] = ()
    take: Path | None = None
    error: str = ""
    """Why it cannot even be tried"""


@dataclass
class Result:
    """One entry of report.json."""

    input: str
    name: str
    status: str = "pending"
    """pending, ok, failed or interrupted"""
    seconds: float = 0.0
    frames: int = 0
    hands: list[dict[str, Any]] = field(default_factory=list)
    """per hand its side, the frames in which it was detected, and mean_reprojection_error_px"""
    files: list[str] = field(default_factory=list)
    """relative to the report's folder"""
    warnings: list[str] = field(default_factory=list)
    error: str = ""


def main(argv: Sequence[str] | None = None, default_inputs: Sequence[str] = ()) -> int:
    """Run the batch; returns the exit code. `default_inputs` are used where none are given."""
    args = parse_arguments(argv, default_inputs)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # a file name must not end a run on a narrow console
            stream.reconfigure(errors="backslashreplace")
    with contextlib.suppress(ValueError):  # not in the main thread
        # Blender keeps Ctrl-C to itself in the background; farms end jobs with SIGTERM.
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, _interrupt)
    try:
        formats = _checked_formats(args.format)
        if args.frames:
            FrameRange.parse(args.frames)
        options = _capture_options(args)
        get_solver(options.solver or DEFAULT_SOLVER, hand_length=options.hand_length)
        jobs = with_free_names(
            [job for text in args.inputs for job in expand(text, args.grouping)],
            args.output,
            # In a flat folder names only need to differ from each other: results replace older ones.
            args.overwrite or args.flat,
        )
        return _run(jobs, formats, options, args)
    except HandfitError as error:
        return _fail(error, args.debug, EXIT_USAGE)
    except KeyboardInterrupt:
        print("stopped; what was finished is kept", file=sys.stderr)
        return EXIT_INTERRUPTED
    except Exception as error:  # a defect of ours: still one line, and never exit code 0
        return _fail(error, args.debug, EXIT_SOME_FAILED)


def parse_arguments(
    argv: Sequence[str] | None = None, default_inputs: Sequence[str] = ()
) -> argparse.Namespace:
    """The command line: what follows `--` under Blender, everything under Python."""
    if argv is None:
        argv = sys.argv[sys.argv.index("--") + 1 :] if "--" in sys.argv else sys.argv[1:]
    parser = argparse.ArgumentParser(
        prog="batch_fit.py", description="Fit hands to photos, sequences, videos and folders of them."
    )
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
    parser.add_argument("--python", metavar="PATH", help="Python that captures (default: this one)")
    parser.add_argument("--timeout", type=float, metavar="SECONDS", help="longest capture of one input")
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
    parser.add_argument("--preview", action="store_true", help="render a preview picture of each input")
    parser.add_argument("--no-picture", action="store_true", help="no picture behind the hands in the .blend")
    parser.add_argument("--no-correctives", action="store_true", help="no corrective shape keys (MANO)")
    parser.add_argument("--overwrite", action="store_true", help="write into result folders that exist")
    parser.add_argument(
        "--flat", action="store_true", help="all results directly in DIR, without a folder per input"
    )
    parser.add_argument("--debug", action="store_true", help="show tracebacks and Blender's own messages")
    return parser.parse_args(argv)


def expand(text: str, grouping: str | None = None) -> list[Job]:
    """The jobs of one INPUT.

    A folder or a glob pattern gives one job per video, and one per photo, unless the photos
    form one numbered sequence (`grouping` forces either: "sequence" or "separate").
    """
    path = Path(text).expanduser()
    if path.is_dir():
        videos = sorted(p for p in path.iterdir() if p.suffix.lower() in VIDEO_SUFFIXES and p.name[0] != ".")
        jobs = _group(pictures_in(path), grouping, path.resolve().name) + [_file_job(v) for v in videos]
        return jobs or [Job(text, path.resolve().name, error=f"{text}: no photos or videos in this folder")]
    if path.exists() or not is_pattern(text):
        return [_file_job(path)]
    if not any(c in path.name for c in "*?["):  # name.%04d.png and name.####.png are sequences by intent
        name = path.name.partition("%")[0].partition("#")[0].rstrip("._- ") or path.absolute().parent.name
        return [Job(text, name, (str(path),))]
    pattern = str(Path(glob.escape(str(path.parent))) / path.name)
    found = sorted(p for p in map(Path, glob.glob(pattern)) if p.is_file())
    pictures = [p for p in found if p.suffix.lower() in PHOTO_SUFFIXES]
    others = [_file_job(p) for p in found if p not in pictures]
    jobs = _group(pictures, grouping, path.absolute().parent.name) + others
    return jobs or [Job(text, "pattern", error=f"{text}: no file matches this pattern")]


def with_free_names(jobs: list[Job], output: Path, overwrite: bool) -> list[Job]:
    """Give every job a result folder of its own: a name that is taken gets -2, -3, ...

    Names are compared without case, since some file systems do.
    """
    taken: set[str] = set()
    if not overwrite and output.is_dir():
        taken = {p.name.lower() for p in output.iterdir() if p.is_dir() and any(p.iterdir())}
    named = []
    for job in jobs:
        name, number = job.name, 1
        while name.lower() in taken:
            number += 1
            name = f"{job.name}-{number}"
        taken.add(name.lower())
        named.append(Job(job.shown, name, job.source, job.take, job.error))
    return named


def _file_job(path: Path) -> Job:
    if path.suffix.lower() == ".npz":
        return Job(str(path), path.stem.removesuffix(".take"), take=path)
    return Job(str(path), path.stem, (str(path),))


def _group(pictures: list[Path], grouping: str | None, name: str) -> list[Job]:
    is_sequence = grouping == "sequence" or (grouping is None and sequence_numbers(pictures) is not None)
    if len(pictures) > 1 and is_sequence:
        shown = f"{pictures[0]} ... {pictures[-1].name} ({len(pictures)} pictures)"
        return [Job(shown, name, tuple(map(str, pictures)))]
    return [_file_job(p) for p in pictures]


def _checked_formats(text: str) -> list[str]:
    """Validate every format before any work. Raises OptionError."""
    try:
        import bpy  # noqa: F401
    except ImportError as error:
        raise OptionError(
            "this Python has no bpy: run the script with 'blender -b -P scripts/batch_fit.py -- ...', or "
            "install Blender's bpy wheel"
        ) from error
    from blender_manient.scene.export import FORMATS, available, find_format

    formats = list(dict.fromkeys(f.strip().lower().lstrip(".") for f in text.split(",") if f.strip()))
    for name in formats:
        if not available(find_format(name)):
            can = ", ".join(k for k, f in FORMATS.items() if available(f))
            raise OptionError(f"this Blender cannot write {name}; choose from {can}")
    return formats


def _capture_options(args: argparse.Namespace) -> CaptureOptions:
    """What every capture of the batch is told. Raises OptionError."""
    from blender_manient.worker.client import CaptureOptions

    camera = parse_intrinsics(args.intrinsics) if args.intrinsics else None
    return CaptureOptions(
        frames=args.frames,
        hands=args.hands,
        solver=args.solver,
        model=args.model,
        threshold=args.threshold,
        intrinsics=None if camera is None else (camera.fx, camera.fy, camera.cx, camera.cy),
        landmark_model=args.landmark_model,
        smoothing=args.smoothing,
        plain_detection=args.plain_detection or None,
        hand_length=None if args.hand_length is None else args.hand_length / 1000.0,
    )


def _run(jobs: list[Job], formats: list[str], options: CaptureOptions, args: argparse.Namespace) -> int:
    """Every job with one worker, which starts with the first capture and again after a crash."""
    from blender_manient.worker.client import PYTHON_VARIABLE, Advice, Worker

    where = f"with --python or in ${PYTHON_VARIABLE}"
    advice = Advice(where, crash=f"try again with --debug, or choose another Python {where}")
    with Worker(args.python, debug=args.debug, advice=advice) as worker:
        return _run_with(worker, jobs, formats, options, args)


def _run_with(
    worker: Worker, jobs: list[Job], formats: list[str], options: CaptureOptions, args: argparse.Namespace
) -> int:
    results = [Result(job.shown, job.name) for job in jobs]
    report = args.output / "report.json"
    _write_report(report, results)  # also finds out now, not after an hour, that it cannot be written
    for number, (job, result) in enumerate(zip(jobs, results, strict=True), 1):
        started = time.perf_counter()
        try:
            _fit_one(job, result, formats, worker, options, args)
            result.status = "ok"
        except KeyboardInterrupt:
            result.status, result.error = "interrupted", "stopped by the user"
            raise
        except HandfitError as error:
            result.status, result.error = "failed", " ".join(str(error).split())
            if args.debug:
                traceback.print_exc()
        except Exception as error:
            result.status = "failed"
            result.error = f"unexpected {type(error).__name__}: {' '.join(str(error).split())} (see --debug)"
            if args.debug:
                traceback.print_exc()
        finally:
            result.seconds = round(time.perf_counter() - started, 3)
            if not args.flat:
                with contextlib.suppress(OSError):
                    (args.output / job.name).rmdir()  # only if nothing was written
            _write_report(report, results)
            print(f"[{number}/{len(jobs)}] {_line(result)}", flush=True)
    return EXIT_OK if all(r.status == "ok" for r in results) else EXIT_SOME_FAILED


def _fit_one(
    job: Job,
    result: Result,
    formats: list[str],
    worker: Worker,
    options: CaptureOptions,
    args: argparse.Namespace,
) -> None:
    """Capture, build, export: fills in `result` as it goes."""
    if job.error:
        raise InputError(job.error)
    folder = args.output if args.flat else args.output / job.name
    take_path = folder / f"{job.name}{TAKE_SUFFIX}"
    if job.take is None:
        _capture(job, take_path, result, worker, options, args.timeout)
        take = Take.load(take_path)
    else:
        take = Take.load(job.take)
        if not (take_path.exists() and take_path.samefile(job.take)):
            take.save(take_path)
    _describe(take, result)
    result.files.append(_relative(take_path, args.output))

    import bpy

    from blender_manient.scene.build import build_take
    from blender_manient.scene.export import export_take
    from blender_manient.scene.preview import render_preview, spread_frames

    with _blender_silenced(args.debug):
        bpy.ops.wm.read_factory_settings(use_empty=True)
        built = build_take(
            take,
            model=args.model if job.take else None,
            pose_correctives=not args.no_correctives,
            picture=not args.no_picture,
        )
        result.warnings += built.warnings
        for fmt in formats:
            for path in export_take(built, take, folder, job.name, fmt):
                result.files.append(_relative(path, args.output))
        frames = spread_frames(take, 3)
        if args.preview and frames:
            path = folder / f"{job.name}.preview.png"
            render_preview(built, take, frames[len(frames) // 2], path)
            result.files.append(_relative(path, args.output))


def _capture(
    job: Job,
    take_path: Path,
    result: Result,
    worker: Worker,
    options: CaptureOptions,
    timeout: float | None,
) -> None:
    """Write the take of one input. Raises HandfitError; after `timeout` seconds WorkerError."""
    shown = sys.stderr.isatty()

    def on_event(event: dict[str, Any]) -> None:
        if event["event"] == "warning":
            result.warnings.append(str(event["message"]))
        elif shown:
            line = f"{job.name}: {event['stage']} {event['done']}/{event['total']} "
            print(f"\r{line}", end="", file=sys.stderr, flush=True)

    request = worker.request(
        "capture", input=list(job.source), output=str(take_path), options=options.to_message()
    )
    try:
        worker.wait(request, on_event, timeout)
    finally:
        if shown:
            print("\r" + " " * 70 + "\r", end="", file=sys.stderr, flush=True)


def _describe(take: Take, result: Result) -> None:
    result.frames = len(take.frame_numbers)
    for track in take.hands:
        error = track.reprojection_error[track.detected]
        result.hands.append(
            {
                "side": track.side,
                "detected": int(track.detected.sum()),
                "mean_reprojection_error_px": round(float(error.mean()), 3) if len(error) else None,
            }
        )


def _write_report(path: Path, results: list[Result]) -> None:
    report = {"format": "handfit-batch", "version": 1, "inputs": [asdict(r) for r in results]}
    with written_whole(path) as beside:
        beside.write_text(json.dumps(report, indent=2, ensure_ascii=False) + "\n", encoding="utf-8")


def _line(result: Result) -> str:
    """One line about one input, for people."""
    if result.status != "ok":
        named = "" if result.error.startswith(result.input) else f"{result.input}: "
        return f"{result.status}: {named}{result.error}"
    hands = ", ".join(
        f"{hand['side']} hand in {hand['detected']} of {result.frames} frames"
        + (f" ({hand['mean_reprojection_error_px']:.1f} px)" if hand["detected"] else "")
        for hand in result.hands
    )
    warnings = f", {len(result.warnings)} warnings" if result.warnings else ""
    return f"ok: {result.input}: {hands}{warnings}, {result.seconds:.1f} s"


def _relative(path: Path, base: Path) -> str:
    return path.relative_to(base).as_posix()


def _interrupt(_number: int, _frame: object) -> None:
    raise KeyboardInterrupt


def _fail(error: Exception, debug: bool, code: int) -> int:
    expected = isinstance(error, HandfitError)
    text = " ".join(str(error).split())
    print(f"error: {text if expected else f'unexpected {type(error).__name__}: {text}'}", file=sys.stderr)
    if debug:
        traceback.print_exc()
    return code


@contextlib.contextmanager
def _blender_silenced(debug: bool) -> Iterator[None]:
    """Keep exporters and renders from talking on stdout, where our lines belong; errors stay visible."""
    sys.stdout.flush()
    kept = os.dup(1)
    target = os.dup(2) if debug else os.open(os.devnull, os.O_WRONLY)
    os.dup2(target, 1)
    try:
        yield
    finally:
        sys.stdout.flush()
        os.dup2(kept, 1)
        os.close(kept)
        os.close(target)


def _leave(code: int) -> NoReturn:
    """End with this code. Blender ends with it too; only an uncaught exception would leave it at 0.

    As a Python module, Blender 4.2 crashes while the interpreter shuts down after a glTF export, which
    would turn a finished run into a failed one: there the process ends without that.
    """
    bpy = sys.modules.get("bpy")
    if bpy is not None and not bpy.app.binary_path:
        shutil.rmtree(bpy.app.tempdir, ignore_errors=True)
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)
    sys.exit(code)


if __name__ == "__main__":
    _leave(main())
