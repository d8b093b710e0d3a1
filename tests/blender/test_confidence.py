"""How well hands meet the picture: bones coloured by it, and doubtful frames marked."""

from __future__ import annotations

from dataclasses import replace

import bpy
import numpy as np
import pytest

import blender_manient
from blender_manient.exporters.take import retaken
from blender_manient.rigs.captured_hand import bone_names
from blender_manient.scene import confidence, corrections
from blender_manient.scene.build import build_take
from blender_manient.scene.confidence import (
    UNSEEN_COLOR,
    bone_errors,
    errors_of,
    is_marked,
    mark_doubtful,
)
from blender_manient.scene.keys import pose_at
from blender_manient.scene.store import hand_of
from handfit_core.common.skeleton import FINGERS
from handfit_core.take.fit_quality import EXPECTED
from tests.takes import seen_as

from .conftest import FRAMES, UNSEEN

pytestmark = pytest.mark.usefixtures("registered")


BAD_FRAME, INDEX_TIP = 8, 8
GOOD, FAIR, POOR = 0.02, 0.05, 0.10
ROW = int(np.flatnonzero(FRAMES == BAD_FRAME)[0])
GREEN, YELLOW, RED, GREY = confidence.colors_of(
    np.array([0.5 * GOOD, FAIR, 2 * POOR, np.nan]), (GOOD, FAIR, POOR)
)


def off_at_the_index(take):
    """On the spot everywhere, but in one frame the index fingertip was detected half a hand away."""
    hands = []
    for track in take.hands:
        keypoints = take.intrinsics.project(track.joints_3d)
        keypoints[ROW, INDEX_TIP] += [60.0, 0.0]
        hands.append(seen_as(track, keypoints_2d=keypoints))
    return replace(take, hands=tuple(hands))


@pytest.fixture
def armature(make_take):
    return build_take(off_at_the_index(make_take(sides=("right",)).take)).hands[0].armature


def shown(armature, evaluated: bool = True) -> dict[str, tuple]:
    """Bone -> its normal colour, as it is drawn."""
    if evaluated:
        armature = armature.evaluated_get(bpy.context.evaluated_depsgraph_get())
    return {b.name: tuple(b.color.custom.normal) for b in armature.pose.bones if b.color.palette == "CUSTOM"}


def is_close(color, expected) -> bool:
    return bool(np.abs(np.array(color) - expected).max() < 0.01)


def test_errors_are_parts_of_the_hand(make_take):
    take = off_at_the_index(make_take(sides=("right",)).take)
    track = take.hands[0]
    errors = bone_errors(take, track)
    assert errors.shape == (len(FRAMES), 16)
    assert np.isnan(errors[UNSEEN]).all()
    seen = np.delete(errors, [UNSEEN, ROW], axis=0)
    np.testing.assert_allclose(seen, 0.0, atol=1e-9)
    off = np.flatnonzero(errors[ROW] > 1e-9)
    assert [bone_names("right")[i] for i in off] == ["index_distal.R"]
    joints = track.joints_3d[ROW]
    length = sum(np.linalg.norm(joints[b] - joints[a]) for a, b in ((0, 9), (9, 10), (10, 11), (11, 12)))
    expected = 30.0 / (take.intrinsics.fx * length / joints[:, 2].mean())
    assert errors[ROW, off[0]] == pytest.approx(expected)


def test_colors_are_there_at_once_and_follow_the_frame(armature):
    scene = bpy.context.scene
    scene.frame_set(BAD_FRAME)
    armature.manient.show_confidence = True
    colors = shown(armature)
    assert is_close(colors.pop("index_distal.R"), RED)
    assert len(colors) == 15
    assert all(is_close(c, GREEN) for c in colors.values())
    for frame, color in ((3, GREEN), (FRAMES[UNSEEN], GREY), (900, GREY)):
        scene.frame_set(int(frame))
        assert all(is_close(c, color) for c in shown(armature).values())


def test_own_colors_come_back(armature):
    bones = armature.pose.bones
    bones["wrist.R"].color.palette = "THEME03"
    bones["thumb_distal.R"].color.palette = "CUSTOM"
    bones["thumb_distal.R"].color.custom.normal = (0.2, 0.4, 0.6)
    armature.manient.show_confidence = True
    bpy.context.scene.frame_set(BAD_FRAME)
    assert bones["wrist.R"].color.palette == "CUSTOM"
    armature.manient.show_confidence = False
    assert bones["wrist.R"].color.palette == "THEME03"
    assert bones["index_distal.R"].color.palette == "DEFAULT"
    assert shown(armature, evaluated=False).keys() == {"thumb_distal.R"}
    assert is_close(bones["thumb_distal.R"].color.custom.normal, (0.2, 0.4, 0.6))
    bpy.context.scene.frame_set(3)
    assert shown(armature).keys() == {"thumb_distal.R"}
    assert armature.manient.own_colors == ""
    bpy.ops.object.armature_add()
    bpy.context.object.manient.show_confidence = True  # which is no captured hand
    assert shown(bpy.context.object, evaluated=False) == {}


def test_saved_and_opened_again_it_goes_on(armature, tmp_path):
    """Also from files that say something of the graph of errors, which Manient no longer has."""
    armature.manient.show_confidence = True
    kept = armature.bl_system_properties_get() if bpy.app.version >= (5, 0, 0) else armature
    kept["manient"]["show_error"] = True
    name, path = armature.name, str(tmp_path / "shown.blend")
    bpy.ops.wm.save_as_mainfile(filepath=path)
    bpy.ops.wm.read_factory_settings(use_empty=True)
    assert not confidence._following
    bpy.ops.wm.open_mainfile(filepath=path)
    assert confidence._following
    bpy.context.scene.frame_set(BAD_FRAME)
    armature = bpy.data.objects[name]
    assert is_close(shown(armature)["index_distal.R"], RED)
    armature.manient.show_confidence = False
    assert shown(armature, evaluated=False) == {}


