"""scripts/batch_fit.py as its users run it: a process of its own, under the bpy wheel and in real Blender."""

from __future__ import annotations

import functools
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("bpy", reason="needs one of the bpy wheels")

from handfit_core.geometry.camera import Intrinsics
from handfit_core.hand_model.files import save_model_npz
from handfit_core.media.source import Source
from handfit_core.skeleton import SIDES
from handfit_core.version import __version__
from tests.capturing import can_capture
from tests.imitation_mano import imitation_model
from tests.takes import take_of, track_of

ROOT = Path(__file__).resolve().parents[2]
SCRIPT = ROOT / "scripts" / "batch_fit.py"
SAMPLES = Path(os.environ.get("HANDFIT_SAMPLES", ROOT.parent / "shared" / "samples"))
TIMEOUT = 1200


needs_capture = pytest.mark.skipif(
    not SAMPLES.is_dir() or not can_capture(),
    reason="needs the samples, and a Python with torch, OpenCV and MediaPipe in HANDFIT_PYTHON",
)


needs_scripts = pytest.mark.skipif(sys.platform == "win32", reason="the peer is a script with a #! line")


@pytest.fixture
def batch(in_blender):
    """batch(*arguments) -> CompletedProcess, run in a folder of its own."""
    return functools.partial(in_blender, SCRIPT)


@pytest.fixture
def take_file(tmp_path):
    """take_file(name, frames) -> path of a saved take of a right hand."""

    def make(name: str = "wave", frames: int = 5) -> Path:
        t = np.linspace(0, 1, frames)
        orient = np.stack([0.3 + t, t * 0, t], -1)
        pose = np.tile(np.tile([0.0, 0.0, 0.4], 15), (frames, 1)) * t[:, None]
        camera = Intrinsics.assumed(320, 240)
        hand = track_of("right", orient, pose, np.tile([0.0, 0.0, 0.6], (frames, 1)), camera)
        take = take_of([hand], camera, 320, 240, source=Source("photo", (str(tmp_path / "gone.png"),)))
        return take.save(tmp_path / f"{name}.take.npz")

    return make


def report(folder: Path) -> list[dict]:
    content = json.loads((folder / "report.json").read_text(encoding="utf-8"))
    assert (content["format"], content["version"]) == ("handfit-batch", 1)
    return content["inputs"]


def plan_in(folder: Path) -> str:
    """The name of the only plan in a folder of results."""
    (plan,) = (folder / "plans").iterdir()
    return plan.relative_to(folder).as_posix()


def lines(text: str) -> list[str]:
    return [line for line in text.splitlines() if line.startswith("[")]


def read_back(path: Path) -> dict:
    """What a fresh Blender finds in a result file."""
    operators = {
        ".blend": "wm.open_mainfile",
        ".glb": "import_scene.gltf",
        ".fbx": "import_scene.fbx",
        ".bvh": "import_anim.bvh",
    }
    code = (
        "import bpy, json, sys\n"
        "bpy.ops.wm.read_factory_settings(use_empty=True)\n"
        f"bpy.ops.{operators[path.suffix]}(filepath=sys.argv[1])\n"
        "rigs = [o for o in bpy.data.objects if o.type == 'ARMATURE']\n"
        "print('FOUND', json.dumps({'rigs': len(rigs), 'bones': sorted(len(r.data.bones) for r in rigs),\n"
        " 'suffixes': sorted(r.data.bones[0].name[-2:] for r in rigs),\n"
        " 'animated': all(r.animation_data and r.animation_data.action for r in rigs),\n"
        " 'frames': [bpy.context.scene.frame_start, bpy.context.scene.frame_end],\n"
        " 'pictures': [bpy.path.abspath(i.filepath) for i in bpy.data.images if i.filepath]}))\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, str(path)], capture_output=True, text=True, check=True, timeout=TIMEOUT
    )
    return json.loads(next(x for x in done.stdout.splitlines() if x.startswith("FOUND"))[6:])


