"""What follows by and by, in its own steps: a character that is linked to a hand, and how its hand moves."""

from __future__ import annotations

import time

import bpy
import numpy as np
import pytest

from blender_manient.panels.character import MANIENT_PT_character
from blender_manient.rigs.captured_hand import bone_names
from blender_manient.scene.hand_motion import MARK, written_keys
from blender_manient.scene.keys import PoseKeys, pose_at, remove_pose_keys, write_pose_keys
from blender_manient.scene.store import hand_of
from blender_manient.session import followers, hand_adjusting, live_link
from tests.drawn import drawn

from .characters import joint_name, one_handed
from .conftest import action_curves, shown_bones
from .looking import directions, directions_apart

pytestmark = pytest.mark.usefixtures("registered")

NAMES = [joint_name(j, "right") for j in range(16)]


@pytest.fixture
def linked(hand):
    """A captured hand, and a character that follows it."""
    target = one_handed(bend=0.4, stretch=0.2)
    target.manient.character.live = True
    settle()
    assert live_link.trouble(target) is None
    return hand, target


def settle() -> None:
    """Have all be done that would be by and by: timers do not run without a window."""
    bpy.context.view_layer.update()
    for _ in range(400):
        if [step() for step in (live_link.step, hand_adjusting.step)] == [None, None]:
            return
        time.sleep(0.01)
    raise AssertionError("it does not end")


def curl(hand, frame, turn=0.4):
    """Key another pose of the index finger, as a correction would."""
    quats, _ = pose_at(hand.rig, np.array([float(frame)]))
    half = 0.5 * turn
    quats[0, 1] = [np.cos(half), np.sin(half), 0.0, 0.0]
    keyed = np.zeros((1, 16), dtype=bool)
    keyed[0, 1] = True
    write_pose_keys(
        hand.rig, PoseKeys(np.array([float(frame)]), quats, np.zeros((1, 3)), keyed, np.zeros(1, bool))
    )


def values(target):
    return {
        (c.data_path, c.array_index): [tuple(k.co) for k in c.keyframe_points]
        for c in action_curves(target.animation_data.action)
    }


def alike(hand, target, frame):
    shown = directions(target, NAMES, frame), directions(hand.armature, bone_names("right"), frame)
    return directions_apart(*shown) < 0.1


def test_an_offset_in_time_moves_all_keys(linked):
    hand, target = linked
    before = {curve: [frame for frame, _ in keys] for curve, keys in values(target).items()}
    target.manient.character.time_offset = 4
    settle()
    after = {curve: [frame - 4.0 for frame, _ in keys] for curve, keys in values(target).items()}
    assert after == before
    shown = directions(target, NAMES, 12), directions(hand.armature, bone_names("right"), 8)
    assert directions_apart(*shown) < 0.1


def test_switched_on_it_shows_this_frame_before_it_keys_all(hand, monkeypatch):
    target = one_handed(bend=0.4, stretch=0.2)
    bpy.context.scene.frame_set(6)
    monkeypatch.setattr(followers, "slice_clock", lambda: lambda: True)
    target.manient.character.live = True
    assert live_link.step() is not None
    assert target.manient.character.right.source == hand.armature
    assert target.animation_data is None, "a key"
    assert alike(hand, target, 6)
    assert live_link.keying_progress(target) is None
    live_link.step()
    assert live_link.keying_progress(target) == 0.0
    settle()
    assert live_link.keying_progress(target) is None
    assert all(alike(hand, target, frame) for frame in (3, 6, 9))


def own_key(target):
    """Key a bone as an artist does; then all keys."""
    own = target.pose.bones[NAMES[2]]
    own.rotation_quaternion = (0.8, 0.6, 0.0, 0.0)
    own.keyframe_insert("rotation_quaternion", frame=8)
    return values(target)


