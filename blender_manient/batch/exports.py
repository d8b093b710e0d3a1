"""What a batch makes of takes: files of other programs, .blend files and previews.

`export` is what a Blender does that the core's second step (`tasks/exporting.py`) has started: it turns takes
into files, one after another.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import traceback
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import bpy

from handfit_core.common.errors import HandfitError, OptionError
from handfit_core.take import Take
from handfit_core.tasks.arguments import EXPORTED
from handfit_core.tasks.inputs import PREVIEW_SUFFIX
from handfit_core.tasks.task import TAKE_SUFFIX, fingerprint

from ..exporters import EXPORTERS, find_exporter
from ..exporters.export_hands import Stage, export_hands, export_take
from ..scene.build import build_take
from ..scene.preview import render_preview, spread_frames
from .character import Character

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
"""The names of arguments that decide what files hold, beside those of the capture"""
_GIVEN = (*_MAKING, "format", "preview", "apply_to", "bones", "model", "max_megapixels")


@dataclass(frozen=True)
class Exports:
    """The files that are made of every take of a batch."""

    formats: tuple[str, ...]
    given: Mapping[str, Any]
    """The arguments of the command line that it was made of, as JSON can hold them"""
    character: Character | None
    """The character that gets the motion; None: the captured hands themselves are written"""

    @classmethod
    def of_arguments(cls, args: argparse.Namespace) -> Exports:
        """Make the exports of parsed arguments, out of whose `hands` those of a character are taken. Raises
        OptionError."""
        given = {name: getattr(args, name) for name in _GIVEN}
        character = Character.of_arguments(args)
        asked = ("blend,glb" if args.format is None else args.format).split(",")
        formats = [text for each in asked if (text := each.strip().lower().lstrip("."))]
        can = [name for name, e in EXPORTERS.items() if e.writes != "captured" and not e.why_not()]
        for name in formats:
            if find_exporter(name).name not in can:
                raise OptionError(f"this Blender cannot write {name}; choose from {', '.join(can)}")
        formats += [PREVIEW] if args.preview else []
        return cls(tuple(dict.fromkeys(formats)), given, character)

    @property
    def key(self) -> str:
        """A text that changes with what decides the files of a take, beside the options of the capture."""
        options: list[Any] = [self.given[name] for name in _MAKING]
        files = [Path(self.given["bones"])] if self.given["bones"] else []
        if self.character is not None:
            options.append(self.character.armature)
            files.append(self.character.path)
        return json.dumps([options, fingerprint(files)])


def export(*, keep_addons: bool) -> None:
    """Turn takes into files, as lines of JSON on stdin say: first `given` of Exports, then of each take its
    `folder`, its `name`, the `formats`, and the `model` that is taken instead of its own. Each is answered by
    a line on stdout: what was `made`, as sizes of files by format, `warnings`, `character`, and an `error`,
    empty where there is none."""
    sys.stdout.flush()
    answers = os.fdopen(os.dup(1), "w", encoding="ascii")
    os.dup2(2, 1)  # what Blender and its exporters print
    exports = Exports.of_arguments(argparse.Namespace(**json.loads(sys.stdin.readline())))
    for line in sys.stdin:
        answer: dict[str, Any] = {"made": {}, "warnings": [], "character": None, "error": ""}
        try:
            _make(exports, answer, **json.loads(line), keep_addons=keep_addons)
        except HandfitError as error:
            answer["error"] = str(error)
        except Exception as error:
            traceback.print_exc()
            said = " ".join(str(error).split())
            answer["error"] = f"unexpected {type(error).__name__}: {said} (see --debug)"
        print(f"{EXPORTED}{json.dumps(answer)}", file=answers, flush=True)


def start_empty(*, keep_addons: bool) -> None:
    """Replace the open file by an empty one. `keep_addons` leaves the add-ons and preferences as they are;
    otherwise they become Blender's factory settings."""
    if keep_addons:
        bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    else:
        bpy.ops.wm.read_factory_settings(use_empty=True)


def _make(
    exports: Exports,
    answer: dict[str, Any],
    folder: str,
    name: str,
    model: str | None,
    formats: Sequence[str],
    *,
    keep_addons: bool,
) -> None:
    """Write a take in some formats, and note each of them in the answer. Raises HandfitError."""
    given, at = exports.given, Path(folder)
    take = Take.load(at / f"{name}{TAKE_SUFFIX}")
    made, warnings = answer["made"], answer["warnings"]
    start_empty(keep_addons=keep_addons)
    left = [fmt for fmt in formats if fmt != PREVIEW]
    if exports.character is not None and left:
        character, answer["character"], told = exports.character.put(take, model)
        warnings += told
        for fmt in left:
            stage = Stage.of_scene(bpy.context.scene)
            made[fmt] = _sizes(export_hands([character], stage, at, name, fmt))
        left = []
        start_empty(keep_addons=keep_addons)
    frames = spread_frames(take, 3) if PREVIEW in formats else []
    preview = at / f"{name}{PREVIEW_SUFFIX}"
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
            made[fmt] = _sizes(export_take(built, take, at, name, fmt))
        if frames:
            render_preview(built, take, frames[len(frames) // 2], preview, max_megapixels=megapixels)
    if PREVIEW in formats:
        made[PREVIEW] = _sizes([preview] if frames else [])


def _sizes(files: Iterable[Path]) -> dict[str, int]:
    return {path.name: path.stat().st_size for path in files}
