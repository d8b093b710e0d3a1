"""The live link, by its own steps: timers do not run without a window."""

from __future__ import annotations

import time

import bpy
import numpy as np
import pytest

from blender_manient.rigs.captured_hand import bone_names
from blender_manient.scene.build import build_take
from blender_manient.scene.characters import keep_map
from blender_manient.scene.keys import PoseKeys, pose_at, remove_pose_keys, set_pose, write_pose_keys
from blender_manient.scene.store import hand_of
from blender_manient.session import followers, live_link

from .characters import build_armature, hand_specs, joint_name, map_of
from .conftest import action_curves
from .test_onto_character import angles, directions

pytestmark = pytest.mark.usefixtures("registered")

NAMES = [joint_name(j, "right") for j in range(16)]


@pytest.fixture
def beside(make_take):
    """A captured hand, and a character that could follow it."""
    hand = hand_of(build_take(make_take(sides=("right",)).take).hands[0].armature)
    assert hand is not None
    target = build_armature(hand_specs("right", np.random.default_rng(3), bend=0.4, stretch=0.2))
    keep_map(target, map_of("right"))
    target.manient.character.contacts = False
    return hand, target


@pytest.fixture
def linked(beside):
    """A captured hand, and a character that follows it."""
    hand, target = beside
    target.manient.character.live = True
    settle()
    assert live_link.trouble(target) is None
    return hand, target


def settle() -> None:
    """Have the link do all that it would do by and by."""
    bpy.context.view_layer.update()
    for _ in range(400):
        wait = live_link.step()
        if wait is None:
            return
        time.sleep(0.01)
    raise AssertionError("the link does not end")


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
    error = angles(directions(target, NAMES, frame), directions(hand.armature, bone_names("right"), frame))
    return error.max() < 0.1


def test_switched_on_it_shows_this_frame_before_it_keys_and_tells_how_far_it_is(beside, monkeypatch):
    hand, target = beside
    bpy.context.scene.frame_set(6)
    monkeypatch.setattr(followers, "slice_clock", lambda: lambda: True)
    target.manient.character.live = True
    assert live_link.step() is not None
    assert target.animation_data is None, "a key"
    assert alike(hand, target, 6)
    assert live_link.keying_progress(target) is None
    told = []
    while live_link.step() is not None:
        told.append(live_link.keying_progress(target))
    assert live_link.keying_progress(target) is None
    assert told[0] == 0.0
    assert told == sorted(told)
    assert len(set(told)) > 10
    assert 0.9 < told[-1] <= 1.0
    assert alike(hand, target, 9)


def test_switched_on_it_keys_all(linked):
    hand, target = linked
    assert target.manient.character.right.source == hand.armature
    assert all(alike(hand, target, frame) for frame in (3, 6, 9))


def test_changed_keys_follow_and_own_keys_elsewhere_stay(linked):
    hand, target = linked
    own = target.pose.bones[NAMES[2]]
    own.rotation_quaternion = (0.8, 0.6, 0.0, 0.0)
    own.keyframe_insert("rotation_quaternion", frame=8)
    before = values(target)
    curl(hand, 5)
    settle()
    assert alike(hand, target, 5)
    after = values(target)
    changed = {
        (path.split('"')[1], key[0])
        for (path, index), keys in after.items()
        for key in keys
        if key not in before[path, index]
    }
    assert changed == {(NAMES[1], 5.0)}


def test_a_pose_without_keys_shows_at_once(linked):
    hand, target = linked
    bpy.context.scene.frame_set(5)
    quats = np.full((16, 4), np.nan)
    quats[1] = [0.9, np.sqrt(1 - 0.81), 0.0, 0.0]
    before = np.array(target.pose.bones[NAMES[1]].rotation_quaternion)
    set_pose(hand.rig, quats)
    bpy.context.view_layer.update()
    live_link.step()
    assert np.abs(np.array(target.pose.bones[NAMES[1]].rotation_quaternion) - before).max() > 0.05


def test_keys_that_go_go(linked):
    hand, target = linked
    remove_pose_keys(hand.rig, 15, 40)
    settle()
    last = max(key[0] for keys in values(target).values() for key in keys)
    assert last == 14


def test_nothing_is_keyed_again_in_a_loaded_file(linked, tmp_path):
    _, target = linked
    own = target.pose.bones[NAMES[2]]
    own.rotation_quaternion = (0.8, 0.6, 0.0, 0.0)
    own.keyframe_insert("rotation_quaternion", frame=8)
    before = values(target)
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
    hand, target = linked
    other = bpy.data.actions.new("mine")
    target.animation_data.action = other
    target.pose.bones[NAMES[3]].keyframe_insert("rotation_quaternion", frame=4)
    before = values(target)
    curl(hand, 5)
    settle()
    assert "another action" in live_link.trouble(target)
    assert values(target) == before


def test_one_characters_trouble_stays_while_another_follows(linked):
    hand, target = linked
    other = build_armature(hand_specs("right", np.random.default_rng(4)), "Other")
    keep_map(other, map_of("right"))
    other.manient.character.contacts = False
    other.manient.character.live = True
    settle()
    target.animation_data.action = bpy.data.actions.new("mine")
    curl(hand, 5)
    settle()
    assert "another action" in live_link.trouble(target)
    live_link._links[other.session_uid].changed = 0.0
    settle()
    assert live_link.trouble(other) is None
    assert "another action" in live_link.trouble(target)


def test_switched_off_it_follows_no_more(linked):
    hand, target = linked
    target.manient.character.live = False
    before = values(target)
    curl(hand, 5)
    settle()
    assert values(target) == before
