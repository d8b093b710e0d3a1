"""`blender --command manient apply`: what it makes of options, characters and takes."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import bpy
import numpy as np
import pytest

from blender_manient import command
from blender_manient.batch.character import Character
from blender_manient.scene.characters import keep_map
from blender_manient.scene.onto_character import MAX_TOUCH_ERROR, motion_of
from handfit_core.hand_model.poses import ready_poses
from handfit_core.retarget.hand_map import to_preset
from handfit_core.retarget.transfer import globally
from handfit_core.skeleton import FINGER_JOINTS, NUM_JOINTS, SIDES, other_side

from .characters import BoneSpec, build_armature, hand_specs, joint_name, map_of
from .conftest import action_curves

pytestmark = pytest.mark.usefixtures("registered")


@pytest.fixture
def clip(make_take, tmp_path) -> Path:
    return make_take().take.save(tmp_path / "clip.take.npz")


@pytest.fixture
def one_hand(make_take, tmp_path) -> Path:
    return make_take(sides=("left",)).take.save(tmp_path / "left.take.npz")


@pytest.fixture
def hero(tmp_path) -> Path:
    """A character whose bones have names that no table knows, with its tables kept."""
    return saved(tmp_path / "hero.blend")


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
    character()
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    bpy.ops.wm.read_factory_settings(use_empty=True)
    return path


def apply(tmp_path: Path, *arguments: object, formats: str = "blend") -> int:
    given = [*arguments, "-o", tmp_path / "out", "--format", formats]
    return command.main(["apply", *map(str, given)])


def report(tmp_path: Path) -> list[dict]:
    return json.loads((tmp_path / "out" / "report.json").read_text(encoding="utf-8"))["inputs"]


def opened(path: Path) -> bpy.types.Object:
    bpy.ops.wm.open_mainfile(filepath=str(path))
    return bpy.data.objects["Hero"]


def bends(armature: bpy.types.Object, side: str, frame: int) -> np.ndarray:
    """(10,) degrees between a finger's segments, which know neither sides nor palms."""
    bpy.context.scene.frame_set(frame)
    bones = armature.evaluated_get(bpy.context.evaluated_depsgraph_get()).pose.bones
    found = []
    for first, second, third in FINGER_JOINTS.values():
        names = [joint_name(joint, side) for joint in (first, second, third)]  # type: ignore[arg-type]
        along = [np.array(bones[name].tail - bones[name].head) for name in names]
        found += [_angle(along[0], along[1]), _angle(along[1], along[2])]
    return np.array(found)


def captured_bends(take, number: int, frame: int) -> np.ndarray:
    """(10,) as `bends`, of a take's hand."""
    motion = motion_of(take, take.hands[number])
    row = int(np.flatnonzero(motion.frames == frame)[0])
    joints, tips = motion.source.points(motion.turns[row][None])
    found = []
    for finger, chain in enumerate(FINGER_JOINTS.values()):
        points = [*(joints[0, joint] for joint in chain), tips[0, finger]]
        along = np.diff(points, axis=0)
        found += [_angle(along[0], along[1]), _angle(along[1], along[2])]
    return np.array(found)


def _angle(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.degrees(np.arccos(a @ b / np.linalg.norm(a) / np.linalg.norm(b))))


@pytest.mark.parametrize(
    ("said", "expected"),
    [
        ((), {"left": 0, "right": 1}),
        (("--hands", "left=right,right=left"), {"left": 1, "right": 0}),
        (("--hands", "left=1,right=1"), {"left": 0, "right": 0}),
        (("--hands", "right=left"), {"right": 0}),
        (("--hands", "both,left=2,right=none"), {"left": 1}),
    ],
)
def test_which_captured_hand_each_hand_gets(make_take, clip, hero, tmp_path, said, expected):
    take = make_take().take
    assert apply(tmp_path, clip, "--to", hero, "--no-contacts", *said) == 0
    (entry,) = report(tmp_path)
    assert {hand["side"]: hand["captured"] - 1 for hand in entry["character"]["hands"]} == expected
    armature = opened(tmp_path / "out" / "clip" / "clip.blend")
    keyed = {curve.data_path.split('"')[1] for curve in action_curves(armature.animation_data.action)}
    assert keyed == {joint_name(joint, side) for side in expected for joint in range(1, NUM_JOINTS)}
    for side, number in expected.items():
        for frame in (3, 8, 17):
            assert np.abs(bends(armature, side, frame) - captured_bends(take, number, frame)).max() < 0.1


