"""The command line: `python -m handfit_core capture INPUT -o OUT.npz`, `arms TAKE`, `batch` for many inputs,
`lens` for cameras, `convert` and `info` for other programs' files, `model convert`, `model info`,
`evaluate DATASET`; and `worker`, the process that Blender talks to."""

from __future__ import annotations

import os

# Before SciPy loads: its OpenBLAS would solve a clip with as many threads as there are cores, which
# wait for each other and for the detector's: seconds instead of milliseconds on a busy machine.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import argparse
import contextlib
import importlib.util
import json
import logging
import math
import re
import sys
import time
import traceback
from collections.abc import Iterator, Sequence
from typing import Any, TextIO

from handfit_core.capturing.convert import add_interchange_commands
from handfit_core.capturing.live.command import add_live_command
from handfit_core.capturing.options import CaptureOptions, add_options, add_progress
from handfit_core.capturing.pipeline import Progress, ProgressCallback, add_arms_to_file, capture_to_file
from handfit_core.common.errors import HandfitError, OptionError
from handfit_core.common.files import path_of, printable
from handfit_core.common.version import __version__
from handfit_core.hand_model.commands import add_model_commands
from handfit_core.media.commands import add_lens_command
from handfit_core.take.fit_quality import IN_PICTURE, NOT_KNOWN, expected_scale
from handfit_core.tasks.commands import add_batch_command

