"""With the zip alone, on the real Blender's command line: install it, `--command manient`, remove it.

That its window captures with it is in tests/window.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import uuid
from dataclasses import dataclass
from fnmatch import fnmatch
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
CHROOT = os.environ.get("HANDFIT_BLENDER_CHROOT")
MARK = "MANIENT_COMMAND_TEST"
TIMEOUT = 1500.0
BLENDERS_OWN = "*/blender/*/config/*", "*/blender/*/extensions/.cache/compat.dat", "*/.cache/thumbnails/*"
"""What Blender leaves, whatever was installed"""

pytestmark = pytest.mark.skipif(
    not CHROOT, reason="HANDFIT_BLENDER_CHROOT does not name a chroot with Blender in it"
)

HERO = """
import addon_utils, bpy
addon_utils.enable("rigify")
bpy.ops.object.armature_human_metarig_add()
bpy.ops.wm.save_as_mainfile(filepath="hero.blend")
"""
"""Makes a character: Rigify's human, before anything is generated of it"""

STEPS = """
run() {
  step=$1; shift
  blender --command "$@" >"$step.out" 2>"$step.err" && code=0 || code=$?
  echo "$code" >"$step.code"
}
run validate extension validate "$ZIP"
run install extension install-file -r user_default --enable "$ZIP"
run help manient capture --help
run wrong manient capture photo.jpg
run check manient check
run capture manient capture photo.jpg clip.mp4 nowhere.jpg --output results --format blend,glb,fbx \
  --frames 1-20 --preview
cp -r results again
run again manient capture photo.jpg clip.mp4 --output again --format blend,bvh --frames 1-20 --jobs 2
run take manient capture results/photo/photo.take.npz --output take --format bvh
blender -b -P hero.py
run apply manient apply results/photo/photo.take.npz --to hero.blend --output applied --format blend,fbx

blender --command manient capture clip.mp4 photo.jpg --output stopped --jobs 1 >stopped.out 2>stopped.err &
while ! ls -d stopped/.part-* >/dev/null 2>&1; do sleep 0.1; done
sleep 1
kill -INT $!
wait $! && code=0 || code=$?
echo "$code" >stopped.code

core=$(echo "$HOME"/.config/blender/*/extensions/.local/lib/python*/site-packages/handfit_core)
mv "$core" moved
run damaged manient check
run damaged_capture manient capture photo.jpg --output damaged
mv moved "$core"
run remove extension remove manient
run gone manient check
find "$HOME"/.[!.]* -type f >left
"""


@dataclass(frozen=True)
class Step:
    """What one command ended with and said."""

    code: int
    out: str
    err: str


@dataclass(frozen=True)
class Commands:
    """The folder in which the commands ran, and what they said."""

    folder: Path
    mark: str
    log: str

    def __getitem__(self, step: str) -> Step:
        path = self.folder / f"{step}.code"
        assert path.is_file(), f"it did not get as far as {step!r}:\n{self.log[-4000:]}"
        out, err = (
            (self.folder / f"{step}.{stream}").read_text(encoding="utf-8", errors="replace")
            for stream in ("out", "err")
        )
        return Step(int(path.read_text()), out, err)

    def report(self, folder: str) -> list[dict]:
        return json.loads((self.folder / folder / "report.json").read_text(encoding="utf-8"))["inputs"]


@pytest.fixture(scope="module")
def commands(zipped: Path, samples: Path, without_network, tmp_path_factory) -> Commands:
    folder = tmp_path_factory.mktemp("command")
    shutil.copy(samples / "photos" / "thumb_up.jpg", folder / "photo.jpg")
    shutil.copy(samples / "videos" / "asl_hand.mp4", folder / "clip.mp4")
    (folder / "hero.py").write_text(HERO)
    mark = uuid.uuid4().hex
    done = subprocess.run(
        [*without_network, str(ROOT / "scripts" / "chroot_blender.sh"), str(Path(CHROOT or "").resolve()),
         "env", "-u", "HANDFIT_CACHE", f"ZIP={zipped}", f"{MARK}={mark}", "sh", "-eu", "-c", STEPS],
        cwd=folder,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        errors="replace",
        env={**os.environ, "CHROOT_SEALED": "1", "CHROOT_BIND": f"{folder}:{zipped.parent}"},
        check=False,
        timeout=TIMEOUT,
    )  # fmt: skip
    return Commands(folder, mark, done.stdout)


