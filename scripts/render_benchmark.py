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
from collections.abc import Container, Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

from handfit_core.errors import HandfitError, OptionError, OutputError
from handfit_core.evaluate.datasets.plain import save_index
from handfit_core.files import written_whole
from handfit_core.skeleton import SIDES
from scripts.benchmark.clips import clip_file, clip_shot
from scripts.benchmark.kinematics import model_of
from scripts.benchmark.shots import FPS, NAME, NOTES, Shot, entries
from scripts.benchmark.stills import still_file, still_shot

RECIPE = 1
"""Raise it when the same seed no longer gives the same pictures"""
SETTINGS = "render_settings.json"
"""In the output folder: what its pictures were made with"""


@dataclass(frozen=True)
class Plan:
    """Which pictures there are to be; numbered from 0, stills first, then clip by clip."""

    stills: int
    clips: int
    frames: int
    seed: int
    size: int

    def __len__(self) -> int:
        return self.stills + self.clips * self.frames

    def there(self, output: Path) -> list[int]:
        """The numbers of the pictures that are in the folder, whenever they were rendered."""
        clips = ((c, t) for c in range(self.clips) for t in range(self.frames))
        files = [still_file(n) for n in range(self.stills)] + [clip_file(*at) for at in clips]
        return [number for number, file in enumerate(files) if (output / file).is_file()]

    def shots(self, chosen: Container[int]) -> Iterator[tuple[Shot, list[int]]]:
        """Each shot that has any of the `chosen` pictures, and which of its pictures those are."""
        for number in range(self.stills):
            if number in chosen:
                yield still_shot(self.seed, number, self.size), [0]
        for clip in range(self.clips):
            first = self.stills + clip * self.frames
            pictures = [t for t in range(self.frames) if first + t in chosen]
            if pictures:
                yield clip_shot(self.seed, clip, self.frames, self.size), pictures


def main(argv: list[str] | None = None) -> int:
    """Run the script; returns the exit code."""
    args = _parser().parse_args(_own_arguments() if argv is None else argv)
    plan = Plan(args.stills, args.clips, args.frames, args.seed, args.size)
    try:
        _check(plan, args.samples)
        chosen = _chosen(args.only, len(plan))
        return _render_all(args.output, plan, chosen, args.samples, args.overwrite)
    except HandfitError as error:
        print(f"render_benchmark: {error}", file=sys.stderr)
        return 2


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="render_benchmark.py", description=(__doc__ or "").splitlines()[0])
    parser.add_argument("output", type=Path, help="folder for the pictures and index.json")
    parser.add_argument("--stills", type=int, default=500, help="single pictures (default 500)")
    parser.add_argument("--clips", type=int, default=10, help="moving hands (default 10)")
    parser.add_argument("--frames", type=int, default=100, help="pictures a clip, 25 a second (default 100)")
    parser.add_argument("--seed", type=int, default=0, help="another seed, other pictures (default 0)")
    parser.add_argument("--size", type=int, default=512, help="pixels a side (default 512)")
    parser.add_argument("--samples", type=int, default=3, help="Cycles samples a pixel (default 3, denoised)")
    parser.add_argument("--only", metavar="N-M", help="only these pictures, from 0, clips after stills")
    parser.add_argument("--overwrite", action="store_true", help="render pictures again that are there")
    return parser


def _own_arguments() -> list[str]:
    """Blender keeps what stands before `--` for itself."""
    arguments = sys.argv[1:]
    return arguments[arguments.index("--") + 1 :] if "--" in arguments else arguments


def _check(plan: Plan, samples: int) -> None:
    least = {"stills": 0, "clips": 0, "frames": 1, "seed": 0, "size": 32}
    for name, value in {**vars(plan), "samples": samples}.items():
        if value < least.get(name, 1):
            raise OptionError(f"--{name} must be {least.get(name, 1)} or more, not {value}")
    if len(plan) == 0:
        raise OptionError("there is nothing to render; ask for --stills or --clips")


def _chosen(only: str | None, count: int) -> range:
    """`N-M` or `N`, both included -> picture numbers."""
    if only is None:
        return range(count)
    first, _, last = only.partition("-")
    if (
        not first.isdecimal()
        or not (last or first).isdecimal()
        or not int(first) <= int(last or first) < count
    ):
        raise OptionError(f"--only wants N-M with 0 <= N <= M < {count}, not {only!r}")
    return range(int(first), int(last or first) + 1)


def _agree_on_settings(output: Path, plan: Plan, samples: int, overwrite: bool) -> None:
    """Refuse to mix pictures of two recipes in one folder."""
    # How many stills and clips there are changes none of them.
    wanted = {
        "recipe": RECIPE,
        "seed": plan.seed,
        "size": plan.size,
        "samples": samples,
        "frames": plan.frames,
        "hands": {side: model_of(side).digest for side in SIDES},
    }
    path = output / SETTINGS
    there = [*output.glob("stills/*.jpg"), *output.glob("clips/*/*.jpg")]
    try:
        found = json.loads(path.read_text(encoding="utf-8")) if path.is_file() else None
    except ValueError:
        found = None
    if there and found != wanted:
        if not overwrite:
            raise OutputError(
                f"{output}: its pictures were made with {found}, not {wanted}; choose another folder, or add "
                "--overwrite to render all of them again"
            )
        # All of them, also those that this run does not come to: their labels would be the new ones.
        for old in (output / "index.json", *there):
            old.unlink(missing_ok=True)
    with written_whole(path) as beside:
        beside.write_text(json.dumps(wanted), encoding="utf-8")


def _render_all(output: Path, plan: Plan, chosen: range, samples: int, overwrite: bool) -> int:
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
    _agree_on_settings(output, plan, samples, overwrite)

    start, drawn, done = time.monotonic(), 0, 0
    with _stop_wanted() as stop:
        for shot, pictures in plan.shots(chosen):
            if stop.is_set():
                break
            built = False
            for picture in pictures:
                done += 1
                path = output / shot.files[picture]
                if stop.is_set() or (path.is_file() and not overwrite):
                    continue
                if not built:
                    build_scene(shot, samples)
                    built = True
                draw(shot, picture, path)
                drawn += 1
                each = (time.monotonic() - start) / drawn
                left = each * (len(chosen) - done) / 60
                print(
                    f"{shot.files[picture]} ({done}/{len(chosen)}), {each:.1f} s each, {left:.0f} min left",
                    flush=True,
                )
    if stop.is_set():
        print("stopped; the same command goes on from here", flush=True)
    pictures = [entries(shot)[t] for shot, found in plan.shots(plan.there(output)) for t in found]
    if pictures:
        save_index(output, pictures, name=NAME, notes=NOTES, fps=FPS)
    print(f"{drawn} pictures rendered, {len(pictures)} in {output / 'index.json'}", flush=True)
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