def test_a_take_moves_a_character_as_its_built_hands_do(make_take):
    """What is computed from a take is what is read from the hands that are built of it."""
    from blender_manient.scene.build import build_take
    from blender_manient.scene.onto_character import reading_motion
    from blender_manient.scene.store import hand_of
    from handfit_core.slices import run_to_completion

    take = make_take().take
    built = build_take(take)
    for number, one in enumerate(built.hands):
        hand = hand_of(one.armature)
        assert hand is not None
        read, computed = run_to_completion(reading_motion(hand)), motion_of(take, take.hands[number])
        np.testing.assert_array_equal(read.frames, computed.frames)
        assert len(read.frames) == 16, "gaps are filled"
        np.testing.assert_allclose(globally(read.turns), globally(computed.turns), atol=1e-5)
        np.testing.assert_allclose(read.turns[:, 0], computed.turns[:, 0], atol=1e-5)
        np.testing.assert_allclose(read.places, computed.places, atol=1e-6)


def test_a_hand_that_was_not_captured_is_left_alone_and_other_inputs_go_on(
    one_hand, clip, hero, tmp_path, capfd
):
    wanted = ("--hands", "left=right,right=none")
    assert apply(tmp_path, one_hand, clip, "--to", hero, *wanted) == 1
    failed, done = report(tmp_path)
    assert failed["status"] == "failed"
    assert failed["error"] == "the character's left hand was left alone: no right hand was captured"
    assert failed["files"] == ["left/left.sheet.jpg", "left/left.take.npz"]
    assert done["status"] == "ok"
    assert done["files"] == ["clip/clip.sheet.jpg", "clip/clip.take.npz", "clip/clip.blend"]
    kept = ["left.json", "left.sheet.jpg", "left.take.npz"]
    assert sorted(p.name for p in (tmp_path / "out" / "left").iterdir()) == kept
    assert apply(tmp_path, one_hand, "--to", hero, "--overwrite") == 0
    entry = next(entry for entry in report(tmp_path) if entry["name"] == "left")
    assert entry["warnings"] == ["the character's right hand was left alone: no right hand was captured"]
    assert "Traceback" not in capfd.readouterr().err


def test_contacts_are_kept_unless_it_is_told_otherwise(make_take, hero, tmp_path):
    take = make_take(sides=("right",)).take
    pose = np.tile(ready_poses()["Pinch"].pose.on("right"), (len(take.frame_numbers), 1))
    take = replace(take, hands=(replace(take.hands[0], hand_pose=pose),))
    clip, gaps = take.save(tmp_path / "pinch.take.npz"), {}
    for options in ((), ("--no-contacts",)):
        assert apply(tmp_path, clip, "--to", hero, "--overwrite", *options) == 0
        (entry,) = report(tmp_path)
        (hand,) = entry["character"]["hands"]
        told = any("fingertips that touch do not meet" in warning for warning in entry["warnings"])
        assert told == (hand["tips_apart"] > MAX_TOUCH_ERROR)
        armature = opened(tmp_path / "out" / "pinch" / "pinch.blend")
        bpy.context.scene.frame_set(8)
        bones = armature.evaluated_get(bpy.context.evaluated_depsgraph_get()).pose.bones
        ends = [bones[joint_name(FINGER_JOINTS[finger][2], "right")].tail for finger in ("thumb", "index")]
        gaps[options] = (ends[0] - ends[1]).length
    _, tips = (motion := motion_of(take, take.hands[0])).source.points(motion.turns[:1])
    wanted = np.linalg.norm(tips[0, 0] - tips[0, 1])
    assert abs(gaps[()] - wanted) < 0.5 * abs(gaps["--no-contacts",] - wanted)


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["--to", "nowhere.blend"], "nowhere.blend: there is no such character's file"),
        (["--to", "words.blend"], "words.blend: Blender could not open the character's file"),
        (["--to", "half.blend"], "half.blend: Blender could not open the character's file"),
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
    ],
)
def test_what_cannot_work_is_said_before_any_work(
    clip, hero, tmp_path, capfd, monkeypatch, arguments, expected
):
    monkeypatch.chdir(tmp_path)
    Path("words.blend").write_text("these are words")
    Path("half.blend").write_bytes(hero.read_bytes()[: hero.stat().st_size // 2])
    Path("left.json").write_text(to_preset([map_of("left")]))
    build_armature([BoneSpec("root", "", (0, 0, 0), (0, 0, 1))], "Hero")
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "unknown.blend"))
    build_armature([BoneSpec("root", "", (0, 0, 0), (0, 0, 1))], "Sidekick")
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "two.blend"))
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "none.blend"))
    assert apply(tmp_path, clip, *arguments) == 2
    errors = [line for line in capfd.readouterr().err.splitlines() if line.startswith("error: ")]
    assert len(errors) == 1
    assert expected in errors[0]
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    "options", [["--hands", "left=left"], ["--bones", "x"], ["--into", "strip"], ["--no-contacts"]]
)
def test_options_of_a_character_need_one(clip, tmp_path, capfd, options):
    assert command.main(["capture", str(clip), "-o", str(tmp_path / "out"), *options]) == 2
    assert f"{options[0]} " in (said := capfd.readouterr().err)
    assert "name its file with --apply-to" in said
    assert not (tmp_path / "out").exists()


