"""The core's doors as hostile cases knock at them, without Blender.

Each opens its input as the program does, goes on as it would, and looks whether what it got is sane.
"""

from __future__ import annotations

import contextlib
import io
import itertools
import json
import math
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import cv2  # noqa: F401  (loaded before the first case: its memory is no case's)
import numpy as np

from handfit_core.__main__ import main
from handfit_core.capturing import pipeline
from handfit_core.capturing.options import CaptureOptions
from handfit_core.capturing.pipeline import hand_summaries
from handfit_core.capturing.sources import open_input
from handfit_core.common import errors
from handfit_core.common.skeleton import SIDES
from handfit_core.hand_model import load_model
from handfit_core.interchange.opening import RELATIVE, read_recording
from handfit_core.media.exif import known_intrinsics
from handfit_core.media.frame_range import FrameRange
from handfit_core.media.opening import open_media
from handfit_core.take import Take
from handfit_core.take.sheet import write_sheet
from handfit_core.tasks.report import line, read_results, write_report
from handfit_core.tasks.task import Task
from handfit_core.worker import answering, events
from tests.core.interchange.known_hands import own_mano
from tests.hostile.engine import MOST_BYTES

FRAMES = 4
"""How many frames of a video are looked at."""


def take(path: str) -> None:
    """Read a take, and what is read of it when it is listed, kept and shown; draw its hands."""
    found = Take.load(path)
    check_take(found)
    write_sheet(found, "result/a.sheet.jpg")


def check_take(found: Take) -> None:
    """Raises AssertionError for a take that nothing behind the door expects."""
    texts = (*found.source.files, found.source.kind, found.solver, found.model, *found.model_digests.values())
    assert all(type(text) is str for text in texts), "a text that is none"
    assert 0 < found.fps <= 1e6, f"fps {found.fps}"
    assert type(found.width) is type(found.height) is int
    assert max(found.width, found.height) < 1 << 20
    assert all(math.isfinite(n) for n in vars(found.intrinsics).values()), "a camera that is not finite"
    assert found.frame_numbers.dtype.kind in "iu", "frame numbers that are none"
    assert 0 <= found.frame_numbers.min() <= found.frame_numbers.max() <= 1_048_574, "no frames of Blender's"
    for track in found.hands:
        assert track.side in SIDES
        for name, value in vars(track).items():
            if isinstance(value, np.ndarray):
                flags = name in ("detected", "filled", "doubtful", "other_side", "overlapped")
                assert value.dtype.kind in ("b" if flags else "fiu"), f"{name} is {value.dtype}"
                seen = value if name == "betas" else value[track.present]
                seen = seen if name == "betas" else seen[np.isfinite(seen)]
                most = 1e30 if name == "reprojection_error" else 1e9  # fits close to the camera fail by much
                assert np.all(np.abs(seen.astype(float)) <= most), f"{name} is beyond all bounds"
    json.dumps(hand_summaries(found), allow_nan=False)
    assert found.source.name is not None
    Take.from_bytes(found.to_bytes())


@cache
def _mano() -> str:
    return str(own_mano(Path(tempfile.mkdtemp())))


def recording(path: str, mano: bool = False, good: bool = False) -> None:
    """Read what another program has found, and make a take of its first frames, with a model of MANO's format
    or with the open hand. A `good` file, which may need the model, is not refused."""
    try:
        _recorded(path, mano or good)
    except errors.HandfitError as error:
        assert not good, f"refused: {error}"
        raise


def _recorded(path: str, mano: bool) -> None:
    options = CaptureOptions(model=_mano() if mano else None)
    found = read_recording(path, options.read_options())
    found.check()
    for phrase in (found.summary, *found.assumed):
        assert "\n" not in phrase, phrase
        assert len(phrase) < 1000, phrase
    options = replace(options, picture_size=(640, 480) if found.size in (None, RELATIVE) else None)
    numbers = open_input(path, options).numbers(0, 2)
    check_take(pipeline.capture(path, replace(options, frames=FrameRange(numbers[0], numbers[-1]))))


def results(path: str) -> None:
    """Read what a folder of results says of a task, and write the reports."""
    task, output = Task("a", "key", "a.mp4"), Path(path)
    write_report(output, read_results(output, [task]))
    content = json.loads((output / "report.json").read_text("utf-8"), parse_constant=_no_number)
    (result,) = content["inputs"]
    assert (result["name"], result["id"]) == ("a", "key")
    assert "<script>canary" not in (output / "overview.html").read_text("utf-8", "replace")
    line(read_results(output, [task])[0])


def _no_number(text: str) -> None:
    raise AssertionError(f"{text} is no JSON")


def model(path: str, side: str) -> None:
    """Read a hand model and pose it."""
    found = load_model(path, side)  # type: ignore[arg-type]
    posed = found.posed(np.zeros(10), np.zeros(3), np.zeros(45), np.zeros(3))
    assert np.all(np.isfinite(posed.vertices)), "vertices that are not finite"
    assert type(found.name) is str
    assert found.digest
    assert np.asarray(found.polygons).ndim == 2


def media(path: str | list[str]) -> None:
    """Probe an input as the panel does, and read its first frames."""
    answer = answering.probe({"input": [path] if isinstance(path, str) else path})
    events.encode(answer)
    assert 0 < answer["fps"] <= 1000
    opened = open_media(path)
    for frame in itertools.islice(opened.frames(), FRAMES):
        if frame.rgb is not None:
            assert frame.rgb.dtype == np.uint8
            assert frame.rgb.shape == (opened.height, opened.width, 3)
    known_intrinsics(opened)


def capture(path: str) -> None:
    """Look for hands as a capture does."""
    pipeline.capture(path, CaptureOptions())


def find(path: str) -> None:
    """Look for all hands of a picture, and copy it, as Find Hands does."""
    answering.find({"input": [path], "picture": "result/a.jpg"})


def command(argv: list[str]) -> None:
    """The command line: exit code 0, or another one and one sentence on stderr."""
    said = io.StringIO()
    with contextlib.redirect_stderr(said), contextlib.redirect_stdout(io.StringIO()):
        try:
            code = main(argv)
        except SystemExit as ended:  # argparse has said what is wrong with the arguments
            code = ended.code
    if code == 2:
        return
    check_ending(code, said.getvalue())


def process(argv: list[str], **environment: str) -> None:
    """The same as a process of its own, whose memory the kernel tells when it has ended."""
    command = [sys.executable, "-m", "handfit_core", *argv]
    with tempfile.TemporaryFile() as said:
        env = {**os.environ, **environment}
        started = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=said, stderr=said, env=env)
        _, status, used = os.wait4(started.pid, 0)
        code = started.returncode = os.waitstatus_to_exitcode(status)
        assert used.ru_maxrss * 1024 < MOST_BYTES, f"memory: {used.ru_maxrss // 1000} MB"
        said.seek(0)
        check_ending(code, said.read().decode("utf-8", errors="replace"))


def check_ending(code: object, said: str) -> None:
    lines = [line for line in said.splitlines() if line and not line.startswith("warning: ")]
    if code == 0:
        assert not any(line.startswith("error: ") for line in lines), said
        return
    assert code == 1, f"exit code {code}: {said[-300:]}"
    assert len(lines) == 1, f"not one sentence: {said[-500:]}"
    assert lines[0].startswith("error: "), said
    assert "unexpected error" not in said, said
    raise errors.HandfitError(lines[0])


DOORS: dict[str, Callable[..., Any]] = {
    door.__name__: door for door in (take, recording, results, model, media, capture, find, command, process)
}
os.environ["OPENCV_FFMPEG_READ_ATTEMPTS"] = "64"
