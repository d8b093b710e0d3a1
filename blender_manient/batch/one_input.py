"""One input: capture, build, export, preview."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import bpy

from handfit_core.errors import InputError
from handfit_core.take import Take
from handfit_core.worker.runner import Event, Runner

from ..scene.build import build_take
from ..scene.export import Stage, export_hands, export_take
from ..scene.preview import render_preview, spread_frames
from .console import blender_silenced
from .inputs import Job
from .order import Order
from .report import Result

TAKE_SUFFIX = ".take.npz"


def fit(job: Job, result: Result, order: Order, runner: Runner, *, keep_addons: bool) -> None:
    """Make everything that is ordered of one input; fills in `result` as it goes.

    The open file is replaced by an empty one. `keep_addons` leaves the add-ons and preferences as they
    are; otherwise they become Blender's factory settings. Raises HandfitError.
    """
    if job.error:
        raise InputError(job.error)
    folder = order.folder(job.name)
    take_path = folder / f"{job.name}{TAKE_SUFFIX}"
    if job.take is None:
        _capture(job, take_path, result, runner, order)
        take = Take.load(take_path)
    else:
        take = Take.load(job.take)
        if not (take_path.exists() and take_path.samefile(job.take)):
            take.save(take_path)
    result.describe(take)
    result.files.append(_relative(take_path, order.output))

    with blender_silenced(order.debug):
        for path in _results(take, job, folder, result, order, keep_addons):
            result.files.append(_relative(path, order.output))


def start_empty(*, keep_addons: bool) -> None:
    """Replace the open file by an empty one. `keep_addons` leaves the add-ons and preferences as they are;
    otherwise they become Blender's factory settings."""
    if keep_addons:
        bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    else:
        bpy.ops.wm.read_factory_settings(use_empty=True)


def _results(
    take: Take, job: Job, folder: Path, result: Result, order: Order, keep_addons: bool
) -> Iterator[Path]:
    """Write what is made of a take; gives each file that is there."""
    model = order.model if job.take else None
    frames = spread_frames(take, 3) if order.preview else []
    start_empty(keep_addons=keep_addons)
    if order.character is not None:
        character, result.character, warnings = order.character.put(take, model)
        result.warnings += warnings
        for fmt in order.formats:
            yield from export_hands([character], Stage.of_scene(bpy.context.scene), folder, job.name, fmt)
        if not frames:
            return
        start_empty(keep_addons=keep_addons)
    built = build_take(
        take,
        model=model,
        pose_correctives=order.pose_correctives,
        picture=order.picture,
        max_megapixels=order.options.max_megapixels,
    )
    result.warnings += built.warnings
    if order.character is None:
        for fmt in order.formats:
            yield from export_take(built, take, folder, job.name, fmt)
    if frames:
        path = folder / f"{job.name}.preview.png"
        render_preview(
            built, take, frames[len(frames) // 2], path, max_megapixels=order.options.max_megapixels
        )
        yield path


def _capture(job: Job, take_path: Path, result: Result, runner: Runner, order: Order) -> None:
    """Write the take of one input. Raises HandfitError; after the order's timeout WorkerError."""
    shown = sys.stderr.isatty()

    def on_event(event: Event) -> None:
        if event["event"] == "warning":
            result.warnings.append(str(event["message"]))
        elif shown:
            line = f"{job.name}: {event['stage']} {event['done']}/{event['total']} "
            print(f"\r{line}", end="", file=sys.stderr, flush=True)

    request = runner.submit(
        "capture", input=list(job.source), output=str(take_path), options=order.options.to_message()
    )
    try:
        runner.wait(request, on_event, order.timeout)
    finally:
        if shown:
            print("\r" + " " * 70 + "\r", end="", file=sys.stderr, flush=True)


def _relative(path: Path, base: Path) -> str:
    return path.relative_to(base).as_posix()
