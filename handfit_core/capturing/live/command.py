"""The command `live`: hands are followed as they move, sent to other programs, and recorded."""

from __future__ import annotations

import argparse
import contextlib
import math
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from handfit_core.capturing.options import CaptureOptions, LiveOptions, add_options, add_progress
from handfit_core.capturing.pipeline import capture_to_file
from handfit_core.common.errors import HandfitError, InputError, OptionError, OutputError
from handfit_core.common.files import check_writable, path_of, shown, written_whole

if TYPE_CHECKING:
    from handfit_core.capturing.live.streaming import Live, LivePose

_STATUS_SECONDS: Final = 0.5
"""seconds between two status lines of a terminal"""


def add_live_command(commands: Any) -> argparse.ArgumentParser:
    """Add `live`, which sets `handler`, called as handler(args) -> exit code. It raises HandfitError for what
    the user can mend. Returns its parser, whose `sender` may be set to what opens the context in which poses
    are sent to where `vmc` says."""
    live = commands.add_parser("live", help="follow hands in a camera's pictures as they move")
    live.add_argument(
        "source",
        metavar="SOURCE",
        help="a camera's number or name, an address (http, https, rtsp), or file:CLIP, which plays a file",
    )
    live.add_argument(
        "-o",
        "--output",
        type=path_of,
        metavar="TAKE.npz",
        help="record beside it (TAKE.mkv), and capture that to this take at the end",
    )
    live.add_argument("--seconds", type=float, metavar="S", help="how long (default: until Ctrl+C)")
    add_options(live, ("online", "size", "fps", "min_cutoff", "beta"), LiveOptions)
    live.add_argument("--preview", type=path_of, metavar="PICTURE.jpg", help="keep the newest picture, drawn")
    live.add_argument("--mirror", action="store_true", help="mirror the preview, and nothing else")
    add_progress(live)
    add_options(
        live, ("hands", "hand_length", "model", "intrinsics", "lens", "threshold", "quality", "smoothing")
    )
    live.set_defaults(handler=_live, vmc=None, sender=None)
    return live


def _live(args: argparse.Namespace) -> int:
    from handfit_core.capturing.live.streaming import Live  # slow to load, with all that fits hands

    capture = CaptureOptions.of_arguments(args)
    options = LiveOptions.of_arguments(args, capture=capture)
    if args.seconds is not None and not 0.0 < args.seconds < math.inf:
        raise OptionError(f"--seconds must be above 0, not {args.seconds:g}")
    output, recording = args.output, None
    if output is not None:
        recording = Path(output).with_suffix(".mkv")
        check_writable(output, [args.source.removeprefix("file:")])
    written = None
    with contextlib.ExitStack() as opened:
        send = opened.enter_context(args.sender(args, capture)) if args.vmc is not None else None
        run = Live(args.source, options)
        if recording is not None:
            run.reader.record(recording)
            written = run.reader.recording
        with run, contextlib.suppress(KeyboardInterrupt):
            _follow(run, args, send)
    if not run.reader.received:
        raise InputError(f"{shown(args.source)}: no picture came")
    if output is None or written is None:
        return 0
    if not written.frames:
        raise OutputError(run.reader.problem or f"{shown(args.source)}: sends no pictures that can be read")
    path, report = str(written.path), None if args.progress == "none" else args.reporter.progress
    try:
        args.reporter.done(capture_to_file(path, output, capture, report))
    except OutputError as error:
        raise OutputError(f"{error}; `capture {shown(path)}` makes the take later") from error
    return 0


def _follow(run: Live, args: argparse.Namespace, send: Callable[[LivePose], None] | None) -> None:
    """Follow until the source or the time ends, and tell how it goes."""
    began, told, problem = time.perf_counter(), 0.0, ""
    while not run.reader.ended:
        now = time.perf_counter()
        if args.seconds is not None and now - began >= args.seconds:
            return
        if run.reader.problem != problem:
            problem = run.reader.problem
            if problem:
                args.reporter.warning(problem)
        pose = run.next()
        if pose is None:
            continue
        if send is not None:
            send(pose)
        if now - told >= _STATUS_SECONDS and args.progress != "none":
            told = now
            _tell(run, pose, args)


def _tell(run: Live, pose: LivePose, args: argparse.Namespace) -> None:
    """Say how fast it goes, and keep the preview."""
    if args.preview is not None:
        _keep_preview(pose, args)
    figures = {
        "fps": round(run.fps, 1),
        "latency_ms": round(1000.0 * run.latency, 1),
        "dropped": run.reader.dropped,
        "hands": {hand.side: hand.state for hand in pose.hands},
    }
    args.reporter.live(figures)


def _keep_preview(pose: LivePose, args: argparse.Namespace) -> None:
    import cv2

    from handfit_core.capturing.live.streaming import picture

    drawn = picture(pose, pose.rgb.shape[1], mirror=args.mirror)
    with contextlib.suppress(HandfitError), written_whole(args.preview) as beside:
        beside.write_bytes(cv2.imencode(".jpg", drawn[..., ::-1])[1].tobytes())