@pytest.mark.parametrize(
    ("step", "code", "out", "err"),
    [
        ("validate", 0, "", ""),
        ("install", 0, "Installed", ""),
        ("help", 0, "usage: blender --command manient capture", ""),
        ("wrong", 2, "", "--output"),
        ("check", 0, "Everything works\n", ""),
        ("stopped", 130, "", "what was finished is kept"),
        ("damaged", 1, "handfit_core not loaded", "error: "),
        ("damaged_capture", 1, "", "error: "),
        ("remove", 0, "", ""),
    ],
)
def test_what_a_command_ends_with_and_says(commands, step, code, out, err):
    found = commands[step]
    assert found.code == code, found
    assert out in found.out
    assert err in found.err
    assert "Traceback" not in found.err


def test_a_photo_and_a_video_become_files(commands):
    assert commands["capture"].code == 1  # one of the inputs is not there
    photo, clip, nowhere = commands.report("results")
    assert [entry["status"] for entry in (photo, clip, nowhere)] == ["ok", "ok", "failed"]
    assert "no such file" in nowhere["error"]
    assert [(h["side"], h["detected"]) for h in photo["hands"]] == [("left", 1)]
    assert [(h["side"], h["detected"]) for h in clip["hands"]] == [("right", 20)]
    for entry in (photo, clip):
        name = entry["name"]
        endings = (".take.npz", ".sheet.jpg", ".blend", ".glb", ".fbx", ".preview.png")
        assert sorted(entry["files"]) == sorted(f"{name}/{name}{ending}" for ending in endings)
        sizes = [(commands.folder / "results" / file).stat().st_size for file in entry["files"]]
        assert min(sizes) > 1000, sizes
    told = [
        line.partition(":")[0].split() for line in commands["capture"].out.splitlines() if line[:1] == "["
    ]
    assert [number for number, _ in told] == ["[1/3]", "[2/3]", "[3/3]"]
    assert sorted(status for _, status in told) == ["failed", "ok", "ok"]


def test_the_same_line_with_another_format_only_makes_that(commands):
    assert commands["again"].code == 0, commands["again"].err
    exported = [line for line in commands["again"].out.splitlines() if line.startswith("exported: ")]
    assert sorted(exported) == ["exported: clip.mp4", "exported: photo.jpg"]
    for name in ("photo", "clip"):
        assert (commands.folder / "again" / name / f"{name}.bvh").is_file()


def test_a_take_becomes_other_files(commands):
    assert commands["take"].code == 0, commands["take"].err
    (entry,) = commands.report("take")
    assert sorted(entry["files"]) == [f"photo/photo{e}" for e in (".bvh", ".sheet.jpg", ".take.npz")]


def test_a_take_goes_onto_a_character(commands):
    assert commands["apply"].code == 0, commands["apply"].err
    (entry,) = commands.report("applied")
    endings = (".blend", ".fbx", ".sheet.jpg", ".take.npz")
    assert sorted(entry["files"]) == [f"photo/photo{ending}" for ending in endings]
    (hand,) = entry["character"]["hands"]
    assert (hand["side"], hand["rig"], hand["bones"], hand["frames"]) == ("left", "Rigify bones", 15, 1)


def test_ctrl_c_ends_the_worker(commands, processes_with):
    assert [entry["status"] for entry in commands.report("stopped")] == ["pending", "pending"]
    assert processes_with(f"{MARK}={commands.mark}") == []


def test_a_damaged_installation_says_so_once_and_makes_nothing(commands):
    for step in ("damaged", "damaged_capture"):
        (error,) = [line for line in commands[step].err.splitlines() if line.startswith("error: ")]
        assert "The add-on is not whole: remove it and install the zip again" in error
    assert not (commands.folder / "damaged").exists()


def test_removing_it_leaves_no_file_and_no_command(commands):
    assert commands["gone"].code != 0
    left = (commands.folder / "left").read_text().splitlines()
    assert [name for name in left if not any(fnmatch(name, own) for own in BLENDERS_OWN)] == []
