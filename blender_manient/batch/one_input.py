"""One input: capture, build, export, preview."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import bpy

from handfit_core.errors import HandfitError, InputError
from handfit_core.farm.folder import files_in
from handfit_core.farm.inputs import PREVIEW_SUFFIX
from handfit_core.farm.plan import Task, check_files, files_of, fingerprint
from handfit_core.farm.report import Result
from handfit_core.sheet import SUFFIX
from handfit_core.take import Take
from handfit_core.worker.runner import Event, Runner

from ..scene.build import build_take
from ..scene.export import Stage, export_hands, export_take
from ..scene.preview import render_preview, spread_frames
from .console import blender_silenced
from .order import Order

TAKE_SUFFIX = ".take.npz"
_SHEET_LIMIT = 300.0
"""seconds that a contact sheet may take; where a long video cannot be jumped in, it needs minutes"""
_WHILE_READ = "while it was read: if it is still being copied, wait until it is complete"
_SINCE = "since the batch was planned: see that it is what it should be"


class InputGone(InputError):
    """An input that was there when the batch was planned; it may come back with its disk."""


@dataclass(frozen=True)
class Work:
    """One task for this process."""

    task: Task
    order: Order
    folder: Path
    """Where the results go"""
    finished: Mapping[str, Path]
    """Results that an earlier attempt has left, by their names"""
    parts: Sequence[Path]
    """Files in which the hands of the clip's parts are"""
    named: Sequence[Sequence[str]]
    """`Plan.files`: those that the options name"""
    say: Callable[..., None]
    """Takes the kind of an event and its fields"""

    def tell(self, path: Path) -> None:
        """Tell of a result that is there."""
        name = path.relative_to(self.folder).as_posix()
        self.say("file", name=name, **files_in(self.folder, [name])[name])


def fit(work: Work, result: Result, runner: Runner, *, keep_addons: bool) -> None:
    """Make everything that is ordered of one input; fills in `result` as it goes.

    The open file is replaced by an empty one. `keep_addons` leaves the add-ons and preferences as they
    are; otherwise they become Blender's factory settings. Raises HandfitError.
    """
    task, order, folder = work.task, work.order, work.folder
    check_files(work.named)
    if task.part:
        return _detect(work, result, runner)
    take_path = folder / f"{task.name}{TAKE_SUFFIX}"
    take = _finished_take(work, take_path.name)
    if take is None and task.take:
        _check_input(task)
        take = Take.load(task.take)
    if take is None:
        _check_input(task)
        _capture(work, take_path, result, runner)
        take = Take.load(take_path)
        _check_input(task, _WHILE_READ)
        check_files(work.named)  # before it is told of: the next attempt would go on with it
    elif not (take_path.exists() and task.take and take_path.samefile(task.take)):
        take.save(take_path)
    result.describe(take)
    work.tell(take_path)
    if order.sheet:
        sheet_path = folder / f"{task.name}{SUFFIX}"
        if missing := sheet(runner, take_path, sheet_path, order.options.max_megapixels):
            result.warnings += [] if task.take else [missing]  # takes need no Python that captures
        else:
            work.tell(sheet_path)
    with blender_silenced(order.debug):
        for path in _results(take, work, result, keep_addons):
            work.tell(path)
    check_files(work.named)


def _finished_take(work: Work, name: str) -> Take | None:
    """The take that an earlier attempt has left, so that nobody captures twice."""
    if name not in work.finished:
        return None
    with contextlib.suppress(HandfitError):
        return Take.load(work.finished[name])
    return None


def _check_input(task: Task, when: str = _SINCE) -> None:
    """Raise InputError where the input's files are not those that the task is for."""
    files = [Path(task.take)] if task.take else files_of(task.source)
    if task.made_of == fingerprint(files):
        return
    gone = [file for file in files if not file.exists()]
    if gone or not files:
        raise InputGone(f"{task.shown}: is gone; bring it back, or start the batch again without it")
    raise InputError(f"{task.shown}: has changed {when}, and start the batch again")


def sheet(runner: Runner, take: Path, path: Path, max_megapixels: float | None = None) -> str:
    """Have the worker write the contact sheet of a take. No task fails for it: where there is none, a
    sentence comes back that says why, and else an empty one."""
    fields = {"take": str(take), "output": str(path), "max_megapixels": max_megapixels}
    try:
        runner.wait(runner.submit("sheet", **fields), timeout=_SHEET_LIMIT)
    except HandfitError as error:
        return f"there is no contact sheet of it: {error}"
    return ""


def start_empty(*, keep_addons: bool) -> None:
    """Replace the open file by an empty one. `keep_addons` leaves the add-ons and preferences as they are;
    otherwise they become Blender's factory settings."""
    if keep_addons:
        bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    else:
        bpy.ops.wm.read_factory_settings(use_empty=True)


def _results(take: Take, work: Work, result: Result, keep_addons: bool) -> Iterator[Path]:
    """Write what is made of a take; gives each file that is there."""
    order, folder, name = work.order, work.folder, work.task.name
    model = order.model if work.task.take else None
    frames = spread_frames(take, 3) if order.preview else []
    start_empty(keep_addons=keep_addons)
    if order.character is not None:
        character, result.character, warnings = order.character.put(take, model)
        result.warnings += warnings
        for fmt in order.formats:
            yield from export_hands([character], Stage.of_scene(bpy.context.scene), folder, name, fmt)
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
            yield from export_take(built, take, folder, name, fmt)
    if frames:
        path = folder / f"{name}{PREVIEW_SUFFIX}"
        render_preview(
            built, take, frames[len(frames) // 2], path, max_megapixels=order.options.max_megapixels
        )
        yield path


def _detect(work: Work, result: Result, runner: Runner) -> None:
    """Write the hands that are found in a part of a clip. Raises HandfitError."""
    _check_input(work.task)
    path = work.folder / f"{work.task.name}.npz"
    done = _ask(work, result, runner, "detect", output=str(path), part=work.task.part)
    result.frames = done.get("frames", 0)
    _check_input(work.task, _WHILE_READ)
    work.tell(path)


def _capture(work: Work, take_path: Path, result: Result, runner: Runner) -> None:
    """Write the take of one input. Raises HandfitError."""
    parts = {"parts": [str(path) for path in work.parts]} if work.parts else {}
    _ask(work, result, runner, "capture", output=str(take_path), **parts)


def _ask(work: Work, result: Result, runner: Runner, kind: str, **fields: Any) -> Event:
    """Have the worker do something with the input; its `done` event. Raises HandfitError."""

    def on_event(event: Event) -> None:
        if event["event"] == "warning":
            result.warnings.append(str(event["message"]))
            work.say("warning", message=event["message"])
        else:
            work.say("progress", stage=event["stage"], done=event["done"], total=event["total"])

    source, options = list(work.task.source), work.order.options.to_message()
    request = runner.submit(kind, input=source, options=options, **fields)
    return runner.wait(request, on_event)
