"""Which keys are the artist's own, and the range and the words with which Re-fit Range asks."""

from __future__ import annotations

from dataclasses import replace

import bpy
import numpy as np
import pytest

from blender_manient.operators.refit_range import MANIENT_OT_refit_range, replaced, suggested_range
from blender_manient.rigs import rig_of
from blender_manient.scene import build, corrections
from blender_manient.scene.build import build_take
from blender_manient.scene.keys import PoseKeys, pose_at, write_pose_keys
from blender_manient.scene.own_keys import captured_poses, keyed_by_hand, note_fitted, smoothed
from blender_manient.scene.store import hand_of
from blender_manient.scene.timing import timing_in
from handfit_core.common.skeleton import NUM_JOINTS
from handfit_core.edit.corrections import changed_quats
from handfit_core.media.source import Source
from tests.drawn import drawn

from .conftest import FRAMES, UNSEEN

pytestmark = pytest.mark.usefixtures("registered")

ROWS = np.arange(len(FRAMES))
ROW = 2
"""Of frame 5"""
PINS = [{8: (1.0, 2.0)}]


@pytest.fixture(params=["matched", "between"])
def armature(request, make_take, picture, monkeypatch):
    """On its own frames, and between whole ones, as older versions built a clip of 30 frames per second in a
    shot of 24 that begins at 1001."""
    monkeypatch.setattr(build, "in_scene", lambda *args: (args[1], *[timing_in(*args)] * 2))
    bpy.context.scene.frame_set(1001)
    made = make_take(sides=("right",), source=Source("video", (str(picture),)), fps=30.0)
    built = build_take(made.take, match_scene=request.param == "matched", picture=False)
    bpy.context.view_layer.objects.active = built.hands[0].armature
    return built.hands[0].armature


def place(armature, row: int = ROW) -> float:
    return float(corrections.timing_of(armature).scene_frames(FRAMES)[row])


def turned(armature, row: int = ROW, joints: tuple[int, ...] = (5,), by: float = 0.2) -> np.ndarray:
    """Rotate bones and key them, as an artist does."""
    frame = np.array([place(armature, row)])
    quats, locations = pose_at(rig_of(armature), frame)
    keyed = np.isin(np.arange(NUM_JOINTS), joints)[None]
    quats = changed_quats(quats, np.zeros((1, 16, 3)), np.full((1, 16, 3), by))
    write_pose_keys(rig_of(armature), PoseKeys(frame, quats, locations, keyed, np.array([False])))
    return quats


def own(armature) -> list[tuple[int, int]]:
    """(row, bone) of the artist's keys; bone 16 is the wrist's location."""
    hand = hand_of(armature)
    assert hand is not None
    return [(int(r), int(b)) for r, b in zip(*np.nonzero(keyed_by_hand(hand, ROWS)), strict=True)]


def test_keys_that_were_changed_or_set_where_there_were_none_are_the_artists(armature):
    """And no others: a correction and its fading, and other proportions, make none."""
    assert own(armature) == []
    correct(armature)
    armature.manient.betas = [2.0, -2.0, 1.0, 1.0, *[0.0] * 6]
    assert own(armature) == []
    turned(armature, ROW + 2, joints=(5, 6))
    turned(armature, UNSEEN, joints=(9,))
    assert sorted(own(armature)) == sorted([(ROW + 2, 5), (ROW + 2, 6), (UNSEEN, 9)])


def test_a_key_that_was_changed_by_a_fifth_of_a_degree_stays(armature):
    """It is kept when the motion is smoothed; and so is one that was moved by a tenth of a millimetre."""
    turned(armature, by=np.radians(0.2) / np.sqrt(3.0))
    frame, rig = np.array([place(armature, ROW + 3)]), rig_of(armature)
    quats, locations = pose_at(rig, frame)
    write_pose_keys(rig, PoseKeys(frame, quats, locations + 6e-5, np.zeros((1, 16), bool), np.array([True])))
    assert own(armature) == [(ROW, 5), (ROW + 3, 16)]
    hand = hand_of(armature)
    keys = smoothed(hand, ROWS, np.ones(len(ROWS), bool), *captured_poses(hand, ROWS), 2.0).keys
    assert not keys.rotation_keyed[ROW, 5]
    assert not keys.location_keyed[ROW + 3]
    assert keys.rotation_keyed[ROW + 1].all()