def test_undo_redo_and_the_end_of_the_add_on(armature):
    name = armature.name
    bpy.ops.ed.undo_push(message="built")
    armature.manient.show_confidence = True
    bpy.ops.ed.undo_push(message="shown")
    bpy.context.scene.frame_set(BAD_FRAME)
    bpy.ops.ed.undo()
    assert shown(bpy.data.objects[name], evaluated=False) == {}
    bpy.ops.ed.redo()
    bpy.context.scene.frame_set(BAD_FRAME)
    assert is_close(shown(bpy.data.objects[name])["index_distal.R"], RED)
    blender_manient.unregister()
    try:
        assert shown(bpy.data.objects[name], evaluated=False) == {}
        assert not confidence._following
    finally:
        blender_manient.register()


FINGERS_OFF = np.array([0.002, 0.014, 0.005, 0.005, 0.005])
"""metres: the thumb is sure, the index finger is not"""


@pytest.fixture
def expecting(make_take):
    """A hand whose take tells what errors are expected, more in frame BAD_FRAME, which is doubtful."""
    take = make_take(sides=("right",)).take
    times = np.where(FRAMES == BAD_FRAME, 4.0, 1.0)
    times[UNSEEN] = np.nan
    track = replace(
        take.hands[0], expected_error=times[:, None] * FINGERS_OFF, doubtful=np.arange(len(FRAMES)) == ROW
    )
    return hand_of(build_take(replace(take, hands=(track,))).hands[0].armature)


def test_expected_errors_are_shown_finger_by_finger(expecting):
    errors = errors_of(expecting)
    assert errors.scale is EXPECTED
    assert np.isnan(errors.frames).tolist() == [row == UNSEEN for row in range(len(FRAMES))]
    assert errors.frames[ROW] == pytest.approx(4 * FINGERS_OFF.mean())
    assert errors.doubtful.tolist() == (FRAMES == BAD_FRAME).tolist()
    expecting.armature.manient.show_confidence = True
    for frame, times in ((3, 1.0), (BAD_FRAME, 4.0)):
        bpy.context.scene.frame_set(frame)
        colors = shown(expecting.armature)
        for finger, off in zip(FINGERS, FINGERS_OFF, strict=True):
            (expected,) = confidence.colors_of(np.array([times * off]), EXPECTED.levels)
            bones = [name for name in colors if name.startswith(finger)]
            assert len(bones) == 3
            assert all(is_close(colors[name], expected) for name in bones)
        (whole,) = confidence.colors_of(np.array([times * FINGERS_OFF.mean()]), EXPECTED.levels)
        assert is_close(colors["wrist.R"], whole)


def test_what_the_artist_has_corrected_is_not_doubted_any_more(expecting):
    armature = expecting.armature
    quats, locations = pose_at(expecting.rig, np.array([float(BAD_FRAME)]))
    quats[0, 5] = [0.9, 0.1, 0.2, 0.3]
    before = errors_of(expecting)
    corrections.correct_frames(armature, [BAD_FRAME], quats, locations, 2, pins=[{8: (1.0, 2.0)}])
    errors = errors_of(expecting)
    assert np.flatnonzero(np.isnan(errors.frames) & np.isfinite(before.frames)).tolist() == [ROW]
    assert not errors.doubtful.any()
    armature.manient.show_confidence = True
    bpy.context.scene.frame_set(BAD_FRAME)
    assert all(is_close(color, UNSEEN_COLOR) for color in shown(armature).values())
    (track,) = retaken([expecting]).hands
    assert not track.doubtful.any()
    np.testing.assert_array_equal(np.isnan(track.expected_error).all(axis=1), np.isnan(errors.frames))
    corrections.clear_corrections(armature)
    np.testing.assert_array_equal(errors_of(expecting).frames, before.frames)
    assert errors_of(expecting).doubtful[ROW]


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
    return hand_of(built.hands[1].armature)


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


def test_markers_come_once_replace_stale_ones_and_go(hand):
    scene = bpy.context.scene
    scene.timeline_markers.new("Cut", frame=8)
    scene.timeline_markers.new("Doubtful R", frame=5)
    for _ in range(2):
        assert mark_doubtful(scene, hand, True) == len(OURS)
        assert markers() == sorted([*OURS, (8, "Cut")])
        assert is_marked(scene, hand)
    assert mark_doubtful(scene, hand, False) == 0
    assert markers() == [(8, "Cut")]
    assert not is_marked(scene, hand)


def test_another_captures_hand_keeps_its_markers(hand, make_take):
    scene = bpy.context.scene
    scene.frame_set(103)
    later = hand_of(build_take(with_flags(make_take(seed=4).take), match_scene=False).hands[1].armature)
    for each in (hand, later):
        mark_doubtful(scene, each, True)
    assert markers() == sorted([*OURS, *((frame + 100, name) for frame, name in OURS)])
    mark_doubtful(scene, later, False)
    assert markers() == OURS


def test_operators(hand):
    scene = bpy.context.scene
    name = hand.armature.name
    bpy.context.view_layer.objects.active = None
    with pytest.raises(RuntimeError, match="No captured hand: select"):
        bpy.ops.manient.mark_doubtful()
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

    bpy.ops.manient.mark_doubtful(hand=name)
    assert bpy.ops.manient.remove_capture(capture=hand.collection.name) == {"FINISHED"}
    assert markers() == [], "a capture takes its markers along"