def test_a_dry_run_tells_what_would_be_done(batch, take_file, tmp_path):
    out = tmp_path / "out"
    broken = tmp_path / "broken.npz"
    broken.write_bytes(b"no take")
    inputs, rest = [take_file("wave"), broken], ["--output", out, "--format", "bvh"]
    assert batch(*inputs, *rest).returncode == 1
    before = sorted(out.rglob("*"))
    done = batch(*inputs, take_file("nod"), *rest, "--dry-run")
    assert done.returncode == 0, done.stderr
    finished, failed, left, summary = _of_dry_run(done.stdout)
    told = dict(line.split(maxsplit=1) for line in (finished, failed))
    assert told["done"] == f"{inputs[0]} -> {out / 'wave'}"
    assert told["failed"].startswith(f"{broken} -> {out / 'broken'}: ")
    assert told["failed"].endswith("; --retry-failed tries it again")
    assert left == f"to do    {tmp_path / 'nod.take.npz'} -> {out / 'nod'}"
    assert summary.startswith("1 of 3 to do, 1 at a time: about 0:0")
    again = batch(*inputs, *rest, "--dry-run", "--retry-failed")
    assert _of_dry_run(again.stdout)[-1].startswith("1 of 2 to do")
    assert sorted(out.rglob("*")) == before, "nothing was done"


def _of_dry_run(text: str) -> list[str]:
    """The lines that are not Blender's own."""
    return [line for line in text.splitlines() if line.startswith(("done ", "failed ", "to do ", "1 of "))]


def test_takes_become_files(batch, take_file, tmp_path):
    take = take_file()
    out = tmp_path / "out"
    done = batch(take, "--output", out, "--format", "blend,glb,fbx,bvh", "--preview", "--no-sheet")
    assert done.returncode == 0, done.stderr
    assert len(lines(done.stdout)) == 1
    (entry,) = report(out)
    assert entry["status"] == "ok"
    assert entry["frames"] == 5
    assert [(h["side"], h["detected"]) for h in entry["hands"]] == [("right", 5)]
    assert "gone.png" in entry["warnings"][0]
    assert sorted(entry["files"]) == sorted(
        f"wave/wave{s}" for s in (".take.npz", ".blend", ".glb", ".fbx", ".bvh", ".preview.png")
    )
    assert sorted(p.relative_to(out).as_posix() for p in out.rglob("*") if p.is_file()) == sorted(
        ["report.json", "overview.html", plan_in(out), "wave/done.json", *entry["files"]]
    )
    for suffix in (".glb", ".fbx", ".bvh"):
        found = read_back(out / "wave" / f"wave{suffix}")
        assert (found["rigs"], found["bones"], found["animated"]) == (1, [16], True), suffix


@pytest.mark.skipif(sys.platform == "win32", reason="limits of a process are POSIX only")
def test_a_report_that_cannot_be_written_does_not_end_the_batch(take_file, tmp_path):
    """Long names make report.json the largest file of the batch; at last it is larger than a file may be."""
    import resource

    names = [f"{number:02}{'x' * 200}" for number in range(24)]
    takes = [take_file(name, frames=1) for name in names]

    def run(output: Path, limit: int) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            list(map(str, [sys.executable, SCRIPT, *takes, "--output", output, "--format", ""])),
            capture_output=True,
            text=True,
            cwd=tmp_path,
            timeout=TIMEOUT,
            check=False,
            preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit)),
        )

    done = run(tmp_path / "one", resource.RLIM_INFINITY)
    assert done.returncode == 0, done.stderr
    size = (tmp_path / "one" / "report.json").stat().st_size
    done = run(tmp_path / "two", int(0.9 * size))
    assert done.returncode == 1, "some failed; that nothing was tried would be 2"
    assert [line.split()[1] for line in lines(done.stdout)] == ["ok:"] * len(takes)
    assert all((tmp_path / "two" / name / f"{name}.take.npz").stat().st_size for name in names)
    said = [line for line in done.stderr.splitlines() if "report.json" in line]
    assert said
    assert all("could not be written" in line and "Traceback" not in line for line in said)
    kept = report(tmp_path / "two")
    assert kept[0]["status"] == "ok", "what could be written last stays, and whole"
    assert kept[-1]["status"] == "pending"


