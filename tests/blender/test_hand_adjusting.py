"""How a character's hand itself moves, changed after its keys were written, by the part's own steps: timers
do not run without a window."""

from __future__ import annotations

import time

import bpy
import numpy as np
import pytest

from blender_manient.panels.character import MANIENT_PT_character
from blender_manient.scene.build import build_take
from blender_manient.scene.characters import keep_map
from blender_manient.scene.hand_motion import MARK, written_keys
from blender_manient.scene.store import hand_of
from blender_manient.session import hand_adjusting, live_link
from tests.drawn import drawn

from .characters import build_armature, hand_specs, joint_name, map_of
from .conftest import action_curves

pytestmark = pytest.mark.usefixtures("registered")

HAND = joint_name(0, "right")


def settle() -> None:
    """Have all be done that would be by and by."""
    bpy.context.view_layer.update()
    for _ in range(400):
        if [step() for step in (live_link.step, hand_adjusting.step)] == [None, None]:
            return
        time.sleep(0.01)
    raise AssertionError("it does not end")


@pytest.fixture(params=["NEW", "STRIP", "ACTION"])
def target(make_take, request):
    """A character whose hand moves as a captured one from frame 3 on; it is ten times as large."""
    hand = hand_of(build_take(make_take(sides=("right",)).take).hands[0].armature)
    assert hand is not None
    target = build_armature(hand_specs("right", np.random.default_rng(3), scale=10.0))
    keep_map(target, map_of("right"))
    character = target.manient.character
    character.right.source = hand.armature
    character.contacts = False
    character.into, character.wrist, character.reference = request.param, "PLACED", 3
    assert bpy.ops.manient.apply_to_character() == {"FINISHED"}
    return target


def places(target, frames=(3, 6, 12)) -> np.ndarray:
    """(N, 3) where the hand is shown."""
    found = []
    for frame in frames:
        bpy.context.scene.frame_set(frame)
        shown = target.evaluated_get(bpy.context.evaluated_depsgraph_get()).pose.bones[HAND]
        found.append(tuple(shown.head))
    return np.array(found)


def turns(target, frame) -> np.ndarray:
    bpy.context.scene.frame_set(frame)
    shown = target.evaluated_get(bpy.context.evaluated_depsgraph_get()).pose.bones[HAND]
    return np.array(shown.matrix.to_3x3())


def curve_of(target, path="location", index=0):
    action = written_keys(target, "right").action
    return next(
        c
        for c in action_curves(action)
        if c.data_path.endswith(f'"{HAND}"].{path}') and c.array_index == index
    )


def test_travel_is_scaled_again_and_again_about_the_marked_frame(target):
    before, turned = places(target), turns(target, 12)
    actions = len(bpy.data.actions)
    for travel in (0.5, 2.0, 0.0, 1.0):
        target.manient.character.travel = travel
        settle()
        found = places(target)
        np.testing.assert_allclose(found[0], before[0], atol=1e-5)
        np.testing.assert_allclose(found - found[0], travel * (before - before[0]), atol=1e-4)
        np.testing.assert_allclose(turns(target, 12), turned, atol=1e-4)
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
    curve = curve_of(target)
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
    """Fingers alone were applied, or keys of another kind are chosen now."""
    character = target.manient.character
    before = places(target)
    for wrist in ("TURNED", "FINGERS"):
        character.wrist = wrist
        character.travel = 0.5
        settle()
        np.testing.assert_allclose(places(target), before, atol=1e-5)
    action = written_keys(target, "right").action
    for damaged in ({"0/right": 3}, "text", {key: {"keys": "?"} for key in dict(action[MARK])}):
        action[MARK] = damaged
        character.travel = 0.7
        settle()
        assert written_keys(target, "right") is None
        np.testing.assert_allclose(places(target), before, atol=1e-5)


def test_an_undone_change_is_undone_in_the_keys(target):
    name = target.name
    before = places(target)
    bpy.ops.ed.undo_push(message="applied")
    target.manient.character.travel = 0.5
    bpy.ops.ed.undo_push(message="travel")
    settle()
    assert np.abs(places(target) - before).max() > 1e-3
    bpy.ops.ed.undo()
    settle()
    target = bpy.data.objects[name]
    assert target.manient.character.travel == 1.0
    np.testing.assert_allclose(places(target), before, atol=1e-4)


def test_the_live_link_follows_an_offset(make_take):
    hand = hand_of(build_take(make_take(sides=("right",)).take).hands[0].armature)
    target = build_armature(hand_specs("right", np.random.default_rng(3)))
    keep_map(target, map_of("right"))
    character = target.manient.character
    character.contacts, character.wrist, character.reference = False, "PLACED", 3
    character.right.source = hand.armature
    character.live = True
    settle()
    before = places(target)
    assert bpy.ops.manient.add_hand_offset(side="right") == {"FINISHED"}
    character.right.offset.location = (0.0, 0.2, 0.0)
    settle()
    assert live_link.trouble(target) is None
    np.testing.assert_allclose(places(target), before + [0.0, 0.2, 0.0], atol=1e-5)
    character.travel = 0.5
    settle()
    found = places(target)
    np.testing.assert_allclose(found - found[0], 0.5 * (before - before[0]), atol=1e-5)
