"""`blender --command manient`: what Blender calls with the arguments that follow."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import bpy
import pytest

from blender_manient import command
from blender_manient.common import preferences
from blender_manient.scene.store import captured_hands, hand_of
from handfit_core.take import Take

from .conftest import READY

pytestmark = pytest.mark.usefixtures("registered")

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture
def take_file(make_take, tmp_path) -> Path:
    return make_take(sides=("right",)).take.save(tmp_path / "wave.take.npz")


INTERRUPTING = f"{READY}sys.stdin.readline(); os.kill(os.getppid(), signal.SIGINT); time.sleep(600)"
"""A worker that answers every request with a Ctrl-C to who asked"""


def report(folder: Path) -> list[dict]:
    return json.loads((folder / "report.json").read_text(encoding="utf-8"))["inputs"]


@pytest.mark.parametrize("arguments", [["--help"], ["capture", "--help"], ["check", "--help"]])
def test_help(arguments, capfd):
    assert command.main(arguments) == 0
    said = capfd.readouterr()
    assert said.out.startswith("usage: blender --command manient")
    assert said.err == ""


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        ([], "COMMAND"),
        (["fetch"], "fetch"),
        (["work", "out"], "there is no command work any more; "),
        (["capture", "a.jpg", "-o", "out", "--split", "100"], "there is no option --split any more; "),
        (["capture"], "INPUT"),
        (["capture", "a.jpg", "-o", "out", "--nonsense"], "--nonsense"),
    ],
)
def test_wrong_arguments(arguments, expected, capfd):
    assert command.main(arguments) == 2
    assert expected in capfd.readouterr().err


def test_what_cannot_be_meant_is_refused_before_any_work(tmp_path, capfd):
    assert command.main(["capture", "a.jpg", "-o", str(tmp_path / "out"), "--format", "obj"]) == 2
    assert "there is no export format 'obj'" in capfd.readouterr().err
    assert not (tmp_path / "out").exists()


def test_a_take_becomes_files_and_the_addon_stays(take_file, tmp_path, capfd):
    out = tmp_path / "out"
    arguments = ["capture", str(take_file), "--output", str(out), "--format", "blend,bvh", "--no-sheet"]
    assert command.main(arguments) == 0
    (entry,) = report(out)
    assert (entry["status"], entry["files"]) == (
        "ok",
        ["wave/wave.take.npz", "wave/wave.blend", "wave/wave.bvh"],
    )
    assert "[1/1] ok: " in capfd.readouterr().out
    assert hasattr(bpy.types.Scene, "manient")
    assert preferences.get().cache_folder == str(tmp_path / "cache")
    bpy.ops.wm.open_mainfile(filepath=str(out / "wave" / "wave.blend"))
    (armature,) = captured_hands(bpy.context.scene)
    hand = hand_of(armature)
    assert hand is not None
    assert hand.take.frame_numbers.tolist() == Take.load(take_file).frame_numbers.tolist()


def test_the_python_is_the_preferences_unless_an_option_names_one(tmp_path, capfd):
    (tmp_path / "a.jpg").write_bytes(b"\xff\xd8\xff")
    preferences.get().python = str(tmp_path / "preferred-python")
    arguments = ["capture", str(tmp_path / "a.jpg"), "-o", str(tmp_path / "out")]
    for options, expected in (([], "preferred-python"), (["--python", "named-python"], "named-python")):
        assert command.main([*arguments, *options]) == 2
        said = capfd.readouterr().err
        assert all(word in said for word in (f"{expected}'", "--python", "preferences"))
    assert not (tmp_path / "out").exists()


def test_takes_need_no_python_that_captures(take_file, tmp_path):
    preferences.get().python = str(tmp_path / "no-python")
    arguments = ["capture", str(take_file), "-o", str(tmp_path / "out"), "--format", "bvh", "--jobs", "1"]
    assert command.main(arguments) == 0


def test_ctrl_c_ends_a_check(peer, capfd):
    preferences.get().python = peer(INTERRUPTING)
    assert command.main(["check"]) == 130
    said = capfd.readouterr()
    assert (said.out, said.err) == ("", "stopped\n")


def test_a_check_that_fails_says_why(tmp_path, capfd):
    assert command.main(["check", "--python", str(tmp_path / "no-python")]) == 1
    said = capfd.readouterr()
    assert said.out.startswith("Hand Capture Check\n")
    assert f"Python that captures: {tmp_path / 'no-python'} (command line)" in said.out
    assert bpy.app.version_string in said.out
    assert said.err == ""


@pytest.mark.parametrize("arguments", [["capture", "a.jpg", "--output", "out"], ["check"]])
@pytest.mark.parametrize("missing", ["handfit_core", "numpy"])
def test_without_a_part_that_blenders_side_needs(arguments, missing, tmp_path):
    code = (
        "import sys\n"
        f"sys.path.insert(0, {str(ROOT)!r})\n"
        "import bpy\n"
        f"for name in [n for n in sys.modules if n.partition('.')[0] == {missing!r}]: del sys.modules[name]\n"
        f"sys.modules[{missing!r}] = None\n"
        "import blender_manient\n"
        "blender_manient.register()\n"
        "from blender_manient import command\n"
        "print('HELP', command.main(['--help']))\n"
        f"print('ENDED', command.main({arguments!r}))\n"
        "sys.stdout.flush()\n"
        "import os; os._exit(0)\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, cwd=tmp_path, timeout=120, check=False
    )
    assert "HELP 0" in done.stdout, done.stderr
    assert "ENDED 1" in done.stdout, done.stderr
    name = {"numpy": "NumPy"}.get(missing, missing)
    assert [line for line in done.stderr.splitlines() if line.startswith("error: ") and name in line]
    assert "Traceback" not in done.stderr
    assert not (tmp_path / "out").exists()
