"""What every input of a batch gets, checked before any work."""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path

from handfit_core.detect.detector import DETECTORS
from handfit_core.errors import OptionError
from handfit_core.options import CaptureOptions
from handfit_core.solvers import SOLVERS, get_solver
from handfit_core.worker.interpreter import find_python, runs_here

from ..exporters import EXPORTERS, find_exporter
from .character import Character


@dataclass(frozen=True)
class Order:
    """What to make of every input."""

    output: Path
    formats: tuple[str, ...]
    options: CaptureOptions
    timeout: float | None
    """seconds that the capture of one input may take"""
    model: str | None
    """for takes, instead of the model that they name"""
    flat: bool
    preview: bool
    picture: bool
    pose_correctives: bool
    character: Character | None
    """What gets the motion; None: the results are the captured hands themselves"""
    debug: bool

    @classmethod
    def of_arguments(cls, args: argparse.Namespace, python: str | None) -> Order:
        """From parsed arguments (batch/arguments.py); `python` captures, None: as `find_python` chooses.
        Raises OptionError for values that cannot be meant."""
        formats = _checked_formats(args.format)
        character = Character.of_arguments(args)
        options = CaptureOptions.of_arguments(args)
        if args.python is None:  # a Python that is named may have solvers and detectors of its own
            SOLVERS.get(options.solver)
            DETECTORS.get(options.detector)
        if runs_here(find_python(python)):  # another may have what a solver needs
            get_solver(options.solver)
        return cls(
            output=args.output,
            formats=formats,
            options=options,
            timeout=args.timeout,
            model=options.model,
            flat=args.flat,
            preview=args.preview,
            picture=not args.no_picture,
            pose_correctives=not args.no_correctives,
            character=character,
            debug=args.debug,
        )

    def folder(self, name: str) -> Path:
        """Where the results of that name go."""
        return self.output if self.flat else self.output / name


def _checked_formats(text: str) -> tuple[str, ...]:
    formats = tuple(dict.fromkeys(f.strip().lower().lstrip(".") for f in text.split(",") if f.strip()))
    can = [name for name, e in EXPORTERS.items() if e.writes != "captured" and not e.why_not()]
    for name in formats:
        if find_exporter(name).name not in can:
            raise OptionError(f"this Blender cannot write {name}; choose from {', '.join(can)}")
    return formats