def correct(armature, row: int = ROW, spread: float = 4, by: float = 0.2) -> None:
    """Correct a frame as a dragged point does."""
    quats, locations = pose_at(rig_of(armature), np.array([place(armature, row)]))
    dragged = changed_quats(quats, np.zeros((1, 16, 3)), np.full((1, 16, 3), by))
    corrections.correct_frames(armature, [FRAMES[row]], dragged, locations + 0.01, spread, pins=PINS)


def test_what_was_fitted_again_is_nobodys_own_until_it_is_changed(armature):
    quats = turned(armature, joints=tuple(range(16)))
    assert len(own(armature)) == 16
    _, locations = pose_at(rig_of(armature), np.array([place(armature)]))
    note_fitted(armature, [int(FRAMES[ROW])], quats, locations)
    assert own(armature) == []
    armature.manient.betas[0] += 1.0
    assert own(armature) == []
    again = turned(armature, ROW + 1, joints=(3,))
    assert own(armature) == [(ROW + 1, 3)]
    note_fitted(armature, [int(FRAMES[ROW + 1])], again, locations)
    turned(armature, ROW)
    assert own(armature) == [(ROW, 5)]
    # What cannot be read protects every key that the take does not know.
    armature.manient.fitted = "no text of ours"
    assert len(own(armature)) == 17


def test_the_words_follow_the_range(armature):
    turned(armature, 1, joints=(5, 6))
    turned(armature, 3, joints=(7,))
    frames = [round(place(armature, row)) for row in range(len(FRAMES))]
    words = "Fits 12 frames again. Replaces 3 keys set by hand, on 2 frames"
    assert replaced(bpy.context, frames[0], frames[-1]) == (words, True)
    dialog = drawn(MANIENT_OT_refit_range, first=frames[0], last=frames[-1])
    # Without a window a dialog's lines have no room, and break after each letter.
    assert "".join(dialog.said.split()) == "".join(f"first last {words}".split())
    words = "Fits 7 frames again. Replaces no key set by hand"
    assert replaced(bpy.context, frames[5], frames[-1]) == (words, False)
    assert replaced(bpy.context, 5000, 6000) == ("None of these frames was captured", False)
    armature.manient.locked[7] = True  # it keeps its keys
    assert "2 keys set by hand, on 1 frame" in replaced(bpy.context, frames[0], frames[-1])[0]
    bpy.context.scene.frame_set(frames[7])
    assert bpy.ops.manient.apply_pose(pose="Relaxed") == {"FINISHED"}
    correct(armature, 10, 1)
    words = "Replaces 1 applied pose. The points of 1 corrected frame stay"
    assert replaced(bpy.context, frames[5], frames[-1]) == (f"Fits 7 frames again. {words}", True)


def test_the_range_that_is_offered_is_never_everything(make_take):
    made = make_take(sides=("right",), fps=4.0)
    track = replace(made.take.hands[0], doubtful=np.isin(FRAMES, (7, 8)))
    armature = build_take(replace(made.take, hands=(track,))).hands[0].armature
    scene = bpy.context.scene
    bpy.context.view_layer.objects.active = armature
    for frame, offered in ((14, (12, 16)), (18, (16, 18)), (99, (16, 18))):
        scene.frame_set(frame)
        assert suggested_range(bpy.context) == offered, "half a second around, as far as it was captured"
    correct(armature, int(np.flatnonzero(FRAMES == 14)[0]), 3)
    for frame, offered in ((12, (11, 17)), (8, (7, 8))):
        scene.frame_set(frame)
        assert suggested_range(bpy.context) == offered, "the correction's reach, or the doubtful frames"
    scene.use_preview_range, scene.frame_preview_start, scene.frame_preview_end = True, 5, 9
    assert suggested_range(bpy.context) == (5, 9)