def test_apply_needs_a_character(clip, tmp_path, capfd):
    assert apply(tmp_path, clip) == 2
    assert "--to" in capfd.readouterr().err


def test_the_one_armature_with_a_mesh_is_meant(clip, tmp_path):
    armature = character()
    character("metarig")
    mesh = bpy.data.objects.new("Skin", bpy.data.meshes.new("Skin"))
    bpy.context.collection.objects.link(mesh)
    mesh.modifiers.new("Armature", "ARMATURE").object = armature
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "two.blend"))
    for named, expected in (("", "Hero"), (":metarig", "metarig")):
        assert apply(tmp_path, clip, "--to", f"{tmp_path / 'two.blend'}{named}", "--overwrite") == 0
        assert [entry["character"]["armature"] for entry in report(tmp_path)] == [expected]


def test_presets_say_which_bones(clip, tmp_path):
    character(keep=False)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "hero.blend"))
    swapped = {side: map_of(other_side(side)) for side in SIDES}
    (tmp_path / "hero.json").write_text(to_preset(swapped.values()), encoding="utf-8")
    assert apply(tmp_path, clip, "--to", tmp_path / "hero.blend", "--bones", tmp_path / "hero.json") == 0
    assert [hand["bones"] for hand in report(tmp_path)[0]["character"]["hands"]] == [15, 15]


@pytest.mark.parametrize("into", ["new", "strip", "action"])
def test_where_the_keys_go(clip, hero, tmp_path, into):
    armature = opened(hero)
    armature.pose.bones["root"].keyframe_insert("location", frame=1)
    before = armature.animation_data.action.name
    bpy.ops.wm.save_mainfile()
    assert apply(tmp_path, clip, "--to", hero, "--into", into) == 0
    data = opened(tmp_path / "out" / "clip" / "clip.blend").animation_data
    assert (len(data.nla_tracks), data.action.name == before) == {
        "new": (1, False),
        "strip": (1, True),
        "action": (0, True),
    }[into]


