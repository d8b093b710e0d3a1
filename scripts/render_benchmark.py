#!/usr/bin/env python3
"""Render the benchmark: pictures of hands with exact labels, in the plain folder form.

    python scripts/render_benchmark.py OUT                    (Python with a bpy wheel)
    blender -b -P scripts/render_benchmark.py -- OUT          (Blender)

The same seed gives the same labels always, and the same pictures on the same machine and Blender.
Pictures that are there already are kept, so that an interrupted run goes on where it stopped.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import signal
import sys
import threading
import time
from collections.abc import Iterator
from itertools import chain
from pathlib import Path
from typing import Any, Final

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

from handfit_core.common.errors import HandfitError, OptionError, OutputError
from handfit_core.common.files import written_whole
from handfit_core.common.skeleton import SIDES
from handfit_core.evaluate.datasets.plain import save_index
from scripts.benchmark.clips import clip_shot
from scripts.benchmark.kinematics import model_of
from scripts.benchmark.pairs import FOLDER, TRUTH, pair_shots
from scripts.benchmark.shots import FPS, NAME, NOTES, entries
from scripts.benchmark.stills import still_shot

RECIPE = 1
"""Raise it when the same seed no longer gives the same pictures"""
SETTINGS = "render_settings.json"
"""File in the output folder with the settings of its pictures"""


OPTIONS: Final = {
    "stills": (500, 0, "single pictures"),
    "clips": (10, 0, "moving hands"),
    "pairs": (0, 0, "moving hands before two cameras"),
    "frames": (100, 1, "pictures a clip, 25 a second"),
    "seed": (0, 0, "another seed, other pictures"),
    "size": (512, 32, "pixels a side"),
    "samples": (3, 1, "Cycles samples a pixel, before the picture is denoised"),
}
"""Name of an option -> its default, its least value, and its help"""


def main(argv: list[str] | None = None) -> int:
    """Run the script; returns the exit code."""
    args = _parser().parse_args(_own_arguments() if argv is None else argv)
    try:
        for name, (_, least, _) in OPTIONS.items():
            if (value := getattr(args, name)) < least:
                raise OptionError(f"--{name} must be {least} or more, not {value}")
        if _total(args) == 0:
            raise OptionError("there is nothing to render; ask for --stills, --clips or --pairs")
        return _render_all(args)
    except HandfitError as error:
        print(f"render_benchmark: {error}", file=sys.stderr)
        return 2


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="render_benchmark.py", description=(__doc__ or "").splitlines()[0])
    parser.add_argument("output", type=Path, help="folder for the pictures and index.json")
    for name, (default, _, text) in OPTIONS.items():
        parser.add_argument(f"--{name}", type=int, default=default, help=f"{text} (default {default})")
    return parser


def _own_arguments() -> list[str]:
    """Blender keeps what stands before `--` for itself."""
    arguments = sys.argv[1:]
    return arguments[arguments.index("--") + 1 :] if "--" in arguments else arguments


def _total(args: argparse.Namespace) -> int:
    """Number of pictures."""
    return args.stills + (args.clips + 2 * args.pairs) * args.frames


def _agree_on_settings(args: argparse.Namespace) -> None:
    """Refuse to mix pictures of two recipes in one folder."""
    output = args.output
    # How many stills and clips there are changes none of them.
    wanted = {name: getattr(args, name) for name in ("seed", "size", "samples", "frames")}
    wanted |= {"recipe": RECIPE, "hands": {side: model_of(side).digest for side in SIDES}}
    path = output / SETTINGS
    there = any(output.glob("stills/*.jpg")) or any(output.glob("*/*/*.jpg"))
    try:
        found = json.loads(path.read_text(encoding="utf-8")) if path.is_file() else None
    except ValueError:
        found = None
    if there and found != wanted:
        raise OutputError(
            f"{output}: its pictures were made with {found}, not {wanted}; choose another folder"
        )
    with written_whole(path) as beside:
        beside.write_text(json.dumps(wanted), encoding="utf-8")


def _render_all(args: argparse.Namespace) -> int:
    # Blender's part loads here, so that --help and wrong options answer at once and without it.
    try:
        from scripts.benchmark.drawing import draw
        from scripts.benchmark.scene import build_scene
    except ModuleNotFoundError as error:
        if error.name != "bpy":
            raise
        raise OptionError(
            "this Python has no Blender in it; install a bpy wheel, or run it as "
            "blender -b -P scripts/render_benchmark.py -- OUT"
        ) from error
    _agree_on_settings(args)

    output, total = args.output, _total(args)
    start, drawn, done = time.monotonic(), 0, 0
    pictures: list[dict[str, Any]] = []
    with _stop_wanted() as stop:
        stills = (still_shot(args.seed, number, args.size) for number in range(args.stills))
        clips = (clip_shot(args.seed, number, args.frames, args.size) for number in range(args.clips))
        pairs = [pair_shots(args.seed, number, args.frames, args.size) for number in range(args.pairs)]
        if pairs:
            with written_whole(output / FOLDER / TRUTH) as beside:
                beside.write_text(json.dumps([truth for _, _, truth in pairs]), encoding="utf-8")
        for shot in chain(stills, clips, *(pair[:2] for pair in pairs)):
            if stop.is_set():
                break
            built = False
            for picture, (file, entry) in enumerate(zip(shot.files, entries(shot), strict=True)):
                done += 1
                path = output / file
                if path.is_file():
                    pictures.append(entry)
                    continue
                if stop.is_set():
                    continue
                if not built:
                    build_scene(shot, args.samples)
                    built = True
                draw(shot, picture, path)
                pictures.append(entry)
                drawn += 1
                each = (time.monotonic() - start) / drawn
                left = each * (total - done) / 60
                print(f"{file} ({done}/{total}), {each:.1f} s each, {left:.0f} min left", flush=True)
    if stop.is_set():
        print("stopped; the same command goes on from here", flush=True)
    # Stopped before it drew anything, this run has not come to all pictures of the runs before.
    # Pairs have their truth in a file of their own.
    labelled = [entry for entry in pictures if not entry["file"].startswith(FOLDER)]
    if labelled and (drawn or not stop.is_set()):
        save_index(output, labelled, name=NAME, notes=NOTES, fps=FPS)
    print(f"{drawn} pictures rendered, {len(pictures)} of {total} are there", flush=True)
    return 130 if stop.is_set() else 0


@contextlib.contextmanager
def _stop_wanted() -> Iterator[threading.Event]:
    """Ctrl-C and SIGTERM set the event, to be looked at between pictures.

    As exceptions they would be lost: Cycles calls Python while it renders, and Blender prints what is
    raised there and goes on.
    """
    wanted = threading.Event()
    before = {s: signal.signal(s, lambda *_: wanted.set()) for s in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield wanted
    finally:
        for number, handler in before.items():
            # Blender's own handlers are not Python's: they come back as None, and cannot be put back.
            signal.signal(number, signal.SIG_DFL if handler is None else handler)


if __name__ == "__main__":
    sys.exit(main())
