"""The command line as its users run it: exit codes, one line per error, nothing written half."""

import json
import os
import subprocess
import sys
from dataclasses import replace

import cv2
import numpy as np
import pytest

from handfit_core import Take
from handfit_core.__main__ import main
from handfit_core.geometry.camera import Intrinsics
from handfit_core.geometry.lens import Lens
from tests.conftest import ROOT
from tests.films import all_around, film

PHOTO = ROOT / "samples" / "rendered_hand" / "hand.0001.jpg"


def run(*arguments, **environment: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "handfit_core", *map(str, arguments)]
    variables = {**os.environ, **environment}
    return subprocess.run(command, capture_output=True, text=True, cwd=ROOT, env=variables, timeout=300)


def test_capture_writes_a_take(tmp_path):
    """Also under a name that the console cannot show. MediaPipe's and TensorFlow Lite's own chatter is kept
    away from people."""
    output = tmp_path / "new folder" / "手.npz"
    result = run("capture", PHOTO, "-o", output, PYTHONIOENCODING="ascii")
    assert result.returncode == 0, result.stderr
    assert "right hand in 1 of 1 frames" in result.stderr
    assert "\\u624b.npz" in result.stderr
    assert len(result.stderr.splitlines()) == 1
    assert [p.name for p in output.parent.iterdir()] == [output.name]
    assert Take.load(output).hands[0].side == "right"


def test_arms_are_added_to_a_take(tmp_path):
    """Over the take itself, or beside it, where they say why there are none; its hands stay."""
    path, beside = tmp_path / "a.npz", tmp_path / "b.npz"
    assert run("capture", PHOTO, "-o", path).returncode == 0
    before = Take.load(path)
    for more, output in ((), path), (("-o", beside), beside):
        result = run("arms", path, *more)
        assert result.returncode == 0, result.stderr
        take = Take.load(output)
        assert take.hands[0].no_arm.startswith("no arm: ")
        assert take.hands[0].no_arm in result.stderr
        np.testing.assert_array_equal(take.hands[0].joints_3d, before.hands[0].joints_3d)
    assert f"({take.hands[0].no_arm})" in run("info", beside).stdout
    replace(before, source=replace(before.source, files=(str(tmp_path / "gone.jpg"),))).save(path)
    assert "gone.jpg: there is no such file" in run("arms", path).stderr


def test_json_progress(tmp_path):
    pattern = PHOTO.parent / "hand.%04d.jpg"
    result = run("capture", pattern, "--frames=5-7:2", "--progress", "json", "-o", tmp_path / "a.npz")
    events = [json.loads(line) for line in result.stdout.splitlines()]
    assert [e["event"] for e in events] == ["progress"] * 4 + ["done"]
    assert events[0] == {"event": "progress", "stage": "detect", "done": 1, "total": 2}
    assert events[-1]["hands"][0]["frames"] == 2
    np.testing.assert_array_equal(Take.load(tmp_path / "a.npz").frame_numbers, [5, 7])


BAD = {
    "{folder}/gone.jpg": "no such file",
    "{folder}/wall.png": "lower detection threshold",
    f"{PHOTO} --solver magic": "paper-a, paper-b",
    f"{PHOTO} --frames 9-2": "frame range",
    f"{PHOTO} --intrinsics 1,2": "FX,FY,CX,CY",
    f"{PHOTO} --smoothing=-1": "smoothing must lie between 0 and 10",
    f"{PHOTO} --model {{folder}}/gone.pkl": "no such hand model",
    f"{PHOTO} --landmark-model {{folder}}/gone.task": "no such landmark model",
    f"{PHOTO} -o {{folder}}/wall.png/out.npz": "cannot write here",
    f"{PHOTO} -o {{folder}}": "this is a folder",
}


def test_bad_calls_are_one_line_and_leave_nothing(tmp_path, monkeypatch, capsys):
    cv2.imwrite(str(tmp_path / "wall.png"), np.full((200, 200, 3), 90, np.uint8))
    for call, words in BAD.items():
        arguments = ["-o", str(tmp_path / "out.npz"), *call.format(folder=tmp_path).split()]
        assert main(["capture", *arguments]) == 1, arguments
        lines = capsys.readouterr().err.splitlines()
        assert len(lines) == 1, lines
        assert lines[0].startswith("error: ")
        assert words in lines[0]
    assert [p.name for p in tmp_path.iterdir()] == ["wall.png"]


def test_error_as_json_and_debug(tmp_path):
    call = "capture", "", "-o", tmp_path / "a.npz"
    result = run(*call, "--progress", "json")
    assert result.returncode == 1
    told = json.loads(result.stdout)
    assert told["type"] == "InputError"
    assert "no input was given" in told["message"]
    assert "Traceback" in run(*call, "--debug").stderr


@pytest.mark.parametrize("arguments", ["", "capture", "nothing", "capture a -o b --smoothing much"])
def test_usage(arguments):
    result = run(*arguments.split())
    assert result.returncode == 2
    assert "usage:" in result.stderr


def test_a_lens_is_measured_listed_used_and_forgotten(tmp_path, monkeypatch, capsys):
    """As somebody does it: draw the board, film it, name the lens, capture with it."""
    monkeypatch.setenv("HANDFIT_DATA", str(tmp_path / "data"))
    assert main(["lens", "--board", str(tmp_path / "board.png")]) == 0
    assert "film it for half a minute" in capsys.readouterr().out
    assert cv2.imread(str(tmp_path / "board.png")).shape == (1080, 1920, 3)
    lens = Lens(Intrinsics(430.0, 430.0, 320.0, 240.0), (-0.1, 0.0, 0.0, 0.0, 0.0), 640, 480)
    clip = str(film(tmp_path / "film.mp4", lens, all_around(lens, 20), still=1))
    for name, said in (("1,2,3", "a name with a letter"), (None, "give the lens a name, with --name")):
        assert main(["lens", clip, *([f"--name={name}"] if name else [])]) == 1
        assert said in capsys.readouterr().err
    assert main(["lens", clip, "--name", "my/phone 📱"]) == 0
    told = capsys.readouterr().out
    assert told.startswith("my/phone 📱: focal length 4")
    assert main(["lens", "--list"]) == 0
    assert capsys.readouterr().out == told
    assert main(["capture", str(PHOTO), "--lens", "my/phone 📱", "-o", str(tmp_path / "a.npz")]) == 0
    assert Take.load(tmp_path / "a.npz").intrinsics.fx == pytest.approx(430.0, rel=0.005)
    assert main(["lens", "--remove", "my/phone 📱"]) == 0
    capsys.readouterr()
    assert main(["capture", str(PHOTO), "--lens", "my/phone 📱", "-o", str(tmp_path / "b.npz")]) == 1
    assert "there is no measured lens my/phone 📱, and none is saved" in capsys.readouterr().err
