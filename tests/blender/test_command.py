"""`blender --command manient`: what it makes of arguments, takes and characters."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import bpy
import numpy as np
import pytest

from blender_manient import command
from blender_manient.common import preferences
from blender_manient.scene.characters import keep_map
from blender_manient.scene.onto_character import MAX_TOUCH_ERROR, motion_of
from blender_manient.scene.store import captured_hands, hand_of
from handfit_core.common.skeleton import FINGER_JOINTS, NUM_JOINTS, SIDES, Side, other_side
from handfit_core.hand_model.poses import ready_poses
from handfit_core.retarget.hand_map import to_preset
from handfit_core.retarget.saved_rigs import rigs_folder, save_rig
from handfit_core.take import Take
from tests.conftest import ROOT

from .characters import BoneSpec, build_armature, hand_specs, joint_name, map_of
from .conftest import READY, action_curves, shown_bones
from .looking import keyed_bones

pytestmark = pytest.mark.usefixtures("registered")


@pytest.fixture
def take_file(make_take, tmp_path) -> Path:
    return make_take(sides=("right",)).take.save(tmp_path / "wave.take.npz")


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
        (["capture"], "INPUT"),
        (["capture", "a.jpg", "-o", "out", "--nonsense"], "--nonsense"),
        (["capture", "a.jpg", "-o", "out", "--format", "obj"], "there is no export format 'obj'"),
    ],
)
def test_wrong_arguments(arguments, expected, capfd, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert command.main(arguments) == 2
    assert expected in capfd.readouterr().err
    assert not (tmp_path / "out").exists()


def test_a_take_becomes_files_and_the_addon_stays(take_file, tmp_path, capfd):
    """Takes need no Python that captures."""
    out = tmp_path / "out"
    preferences.get().python = str(tmp_path / "no-python")
    arguments = ["capture", str(take_file), "--output", str(out), "--format", "blend,bvh", "--no-sheet"]
    assert command.main(arguments) == 0
    (entry,) = report(tmp_path)
    assert entry["status"] == "ok"
    assert entry["files"] == ["wave/wave.take.npz", "wave/wave.blend", "wave/wave.bvh"]
    assert "[1/1] ok: " in capfd.readouterr().out
    assert hasattr(bpy.types.Scene, "manient")
    assert preferences.get().cache_folder == str(tmp_path / "cache")
    bpy.ops.wm.open_mainfile(filepath=str(out / "wave" / "wave.blend"))
    (armature,) = captured_hands(bpy.context.scene)
    assert hand_of(armature).take.frame_numbers.tolist() == Take.load(take_file).frame_numbers.tolist()


def test_no_format_makes_no_file_of_a_take(take_file, tmp_path, capfd):
    arguments = ["capture", str(take_file), "--output", str(tmp_path / "out"), "--format", "", "--no-sheet"]
    assert command.main(arguments) == 0
    assert [entry["files"] for entry in report(tmp_path)] == [["wave/wave.take.npz"]]
    assert "exported" not in capfd.readouterr().out


def test_the_python_is_the_preferences_unless_an_option_names_one(tmp_path, capfd):
    (tmp_path / "a.jpg").write_bytes(b"\xff\xd8\xff")
    preferences.get().python = str(tmp_path / "preferred-python")
    arguments = ["capture", str(tmp_path / "a.jpg"), "-o", str(tmp_path / "out")]
    for options, expected in (([], "preferred-python"), (["--python", "named-python"], "named-python")):
        assert command.main([*arguments, *options]) == 2
        said = capfd.readouterr().err
        assert all(word in said for word in (f"{expected}'", "--python", "preferences"))
    assert not (tmp_path / "out").exists()


def test_ctrl_c_ends_a_check(peer, capfd):
    interrupting = "sys.stdin.readline(); os.kill(os.getppid(), signal.SIGINT); time.sleep(600)"
    preferences.get().python = peer(READY + interrupting)
    assert command.main(["check"]) == 130
    said = capfd.readouterr()
    assert (said.out, said.err) == ("", "stopped\n")


def test_a_check_that_fails_says_why(tmp_path, capfd):
    assert command.main(["check", "--python", str(tmp_path / "no-python")]) == 1
    said = capfd.readouterr()
    assert said.out.startswith(f"The Python '{tmp_path / 'no-python'}' cannot be started")
    assert f"The Python that captures, {tmp_path / 'no-python'}:" in said.out
    assert bpy.app.version_string in said.out
    assert said.err == ""


def test_importing_the_addon_loads_nothing_heavy(tmp_path):
    done = run_python(
        "import sys, bpy, blender_manient, blender_manient.exporters.export_hands, "
        "blender_manient.scene.preview, handfit_core.worker.client;"
        "blender_manient.register();"
        "print([m for m in ('torch', 'scipy', 'cv2', 'mediapipe') if m in sys.modules]);"
        "blender_manient.unregister()",  # the bpy wheel of 4.5 hangs at exit on classes left behind
        tmp_path,
    )
    assert done.stdout.strip().splitlines()[-1] == "[]", done.stderr


def run_python(code: str, folder: Path) -> subprocess.CompletedProcess[str]:
    env = {**os.environ, "PYTHONPATH": str(ROOT)}
    line = [sys.executable, "-c", code]
    return subprocess.run(line, cwd=folder, env=env, capture_output=True, text=True, timeout=120, check=False)


@pytest.fixture
def clip(make_take, tmp_path) -> Path:
    return make_take().take.save(tmp_path / "clip.take.npz")


@pytest.fixture
def hero(tmp_path) -> Path:
    """A character whose bones have names that no table knows, with its tables kept."""
    character()
    path = saved(tmp_path / "hero.blend")
    bpy.ops.wm.read_factory_settings(use_empty=True)
    return path


def character(name: str = "Hero", *, keep: bool = True) -> bpy.types.Object:
    rng = np.random.default_rng(4)
    specs = [BoneSpec("root", "", (0, 0, 0), (0, 0, 1))]
    for side in SIDES:
        x = 1.0 if side == "left" else -1.0
        specs += hand_specs(side, rng, bend=0.4, stretch=0.2, parent="root", place=np.array([x, 0.0, 1.0]))
    armature = build_armature(specs, name)
    if keep:
        for side in SIDES:
            keep_map(armature, map_of(side))
    return armature


def saved(path: Path) -> Path:
    bpy.ops.wm.save_as_mainfile(filepath=str(path), compress=False)
    return path


def apply(tmp_path: Path, *arguments: object, formats: str = "blend") -> int:
    given = [*arguments, "-o", tmp_path / "out", "--format", formats]
    return command.main(["apply", *map(str, given)])


def report(tmp_path: Path) -> list[dict]:
    return json.loads((tmp_path / "out" / "report.json").read_text(encoding="utf-8"))["inputs"]


def opened(path: Path) -> bpy.types.Object:
    bpy.ops.wm.open_mainfile(filepath=str(path))
    return bpy.data.objects["Hero"]


def bends(fingers: list) -> np.ndarray:
    """(5, 2) degrees between the segments of fingers, (5, 4, 3) points; they know neither sides nor palms."""
    along = np.diff(np.array(fingers), axis=1)
    along /= np.linalg.norm(along, axis=-1, keepdims=True)
    return np.degrees(np.arccos(np.sum(along[:, 1:] * along[:, :-1], axis=-1)))


def bends_of(armature: bpy.types.Object, side: Side, frame: int) -> np.ndarray:
    bones = shown_bones(armature, frame)
    chains = [[bones[joint_name(joint, side)] for joint in chain] for chain in FINGER_JOINTS.values()]
    return bends([[*(bone.head for bone in chain), chain[-1].tail] for chain in chains])


def captured_bends(take, number: int, frame: int) -> np.ndarray:
    motion = motion_of(take, take.hands[number])
    joints, tips = motion.source.points(motion.turns[motion.frames == frame])
    return bends([[*joints[0, list(chain)], tips[0, f]] for f, chain in enumerate(FINGER_JOINTS.values())])


@pytest.mark.parametrize(
    ("said", "expected"),
    [
        ((), {"left": 0, "right": 1}),
        (("--hands", "left=1,right=1"), {"left": 0, "right": 0}),
        (("--hands", "both,left=2,right=none"), {"left": 1}),
    ],
)
def test_which_captured_hand_each_hand_gets(make_take, clip, hero, tmp_path, said, expected):
    take = make_take().take
    assert apply(tmp_path, clip, "--to", hero, "--no-contacts", *said) == 0
    (entry,) = report(tmp_path)
    assert {hand["side"]: hand["captured"] - 1 for hand in entry["character"]["hands"]} == expected
    armature = opened(tmp_path / "out" / "clip" / "clip.blend")
    assert keyed_bones(armature) == {
        joint_name(joint, side) for side in expected for joint in range(1, NUM_JOINTS)
    }
    for side, number in expected.items():
        for frame in (3, 8, 17):
            assert np.abs(bends_of(armature, side, frame) - captured_bends(take, number, frame)).max() < 0.1


def test_a_hand_that_was_not_captured_is_left_alone(make_take, clip, hero, tmp_path):
    """Other inputs go on; where it was not asked for by name, it is a warning."""
    left = make_take(sides=("left",)).take.save(tmp_path / "left.take.npz")
    assert apply(tmp_path, left, clip, "--to", hero, "--hands", "left=right,right=none") == 1
    failed, done = report(tmp_path)
    assert failed["error"] == "the character's left hand was left alone: no right hand was captured"
    assert failed["files"] == ["left/left.sheet.jpg", "left/left.take.npz"]
    assert not (tmp_path / "out" / "left" / "left.blend").exists()
    assert (failed["status"], done["status"]) == ("failed", "ok")
    assert done["files"] == ["clip/clip.sheet.jpg", "clip/clip.take.npz", "clip/clip.blend"]
    assert apply(tmp_path, left, "--to", hero, "--overwrite") == 0
    entry = next(entry for entry in report(tmp_path) if entry["name"] == "left")
    assert entry["warnings"] == ["the character's right hand was left alone: no right hand was captured"]


@pytest.mark.slow
def test_contacts_are_kept_unless_it_is_told_otherwise(make_take, hero, tmp_path):
    take = make_take(sides=("right",)).take
    pose = np.tile(ready_poses()["Pinch"].pose.on("right"), (len(take.frame_numbers), 1))
    take = replace(take, hands=(replace(take.hands[0], hand_pose=pose),))
    clip, gaps = take.save(tmp_path / "pinch.take.npz"), {}
    for options in ((), ("--no-contacts",)):
        assert apply(tmp_path, clip, "--to", hero, "--overwrite", *options) == 0
        (entry,) = report(tmp_path)
        told = any("fingertips that touch do not meet" in warning for warning in entry["warnings"])
        assert told == (entry["character"]["hands"][0]["tips_apart"] > MAX_TOUCH_ERROR)
        bones = shown_bones(opened(tmp_path / "out" / "pinch" / "pinch.blend"), 8)
        ends = [bones[joint_name(FINGER_JOINTS[finger][2], "right")].tail for finger in ("thumb", "index")]
        gaps[options] = (ends[0] - ends[1]).length
    _, tips = (motion := motion_of(take, take.hands[0])).source.points(motion.turns[:1])
    wanted = np.linalg.norm(tips[0, 0] - tips[0, 1])
    assert abs(gaps[()] - wanted) < 0.5 * abs(gaps["--no-contacts",] - wanted)


WRONG = [
    (["--to", "nowhere.blend"], "nowhere.blend: there is no such character's file"),
    (["--to", "words.blend"], "words.blend: Blender could not open the character's file"),
    (["--to", "half.blend"], "half.blend: Blender could not open the character's file"),
    (["--to", "later.blend"], "later.blend: the character's file was saved by Blender"),
    (["--to", "hero.blend:Villain"], "there is no armature 'Villain'; choose from Hero"),
    (
        ["--to", "two.blend"],
        "there are several armatures (Hero, Sidekick); name one, as in two.blend:Hero",
    ),
    (["--to", "none.blend"], "there is no armature in its open scene"),
    (["--to", "unknown.blend"], "no left hand was found among the 1 bones of 'Hero'"),
    (["--to", "hero.blend", "--hands", "left=up"], "as in left=right,right=none; got left=up"),
    (["--to", "hero.blend", "--hands", "thumb=left"], "got thumb=left"),
    (["--to", "hero.blend", "--hands", "left=0"], "got left=0"),
    (["--to", "hero.blend", "--hands", "left=none"], "--hands lets no hand of it have motion"),
    (["--to", "hero.blend", "--hands", "all,left=left"], "hands must be one of auto"),
    (
        ["--to", "hero.blend", "--bones", "words.blend"],
        "words.blend: this is no preset of a hand's bones",
    ),
    (["--to", "hero.blend", "--bones", "nowhere.json"], "nowhere.json: No such file"),
    (["--to", "unknown.blend", "--bones", "left.json", "--hands", "left=left"], "there is no bone"),
]


def test_what_cannot_work_is_said_at_once(clip, hero, tmp_path, capfd, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("words.blend").write_text("these are words")
    Path("half.blend").write_bytes(hero.read_bytes()[: hero.stat().st_size // 2])
    Path("left.json").write_text(to_preset([map_of("left")]))
    for name, file in (("Hero", "unknown"), ("Sidekick", "two")):
        build_armature([BoneSpec("root", "", (0, 0, 0), (0, 0, 1))], name)
        saved(tmp_path / f"{file}.blend")
    bpy.ops.wm.read_factory_settings(use_empty=True)
    head = saved(tmp_path / "none.blend").read_bytes()
    assert head.startswith(b"BLENDER")
    at = head.index(b"v") + 1
    newest = b"0999" if head[at : at + 1] == b"0" else b"999"
    Path("later.blend").write_bytes(head[:at] + newest + head[at + len(newest) :])
    for arguments, expected in WRONG:
        assert apply(tmp_path, clip, *arguments) == 2, arguments
        (error,) = (line for line in capfd.readouterr().err.splitlines() if line.startswith("error: "))
        assert expected in error
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    "options", [["--hands", "left=left"], ["--bones", "x"], ["--into", "strip"], ["--no-contacts"]]
)
def test_options_of_a_character_need_one(clip, tmp_path, capfd, options):
    assert command.main(["capture", str(clip), "-o", str(tmp_path / "out"), *options]) == 2
    assert f"{options[0]} " in (said := capfd.readouterr().err)
    assert "name its file with --apply-to" in said
    assert apply(tmp_path, clip) == 2
    assert "--to" in capfd.readouterr().err
    assert not (tmp_path / "out").exists()


def test_the_one_armature_with_a_mesh_is_meant(clip, tmp_path):
    armature = character()
    character("metarig")
    mesh = bpy.data.objects.new("Skin", bpy.data.meshes.new("Skin"))
    bpy.context.collection.objects.link(mesh)
    mesh.modifiers.new("Armature", "ARMATURE").object = armature
    path = saved(tmp_path / "two.blend")
    for named, expected in (("", "Hero"), (":metarig", "metarig")):
        assert apply(tmp_path, clip, "--to", f"{path}{named}", "--overwrite") == 0
        assert [entry["character"]["armature"] for entry in report(tmp_path)] == [expected]


def test_presets_say_which_bones(clip, tmp_path):
    character(keep=False)
    preset = tmp_path / "hero.json"
    preset.write_text(to_preset(map_of(other_side(side)) for side in SIDES), encoding="utf-8")
    assert apply(tmp_path, clip, "--to", saved(tmp_path / "hero.blend"), "--bones", preset) == 0
    assert [hand["bones"] for hand in report(tmp_path)[0]["character"]["hands"]] == [15, 15]


def test_a_saved_rig_is_used_without_a_word(clip, tmp_path, monkeypatch):
    """Its change makes the files anew, and damaged ones are told of."""
    monkeypatch.setenv("HANDFIT_DATA", str(tmp_path / "data"))
    character(keep=False)
    path = saved(tmp_path / "hero.blend")
    tables = [map_of(side) for side in SIDES]
    save_rig(
        "Heroes", [replace(tables[0], bones=(*tables[0].bones[:9], "", *tables[0].bones[10:])), tables[1]]
    )
    assert apply(tmp_path, clip, "--to", path) == 0
    hands = report(tmp_path)[0]["character"]["hands"]
    assert [(hand["rig"], hand["bones"]) for hand in hands] == [
        ("Heroes, your rig", 14),
        ("Heroes, your rig", 15),
    ]
    save_rig("Heroes", tables)
    assert apply(tmp_path, clip, "--to", path, "--overwrite") == 0
    assert [hand["bones"] for hand in report(tmp_path)[0]["character"]["hands"]] == [15, 15]
    (rigs_folder() / "Heroes.json").write_text("[")
    assert apply(tmp_path, clip, "--to", path, "--overwrite") == 0
    (entry,) = report(tmp_path)
    assert "this saved rig is left out, mend or remove it" in entry["warnings"][0]
    assert "your rig" not in entry["character"]["hands"][0]["rig"]


@pytest.mark.parametrize("into", ["strip", "action"])
def test_where_the_keys_go(clip, hero, tmp_path, into):
    armature = opened(hero)
    armature.pose.bones["root"].keyframe_insert("location", frame=1)
    before = armature.animation_data.action.name
    bpy.ops.wm.save_mainfile()
    assert apply(tmp_path, clip, "--to", hero, "--into", into, "--wrist", "turned", "--reference", "6") == 0
    armature = opened(tmp_path / "out" / "clip" / "clip.blend")
    data, wrist = armature.animation_data, joint_name(0, "left")
    rest = armature.data.bones[wrist].matrix_local.to_3x3()
    turned = [rest.inverted() @ shown_bones(armature, frame)[wrist].matrix.to_3x3() for frame in (6, 17)]
    assert turned[0].to_quaternion().angle < 1e-3 < turned[1].to_quaternion().angle
    expected = {"strip": (1, True), "action": (0, True)}
    assert (len(data.nla_tracks), data.action.name == before) == expected[into]


def test_no_script_of_the_file_is_run(clip, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    armature = character()
    text = bpy.data.texts.new("evil.py")
    text.write("open('canary', 'w')\n")
    text.use_module = True
    driver = armature.driver_add("location", 0).driver
    driver.expression = "len([open('canary', 'w')])"
    saved(tmp_path / "evil.blend")
    bpy.ops.wm.read_factory_settings(use_empty=True)
    Path("canary").unlink(missing_ok=True)
    bpy.context.preferences.filepaths.use_scripts_auto_execute = True
    assert apply(tmp_path, clip, "--to", "evil.blend", formats="blend,glb") == 0
    assert not Path("canary").exists()
    (warning,) = report(tmp_path)[0]["warnings"]
    assert "drivers that need Python stand still" in warning


def test_linked_characters(clip, hero, tmp_path, capfd):
    """Overrides get keys and keep their library wherever the result goes; what is only linked is refused."""
    with bpy.data.libraries.load(str(hero), link=True) as (_, loaded):
        loaded.objects = ["Hero"]
    bpy.context.scene.collection.objects.link(bpy.data.objects["Hero"])
    saved(tmp_path / "shot.blend")
    bpy.ops.file.make_paths_relative()
    assert apply(tmp_path, clip, "--to", saved(tmp_path / "shot.blend")) == 2
    assert "make a library override" in capfd.readouterr().err

    opened(tmp_path / "shot.blend").override_create(remap_local_usages=True)
    assert apply(tmp_path, clip, "--to", saved(tmp_path / "shot.blend"), formats="blend,glb") == 0
    armature = opened(tmp_path / "out" / "clip" / "clip.blend")
    (library,) = bpy.data.libraries
    assert library.filepath.startswith("//")
    assert Path(bpy.path.abspath(library.filepath)).resolve() == hero
    assert armature.override_library is not None
    assert len(action_curves(armature.animation_data.action)) >= 15 * 4 * 2

    hero.rename(tmp_path / "moved.blend")
    assert apply(tmp_path, clip, "--to", tmp_path / "shot.blend") == 2
    assert "hero.blend, from which something in it is linked, is not there" in capfd.readouterr().err
