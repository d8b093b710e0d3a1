"""scripts/batch_fit.py as its users run it: a process of its own, under the bpy wheel and in real Blender."""

from __future__ import annotations

import functools
import json
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

pytest.importorskip("bpy", reason="needs one of the bpy wheels")

ROOT = Path(__file__).resolve().parents[2]
SCRIPT = ROOT / "scripts" / "batch_fit.py"
TIMEOUT = 1200

needs_signals = pytest.mark.skipif(sys.platform == "win32", reason="signals are POSIX's")


@pytest.fixture
def batch(in_blender):
    """batch(*arguments) -> CompletedProcess, run in a folder of its own."""
    return functools.partial(in_blender, SCRIPT)


@pytest.fixture
def wheel(tmp_path):
    """wheel(*arguments) -> CompletedProcess, under the bpy wheel alone."""

    def run(*arguments: object, script: Path = SCRIPT, **limits: object) -> subprocess.CompletedProcess[str]:
        command = [sys.executable, str(script), *map(str, arguments)]
        return subprocess.run(
            command, capture_output=True, text=True, cwd=tmp_path, timeout=TIMEOUT, check=False, **limits
        )

    return run


def report(folder: Path) -> list[dict]:
    content = json.loads((folder / "report.json").read_text(encoding="utf-8"))
    assert (content["format"], content["version"]) == ("handfit-batch", 1)
    return content["inputs"]


def times(folder: Path) -> dict[str, int]:
    """When each result was written."""
    return {path.name: path.stat().st_mtime_ns for path in folder.iterdir()}


IMPORTERS = {".glb": "import_scene.gltf", ".fbx": "import_scene.fbx", ".bvh": "import_anim.bvh"}


def read_back(stem: Path) -> list[str]:
    """The armatures that a Blender finds in each result file: bones, and whether they have an action."""
    code = (
        "import bpy, sys\n"
        f"for suffix, importer in {IMPORTERS}.items():\n"
        "    bpy.ops.wm.read_factory_settings(use_empty=True)\n"
        "    module, name = importer.split('.')\n"
        "    getattr(getattr(bpy.ops, module), name)(filepath=sys.argv[1] + suffix)\n"
        "    rigs = [o for o in bpy.data.objects if o.type == 'ARMATURE']\n"
        "    print('FOUND', *((len(r.data.bones), bool(r.animation_data.action)) for r in rigs))\n"
    )
    command = [sys.executable, "-c", code, str(stem)]
    done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=TIMEOUT)
    return [line for line in done.stdout.splitlines() if line.startswith("FOUND")]


def test_takes_become_files(batch, take_file, tmp_path):
    """The whole path, which takes its time: it starts several Blenders, and renders."""
    out = tmp_path / "out"
    done = batch(
        *(take_file("wave"), take_file("nod"), "--output", out),
        *("--format", "blend,glb,fbx,bvh", "--preview", "--no-sheet", "--jobs", "1"),
    )
    assert done.returncode == 0, done.stderr
    assert [line for line in done.stdout.splitlines() if line.startswith("exported: ")]
    endings = (".take.npz", ".blend", ".glb", ".fbx", ".bvh", ".preview.png")
    for entry in report(out):
        name = entry["name"]
        assert (entry["status"], entry["frames"]) == ("ok", 5)
        assert [(h["side"], h["detected"]) for h in entry["hands"]] == [("right", 5)]
        assert "gone.png" in entry["warnings"][0]
        assert entry["files"] == [f"{name}/{name}{ending}" for ending in endings]
        ours = [f"{name}.json", f"{name}.export.json"]
        assert sorted(times(out / name)) == sorted([*ours, *(f"{name}{ending}" for ending in endings)])
    assert read_back(out / "wave" / "wave") == ["FOUND (16, True)"] * len(IMPORTERS)