EXIT_FAILED = 1
EXIT_INTERRUPTED = 130


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command; returns the exit code. User errors are one line on stderr."""
    parser, words = _parser(), sys.argv[1:] if argv is None else argv
    for word in words:
        if re.fullmatch(r"(-\w|--[\w-]+=)--", word):  # of which argparse makes an empty list
            parser.error(f"argument {word[:-2].rstrip('=')}: expected one argument")
    args = parser.parse_args(words)
    output = _JsonOutput() if getattr(args, "progress", None) == "json" else _TextOutput()
    args.reporter = output
    log_handler = _LogHandler(output)
    logging.getLogger("handfit").addHandler(log_handler)
    try:
        with contextlib.nullcontext() if args.debug else _native_noise_dropped():
            return args.handler(args)
    except HandfitError as error:
        output.error(type(error).__name__, str(error))
        if args.debug:
            traceback.print_exc()
        return EXIT_FAILED
    except KeyboardInterrupt:
        output.error("Interrupted", "stopped")
        return EXIT_INTERRUPTED
    except Exception as error:  # a defect of ours: still one line, unless --debug
        output.error(type(error).__name__, f"unexpected error: {error} (run with --debug for details)")
        if args.debug:
            traceback.print_exc()
        return EXIT_FAILED
    finally:
        logging.getLogger("handfit").removeHandler(log_handler)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m handfit_core", description="Fit a rigged hand to photos, image sequences and videos."
    )
    parser.add_argument("--version", action="version", version=__version__)
    commands = parser.add_subparsers(required=True, metavar="COMMAND")

    command = commands.add_parser("capture", help="find and fit the hands of one input, write a take")
    command.set_defaults(handler=_capture)
    command.add_argument(
        "input",
        nargs="+",
        metavar="INPUT",
        help="a photo, a folder or several photos of one sequence, a name.%%04d.png or glob pattern, a video",
    )
    _add_output(command, "the take to write")
    add_options(command)
    text = "where to write the cameras of two views, too, in aniposelib's TOML layout"
    command.add_argument("--write-cameras", type=path_of, metavar="RIG.toml", help=text)

    arms = commands.add_parser("arms", help="find the arms of a take's hands in its pictures")
    arms.set_defaults(handler=_arms)
    arms.add_argument("take", type=path_of, metavar="TAKE", help="the take to which arms are added")
    _add_output(arms, "the take to write (default: TAKE itself)", required=False)
    add_options(arms, ["max_megapixels"])

    worker = commands.add_parser(
        "worker", help="answer Blender's requests on stdin (docs/worker-protocol.md)"
    )
    worker.set_defaults(handler=_worker)
    worker.add_argument(
        "--threads", type=int, metavar="N", help="how many threads the numeric libraries use at most"
    )

    live = add_live_command(commands)
    add_interchange_commands(commands)
    add_batch_command(commands)
    add_lens_command(commands, lambda args, *at: args.reporter.progress(Progress("lens", *at)))
    add_model_commands(commands)
    if importlib.util.find_spec("handfit_core.capturing.live.send"):  # as with the next one
        from handfit_core.capturing.live.send import add_send_command, add_vmc_option

        add_send_command(commands)
        add_vmc_option(live)
    if importlib.util.find_spec("handfit_core.evaluate"):  # which only a checkout has
        from handfit_core.evaluate.commands import add_evaluate_command

        add_evaluate_command(commands)
    for sub in _all_parsers(commands):
        sub.add_argument(
            "--debug", action="store_true", help="show tracebacks and the libraries' own messages"
        )
    return parser


def _add_output(command: argparse.ArgumentParser, what: str, *, required: bool = True) -> None:
    """Where the result goes, and how it is told of."""
    command.add_argument("-o", "--output", required=required, type=path_of, metavar="OUT.npz", help=what)
    add_progress(command)


def _all_parsers(commands: Any) -> Iterator[argparse.ArgumentParser]:
    """The parsers that run something: leaves of the tree of commands."""
    for sub in commands.choices.values():
        nested = [a for a in sub._actions if isinstance(a, argparse._SubParsersAction)]
        if nested:
            yield from _all_parsers(nested[0])
        else:
            yield sub


def _worker(args: argparse.Namespace) -> int:
    from handfit_core.worker.server import serve  # which no other command needs

    serve(args.threads)
    return 0


def _capture(args: argparse.Namespace) -> int:
    source, options = args.input[0] if len(args.input) == 1 else args.input, CaptureOptions.of_arguments(args)
    if args.write_cameras is not None and options.view is None:
        raise OptionError("--write-cameras writes the cameras of two views: give the second one with --view")
    report = capture_to_file(source, args.output, options, _progress(args), cameras_to=args.write_cameras)
    args.reporter.done(report)
    return 0


def _arms(args: argparse.Namespace) -> int:
    limit = CaptureOptions.of_arguments(args).max_megapixels
    report = add_arms_to_file(args.take, args.output, _progress(args), max_megapixels=limit)
    args.reporter.done(report)
    return 0


def _progress(args: argparse.Namespace) -> ProgressCallback | None:
    return None if args.progress == "none" else args.reporter.progress


class _JsonOutput:
    """One JSON object a line on stdout; docs/batch.md lists the events."""

    def _write(self, **event: Any) -> None:
        print(json.dumps(event), flush=True)

    def progress(self, progress: Progress) -> None:
        self._write(event="progress", stage=progress.stage, done=progress.done, total=progress.total)

    def done(self, summary: dict[str, Any]) -> None:
        self._write(event="done", **summary)

    def live(self, figures: dict[str, Any]) -> None:
        self._write(event="live", **figures)

    def evaluated(self, summary: dict[str, Any], table: str) -> None:  # noqa: ARG002 (machines read the numbers)
        self._write(event="done", **_without_nan(summary))

    def warning(self, message: str) -> None:
        self._write(event="warning", message=message)

    def error(self, kind: str, message: str) -> None:
        self._write(event="error", type=kind, message=message)


def _without_nan(value: Any) -> Any:
    """What does not apply is null: JSON has no NaN."""
    if isinstance(value, dict):
        return {key: _without_nan(inner) for key, inner in value.items()}
    return None if isinstance(value, float) and math.isnan(value) else value


class _TextOutput:
    """A progress bar and sentences for people, on whatever sys.stderr is at the time."""

    _WIDTH = 30
    _EVERY = 0.1
    _EVERY_IN_LOGS = 30.0
    _VERBS = {  # noqa: RUF012
        "detect": "finding hands",
        "fit": "fitting      ",
        "arms": "finding arms ",
        "join": "joining views",
        "score": "scoring      ",
        "lens": "reading film ",
    }

    def __init__(self) -> None:
        self._bar = sys.stderr.isatty()
        self._last = 0.0 if self._bar else time.monotonic()
        self._dirty = False

    def progress(self, progress: Progress) -> None:
        now = time.monotonic()
        finished = progress.total > 0 and progress.done >= progress.total
        if not self._bar:
            if now - self._last >= self._EVERY_IN_LOGS:
                self._last = now
                self._line(
                    f"{self._VERBS[progress.stage].strip()}: {progress.done} of {progress.total or '?'}"
                )
            return
        if not progress.total:
            text = f"{self._VERBS[progress.stage]}: step {progress.done}"
            print(f"\r{text:<78}", end="", file=sys.stderr, flush=True)
            self._dirty = True
            return
        if now - self._last < self._EVERY and not finished:
            return
        self._last = now
        filled = self._WIDTH * progress.done // max(progress.total, 1)
        bar = "#" * filled + "." * (self._WIDTH - filled)
        verb = self._VERBS[progress.stage]
        print(f"\r{verb} [{bar}] {progress.done}/{progress.total}", end="", file=sys.stderr, flush=True)
        self._dirty = True

    def live(self, figures: dict[str, Any]) -> None:
        """How a live run goes, in one line that is written over."""
        hands = ", ".join(f"{side} {state}" for side, state in figures["hands"].items()) or "no hand"
        text = (
            f"{figures['fps']:.1f} frames a second, {figures['latency_ms']:.0f} ms, "
            f"{figures['dropped']} dropped; {hands}"
        )
        print(f"\r{text:<78}", end="", file=sys.stderr, flush=True)
        self._dirty = True

    def _line(self, text: str) -> None:
        if self._dirty:
            print(file=sys.stderr)
            self._dirty = False
        print(printable(text), file=sys.stderr, flush=True)

    def done(self, summary: dict[str, Any]) -> None:
        hands = (
            "; ".join(
                f"{h['side']} hand in {h['frames']} of {summary['frames']} frames, "
                + (f"{h['filled']} more filled, " if h["filled"] else "")
                + (f"{h['doubtful']} doubtful, " if h["doubtful"] else "")
                + _mean_error(h)
                + _arm(h)
                for h in summary.get("hands", ())
            )
            or f"{summary['frames']} frames looked at"
        )
        self._line(f"{summary['output']}: {hands} ({summary['seconds']:.1f} s)")
        if "views" in summary:
            self._line(f"two views: {summary['views']['text']}")

    def evaluated(self, summary: dict[str, Any], table: str) -> None:
        print(table, flush=True)
        for kind, count in summary["problems"].items():
            self._line(f"warning: {kind}: {count}")
        self._line(f"report: {summary['output']}")

    def warning(self, message: str) -> None:
        self._line(f"warning: {message}")

    def error(self, kind: str, message: str) -> None:  # noqa: ARG002 (people read the message)
        self._line(f"error: {message}")


def _mean_error(hand: dict[str, Any]) -> str:
    """The mean error of a hand, as `hand_summaries` gives it, in words."""
    share, pixels = hand["mean_error_of_hand"], hand["mean_reprojection_error_px"]
    if share is None or pixels is None:
        return "no mean error"
    likely, scale = hand["mean_expected_error"], expected_scale(hand["frames"])
    if not hand["error_known"]:  # a fit that lies on wrong keypoints is no better for it
        told, word = f"{NOT_KNOWN}, ", ""
    elif likely is None:
        told, word = "", f"{IN_PICTURE.quality(share)}, "
    else:  # one word: the picture tells less
        told, word = f"likely error {scale.said(likely)} ({scale.quality(likely)}), ", ""
    return f"{told}mean error {IN_PICTURE.said(share)} ({word}{pixels:.1f} px)"


def _arm(hand: dict[str, Any]) -> str:
    """What was found of a hand's arm, where it was looked for, in words."""
    if "arm" not in hand:
        return ""
    return f", {hand['no_arm'] or 'arm in ' + str(hand['arm']) + ' frames'}"


