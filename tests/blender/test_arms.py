"""Arms: two bones behind the wrist, keyed as the take has them, without changing the hand."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import bpy
import numpy as np
import pytest

from blender_manient.exporters import EXPORTERS
from blender_manient.exporters.export_hands import Stage, export_hands
from blender_manient.rigs import rig_of
from blender_manient.rigs.arm import ArmBones, has_arm
from blender_manient.rigs.captured_hand import bone_names
from blender_manient.scene.arms import add_arms
from blender_manient.scene.build import build_take
from blender_manient.scene.keys import read_pose_keys
from blender_manient.scene.onto_character import is_keyframed
from blender_manient.scene.store import captured_take, hand_of, kept_take
from handfit_core.common.errors import OptionError
from handfit_core.common.skeleton import other_side
from handfit_core.hand_model import load_model
from handfit_core.hand_model.forearm import with_wrist, wrist_ring
from tests.capturing import needs_capture
from tests.takes import with_arms

from .conftest import action_curves, evaluated_vertices, shown_bones, world
from .importing import read_back
from .looking import chosen

pytestmark = pytest.mark.usefixtures("registered")

SAMPLE = Path(__file__).resolve().parents[2] / "samples" / "rendered_hand"


@pytest.fixture
def armed(make_take):
    """A take of a right hand with its arm, what was built of it, and the armature, which is active."""
    take = with_arms(make_take(sides=("right",)).take)
    built = build_take(take)
    return take, built, chosen(built.hands[0].armature)


def arm_points(armature, frame=None) -> np.ndarray:
    """(4, 3) world: shoulder, elbow, the forearm's end and the hand's wrist, as they are shown."""
    bones = shown_bones(armature, frame)
    upper, fore = (bones[name] for name in ArmBones(armature).bones)
    wrist = bones[bone_names(armature.manient.side)[0]]
    points = [upper.head, fore.head, fore.tail, wrist.head]
    return np.array([armature.matrix_world @ point for point in points])


def arm_error(hand, arm, frames) -> float:
    """Largest distance in metres of what is shown from an arm whose rows (T,) lie on scene frames (T,)."""
    worst = 0.0
    for row in np.flatnonzero(arm.present):
        wanted = world(np.stack([arm.shoulder[row], arm.elbow[row], arm.wrist[row], arm.wrist[row]]))
        worst = max(worst, np.abs(arm_points(hand.armature, frames[row]) - wanted).max())
    return worst


def keys_of(armature) -> dict[tuple[str, int], list[tuple[float, float]]]:
    """All keys of its action, by curve."""
    curves = action_curves(armature.animation_data.action)
    return {(c.data_path, c.array_index): [tuple(p.co) for p in c.keyframe_points] for c in curves}


def test_it_is_where_the_take_has_it(make_take):
    take = with_arms(make_take().take)
    for hand, track in zip(build_take(take).hands, take.hands, strict=True):
        assert arm_error(hand, track.arm, take.frame_numbers) < 1e-4


def test_added_later_it_is_the_same_and_the_hand_stays(make_take):
    take = make_take(sides=("right",)).take
    built = build_take(take)
    armature = built.hands[0].armature
    bone = armature.pose.bones[bone_names("right")[2]]
    bone.rotation_quaternion = (0.9, 0.1, 0.2, 0.3)
    bone.keyframe_insert("rotation_quaternion", frame=9)
    before = keys_of(armature)
    found = with_arms(take)
    add_arms(built.collection, found)
    assert {path: keys for path, keys in keys_of(armature).items() if path in before} == before
    assert arm_error(built.hands[0], found.hands[0].arm, take.frame_numbers) < 1e-4
    assert kept_take(built.collection).hands[0].arm is not None
    with pytest.raises(OptionError, match="already"):
        add_arms(built.collection, found)


@pytest.mark.parametrize("later", [False, True])
def test_fewer_keys_and_all_of_them(make_take, later: bool):
    """Of arms that are there, and of those that are added behind fewer keys."""
    take = make_take(sides=("right",)).take
    found = with_arms(take)
    arm = found.hands[0].arm
    assert arm is not None
    elbow = arm.wrist + [0.25, 0.0, 0.0]
    arm = replace(arm, elbow=elbow, shoulder=elbow - [0.0, 0.28, 0.0])  # which turns nowhere
    found = replace(found, hands=(replace(found.hands[0], arm=arm),))
    built = build_take(take if later else found)
    armature = bpy.context.view_layer.objects.active = built.hands[0].armature
    assert bpy.ops.manient.simplify_keys() == {"FINISHED"}
    if later:
        add_arms(built.collection, found)
    else:
        few = read_pose_keys(ArmBones(armature)).rotation_keyed.sum(axis=0)
        assert few.max() < arm.present.sum()
    for operator in (lambda: {"FINISHED"}, bpy.ops.manient.restore_keys):
        assert operator() == {"FINISHED"}
        assert arm_error(built.hands[0], arm, take.frame_numbers) < 2e-2


@pytest.mark.parametrize("when", ["captured", "added later", "taken away again"])
def test_the_skin_behind_the_wrist_follows_it(make_take, when: str):
    """To the elbow, and without wringing where the hand is twisted; without an arm it is the hand's."""
    take = make_take(sides=("right",)).take
    found = with_arms(take)
    arm = found.hands[0].arm
    assert arm is not None
    along = arm.elbow - arm.wrist
    side = np.cross(along, [0.0, 0.0, 1.0])
    side *= 0.25 / np.linalg.norm(side, axis=1, keepdims=True)
    turn = 0.8 * side - 0.4 * along  # by 53 degrees
    bent = replace(arm, elbow=arm.elbow + turn, shoulder=arm.shoulder + turn)
    found = replace(found, hands=(replace(found.hands[0], arm=bent),))
    built = build_take(take if when == "added later" else found)
    armature, mesh = built.hands[0].armature, built.hands[0].mesh
    if when == "added later":
        assert armature.manient.wrist == "cap"
        add_arms(built.collection, found)
    assert armature.manient.wrist == "forearm"
    if when == "taken away again":
        bpy.context.view_layer.objects.active = armature
        bpy.ops.object.mode_set(mode="EDIT")
        bpy.ops.armature.select_all(action="DESELECT")
        for name in ArmBones(armature).bones:
            bone = armature.data.edit_bones[name]
            bone.select = bone.select_head = bone.select_tail = True
        bpy.ops.armature.delete()
        bpy.ops.object.mode_set(mode="OBJECT")
        bent = arm
    model, betas = load_model("open-hand", "right"), take.hands[0].betas
    flat = with_wrist(model, "forearm").shaped(betas).vertices
    added = slice(-1 - 3 * len(wrist_ring(model.polygons)), -1)  # the last three rings
    for row in np.flatnonzero(arm.present):
        bpy.context.scene.frame_set(int(take.frame_numbers[row]))
        ring = evaluated_vertices(mesh)[added]
        wrist, elbow = world(bent.wrist[row]), world(bent.elbow[row])
        axes = [ring.mean(axis=0) - wrist, elbow - wrist]
        cosine = np.dot(*axes) / np.prod(np.linalg.norm(axes, axis=1))
        assert cosine > np.cos(np.radians(8.0))
        apart, expected = (np.linalg.norm(points - points[0], axis=1) for points in (ring, flat[added]))
        np.testing.assert_allclose(apart, expected, atol=1e-3)
    armature.manient.forearm = False
    assert np.linalg.norm(evaluated_vertices(mesh)[added] - wrist, axis=1).max() < 0.05


