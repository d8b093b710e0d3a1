"""Edit Keypoints in the window: a point is dragged with the mouse, and the hand follows."""

from __future__ import annotations

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