@pytest.mark.slow
def test_the_same_line_again_makes_what_is_missing(wheel, take_file, tmp_path):
    out, takes = tmp_path / "out", [take_file("wave"), take_file("nod")]
    line = [*takes, "-o", out, "--no-sheet", "--jobs", "2", "--format"]
    assert wheel(*line, "glb,bvh").returncode == 0
    before = times(out / "wave")
    (out / "wave" / "wave.bvh").unlink()
    dry = wheel(*line, "glb,bvh", "--dry-run").stdout.splitlines()
    assert dry[-3:] == [  # before which Blender 5.2 may tell of its colours
        f"to do    {takes[0]} -> {out / 'wave'}",
        f"done     {takes[1]} -> {out / 'nod'}",
        "1 of 2 to do, 1 at a time",
    ]
    assert wheel(*line, "glb,bvh").stdout.count("exported: ") == 1
    assert times(out / "wave")["wave.glb"] == before["wave.glb"]

    assert wheel(*line, "bvh,fbx").returncode == 0, "other formats come beside them"
    assert times(out / "wave")["wave.glb"] == before["wave.glb"]
    assert [entry["files"][1:] for entry in report(out)] == [
        [f"{name}/{name}.{ending}" for ending in ("glb", "bvh", "fbx")] for name in ("wave", "nod")
    ]
    assert [len(entry["warnings"]) for entry in report(out)] == [1, 1], "they are not repeated"

    (out / "nod" / "nod.glb").write_bytes(b"somebody's work")
    done = wheel(*line, "glb", "--no-correctives")
    assert done.returncode == 1
    assert done.stdout.count("is there already, made with other options; --overwrite replaces it") == 2
    assert [entry["status"] for entry in report(out)] == ["failed", "failed"]
    assert wheel(*line, "glb").returncode == 0
    assert "nod.glb: changed since the batch wrote it, and left alone" in report(out)[1]["warnings"][-1]
    assert (out / "nod" / "nod.glb").read_bytes() == b"somebody's work"
    assert wheel(*line, "glb", "--no-correctives", "--overwrite").returncode == 0
    assert (out / "nod" / "nod.glb").stat().st_size > 1000


@pytest.mark.slow
@needs_signals
def test_a_blender_that_dies_is_started_again(wheel, take_file, tmp_path):
    """tests/core/tasks/test_exporting.py has what else can happen."""
    script = tmp_path / "batch_fit.py"
    script.write_text(
        f"import os, sys\nfrom pathlib import Path\nsys.path.insert(0, {str(ROOT)!r})\n"
        "from scripts import batch_fit\n"
        "if 'export' in sys.argv and not Path('begun').exists():\n"
        "    from blender_manient.batch import exports\n"
        "    exports._make = lambda *_, **__: (Path('begun').touch(), os.abort())\n"
        "batch_fit.__file__ = __file__\n"
        "batch_fit._leave(batch_fit.main())\n"
    )
    takes = [take_file(name) for name in ("first", "last")]
    done = wheel(*takes, "-o", "out", "--format", "bvh", "--jobs", "1", "--no-sheet", script=script)
    assert done.returncode == 0, done.stdout
    assert (tmp_path / "begun").exists()
    assert [entry["status"] for entry in report(tmp_path / "out")] == ["ok", "ok"]


def test_bad_inputs_do_not_stop_the_good_ones(batch, take_file, tmp_path, monkeypatch):
    monkeypatch.setenv("PYTHONIOENCODING", "ascii")  # a console that cannot show all names
    (tmp_path / "text.jpg").write_text("these are words")
    (tmp_path / "empty folder").mkdir()
    (tmp_path / "damaged.npz").write_bytes(b"PK\x03\x04 and no more")
    bad = ("nowhere.jpg", "empty folder", "damaged.npz", "nothing.*.png")
    out = tmp_path / "out"
    done = batch(*bad, take_file("手"), "-o", out, "--format", "glb", "--jobs", "1")
    assert done.returncode == 1, done.stderr
    entries = report(out)
    assert [e["status"] for e in entries] == ["failed"] * len(bad) + ["ok"]
    assert all(e["error"] and "Traceback" not in e["error"] for e in entries[:-1])
    assert "Traceback" not in done.stdout + done.stderr
    assert entries[-1]["files"][-1] == "手/手.glb"


def test_wrong_options_are_refused_before_any_work(wheel, tmp_path):
    done = wheel("a.jpg", "-o", "out", "--python=no-python")
    assert done.returncode == 2
    assert "cannot start the Python 'no-python'" in done.stderr
    assert "Traceback" not in done.stderr
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_a_folder_may_be_called_as_a_command(wheel, tmp_path):
    (tmp_path / "capture").mkdir()
    (tmp_path / "capture" / "a.jpg").write_bytes(b"no photo")
    done = wheel("capture", "-o", "out", "--format", "", "--dry-run")
    assert (done.returncode, "1 of 1 to do" in done.stdout) == (0, True), done.stderr


@pytest.mark.slow
@needs_signals
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_ctrl_c_keeps_what_is_finished(take_file, tmp_path, number):
    takes = [take_file(f"wave{n}", frames=200) for n in range(6)]
    options = "-o out --format blend,glb --jobs 1 --no-sheet".split(" ")
    command = [sys.executable, SCRIPT, *takes, *options]
    running = subprocess.Popen(list(map(str, command)), cwd=tmp_path, stderr=subprocess.PIPE, text=True)
    deadline = time.monotonic() + 120
    while time.monotonic() < deadline and not (tmp_path / "out/wave0/wave0.export.json").exists():
        time.sleep(0.05)
    running.send_signal(number)
    _, said = running.communicate(timeout=60)
    assert running.returncode == 130, said
    assert "what was finished is kept" in said
    statuses = [entry["status"] for entry in report(tmp_path / "out")]
    assert (statuses[0], statuses[-1]) == ("ok", "pending")