def test_changed_keys_follow_and_own_keys_elsewhere_stay(linked):
    hand, target = linked
    before = own_key(target)
    curl(hand, 5)
    settle()
    assert alike(hand, target, 5)
    changed = {
        (path.split('"')[1], key[0])
        for (path, index), keys in values(target).items()
        for key in keys
        if key not in before[path, index]
    }
    assert changed == {(NAMES[1], 5.0)}
    remove_pose_keys(hand.rig, 15, 40)
    settle()
    assert max(key[0] for keys in values(target).values() for key in keys) == 14


def test_nothing_is_keyed_again_in_a_loaded_file(linked, tmp_path):
    before = own_key(linked[1])
    path = str(tmp_path / "live.blend")
    bpy.ops.wm.save_as_mainfile(filepath=path)
    bpy.ops.wm.open_mainfile(filepath=path)
    target = bpy.data.objects["Character"]
    settle()
    assert values(target) == before
    hand = hand_of(target.manient.character.right.source)
    curl(hand, 5, 0.7)
    settle()
    assert alike(hand, target, 5)


def test_another_action_is_not_written_to(linked):
    """What went wrong with one character stays told while another one follows."""
    hand, target = linked
    other = one_handed(seed=4, name="Other")
    other.manient.character.live = True
    settle()
    target.animation_data.action = bpy.data.actions.new("mine")
    target.pose.bones[NAMES[3]].keyframe_insert("rotation_quaternion", frame=4)
    before = values(target)
    curl(hand, 5)
    settle()
    live_link._links[other.session_uid].changed = 0.0
    settle()
    assert "another action" in live_link.trouble(target)
    assert values(target) == before
    assert live_link.trouble(other) is None
    other.manient.character.live = False
    before = values(other)
    curl(hand, 5, 0.7)
    settle()
    assert values(other) == before


@pytest.fixture(params=["STRIP", *(pytest.param(into, marks=pytest.mark.slow) for into in ("NEW", "ACTION"))])
def target(hand, request):
    """A character whose hand moves as a captured one from frame 3 on; it is ten times as large."""
    target = one_handed(scale=10.0)
    character = target.manient.character
    character.right.source = hand.armature
    character.into, character.wrist, character.reference = request.param, "PLACED", 3
    assert bpy.ops.manient.apply_to_character() == {"FINISHED"}
    return target


def matrices(target, frames=(3, 6, 12)) -> np.ndarray:
    """(N, 4, 4) how the hand is shown."""
    return np.array([np.array(shown_bones(target, frame)[NAMES[0]].matrix) for frame in frames])


def places(target, frames=(3, 6, 12)) -> np.ndarray:
    """(N, 3) where the hand is shown."""
    return matrices(target, frames)[:, :3, 3]


def test_travel_is_scaled_again_and_again_about_the_marked_frame(target):
    before, actions = matrices(target), len(bpy.data.actions)
    for travel in (0.5, 2.0, 0.0, 1.0):
        target.manient.character.travel = travel
        settle()
        found = matrices(target)
        expected = before[0, :3, 3] + travel * (before - before[0])[:, :3, 3]
        np.testing.assert_allclose(found[:, :3, 3], expected, atol=1e-4)
        np.testing.assert_allclose(found[:, :3, :3], before[:, :3, :3], atol=1e-4)
    assert len(bpy.data.actions) == actions
    assert hand_adjusting.message(target) is None


def test_any_frame_can_be_marked(target):
    """The hand stands there as it did, and goes less far from there on."""
    before = places(target)
    bpy.context.view_layer.objects.active = target
    bpy.context.scene.frame_set(12)
    assert bpy.ops.manient.mark_frame() == {"FINISHED"}
    settle()
    np.testing.assert_allclose(places(target), before, atol=1e-4)
    target.manient.character.travel = 0.5
    settle()
    np.testing.assert_allclose(places(target), before[2] + 0.5 * (before - before[2]), atol=1e-4)
    target.manient.character.reference = 400
    settle()
    assert "marked frame 400" in drawn(MANIENT_PT_character).loud
    np.testing.assert_allclose(places(target), before[2] + 0.5 * (before - before[2]), atol=1e-4)