def test_a_retimed_clip_has_it_at_the_scenes_rate(make_take, picture):
    source = replace(make_take().take.source, kind="video")
    take = make_take(sides=("right",), frame_numbers=np.arange(1, 13), source=source).take
    bpy.context.scene.render.fps = 60
    built = build_take(take, match_scene=False, frame=1.0, picture=False)
    found = with_arms(take)
    add_arms(built.collection, found)
    assert captured_take(built.collection).hands[0].arm is not None
    assert arm_error(built.hands[0], found.hands[0].arm, 1.0 + 2.0 * np.arange(12)) < 1e-3


def test_without_one_the_take_says_why(make_take):
    take = make_take(sides=("right",)).take
    built = build_take(take)
    add_arms(built.collection, with_arms(take, "no arm: no body is in the picture"))
    assert not has_arm(built.hands[0].armature)
    assert "no body" in kept_take(built.collection).hands[0].no_arm
    with pytest.raises(RuntimeError, match="no body"):
        bpy.ops.manient.add_arms(hand=built.hands[0].armature.name)


def test_deleted_in_edit_mode_it_is_gone_until_it_is_added_again(armed, tmp_path: Path):
    """Which is how an artist is rid of a bad one; the hand, and what is made of it, do without."""
    take, built, armature = armed
    hand_keys = read_pose_keys(rig_of(armature))
    bpy.ops.object.mode_set(mode="EDIT")
    for name in ArmBones(armature).bones:
        armature.data.edit_bones.remove(armature.data.edit_bones[name])
    bpy.ops.object.mode_set(mode="OBJECT")
    assert not has_arm(armature)
    assert bpy.ops.manient.simplify_keys() == bpy.ops.manient.restore_keys() == {"FINISHED"}
    np.testing.assert_array_equal(read_pose_keys(rig_of(armature)).frames, hand_keys.frames)
    (file,) = export_hands(built.hands, Stage.of_take(take), tmp_path, "hands", "bvh")
    assert "wrist" in (text := file.read_text())
    assert "arm" not in text
    assert bpy.ops.manient.add_arms(hand=armature.name) == {"FINISHED"}
    assert arm_error(built.hands[0], take.hands[0].arm, take.frame_numbers) < 1e-4


