"""The command line as its users run it: exit codes, one line per error, nothing written half."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from handfit_core import Take
from tests.conftest import ROOT

PHOTO = ROOT / "samples" / "rendered_hand" / "hand.0001.jpg"


def run(*arguments: str | Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "handfit_core", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, cwd=ROOT, timeout=300)


def test_capture_writes_a_take(tmp_path: Path) -> None:
    output = tmp_path / "new folder" / "one.take.npz"
    result = run("capture", PHOTO, "-o", output)
    assert result.returncode == 0, result.stderr
    assert "right hand in 1 of 1 frames" in result.stderr
    # MediaPipe's and TensorFlow Lite's own chatter is kept away from people.
    assert len(result.stderr.splitlines()) == 1
    assert [p.name for p in output.parent.iterdir()] == ["one.take.npz"]
    assert Take.load(output).hands[0].side == "right"


def test_json_progress(tmp_path: Path) -> None:
    pattern = PHOTO.parent / "hand.%04d.jpg"
    result = run("capture", pattern, "--frames=5-7:2", "--progress", "json", "-o", tmp_path / "a.npz")
    events = [json.loads(line) for line in result.stdout.splitlines()]
    assert [e["event"] for e in events] == ["progress"] * 4 + ["done"]
    assert events[0] == {"event": "progress", "stage": "detect", "done": 1, "total": 2}
    assert events[-1]["hands"][0]["frames"] == 2
    np.testing.assert_array_equal(Take.load(tmp_path / "a.npz").frame_numbers, [5, 7])


def test_names_that_the_console_cannot_show(tmp_path: Path) -> None:
    output = tmp_path / "手.npz"
    command = [sys.executable, "-m", "handfit_core", "capture", str(PHOTO), "-o", str(output)]
    environment = {**os.environ, "PYTHONIOENCODING": "ascii"}
    result = subprocess.run(command, capture_output=True, text=True, cwd=ROOT, env=environment, timeout=300)
    assert result.returncode == 0, result.stderr
    assert "\\u624b.npz" in result.stderr
    assert output.is_file()


def bad_calls(folder: Path) -> list[tuple[list[str | Path], str]]:
    (folder / "zero.jpg").write_bytes(b"")
    (folder / "text.jpg").write_text("no picture")
    (folder / "file").write_text("x")
    import cv2

    cv2.imwrite(str(folder / "wall.png"), np.full((200, 200, 3), 90, np.uint8))
    out = ["-o", folder / "out.npz"]
    return [
        (["capture", folder / "gone.jpg", *out], "no such file"),
        (["capture", folder / "zero.jpg", *out], "empty"),
        (["capture", folder / "text.jpg", *out], "not a picture"),
        (["capture", folder / "wall.png", *out], "lower detection threshold"),
        (["capture", PHOTO, "--solver", "magic", *out], "paper-a, paper-b"),
        (["capture", PHOTO, "--frames", "9-2", *out], "frame range"),
        (["capture", PHOTO, "--intrinsics", "1,2", *out], "FX,FY,CX,CY"),
        (["capture", PHOTO, "--smoothing=-1", *out], "smoothing must lie between 0 and 10"),
        (["capture", PHOTO, "--model", folder / "gone.pkl", *out], "no such hand model"),
        (["capture", PHOTO, "--landmark-model", folder / "gone.task", *out], "no such landmark model"),
        (["capture", PHOTO, "-o", folder / "file" / "out.npz"], "cannot write here"),
        (["capture", PHOTO, "-o", folder], "this is a folder"),
        (["capture", "", *out], "no input was given"),
    ]


def test_bad_calls_are_one_line_and_leave_nothing(tmp_path: Path) -> None:
    calls = bad_calls(tmp_path)
    before = sorted(p.name for p in tmp_path.iterdir())
    for arguments, words in calls:
        result = run(*arguments)
        assert result.returncode == 1, arguments
        lines = result.stderr.splitlines()
        assert len(lines) == 1, lines
        assert lines[0].startswith("error: ")
        assert words in lines[0]
    assert sorted(p.name for p in tmp_path.iterdir()) == before


def test_error_as_json_and_debug(tmp_path: Path) -> None:
    result = run("capture", tmp_path / "gone.jpg", "-o", tmp_path / "a.npz", "--progress", "json")
    assert json.loads(result.stdout)["type"] == "InputError"
    assert result.returncode == 1
    debug = run("capture", tmp_path / "gone.jpg", "-o", tmp_path / "a.npz", "--debug")
    assert "Traceback" in debug.stderr


@pytest.mark.parametrize(
    "arguments", [[], ["capture"], ["nothing"], ["capture", "a", "-o", "b", "--smoothing", "much"]]
)
def test_usage(arguments: list[str]) -> None:
    result = run(*arguments)
    assert result.returncode == 2
    assert "usage:" in result.stderr
