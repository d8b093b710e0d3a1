"""The commands `convert` and `info`: from one program's hands to another's, and what a file is."""

from __future__ import annotations

import argparse
import contextlib
import os
import time
from pathlib import Path
from typing import Any, Final

import numpy as np

from handfit_core.capturing.options import OPTIONS, CaptureOptions, add_options, add_progress
from handfit_core.capturing.pipeline import capture, hand_summaries
from handfit_core.common.errors import InputError, NoHandFoundError, OptionError
from handfit_core.common.files import (
    check_writable,
    output_path,
    path_of,
    printable,
    shown,
    written_whole,
)
from handfit_core.interchange.document import Document
from handfit_core.interchange.opening import is_recording, read_recording
from handfit_core.interchange.readers import READERS, tried_with
from handfit_core.interchange.recording import ReadOptions
from handfit_core.interchange.writers import WRITERS, Writer, writer_for
from handfit_core.take import HandTrack, Take, chosen, is_take
from handfit_core.take.fit_quality import error_is_known


def add_interchange_commands(commands: Any) -> None:
    """Add `convert` and `info`; each sets `handler`, called as handler(args) -> exit code. Handlers raise
    HandfitError for what the user can mend."""
    convert = commands.add_parser(
        "convert", help="write a take, or another program's hands, in another format"
    )
    add_input(convert)
    convert.add_argument(
        "-o", "--output", required=True, type=path_of, metavar="OUT", help="the file to write"
    )
    convert.add_argument(
        "--to",
        metavar="NAME",
        help=f"its format (default: by its ending): {', '.join(WRITERS.offered())}",
    )
    convert.add_argument(
        "--wrist",
        action="store_true",
        help="for formats of whole persons (vrma): turn the hands too, straight in their first frame, with "
        "forearms that keep still",
    )
    convert.set_defaults(handler=_convert)

    info = commands.add_parser("info", help="what a file of hands or keypoints is, and what is assumed of it")
    info.add_argument("input", metavar="FILE", help="a take, or a file or folder of docs/interchange.md")
    add_options(info, ("reader", "order", "person", "hands", "fps", "picture_size", "hand_mean", "model"))
    info.set_defaults(handler=_info)


def add_input(command: argparse.ArgumentParser) -> None:
    """Add the input that `take_of_input` reads, and how it is read."""
    command.add_argument(
        "input",
        nargs="+",
        metavar="INPUT",
        help="a take, a file of docs/interchange.md, or what capture takes",
    )
    add_progress(command)
    add_options(command)


def take_of_input(args: argparse.Namespace) -> Take:
    """The take that the arguments of `add_input` name, or that is captured of what they name. Raises
    HandfitError."""
    take = opened_take(Path(args.input[0])) if len(args.input) == 1 else None
    if take is not None:
        return _chosen(take, args)
    source = args.input[0] if len(args.input) == 1 else args.input
    report = None if args.progress == "none" else args.reporter.progress
    return capture(source, CaptureOptions.of_arguments(args), report)


_OF_TAKES: Final = ("hands", "frames", "max_hands")
"""Options of a capture that choose from a take, too"""


def _chosen(take: Take, args: argparse.Namespace) -> Take:
    """Return what of a take the options of a capture choose. Raises OptionError for options that cannot
    choose from a take."""
    options = CaptureOptions.of_arguments(args)
    others = [OPTIONS[name].flag for name in options.to_message() if name not in _OF_TAKES]
    if others:
        raise OptionError(
            f"{shown(args.input[0])}: this is a take, which is captured already: leave {', '.join(others)} "
            "out, or give what it was captured from"
        )
    try:
        return chosen(take, options.hands, options.frames, options.max_hands)
    except (NoHandFoundError, OptionError) as error:
        raise type(error)(f"{shown(args.input[0])}: {error}") from None


def opened_take(path: Path) -> Take | None:
    """Return the take that a file holds; None for a file that is no take. Raises TakeError for a damaged
    one."""
    return Take.load(path) if path.suffix.lower() == ".npz" and is_take(path) else None