def test_bad_inputs_do_not_stop_the_good_ones(batch, take_file, tmp_path):
    (tmp_path / "text.jpg").write_text("these are words")
    (tmp_path / "empty.mp4").touch()
    (tmp_path / "empty folder").mkdir()
    (tmp_path / "damaged.npz").write_bytes(b"PK\x03\x04 and no more")
    bad = ("nowhere.jpg", "empty.mp4", "empty folder", "damaged.npz", "nothing.*.png")
    out = tmp_path / "out"
    done = batch(*bad, take_file(), "-o", out, "--format", "glb")
    assert done.returncode == 1
    entries = report(out)
    assert [e["status"] for e in entries] == ["failed"] * len(bad) + ["ok"]
    assert all(e["error"] and "Traceback" not in e["error"] for e in entries[:-1])
    assert "Traceback" not in done.stdout + done.stderr
    assert len(lines(done.stdout)) == len(entries)
    assert not any((out / Path(name).stem / f"{Path(name).stem}.glb").exists() for name in bad)
    assert all((out / entry["name"] / "failed.json").is_file() for entry in entries[:-1])


def test_names_that_the_console_cannot_show(batch, take_file, tmp_path, monkeypatch):
    monkeypatch.setenv("PYTHONIOENCODING", "ascii")
    done = batch(take_file("手"), take_file("wave"), "-o", tmp_path / "out", "--format", "bvh")
    assert done.returncode == 0, done.stderr
    assert [e["name"] for e in report(tmp_path / "out")] == ["手", "wave"]


def test_unwritable_output_is_one_sentence(batch, take_file, tmp_path):
    (tmp_path / "file").write_text("in the way")
    done = batch(take_file(), "-o", tmp_path / "file" / "out")
    assert done.returncode == 2
    assert "cannot write here" in done.stderr
    assert "Traceback" not in done.stderr


def test_equal_names_get_numbers(batch, take_file, tmp_path):
    first = take_file()
    (tmp_path / "other").mkdir()
    second = Path(shutil.copy(first, tmp_path / "other" / "WAVE.take.npz"))
    out = tmp_path / "out"
    assert batch(first, second, "-o", out, "--format", "bvh").returncode == 0
    assert [e["name"] for e in report(out)] == ["wave", "WAVE-2"]
    before = (out / "wave" / "done.json").stat().st_mtime_ns
    assert batch(first, "-o", out, "--format", "bvh").returncode == 0
    assert [e["name"] for e in report(out)] == ["wave", "WAVE-2"]
    assert (out / "wave" / "done.json").stat().st_mtime_ns == before, "what is sealed is not done again"
    assert batch(first, "-o", out, "--format", "glb").returncode == 0
    assert [e["name"] for e in report(out)] == ["wave", "WAVE-2", "wave-3"]
    assert batch(first, "-o", out, "--format", "glb", "--overwrite").returncode == 0
    assert [(e["name"], e["files"][-1]) for e in report(out)] == [
        *(("wave", "wave/wave.glb"), ("WAVE-2", "WAVE-2/WAVE-2.bvh"), ("wave-3", "wave-3/wave-3.glb")),
    ]


def test_a_python_that_cannot_capture_is_named(batch, tmp_path):
    (tmp_path / "a.jpg").write_bytes(b"\xff\xd8\xff")
    done = batch("a.jpg", "-o", tmp_path / "out", "--python", tmp_path / "no-python")
    assert done.returncode == 1
    (entry,) = report(tmp_path / "out")
    assert "no-python" in entry["error"]
    assert "--python" in entry["error"]


