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

from tests.installed.sealed import ROOT, processes_with, without_network

CHROOT = os.environ.get("HANDFIT_BLENDER_CHROOT")
MARK = "MANIENT_COMMAND_TEST"
TIMEOUT = 400.0
BLENDERS_OWN = "*/blender/*/config/*", "*/blender/*/extensions/.cache/compat.dat", "*/.cache/thumbnails/*"
"""What Blender leaves, whatever was installed"""

pytestmark = pytest.mark.skipif(
    not CHROOT, reason="HANDFIT_BLENDER_CHROOT does not name a chroot with Blender in it"
)

HERO = """
import bpy
data = bpy.data.armatures.new("Hero")
hero = bpy.data.objects.new("Hero", data)
bpy.context.collection.objects.link(hero)
bpy.context.view_layer.objects.active = hero
bpy.ops.object.mode_set(mode="EDIT")

def bone(name, parent, *places):
    made = data.edit_bones.new("mixamorig:LeftHand" + name)
    made.head, made.tail = places
    made.parent = parent
    return made

hand = bone("", None, (0, 0, 0), (1, 0, 0))
for number, finger in enumerate(("Thumb", "Index", "Middle", "Ring", "Pinky")):
    above, x, y = hand, 0.2 if finger == "Thumb" else 1.0, 0.3 * (2 - number)
    for joint in range(3):
        above = bone(f"{finger}{joint + 1}", above, (x + 0.3 * joint, y, 0), (x + 0.3 * joint + 0.3, y, 0))
bpy.ops.object.mode_set(mode="OBJECT")
bpy.ops.wm.save_as_mainfile(filepath="hero.blend")
"""
"""Makes a character with a left hand, as in the photo"""

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
  --frames 1-20 --preview --timeout 200
cp -r results again
run again manient capture photo.jpg clip.mp4 --output again --format blend,bvh --frames 1-20 --jobs 2
run take manient capture results/photo/photo.take.npz --output take --format bvh
run gone_command manient plan photo.jpg --output planned
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
def commands(zipped: Path, samples: Path, tmp_path_factory: pytest.TempPathFactory) -> Commands:
    folder = tmp_path_factory.mktemp("command")
    shutil.copy(samples / "photos" / "thumb_up.jpg", folder / "photo.jpg")
    shutil.copy(samples / "videos" / "asl_hand.mp4", folder / "clip.mp4")
    (folder / "hero.py").write_text(HERO)
    mark = uuid.uuid4().hex
    done = subprocess.run(
        [*without_network(), str(ROOT / "scripts" / "chroot_blender.sh"), str(Path(CHROOT or "").resolve()),
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


def test_blender_validates_and_installs_it(commands):
    assert commands["validate"].code == 0, commands["validate"].out
    assert commands["install"].code == 0
    assert "Installed" in commands["install"].out


def test_help_and_wrong_arguments(commands):
    assert commands["help"].code == 0
    assert commands["help"].out.startswith("usage: blender --command manient capture")
    assert commands["wrong"].code == 2
    assert "--output" in commands["wrong"].err


def test_check(commands):
    assert commands["check"].code == 0
    assert "Everything works." in commands["check"].out
    assert "FAILED" not in commands["check"].out
    assert "hand_landmarks_2020.tflite in " in commands["check"].out


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
    assert "Traceback" not in commands["capture"].err


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


def test_a_command_that_went_says_what_does_it_now(commands):
    assert commands["gone_command"].code == 2
    assert "there is no command plan any more; " in commands["gone_command"].err
    assert not (commands.folder / "planned").exists()


def test_a_take_goes_onto_a_character(commands):
    assert commands["apply"].code == 0, commands["apply"].err
    (entry,) = commands.report("applied")
    endings = (".blend", ".fbx", ".sheet.jpg", ".take.npz")
    assert sorted(entry["files"]) == [f"photo/photo{ending}" for ending in endings]
    (hand,) = entry["character"]["hands"]
    assert (hand["side"], hand["rig"], hand["bones"], hand["frames"]) == ("left", "Mixamo", 15, 1)


def test_ctrl_c_keeps_what_was_finished_and_ends_the_worker(commands):
    assert commands["stopped"].code == 130
    assert "what was finished is kept" in commands["stopped"].err
    assert [entry["status"] for entry in commands.report("stopped")] == ["pending", "pending"]
    assert processes_with(f"{MARK}={commands.mark}") == []


@pytest.mark.parametrize("step", ["damaged", "damaged_capture"])
def test_a_damaged_installation_says_so(commands, step):
    assert commands[step].code == 1
    errors = [line for line in commands[step].err.splitlines() if line.startswith("error: ")]
    assert len(errors) == 1
    assert "handfit" in errors[0]
    assert not (commands.folder / "damaged").exists()


def test_removing_it_leaves_no_file_and_no_command(commands):
    assert commands["remove"].code == 0
    assert commands["gone"].code != 0
    left = (commands.folder / "left").read_text().splitlines()
    assert [name for name in left if not any(fnmatch(name, own) for own in BLENDERS_OWN)] == []
