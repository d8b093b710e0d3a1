"""Captures through Blender's window, from the button to the hand."""

from __future__ import annotations

import json
import shutil

from handfit_core.take import Take

CLIP = 120
"""frames: enough for the panel to tell its rate before it is done"""
LONG_CLIP = 480
VERY_LONG_CLIP = 1500


def test_photo(blender, photo):
    played = blender.play("capture.photo", source=photo)
    (hand,) = played.value["first"]
    assert (hand["side"], hand["frames"], hand["detected"]) == ("right", 1, 1)
    assert hand["keys"] > 0
    assert hand["mesh"] > 500
    assert played.value["undone"] == 0
    assert played.value["redone"] == [hand]
    assert played.value["reloaded"] == [hand]


def test_video_with_progress(blender, make_clip):
    played = blender.play("capture.clip", source=make_clip(CLIP)).value
    (hand,) = played["hands"]
    assert (hand["side"], hand["frames"]) == ("right", CLIP)
    assert hand["detected"] > 0.9 * CLIP
    fractions = [fraction for _, _, fraction, _ in played["seen"]]
    assert fractions == sorted(fractions)
    assert len(set(fractions)) > 3
    assert [s for s in ("detect", "fit") if s in {stage for _, stage, _, _ in played["seen"]}] == [
        "detect",
        "fit",
    ]
    texts = [text for state, _, _, text in played["seen"] if state == "capturing"]
    assert any(f"/{CLIP}" in text and "fps" in text and "left" in text for text in texts)


def test_quality_is_chosen_from_a_list(blender, make_clip):
    played = blender.play("capture.quality", source=make_clip(24)).value
    assert played == {"first": "STANDARD", "chosen": "BEST", "asked": "best"}


def test_another_programs_hands_without_a_size(blender, rendered_hand, tmp_path):
    track, path = Take.load(rendered_hand / "truth.take.npz").hands[0], tmp_path / "hands.json"
    hands = [{"handedness": track.side, "keypoints": points.tolist()} for points in track.keypoints_2d]
    path.write_text(json.dumps({"fps": 24, "frames": [{"hands": [hand]} for hand in hands]}))
    played = blender.play("capture.of_another_program", source=str(path), size=(640, 480)).value
    assert played["size"] == 640
    assert played["colors"] == [[0.35, 0.35, 0.35]], "nobody knows how far off a finger is"


def test_escape_stops_and_keeps_what_is_finished(blender, make_clip):
    """Frames behind a gap between two chunks are not kept, so that fewer may be there than were counted."""
    played = blender.play("capture.cancelled", source=make_clip(VERY_LONG_CLIP)).value
    assert played["looked_at"] < VERY_LONG_CLIP / 2
    assert played["state"] == "done"
    assert "stopped" in played["message"]
    (hand,) = played["hands"]
    assert 0 < hand["detected"] < VERY_LONG_CLIP / 2


def test_the_panels_buttons_by_mouse(blender, make_clip):
    played = blender.play("capture.by_the_button", source=make_clip(VERY_LONG_CLIP)).value
    assert played["state"] == "done"
    assert "stopped" in played["message"]
    assert 5 <= played["frames"][0] < VERY_LONG_CLIP


def test_what_stops_stands_where_it_was_begun_and_a_double_click_does_not_stop(blender, make_clip):
    played = blender.play("capture.in_place", source=make_clip(VERY_LONG_CLIP)).value
    assert played["begun"] == [1, ["Stop", True]]
    assert played["stop"] == played["start"]
    assert played["state"] == "done"
    assert "stopped" in played["message"]


def test_several_captures_queue(blender, photo, make_clip):
    second = shutil.copy(photo, photo.with_name("second.jpg"))
    sources = [str(make_clip(LONG_CLIP)), str(photo), str(second)]
    played = blender.play("capture.queued", sources=sources).value
    assert ["waiting"] * 3 in played["seen"]
    for states in played["seen"]:
        done, waiting = states.count("done"), states.count("waiting")
        running = [state for state in states if state in ("capturing", "building")]
        assert len(running) <= 1
        assert states == ["done"] * done + running + ["waiting"] * waiting  # in their order
    assert len(played["hands"]) == 3


def test_a_queue_into_one_scene_is_a_list_of_captures(blender, photo, make_clip):
    sources = [str(make_clip(12)), str(photo), shutil.copy(photo, photo.with_name("second.jpg"))]
    queued, first, undone, shown, again, removed, back = blender.play(
        "capture.several", sources=[str(source) for source in sources]
    ).value
    names = sorted(queued)
    assert len(names) == 3
    gone, seen = [False] * 3, [True] * 3
    assert queued == dict.fromkeys(names, gone) | {"second": seen}, "the last one is active"
    assert first == again == dict.fromkeys(names, gone) | {names[0]: seen}
    assert undone == queued
    assert shown == {name: [name == names[0], True, True] for name in names}
    assert removed == dict.fromkeys(names[1:], gone) | {names[-1]: seen}
    assert back == first


def test_a_killed_worker_is_one_sentence_and_the_next_capture_works(blender, make_clip):
    played = blender.play("capture.worker_killed", source=make_clip(LONG_CLIP), timeout=180).value
    assert played["state"] == "failed"
    assert_sentence(played["message"])
    assert any(played["message"] in line for line in played["reports"])
    assert any(played["message"] in text for text in played["details"])
    assert not played["same_worker"]
    assert (played["again"], played["frames"]) == ("done", LONG_CLIP)


def test_undo_while_capturing(blender, make_clip):
    played = blender.play("capture.undo_in_the_middle", source=make_clip(CLIP)).value
    assert len(played["hands"]) == 1
    assert played["hands"][0]["frames"] == CLIP
    assert played["undone"] == 0


def test_another_file_while_capturing(blender, make_clip):
    played = blender.play("capture.another_file_in_the_middle", source=make_clip(CLIP)).value
    assert played == {"left": [], "again": "done", "hands": 1}


def test_quitting_while_capturing_leaves_no_process(own_blender, make_clip):
    assert own_blender.play("capture.left_running", source=make_clip(LONG_CLIP)).value == 1
    assert own_blender.quit() == []


def test_dropped_picture(blender, photo):
    played = blender.play("capture.dropped", source=photo).value
    (hand,) = played["hands"]
    assert hand["side"] == "right"
    there = {"hands": 1, "undone": False, "source": photo.name, "shown": photo.name}
    taken_back = there | {"hands": 0, "undone": True}
    not_chosen = taken_back | {"source": "", "shown": ""}
    assert played["said"] == [there, taken_back, not_chosen, taken_back, there]


def test_dropped_video(blender, make_clip):
    (hand,) = blender.play("capture.dropped", source=make_clip(CLIP)).value["hands"]
    assert hand["frames"] == CLIP


def test_the_start_up_scene_is_matched_as_the_panel_says(blender, make_clip):
    played = blender.play("capture.into_the_start_up_scene", source=make_clip(CLIP), timeout=240).value
    assert played["told"] == f"Scene becomes 25 fps, 1-{CLIP}, 640×480, with the footage's camera"
    assert played["said"] == f"Scene became 25 fps, 1-{CLIP}, 640×480, with the footage's camera"
    assert played["scene"] == [25, 1, CLIP, 640, 480]
    assert played["camera"]


def assert_sentence(text: str) -> None:
    """What an artist can read: one sentence, with a remedy, no program's words."""
    assert 20 < len(text) < 300, text
    assert "\n" not in text
    for word in ("Traceback", "Error(", "Exception", "None"):
        assert word not in text, text
