"""What every input of a batch gets, checked before any work."""

from __future__ import annotations

import argparse
import copy
import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from handfit_core.detect.detector import DETECTORS
from handfit_core.detect.landmark_model import TASK
from handfit_core.errors import OptionError
from handfit_core.files import is_file, is_folder
from handfit_core.hand_model.files import files_of_model
from handfit_core.options import CaptureOptions
from handfit_core.solvers import SOLVERS, get_solver
from handfit_core.worker.interpreter import find_python, is_current_interpreter

from ..exporters import EXPORTERS, find_exporter
from .character import Character, file_and_armature

_MAKING = (
    *("format", "hands", "preview", "no_sheet", "no_picture", "no_correctives", "apply_to", "bones", "wrist"),
    *("reference", "into", "no_contacts"),
)
"""Arguments that decide what is made, beside those of the capture"""
_FILES = ("model", "landmark_model", "apply_to", "bones", "keypoints")
"""Arguments that name files, or folders of them"""
_HERE = ("processes",)
"""Options of a capture that change nothing in its result: each machine has its own"""


@dataclass(frozen=True)
class Order:
    """What to make of every input."""

    formats: tuple[str, ...]
    options: CaptureOptions
    model: str | None
    """for takes, instead of the model that they name"""
    preview: bool
    sheet: bool
    picture: bool
    pose_correctives: bool
    character: Character | None
    """What gets the motion; None: the results are the captured hands themselves"""
    debug: bool

    @classmethod
    def of_arguments(cls, args: argparse.Namespace, python: str | None) -> Order:
        """From parsed arguments (batch/arguments.py); `python` captures, None: as `find_python` chooses.
        Raises OptionError for values that cannot be meant."""
        args = copy.copy(args)
        formats = _checked_formats(args.format)
        character = Character.of_arguments(args)
        if isinstance(args, _OfPlan):
            options = CaptureOptions.of_message(args.capture)
        else:
            options = CaptureOptions.of_arguments(args)
        if args.python is None:  # a Python that is named may have solvers and detectors of its own
            SOLVERS.get(options.solver)
            DETECTORS.get(options.detector)
        if is_current_interpreter(find_python(python)):  # another may have what a solver needs
            get_solver(options.solver)
        return cls(
            formats=formats,
            options=options,
            model=options.model,
            preview=args.preview,
            sheet=not args.no_sheet,
            picture=not args.no_picture,
            pose_correctives=not args.no_correctives,
            character=character,
            debug=args.debug,
        )

    @classmethod
    def of_plan(cls, options: Mapping[str, Any], **here: Any) -> Order:
        """From the options of a plan, and from `debug`, `python` and `processes` of this machine. Raises
        OptionError."""
        python = here.get("python")
        chosen = {name: here[name] for name in _HERE if here.get(name) is not None}
        try:
            capture = {**options["capture"], **chosen}
            args = _OfPlan(**options["make"], capture=capture, debug=bool(here.get("debug")), python=python)
            return cls.of_arguments(args, python)
        except (AttributeError, KeyError, TypeError, ValueError) as error:
            raise OptionError(
                "the plan's options are none that this version can read; make the plan anew"
            ) from error


class _OfPlan(argparse.Namespace):
    """Arguments that were parsed before, of a capture what `CaptureOptions.to_message` made of them."""


def options_of(args: argparse.Namespace, order: Order) -> dict[str, Any]:
    """What of parsed arguments decides the results, as a plan keeps it; paths in full."""
    capture = order.options.to_message()
    given: dict[str, Any] = {"hands": args.hands} | {name: getattr(args, name) for name in _MAKING}
    for name in _FILES:
        for values in (capture, given):
            if (path := values.get(name)) and (full := _full(str(path))):
                values[name] = full
    return {"capture": {k: v for k, v in capture.items() if k not in _HERE}, "make": given}


def files_named(options: Mapping[str, Any]) -> list[str]:
    """The files that a plan's options name, those of a hand model's both sides, folders with keypoints, and
    what stands for one that they do not name."""
    named = [(name, str(path)) for each in options.values() for name in _FILES if (path := each.get(name))]
    named.append(("landmark_model", os.environ.get(TASK.variable) or ""))
    found: list[Path] = []
    for name, text in named:
        path = _file_of(text).expanduser()
        if name == "model":
            found += filter(is_file, files_of_model(path))
        elif is_file(path) or (name == "keypoints" and is_folder(path)):
            found.append(path)
    return [str(path.absolute()) for path in found]


def _full(text: str) -> str:
    """A path in full where there is such a file or folder, with what follows its name."""
    path = _file_of(text)
    return str(path.expanduser().absolute()) + text[len(str(path)) :] if path.expanduser().exists() else ""


def _file_of(text: str) -> Path:
    """The file of a path that may have an armature's name behind it."""
    try:
        return file_and_armature(text)[0]
    except OptionError:
        return Path(text)


def _checked_formats(text: str) -> tuple[str, ...]:
    formats = tuple(dict.fromkeys(f.strip().lower().lstrip(".") for f in text.split(",") if f.strip()))
    can = [name for name, e in EXPORTERS.items() if e.writes != "captured" and not e.why_not()]
    for name in formats:
        if find_exporter(name).name not in can:
            raise OptionError(f"this Blender cannot write {name}; choose from {', '.join(can)}")
    return formats