def test_smoothing_takes_out_what_shakes_and_comes_back(target):
    frames = range(3, 16)
    before = places(target, frames)
    target.manient.character.smoothing = 8
    settle()
    after = places(target, frames)
    np.testing.assert_allclose(after[0], before[0], atol=1e-5)  # the marked frame
    rough, smooth = (np.abs(np.diff(found, n=2, axis=0)).sum() for found in (before, after))
    assert smooth < 0.5 * rough
    target.manient.character.smoothing = 0
    settle()
    np.testing.assert_allclose(places(target, frames), before, atol=1e-4)


def test_a_dragged_offset_moves_all_of_it(target):
    before = places(target)
    bpy.context.view_layer.objects.active = target
    bpy.context.scene.frame_set(6)
    assert bpy.ops.manient.add_hand_offset(side="right") == {"FINISHED"}
    handle = bpy.context.active_object
    assert handle == target.manient.character.right.offset
    bpy.context.view_layer.update()
    np.testing.assert_allclose(handle.matrix_world.translation, before[1], atol=1e-5)
    for move in ((0.5, 0.0, -0.25), (0.1, 0.2, 0.3)):
        handle.location = move
        settle()
        np.testing.assert_allclose(places(target), before + move, atol=1e-4)
    # Applied anew and again, it is in the keys once.
    bpy.context.view_layer.objects.active = target
    for _ in range(2):
        assert bpy.ops.manient.apply_to_character() == {"FINISHED"}
        np.testing.assert_allclose(places(target), before + move, atol=1e-4)
    assert bpy.ops.manient.add_hand_offset(side="right") == {"FINISHED"}
    assert bpy.context.active_object == handle
    bpy.ops.object.delete()
    settle()
    np.testing.assert_allclose(places(target), before, atol=1e-4)


def test_keys_of_ones_own_stay(target):
    before = places(target)
    path = f'"{NAMES[0]}"].location'
    curves = action_curves(written_keys(target, "right").action)
    curve = next(c for c in curves if c.data_path.endswith(path) and c.array_index == 0)
    point = next(p for p in curve.keyframe_points if p.co[0] == 6.0)
    point.co[1] += 0.3
    curve.update()
    mine = places(target)[1]
    for travel in (0.5, 0.25):
        target.manient.character.travel = travel
        settle()
        found = places(target)
        np.testing.assert_allclose(found[2] - found[0], travel * (before[2] - before[0]), atol=1e-4)
        np.testing.assert_allclose(found[1], mine, atol=1e-5)
        assert "1 frame with keys of your own stay" in drawn(MANIENT_PT_character).said


def test_nothing_is_written_where_nothing_was(target):
    """Fingers alone were applied, or what tells of the keys is damaged."""
    character, before = target.manient.character, places(target)
    for wrist in ("TURNED", "FINGERS"):
        character.wrist, character.travel = wrist, 0.5
        settle()
        np.testing.assert_allclose(places(target), before, atol=1e-5)
    action = written_keys(target, "right").action
    action[MARK] = {key: {"keys": "?"} for key in dict(action[MARK])}
    character.travel = 0.7
    settle()
    assert written_keys(target, "right") is None
    np.testing.assert_allclose(places(target), before, atol=1e-5)


def test_the_live_link_follows_an_offset(hand):
    target = one_handed()
    character = target.manient.character
    character.wrist, character.reference, character.live = "PLACED", 3, True
    settle()
    before = places(target)
    assert bpy.ops.manient.add_hand_offset(side="right") == {"FINISHED"}
    character.right.offset.location = (0.0, 0.2, 0.0)
    character.travel = 0.5
    settle()
    assert live_link.trouble(target) is None
    expected = before[0] + [0.0, 0.2, 0.0] + 0.5 * (before - before[0])
    np.testing.assert_allclose(places(target), expected, atol=1e-5)
