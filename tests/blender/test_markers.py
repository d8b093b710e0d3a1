"""Timeline markers of doubtful and filled frames, and jumping from one to the next."""

from __future__ import annotations

from dataclasses import replace

import bpy
import numpy as np
import pytest

from blender_manient.scene import store
from blender_manient.scene.build import build_take
from blender_manient.scene.confidence import doubtful_ranges, is_marked, mark_doubtful, next_doubtful

from .conftest import FRAMES, UNSEEN

pytestmark = pytest.mark.usefixtures("registered")


def with_flags(take):
    """Doubtful: frames 3 and 4, 8, and 17 and 18; filled: 7. (FRAMES says which rows they are.)"""
    doubtful = np.isin(FRAMES, (3, 4, 8, 17, 18))
    filled = np.zeros(len(FRAMES), dtype=bool)
    filled[UNSEEN] = True
    hands = []
    for track in take.hands:
        pose = {}
        for name in ("global_orient", "hand_pose", "transl", "joints_3d"):
            pose[name] = np.array(getattr(track, name))
            pose[name][UNSEEN] = pose[name][UNSEEN - 1]
        hands.append(replace(track, doubtful=doubtful, filled=filled, **pose))
    return replace(take, hands=tuple(hands))


@pytest.fixture
def hand(make_take):
    built = build_take(with_flags(make_take().take))
    return store.hand_of(built.hands[1].armature)


def markers() -> list[tuple[int, str]]:
    return sorted((m.frame, m.name) for m in bpy.context.scene.timeline_markers)


OURS = [
    (3, "Doubtful R"),
    (4, "Doubtful R End"),
    (7, "Filled R"),
    (8, "Doubtful R"),
    (17, "Doubtful R"),
    (18, "Doubtful R End"),
]


def test_ranges(hand):
    assert doubtful_ranges(hand) == [(3, 4), (8, 8), (17, 18)]


def test_a_take_that_nobody_judged_has_none(make_take):
    built = build_take(make_take().take)
    assert doubtful_ranges(store.hand_of(built.hands[0].armature)) == []


def test_markers_come_once_and_go(hand):
    scene = bpy.context.scene
    scene.timeline_markers.new("Cut", frame=8)
    for _ in range(2):
        assert mark_doubtful(scene, hand, True) == len(OURS)
        assert markers() == sorted([*OURS, (8, "Cut")])
        assert is_marked(scene, hand)
    assert mark_doubtful(scene, hand, False) == 0
    assert markers() == [(8, "Cut")]
    assert not is_marked(scene, hand)


def test_stale_markers_are_replaced(hand):
    scene = bpy.context.scene
    scene.timeline_markers.new("Doubtful R", frame=5)
    mark_doubtful(scene, hand, True)
    assert markers() == OURS


def test_the_other_hand_keeps_its_markers(hand, make_take):
    scene = bpy.context.scene
    other = store.hand_of(next(o for o in store.captured_hands(scene) if o.manient.side == "left"))
    mark_doubtful(scene, hand, True)
    mark_doubtful(scene, other, True)
    assert len(markers()) == 2 * len(OURS)
    mark_doubtful(scene, other, False)
    assert markers() == OURS


def test_another_capture_of_the_same_side_keeps_its_markers(hand, make_take):
    scene = bpy.context.scene
    scene.frame_set(103)
    later = build_take(with_flags(make_take(seed=4).take), match_scene=False)
    mark_doubtful(scene, hand, True)
    mark_doubtful(scene, store.hand_of(later.hands[1].armature), True)
    assert markers() == sorted([*OURS, *((frame + 100, name) for frame, name in OURS)])
    mark_doubtful(scene, store.hand_of(later.hands[1].armature), False)
    assert markers() == OURS


@pytest.mark.parametrize(
    ("frame", "direction", "expected"),
    [
        (1, "NEXT", 3),
        (3, "NEXT", 8),
        (8, "NEXT", 17),
        (17, "NEXT", None),
        (18, "PREVIOUS", 17),
        (17, "PREVIOUS", 8),
        (8, "PREVIOUS", 3),
        (3, "PREVIOUS", None),
    ],
)
def test_next_doubtful(hand, frame, direction, expected):
    assert next_doubtful(hand, frame, direction) == expected


def test_operators(hand):
    scene = bpy.context.scene
    name = hand.armature.name
    bpy.context.view_layer.objects.active = None
    assert bpy.ops.manient.mark_doubtful(hand=name) == {"FINISHED"}
    assert markers() == OURS
    assert bpy.ops.manient.mark_doubtful(hand=name) == {"FINISHED"}
    assert markers() == []

    bpy.context.view_layer.objects.active = hand.mesh
    scene.frame_set(1)
    for expected in (3, 8, 17):
        assert bpy.ops.manient.jump_doubtful(direction="NEXT") == {"FINISHED"}
        assert scene.frame_current == expected
    assert bpy.ops.manient.jump_doubtful(direction="NEXT") == {"CANCELLED"}
    assert bpy.ops.manient.jump_doubtful(direction="PREVIOUS", hand=name) == {"FINISHED"}
    assert scene.frame_current == 8


@pytest.mark.parametrize("operator", ["mark_doubtful", "jump_doubtful"])
def test_operators_without_a_hand_say_so(operator):
    with pytest.raises(RuntimeError, match="No captured hand: select"):
        getattr(bpy.ops.manient, operator)()