class _LogHandler(logging.Handler):
    """Sends the core's warnings to the output."""

    def __init__(self, output: _JsonOutput | _TextOutput) -> None:
        super().__init__(logging.WARNING)
        self._output = output

    def emit(self, record: logging.LogRecord) -> None:
        self._output.warning(record.getMessage())


def _text_stream(descriptor: int) -> TextIO:
    """stderr's twin on another descriptor; what its encoding lacks is escaped, as stderr does."""
    encoding = getattr(sys.stderr, "encoding", None)
    return os.fdopen(descriptor, "w", buffering=1, encoding=encoding, errors="backslashreplace")


@contextlib.contextmanager
def _native_noise_dropped() -> Iterator[None]:
    """MediaPipe, TensorFlow Lite and FFmpeg write to file descriptor 2 whatever one asks of them.

    Python's own stderr keeps working. A crash is still seen in the exit code.
    """
    try:
        original = sys.stderr.fileno()
    except (OSError, ValueError, AttributeError):  # captured or closed: nothing to divert
        yield
        return
    sys.stderr.flush()
    kept = os.dup(original)
    with open(os.devnull, "w") as nowhere, _text_stream(os.dup(kept)) as python_stderr:
        os.dup2(nowhere.fileno(), original)
        previous, sys.stderr = sys.stderr, python_stderr
        try:
            yield
        finally:
            python_stderr.flush()
            sys.stderr = previous
            os.dup2(kept, original)
            os.close(kept)


if __name__ == "__main__":
    sys.exit(main())