@pytest.fixture
def peer(tmp_path, take_file):
    """A Python whose worker does as the input's name says: crashes, sleeps, or gives a small take."""
    take = take_file("given")
    python = os.environ.get("HANDFIT_PYTHON", sys.executable)
    path = tmp_path / "peer"
    path.write_text(
        f"#!{python}\n"
        "import json, os, shutil, sys, time\n"
        "def say(**event): print(json.dumps(event), flush=True)\n"
        "open('pids', 'a').write(f'{os.getpid()}\\n')\n"
        f"say(event='ready', protocol=1, version={__version__!r}, pid=os.getpid(), python='3')\n"
        "for line in sys.stdin:\n"
        "    request = json.loads(line)\n"
        "    if request['request'] == 'sheet':\n"
        "        say(event='error', id=request['id'], type='OutputError', message='no paper', details='')\n"
        "        continue\n"
        "    name = request['input'][0]\n"
        "    say(event='progress', id=request['id'], stage='detect', done=0, total=1)\n"
        "    if 'crash' in name: os.abort()\n"
        "    if 'slow' in name: time.sleep(600)\n"
        "    if 'grow' in name and os.path.getsize(name) < 9: open(name, 'ab').write(b'more of it')\n"
        "    if 'swap' in name: shutil.copy('other.npz', request['options']['model'])\n"
        "    os.makedirs(os.path.dirname(request['output']), exist_ok=True)\n"
        f"    shutil.copy({str(take)!r}, request['output'])\n"
        "    say(event='done', id=request['id'], output=request['output'])\n"
    )
    path.chmod(0o755)
    return path


def pids(folder: Path) -> list[int]:
    """The processes that `peer` was, in order."""
    return [int(line) for line in (folder / "pids").read_text().split()]