def test_controls_come_and_go_beside_it(armed):
    _, _, armature = armed
    for operator in (bpy.ops.manient.add_controls, bpy.ops.manient.remove_controls):
        assert operator() == {"FINISHED"}
        assert is_keyframed(rig_of(armature, "right"))
    forearm = armature.pose.bones[ArmBones(armature).bones[1]]
    assert [constraint.type for constraint in forearm.constraints] == ["IK"]


CHANGES = {
    "origin": lambda: bpy.ops.manient.origin_to_wrist(),
    "controls": lambda: bpy.ops.manient.add_controls(),
    "mirror": lambda: bpy.ops.manient.mirror_hand(),
}


@pytest.mark.parametrize("change", CHANGES)
def test_it_stays_where_it_is(armed, change):
    take, built, _ = armed
    assert CHANGES[change]() == {"FINISHED"}
    assert arm_error(built.hands[0], take.hands[0].arm, take.frame_numbers) < 1e-4


def test_the_mirrored_hand_has_the_mirrored_arm(make_take):
    made = make_take(sides=("right",))
    made.take.hands[0].transl[:, 0] += 0.6
    made.take.hands[0].joints_3d[:, :, 0] += 0.6
    take = with_arms(made.take)
    built = build_take(take)
    bpy.context.view_layer.objects.active = built.hands[0].armature
    bpy.ops.manient.mirror_hand()
    other = bpy.context.view_layer.objects.active
    assert other.manient.side == other_side("right")
    for frame in (3, 8, 18):
        mirrored = arm_points(built.hands[0].armature, frame) * [-1.0, 1.0, 1.0]
        np.testing.assert_allclose(arm_points(other), mirrored, atol=1e-4)


def test_what_moves_the_hand_takes_it_along(armed):
    """Nearer to the shoulder, so that it can be reached; the shoulder stays."""
    _, _, armature = armed
    before = arm_points(armature, 8)
    toward = 0.1 * (before[0] - before[3])
    wrist = armature.pose.bones[bone_names("right")[0]]
    along = np.array(wrist.bone.matrix_local.to_3x3()).T @ toward
    for curve in action_curves(armature.animation_data.action):
        if curve.data_path == f'pose.bones["{wrist.name}"].location':
            for point in curve.keyframe_points:
                point.co.y += along[curve.array_index]
            curve.update()
    bpy.context.scene.frame_set(9)
    after = arm_points(armature, 8)
    np.testing.assert_allclose(after[0], before[0], atol=1e-5)
    assert np.linalg.norm(after[3] - before[3]) > 0.01
    np.testing.assert_allclose(after[2], after[3], atol=2e-3)


@pytest.mark.parametrize("fmt", [name for name in ("fbx", "glb", "bvh", "usd", "blend") if name in EXPORTERS])
def test_files_have_the_hand_hang_on_it(armed, tmp_path: Path, fmt: str):
    if why := EXPORTERS[fmt].why_not():
        pytest.skip(why)
    take, built, _ = armed
    whole = (built.collection, built.camera) if fmt == "blend" else None
    frames = take.frame_numbers[take.hands[0].present]
    wanted = {int(frame): arm_points(built.hands[0].armature, frame) for frame in frames}
    files = export_hands(built.hands, Stage.of_take(take), tmp_path, "hands", fmt, whole=whole)
    read_back(*files, first=int(take.frame_numbers[0]), fps=30)
    suffix = "_R" if fmt == "usd" else ".R"
    (armature,) = [o for o in bpy.data.objects if o.type == "ARMATURE"]
    bones = {name: armature.data.bones[name + suffix] for name in ("upper_arm", "forearm", "wrist")}
    assert bones["forearm"].parent == bones["upper_arm"]
    if fmt != "blend":
        assert bones["wrist"].parent == bones["forearm"]
    for frame, points in wanted.items():
        shown = shown_bones(armature, frame)
        heads = [armature.matrix_world @ shown[bone.name].head for bone in bones.values()]
        np.testing.assert_allclose(heads, points[[0, 1, 3]], atol=5e-4)


@needs_capture
@pytest.mark.parametrize("at_once", [True, False])
def test_a_hand_without_a_body_gets_none(at_once: bool):
    """In a capture, and afterwards."""
    settings = bpy.context.scene.manient
    settings.source, settings.arms = str(SAMPLE / "hand.0001.jpg"), at_once
    assert bpy.ops.manient.capture() == {"FINISHED"}
    armature = bpy.context.view_layer.objects.active
    if not at_once:
        assert bpy.ops.manient.add_arms() == {"FINISHED"}
    hand = hand_of(armature)
    assert hand is not None
    assert hand.track.no_arm
    assert not has_arm(armature)
