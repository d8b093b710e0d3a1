"""What a batch makes of takes: files of other programs, .blend files and previews.

`export` is what a process does that makes them: one Blender turns many takes into files, one after another.
"""

from __future__ import annotations

import argparse
import faulthandler
import json
import os
import sys
import time
import traceback
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TextIO

import bpy

from handfit_core.common.errors import HandfitError, OptionError
from handfit_core.take import Take
from handfit_core.tasks.inputs import PREVIEW_SUFFIX
from handfit_core.tasks.progress import say
from handfit_core.tasks.record import remove_abandoned
from handfit_core.tasks.task import TAKE_SUFFIX, Task, fingerprint

from ..exporters import EXPORTERS, find_exporter
from ..exporters.export_hands import Stage, export_hands, export_take
from ..scene.build import build_take
from ..scene.preview import render_preview, spread_frames
from .character import Character
from .exported import Exported

PREVIEW = "preview"
"""The format, beside those of EXPORTERS, that --preview adds"""
_MAKING = (
    "hands",
    "wrist",
    "reference",
    "into",
    "time_offset",
    "no_contacts",
    "arms",
    "outside",
    "no_picture",
    "no_correctives",
)
"""Arguments that decide what files hold, beside those of the capture"""
_GIVEN = (
    *(*_MAKING, "format", "preview", "apply_to", "bones", "model", "max_megapixels"),
    *("again", "overwrite", "timeout", "progress"),
)


@dataclass(frozen=True)
class Exports:
    """What is made of every take."""

    formats: tuple[str, ...]
    given: Mapping[str, Any]
    """The arguments of the command line that it was made of, as JSON can hold them"""
    character: Character | None
    """What gets the motion; None: the captured hands themselves are written"""

    @classmethod
    def of_arguments(cls, args: argparse.Namespace) -> Exports:
        """From parsed arguments, out of whose `hands` those of a character are taken. Raises OptionError."""
        given = {name: getattr(args, name) for name in _GIVEN}
        character = Character.of_arguments(args)
        asked = (args.format or "blend,glb").split(",")
        formats = [text for each in asked if (text := each.strip().lower().lstrip("."))]
        can = [name for name, e in EXPORTERS.items() if e.writes != "captured" and not e.why_not()]
        for name in formats:
            if find_exporter(name).name not in can:
                raise OptionError(f"this Blender cannot write {name}; choose from {', '.join(can)}")
        formats += [PREVIEW] if args.preview else []
        return cls(tuple(dict.fromkeys(formats)), given, character)

    @property
    def key(self) -> str:
        """Changes with what decides the files of a take, beside the options of the capture."""
        options: list[Any] = [self.given[name] for name in _MAKING]
        files = [Path(self.given["bones"])] if self.given["bones"] else []
        if self.character is not None:
            options.append(self.character.armature)
            files.append(self.character.path)
        return json.dumps([options, fingerprint(files)])


def export(job: Path, *, keep_addons: bool) -> None:
    """Turn the takes of some tasks into files, as a JSON file says: the `given` of Exports, the folder of
    results (`output`), and the `tasks`. The file `log` beside it gets an object a line: the name of each task
    when it is begun, and the same with an `error`, empty where there is none, when it is over."""
    sys.stdout.flush()
    said = os.fdopen(os.dup(1), "w", encoding=sys.stdout.encoding, errors="backslashreplace")
    os.dup2(2, 1)  # what Blender and its exporters print
    content = json.loads(job.read_text())
    exports = Exports.of_arguments(argparse.Namespace(**content["given"]))
    key, output, parent = exports.key, Path(content["output"]), os.getppid()
    with job.with_suffix(".log").open("w") as log:
        for task in (Task(**fields) for fields in content["tasks"]):
            if os.getppid() != parent:  # it was killed, and somebody may go on with its work
                break
            print(json.dumps({"name": task.name}), file=log, flush=True)
            error = _export(exports, task, Exported(task, output, key), keep_addons=keep_addons)
            print(json.dumps({"name": task.name, "error": error}), file=log, flush=True)
            if not error:
                tell(task, error, exports.given["progress"], said)


def tell(task: Task, error: str, style: str, stream: TextIO | None = None) -> None:
    """Say that files of a take were made, or why not; `style` is that of --progress."""
    if style == "json":
        status = "failed" if error else "ok"
        event = {"event": "exported", "task": task.key, "name": task.name, "status": status, "error": error}
        say(json.dumps(event), stream or sys.stdout)
    elif style == "text":
        said = f"failed: {task.shown}: {error}" if error else f"exported: {task.shown}"
        say(said, stream or sys.stdout)


def start_empty(*, keep_addons: bool) -> None:
    """Replace the open file by an empty one. `keep_addons` leaves the add-ons and preferences as they are;
    otherwise they become Blender's factory settings."""
    if keep_addons:
        bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    else:
        bpy.ops.wm.read_factory_settings(use_empty=True)


def _export(exports: Exports, task: Task, exported: Exported, *, keep_addons: bool) -> str:
    """Make what is missing of a take. Returns why that failed; empty where it did not."""
    given, started = exports.given, time.perf_counter()
    try:
        left = exported.left(exports.formats, again=given["again"], overwrite=given["overwrite"])
        exported.begin(left)
        remove_abandoned(exported.folder)
        if given["timeout"]:  # ends this process, whatever hangs
            faulthandler.dump_traceback_later(given["timeout"], exit=True)
        try:
            _make(exports, task, exported, left, keep_addons=keep_addons)
        finally:
            faulthandler.cancel_dump_traceback_later()
            exported.result.seconds += round(time.perf_counter() - started, 3)
            if exported.formats:
                exported.save()
    except HandfitError as error:
        return str(error)
    except Exception as error:
        traceback.print_exc()
        return f"unexpected {type(error).__name__}: {' '.join(str(error).split())} (see --debug)"
    return ""


def _make(
    exports: Exports, task: Task, exported: Exported, formats: Sequence[str], *, keep_addons: bool
) -> None:
    """Write a take in some formats, each of which is noted in `exported`. Raises HandfitError."""
    given, folder, name = exports.given, exported.folder, task.name
    take = Take.load(folder / f"{name}{TAKE_SUFFIX}")
    model = given["model"] if task.take else None
    made, warnings = exported.formats, exported.result.warnings
    start_empty(keep_addons=keep_addons)
    left = [fmt for fmt in formats if fmt != PREVIEW]
    if exports.character is not None and left:
        character, exported.result.character, told = exports.character.put(take, model)
        warnings += told
        for fmt in left:
            stage = Stage.of_scene(bpy.context.scene)
            made[fmt] = _sizes(export_hands([character], stage, folder, name, fmt))
        left = []
        start_empty(keep_addons=keep_addons)
    frames = spread_frames(take, 3) if PREVIEW in formats else []
    preview = folder / f"{name}{PREVIEW_SUFFIX}"
    if left or frames:
        megapixels = given["max_megapixels"]
        built = build_take(
            take,
            model=model,
            pose_correctives=not given["no_correctives"],
            picture=not given["no_picture"],
            max_megapixels=megapixels,
        )
        warnings += built.warnings
        for fmt in left:
            made[fmt] = _sizes(export_take(built, take, folder, name, fmt))
        if frames:
            render_preview(built, take, frames[len(frames) // 2], preview, max_megapixels=megapixels)
    if PREVIEW in formats:
        made[PREVIEW] = _sizes([preview] if frames else [])


def _sizes(files: Iterable[Path]) -> dict[str, int]:
    return {path.name: path.stat().st_size for path in files}