def test_the_hand_moves_where_it_is_wanted(make_take, clip, hero, tmp_path):
    """By the captured wrist from the marked frame on, as large as the character's palm is."""
    assert apply(tmp_path, clip, "--to", hero, "--wrist", "placed", "--reference", "6") == 0
    armature = opened(tmp_path / "out" / "clip" / "clip.blend")
    take = make_take().take
    for number, side in enumerate(SIDES):
        name = joint_name(0, side)
        motion = motion_of(take, take.hands[number])
        rest = np.array(armature.data.bones[name].matrix_local)[:3, :3]
        marked = int(np.flatnonzero(motion.frames == 6)[0])
        palm = motion.source.joints[4] - motion.source.joints[0]
        knuckle = armature.data.bones[joint_name(4, side)].head_local - armature.data.bones[name].head_local
        size = knuckle.length / np.linalg.norm(palm)
        start = None
        for frame in (6, 3, 17):
            bpy.context.scene.frame_set(frame)
            shown = armature.evaluated_get(bpy.context.evaluated_depsgraph_get()).pose.bones[name]
            if start is None:
                start = np.array(shown.matrix)
                np.testing.assert_allclose(start[:3, :3], rest, atol=1e-4)
            row = int(np.flatnonzero(motion.frames == frame)[0])
            moved = np.linalg.norm(np.array(shown.matrix)[:3, 3] - start[:3, 3])
            assert moved == pytest.approx(
                size * np.linalg.norm(motion.places[row] - motion.places[marked]), abs=1e-4
            )
            turned = motion.turns[row, 0] @ motion.turns[marked, 0].T
            own = np.array(shown.matrix)[:3, :3] @ start[:3, :3].T
            assert np.trace(own) == pytest.approx(np.trace(turned), abs=1e-3)


def test_no_script_of_the_file_is_run(clip, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    armature = character()
    text = bpy.data.texts.new("evil.py")
    text.write("open('canary', 'w')\n")
    text.use_module = True
    driver = armature.driver_add("location", 0).driver
    driver.expression = "len([open('canary', 'w')])"
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "evil.blend"))
    bpy.ops.wm.read_factory_settings(use_empty=True)
    Path("canary").unlink(missing_ok=True)
    bpy.context.preferences.filepaths.use_scripts_auto_execute = True
    assert apply(tmp_path, clip, "--to", "evil.blend", formats="blend,glb") == 0
    assert not Path("canary").exists()
    (warning,) = report(tmp_path)[0]["warnings"]
    assert "drivers that need Python stand still" in warning


def test_linked_characters(clip, hero, tmp_path, capfd):
    """Overrides get keys and keep their library wherever the result goes; what is only linked is refused."""
    scene = bpy.context.scene
    with bpy.data.libraries.load(str(hero), link=True) as (_, loaded):
        loaded.objects = ["Hero"]
    linked = bpy.data.objects["Hero"]
    scene.collection.objects.link(linked)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "linked.blend"))
    bpy.ops.file.make_paths_relative()
    bpy.ops.wm.save_mainfile()
    assert apply(tmp_path, clip, "--to", tmp_path / "linked.blend") == 2
    assert "make a library override" in capfd.readouterr().err

    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "linked.blend"))
    bpy.data.objects["Hero"].override_create(remap_local_usages=True)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "shot.blend"))
    assert apply(tmp_path, clip, "--to", tmp_path / "shot.blend", formats="blend,glb") == 0
    armature = opened(tmp_path / "out" / "clip" / "clip.blend")
    (library,) = bpy.data.libraries
    assert library.filepath.startswith("//")
    assert Path(bpy.path.abspath(library.filepath)).resolve() == hero
    assert armature.override_library is not None
    assert len(action_curves(armature.animation_data.action)) >= 15 * 4 * 2

    hero.rename(tmp_path / "moved.blend")
    assert apply(tmp_path, clip, "--to", tmp_path / "shot.blend") == 2
    assert "hero.blend, from which something in it is linked, is not there" in capfd.readouterr().err


def test_a_file_of_a_newer_blender_is_refused(clip, tmp_path, capfd):
    character()
    path = tmp_path / "newer.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(path), compress=False)
    head = path.read_bytes()
    at = head.index(b"v")
    digits = 3 if head[at + 1 : at + 2] != b"0" else 4
    newest = b"999" if digits == 3 else b"0999"
    path.write_bytes(head[: at + 1] + newest + head[at + 1 + digits :])
    assert apply(tmp_path, clip, "--to", path) == 2
    said = capfd.readouterr().err
    assert "newer.blend" in said
    assert "newer" in said.replace("newer.blend", "")
    assert not (tmp_path / "out").exists()


def test_what_the_options_say():
    import argparse

    from blender_manient.batch.arguments import add_arguments

    parser = argparse.ArgumentParser()
    add_arguments(parser)
    args = parser.parse_args(["a.jpg", "-o", "out", "--hands", "both"])
    assert Character.of_arguments(args) is None
    assert args.hands == "both"