def exists(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return True


@needs_scripts
def test_one_process_for_all_inputs_and_others_after_crashes(batch, peer, tmp_path):
    out = tmp_path / "out"
    options = ("--format", "bvh", "--python", peer)
    done = batch(*"a.jpg b.jpg crash.jpg c.jpg d.jpg".split(), "-o", out, "--jobs", "1", *options)
    assert done.returncode == 1
    entries = report(out)
    assert [e["status"] for e in entries] == ["ok", "ok", "failed", "ok", "ok"]
    for entry in (entries[0], entries[4]):  # no task fails for it
        assert "there is no contact sheet of it: no paper" in entry["warnings"]
        assert entry["files"] == [f"{entry['name']}/{entry['name']}{end}" for end in (".take.npz", ".bvh")]
    assert "SIGABRT" in entries[2]["error"]
    assert "--debug" in entries[2]["error"]
    assert [attempt["kind"] for attempt in entries[2]["attempts"]] == ["WorkerDied"] * 3
    assert len(pids(tmp_path)) <= 4, "one, and one after each crash"
    assert [p.name for p in (out / "crash").iterdir()] == ["failed.json"]


@pytest.fixture
def wheel(tmp_path, peer):
    """wheel(*arguments) -> CompletedProcess, under the bpy wheel, with `peer` as the Python that captures."""

    def run(*arguments: object) -> subprocess.CompletedProcess[str]:
        python = [] if arguments[0] in ("plan", "collect") else ["--python", str(peer)]
        return subprocess.run(
            [sys.executable, str(SCRIPT), *map(str, arguments), *python],
            capture_output=True,
            text=True,
            cwd=tmp_path,
            timeout=TIMEOUT,
            check=False,
        )

    return run


@needs_scripts
def test_an_input_that_grows_while_it_is_read(wheel, tmp_path):
    out = tmp_path / "out"
    (tmp_path / "grow.jpg").write_bytes(b"half")
    assert wheel("grow.jpg", "-o", out, "--format", "bvh").returncode == 1
    (entry,) = report(out)
    assert entry["error"].startswith("grow.jpg: has changed while it was read: if it is still being copied")
    assert not (out / "grow" / "done.json").exists()
    done = wheel("grow.jpg", "-o", out, "--format", "bvh")
    assert done.returncode == 0, done.stderr
    assert [(e["name"], e["status"]) for e in report(out)] == [("grow", "ok")]


@needs_scripts
@pytest.mark.parametrize("named", ["mano", "mano/MANO_RIGHT.npz"])
def test_a_hand_model_that_is_replaced(wheel, tmp_path, named):
    """Between `plan` and `work`, of whichever side: its results would be another task's."""
    out, mano = tmp_path / "out", tmp_path / "mano"
    mano.mkdir()
    (tmp_path / "a.jpg").write_bytes(b"a")
    files = {mano / f"MANO_{side.upper()}.npz": imitation_model(side) for side in SIDES}
    for file, model in files.items():
        save_model_npz(model, file)
    assert wheel("plan", "a.jpg", "-o", out, "--format", "bvh", "--model", named).returncode == 0
    for file, model in files.items():
        save_model_npz(replace(model, v_template=model.v_template * 1.1), file)
        assert wheel("work", out).returncode == 1
        (entry,) = report(out)
        assert entry["status"] == "failed"
        assert entry["error"].startswith(f"{file}: holds something else than when the batch was planned;")
        assert [path.name for path in (out / "a").iterdir()] == ["failed.json"]
        save_model_npz(model, file)
    (mano / "notes.txt").write_text("what no hand is read from")
    done = wheel("work", out)
    assert done.returncode == 0, done.stderr
    assert [entry["status"] for entry in report(out)] == ["ok"]


@needs_scripts
def test_a_hand_model_that_is_replaced_while_it_is_used(wheel, tmp_path):
    out, model = tmp_path / "out", tmp_path / "MANO_RIGHT.npz"
    (tmp_path / "swap.jpg").write_bytes(b"a")
    model.write_bytes(b"one")
    (tmp_path / "other.npz").write_bytes(b"other")
    options = "--format", "bvh", "--model", model
    assert wheel("swap.jpg", "-o", out, *options).returncode == 1
    (entry,) = report(out)
    assert "MANO_RIGHT.npz: holds something else" in entry["error"]
    assert not entry["files"], "the next attempt must not go on with it"
    done = wheel("swap.jpg", "-o", out, *options)
    assert done.returncode == 0, done.stderr
    assert [(e["name"], e["status"]) for e in report(out)] == [("swap", "ok")]


@needs_scripts
def test_inputs_that_are_replaced_or_gone(wheel, tmp_path):
    out = tmp_path / "out"
    for name in ("a", "b", "c"):
        (tmp_path / f"{name}.jpg").write_bytes(name.encode())
    assert wheel("plan", "a.jpg", "b.jpg", "c.jpg", "-o", out, "--format", "bvh").returncode == 0
    (tmp_path / "a.jpg").write_bytes(b"another")
    (tmp_path / "b.jpg").rename(tmp_path / "away.jpg")
    assert wheel("work", out).returncode == 1
    replaced, gone, third = report(out)
    assert "has changed since the batch was planned" in replaced["error"]
    assert "is gone; bring it back" in gone["error"]
    assert third["status"] == "ok"
    (tmp_path / "away.jpg").rename(tmp_path / "b.jpg")
    assert wheel("work", out).returncode == 1
    assert [entry["status"] for entry in report(out)] == ["failed", "ok", "ok"]
    done = wheel("a.jpg", "b.jpg", "c.jpg", "-o", out, "--format", "bvh")
    assert done.returncode == 0, done.stderr
    assert [(e["name"], e["status"]) for e in report(out)] == [("a", "ok"), ("b", "ok"), ("c", "ok")]


@needs_scripts
def test_the_time_limit_is_for_each_input(batch, peer, tmp_path):
    out = tmp_path / "out"
    options = ("--format", "bvh", "--python", peer, "--timeout", "3", "--jobs", "1")
    done = batch("a.jpg", "slow.jpg", "b.jpg", "-o", out, *options)
    assert done.returncode == 1
    entries = report(out)
    assert [e["status"] for e in entries] == ["ok", "failed", "ok"]
    assert entries[1]["error"].startswith("the capture took longer than 3 seconds and was stopped; allow")
    assert len(pids(tmp_path)) == 2


@needs_scripts
def test_ctrl_c_ends_the_worker_too(peer, tmp_path):
    out = tmp_path / "out"
    command = [sys.executable, str(SCRIPT), "a.jpg", "slow.jpg", "c.jpg", "-o", str(out), "--format", "bvh"]
    running = subprocess.Popen(
        [*command, "--python", str(peer), "--jobs", "1"], cwd=tmp_path, stderr=subprocess.PIPE, text=True
    )
    deadline = time.monotonic() + 60
    while time.monotonic() < deadline and not (out / "report.json").exists():
        time.sleep(0.05)
    while time.monotonic() < deadline and report(out)[0]["status"] != "ok":
        time.sleep(0.05)
    time.sleep(0.5)
    running.send_signal(signal.SIGINT)
    _, said = running.communicate(timeout=60)
    assert running.returncode == 130, said
    assert "what was finished is kept" in said
    assert [e["status"] for e in report(out)] == ["ok", "interrupted", "pending"]
    (pid,) = pids(tmp_path)
    deadline = time.monotonic() + 5  # the system's init may need a moment to let go of its number
    while exists(pid) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert not exists(pid)


@pytest.mark.parametrize(
    ("option", "expected"),
    [
        ("--hand-length=5", "between 50 and 300 mm"),
        ("--intrinsics=1,2,3", "FX,FY,CX,CY"),
        ("--detector=x", "no detector 'x'"),
        ("--solver=magic", "paper-a"),
        ("--format=blend,obj", "there is no export format 'obj'; choose from blend"),
    ],
)
def test_wrong_options_are_refused_before_any_work(batch, tmp_path, option, expected):
    done = batch("a.jpg", "-o", tmp_path / "out", option)
    assert done.returncode == 2
    assert expected in done.stderr
    assert not (tmp_path / "out").exists()


@needs_capture
def test_photos_and_videos(batch, tmp_path):
    photos = sorted(p for p in (SAMPLES / "photos").iterdir() if p.suffix in (".jpg", ".png"))
    videos = sorted((SAMPLES / "videos").glob("*.mp4"))
    (tmp_path / "text.jpg").write_text("these are words")
    no_hand = tmp_path / "no_hand.png"
    subprocess.run(
        [
            os.environ.get("HANDFIT_PYTHON", sys.executable),
            "-c",
            "import cv2, sys, numpy as np; cv2.imwrite(sys.argv[1], np.full((240, 320, 3), 90, np.uint8))",
            str(no_hand),
        ],
        check=True,
    )
    out = tmp_path / "out"
    done = batch(*photos, *videos, "text.jpg", no_hand, "-o", out, "--frames", "1-30")
    assert done.returncode == 1
    entries = {e["name"]: e for e in report(out)}
    assert entries["text"]["status"] == "failed"
    assert entries["no_hand"]["status"] == "failed"
    assert "hand" in entries["no_hand"]["error"]
    for source in (*photos, *videos):
        entry = entries[source.stem]
        assert entry["status"] == "ok", entry["error"]
        assert entry["frames"] == (30 if source in videos else 1)
        assert max(hand["detected"] for hand in entry["hands"]) >= 1
        assert all(hand["mean_reprojection_error_px"] > 0 for hand in entry["hands"])
        assert all(0 < hand["mean_error_of_hand"] < 0.1 for hand in entry["hands"])
        sheet = f"{source.stem}/{source.stem}.sheet.jpg"
        assert sheet in entry["files"]
        assert f'src="./{sheet}"' in (out / "overview.html").read_text(encoding="utf-8")
        for suffix in (".blend", ".glb"):
            found = read_back(out / source.stem / f"{source.stem}{suffix}")
            assert found["rigs"] == len(entry["hands"])
            assert found["animated"]
            if suffix == ".blend":
                assert found["frames"] == [1, entry["frames"]]
                assert [Path(p).resolve() for p in found["pictures"]] == [source.resolve()]


@pytest.mark.skipif(sys.platform == "win32", reason="SLURM's job file is for bash")
def test_a_job_file_for_a_farm_does_the_plan(take_file, tmp_path):
    """With the wheel alone: the job file starts what has written it."""
    out, takes = tmp_path / "it's ünï", [take_file("wave 1"), take_file("wave#2")]
    (tmp_path / "wave 3.npz").write_bytes(b"no take")

    def told(*words: object) -> subprocess.CompletedProcess[str]:
        command = [sys.executable, SCRIPT, *words]
        return subprocess.run(list(map(str, command)), capture_output=True, text=True, timeout=TIMEOUT)

    plan = Path(told("plan", *takes, tmp_path / "wave 3.npz", "-o", out, "--format", "blend").stdout.strip())
    file = Path(told("farm-template", "slurm", out, "--jobs", "2").stdout.strip())
    assert file == plan.with_suffix(".slurm.sh")

    def in_job(*words: str, **variables: str) -> int:
        return subprocess.run(
            ["bash", file, *words], env={**os.environ, **variables}, timeout=TIMEOUT
        ).returncode

    codes = [in_job("task", SLURM_ARRAY_TASK_ID=place) for place in "01"]
    assert sorted(codes) == [0, 1], "an input that is no take is no reason to be queued again"
    assert in_job("report") == 1
    assert [entry["status"] for entry in report(out)] == ["ok", "ok", "failed"]
    assert (out / "wave#2" / "wave#2.blend").is_file()
    accepted = told("task", plan, "#1-3", "--accept-failed", "--progress", "openjd")
    assert accepted.returncode == 0, accepted.stdout
    assert "openjd_fail: " in accepted.stdout
    assert told("task", plan, "#1-4").returncode == 2


def test_a_folder_may_be_called_as_a_command(batch, tmp_path):
    (tmp_path / "plan").mkdir()
    (tmp_path / "plan" / "a.jpg").write_bytes(b"no photo")
    done = batch("plan", "-o", "out", "--format", "", "--dry-run")
    assert done.returncode == 0, done.stderr
    assert "1 of 1 to do" in done.stdout
    done = batch("plan", "plan", "-o", "out", "--format", "")
    assert done.returncode == 0, done.stderr
    assert plan_in(tmp_path / "out") in done.stdout


def test_a_plan_that_one_machine_does_not_see(batch, tmp_path):
    done = batch("task", tmp_path / "not mounted" / "plans" / "a.json", "#1", "--accept-failed")
    assert done.returncode == 75, done.stderr
    assert batch("work", tmp_path / "not mounted" / "plans" / "a.json").returncode == 2


@needs_capture
def test_two_hands_in_one_photo_are_two_rigs_of_the_right_sides(batch, tmp_path):
    """The bundled right hand beside its mirror image, which is a left hand."""
    photo = tmp_path / "both.png"
    code = (
        "import cv2, sys, numpy as np\n"
        "right = cv2.imread(sys.argv[1])[:, 120:520]\n"
        "cv2.imwrite(sys.argv[2], np.hstack([right[:, ::-1], right]))\n"
    )
    python = os.environ.get("HANDFIT_PYTHON", sys.executable)
    sample = ROOT / "samples" / "rendered_hand" / "hand.0001.jpg"
    subprocess.run([python, "-c", code, str(sample), str(photo)], check=True)
    done = batch(photo, "-o", tmp_path / "out", "--format", "blend,glb,bvh")
    assert done.returncode == 0, done.stdout + done.stderr
    (entry,) = report(tmp_path / "out")
    assert sorted(hand["side"] for hand in entry["hands"]) == ["left", "right"]
    for suffix in (".blend", ".glb"):
        found = read_back(tmp_path / "out" / "both" / f"both{suffix}")
        assert found["suffixes"] == [".L", ".R"]
    for side, ending in (("left", ".L"), ("right", ".R")):
        found = read_back(tmp_path / "out" / "both" / f"both_{side}.bvh")
        assert found["suffixes"] == [ending]


@needs_capture
def test_a_folder_of_numbered_pictures_is_one_sequence(batch, tmp_path):
    folder = tmp_path / "shots"
    folder.mkdir()
    photo = SAMPLES / "photos" / "thumb_up.jpg"
    for number in (7, 8, 10):
        shutil.copy(photo, folder / f"shot.{number:03d}.jpg")
    done = batch(folder, "-o", tmp_path / "out", "--format", "blend")
    assert done.returncode == 0, done.stdout + done.stderr
    (entry,) = report(tmp_path / "out")
    assert (entry["name"], entry["frames"]) == ("shots", 3)
    assert read_back(tmp_path / "out" / "shots" / "shots.blend")["frames"] == [7, 10]
    done = batch(folder, "-o", tmp_path / "out2", "--format", "bvh", "--separate")
    assert done.returncode == 0, done.stdout + done.stderr
    assert [e["name"] for e in report(tmp_path / "out2")] == ["shot.007", "shot.008", "shot.010"]