def _convert(args: argparse.Namespace) -> int:
    started = time.perf_counter()
    writer = writer_for(args.output, args.to)
    write = writer.write_wrist if args.wrist else writer.write
    if write is None:
        raise OptionError(f"--wrist is no question where {writer.title} is written: leave it away")
    check_writable(args.output, [*args.input, *(each for each in (args.keypoints, args.model) if each)])
    take = take_of_input(args)
    output_path(args.output, take.source.files)
    with written_whole(args.output, lambda beside: _check_readable(writer, take, beside)) as beside:
        write(take, beside)
    args.reporter.done(
        {
            "output": str(args.output),
            "frames": len(take.frame_numbers),
            "seconds": round(time.perf_counter() - started, 3),
            "hands": hand_summaries(take),
        }
    )
    return 0


def _check_readable(writer: Writer, take: Take, path: Path) -> None:
    """Read hands that were just written again, in a format that can be read here, too. Raises InputError
    where that fails."""
    name = next((name for name, each in WRITERS.all().items() if each is writer), None)
    taken = path.suffix.lower() in {ending[ending.rindex(".") :] for ending in writer.endings}
    if name in READERS.built_in() and take.hands and taken:
        with contextlib.suppress(OptionError):  # it wants to know more
            read_recording(path, ReadOptions(reader=name))


def _info(args: argparse.Namespace) -> int:
    path = path_of(args.input)
    if not os.path.exists(path):  # noqa: PTH110  (raises for no name, however long)
        raise InputError(f"{shown(path)}: there is no such file or folder")
    take = opened_take(path)
    if take is not None:
        lines = [
            ("format", f"take of {take.source.kind} {take.source.name}"),
            ("frames", _frames(take.frame_numbers, take.fps)),
            ("picture", f"{take.width}x{take.height} pixels"),
            ("hands", ", ".join(_hand(hand) for hand in take.hands) or "none"),
            *([("program", take.program)] if take.program else _networks(take)),
        ]
    elif is_recording(args.input) or not (path.is_dir() or Document(path).media):
        recording = read_recording(args.input, CaptureOptions.of_arguments(args).read_options())
        size = "not known" if recording.size is None else f"{recording.size[0]}x{recording.size[1]} pixels"
        lines = [
            ("format", recording.format),
            ("frames", _frames(recording.frame_numbers, recording.fps)),
            ("picture", size if recording.size != (1, 1) else "not known: points are parts of its size"),
            ("hands", recording.summary),
            *(("assumed", phrase) for phrase in recording.assumed),
            *([("tried", tried)] if (tried := tried_with(recording)) else []),
        ]
    else:
        raise OptionError(
            f"{shown(path)}: pictures and videos hold no hands that info could describe; capture them. It "
            "describes takes and the formats of docs/interchange.md"
        )
    for name, value in lines:
        print(f"{name:<8} {printable(value)}")
    return 0


def _hand(hand: HandTrack) -> str:
    arm = hand.no_arm if hand.arm is None else f"arm in {int(hand.arm.present.sum())}"
    return f"{hand.side} hand in {int(hand.present.sum())} frames{f' ({arm})' if arm else ''}"


def _networks(take: Take) -> list[tuple[str, str]]:
    """Return which of MediaPipe's landmark networks have predicted the hands, as lines for `info`; none where
    none has."""
    seen = [hand for hand in take.hands if hand.detected.any() and error_is_known(hand)]
    if not seen:
        return []
    second = [(hand.rows.keypoints_2020, hand.keypoints_2d) for hand in seen]
    points = [(both, alone) for both, alone in second if both is not None]
    if not points:
        return [("networks", "the landmark network alone")]
    draft = all(np.array_equal(both[..., :2], alone, equal_nan=True) for both, alone in points)
    return [("networks", "that of December 2020" + ("" if draft else " and the present one"))]


def _frames(numbers: Any, fps: float) -> str:
    return f"{len(numbers)}, {int(numbers[0])} to {int(numbers[-1])}, {fps:g} per second"
