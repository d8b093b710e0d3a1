"""What every input of a batch gets, checked before any work."""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path

from handfit_core.__main__ import parse_intrinsics
from handfit_core.errors import OptionError
from handfit_core.media.frame_range import FrameRange
from handfit_core.media.size_limit import check_limit
from handfit_core.solvers import DEFAULT_SOLVER, solver_of

from ..scene.export import FORMATS, available, find_format
from ..worker.client import CaptureOptions


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
    debug: bool

    @classmethod
    def of_arguments(cls, args: argparse.Namespace) -> Order:
        """From parsed arguments (batch/arguments.py). Raises OptionError for values that cannot be meant."""
        formats = _checked_formats(args.format)
        if args.frames:
            FrameRange.parse(args.frames)
        options = _capture_options(args)
        solver_of(options.solver or DEFAULT_SOLVER, hand_length=options.hand_length)
        return cls(
            output=args.output,
            formats=formats,
            options=options,
            timeout=args.timeout,
            model=args.model,
            flat=args.flat,
            preview=args.preview,
            picture=not args.no_picture,
            pose_correctives=not args.no_correctives,
            debug=args.debug,
        )

    def folder(self, name: str) -> Path:
        """Where the results of that name go."""
        return self.output if self.flat else self.output / name


def _checked_formats(text: str) -> tuple[str, ...]:
    formats = tuple(dict.fromkeys(f.strip().lower().lstrip(".") for f in text.split(",") if f.strip()))
    for name in formats:
        if not available(find_format(name)):
            can = ", ".join(k for k, f in FORMATS.items() if available(f))
            raise OptionError(f"this Blender cannot write {name}; choose from {can}")
    return formats


def _capture_options(args: argparse.Namespace) -> CaptureOptions:
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
        max_megapixels=check_limit(args.max_megapixels),
    )
