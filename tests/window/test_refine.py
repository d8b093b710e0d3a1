"""Edit Keypoints in the window: a point is dragged with the mouse, and the hand follows."""

from __future__ import annotations

import numpy as np
import pytest

from tests.window.inputs import write_far_take
from tests.window.test_capture import assert_sentence

CLIP = 60
"""frames"""


def test_keypoint_dragged_undone_redone_and_saved(blender, make_clip, tmp_path):
    source = tmp_path / "clip.mp4"
    source.write_bytes(make_clip(CLIP).read_bytes())
    played = blender.play("refine.keypoint_dragged", source=source, timeout=240).value
    assert played["pins"] == played["pins_reloaded"] == 1
    assert played["undone"]
    assert played["redone"]
    assert played["reloaded"]
    # Spread is six frames: the neighbours follow, the rest stays, and no key comes or goes.
    assert played["changed"] == [28, 30, 32]
    assert played["keys_now"] == played["keys_then"]


def test_a_range_is_fitted_again_only_after_it_was_asked_for(blender, make_clip):
    played = blender.play("refine.range_refitted", source=make_clip(CLIP), timeout=240).value
    assert played["unchanged"] == []
    # Half a second around frame 30, at 25 frames per second, and one of the two keys set by hand.
    assert played["said"] == "Fits 25 frames again. Replaces 1 key set by hand, on 1 frame"
    # Then six frames more, with the second: a wheel's press and its release are a step each.
    assert {32, 45} <= set(played["changed"]) <= set(range(18, 49))
    assert played["undone"] == []


def test_smoothing_is_a_slider_and_one_undo(blender, make_clip):
    played = blender.play("refine.smoothed", source=make_clip(CLIP), timeout=240).value
    first, undone, second, again = played["strength"]
    assert undone == again == 1.0
    assert 1.0 < first < second <= 3.0
    assert played["changed"][1::2] == [0, 0]
    assert min(played["changed"][::2]) > CLIP / 2
    assert played["kept"] == [True, True]


def test_points_are_made_to_touch_and_the_undo_lets_them_go(blender, make_clip):
    played = blender.play("refine.touched", source=make_clip(CLIP), timeout=240).value
    (first, last), spread = played["range"], played["spread"]
    assert first <= 30 <= last
    assert played["apart"] < 0.001
    reach = range(first - int(spread), last + int(spread) + 1)
    assert set(played["changed"]) <= set(reach)
    assert len(played["changed"]) >= last - first + 1
    assert played["undone"] == []


def test_the_worker_dies_between_two_drags(blender, make_clip):
    played = blender.play("refine.worker_killed", source=make_clip(CLIP), timeout=240).value
    assert played["followed"]
    if played["message"]:
        assert_sentence(played["message"])


def test_the_picture_shows_through_the_hand_while_it_is_edited(blender, photo):
    played = blender.play("refine.see_through", source=photo, timeout=240).value
    picture = [["BACK", 1.0]]
    assert played["before"] == played["ended"] == played["abandoned"] == played["solid"] == picture
    assert played["begun"] == played["dragged"] == [*picture, ["FRONT", 0.5]]
    # The slider is no change of the file: undo takes the drag back, and it is remembered.
    assert played["slider"] == played["undone"] == played["again"] == [*picture, ["FRONT", 0.75]]
    assert played["drags"] == 0


def test_small_hands_are_looked_at_closely(blender, tmp_path):
    take = write_far_take(tmp_path / "far.take.npz")
    played = blender.play("refine.looked_at", take=take, blend=tmp_path / "far.blend", timeout=240).value
    for name in ("begun", "other", "home", "opened"):
        handles, free = (np.reshape(played[name][what], (2, 2)) for what in ("handles", "free"))
        size, room = np.ptp(handles, axis=0), np.ptp(free, axis=0)
        assert (room / size).min() == pytest.approx(2.0, rel=0.02), name
        np.testing.assert_allclose(handles.mean(axis=0), free.mean(axis=0), atol=2.0, err_msg=name)
    picture = np.ptp(np.reshape(played["begun"]["picture"], (2, 2)), axis=0)[0]
    hand = np.ptp(np.reshape(played["begun"]["handles"], (2, 2)), axis=0)
    assert (1280 / picture * hand).max() < 45, "pixels of the hand in the picture"
    mouse, tip = played["tip"]
    np.testing.assert_allclose(tip, mouse, atol=2.0)
    zoomed = [played[name]["zoom"] for name in ("zoomed", "followed", "again", "elsewhere")]
    assert zoomed[0] > played["begun"]["zoom"]
    assert zoomed[1] == zoomed[2] == zoomed[0]
    assert zoomed[3] == played["home"]["zoom"]
    assert played["left"]
    (left, bottom), (right, top) = np.reshape(played["picture"]["picture"], (2, 2))
    free = played["picture"]["free"]
    assert free[0] - 1 <= left < right <= free[2] + 1
    assert free[1] - 1 <= bottom < top <= free[3] + 1
    handles, free = (np.reshape(played["elsewhere"][what], (2, 2)) for what in ("handles", "free"))
    assert (handles >= free[0]).all()
    assert (handles <= free[1]).all()
