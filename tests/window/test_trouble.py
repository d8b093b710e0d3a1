"""Bad input in the window: every failure is one sentence with a remedy."""

from __future__ import annotations

from handfit_core.hand_model import save_model_npz
from tests.imitation_mano import imitation_model
from tests.window.test_capture import CLIP, assert_sentence


def test_half_a_clip_without_hands(blender, make_clip):
    played = blender.play("capture.clip", source=make_clip(CLIP, CLIP // 2), shot="half").value
    (hand,) = played["hands"]
    assert hand["frames"] == CLIP
    assert 0.8 * CLIP / 2 < hand["detected"] <= CLIP / 2


def test_a_clip_without_any_hand(blender, make_clip):
    played = blender.play("capture.fails", source=make_clip(CLIP, 0), shot="no-hand").value
    assert_failed(played, "hand")
    assert played["hands"] == 0


def test_mano_of_the_wrong_side(blender, photo):
    wrong = save_model_npz(imitation_model("left"), photo.with_name("MANO_RIGHT.npz"))
    played = blender.play(
        "capture.fails", source=photo, shot="mano", model="MANO", model_path=str(wrong), hands="right"
    ).value
    assert_failed(played, "left")


def test_a_file_that_is_no_picture(blender, photo):
    photo.write_text("these are words")
    played = blender.play("capture.fails", source=photo, shot="no-picture").value
    assert_failed(played, "picture")
    assert any("hand.jpg" in line for line in played["reports"])


def test_full_disk(blender, photo):
    played = blender.play("capture.full_disk", source=photo).value
    assert_failed(played, "full")
    assert played["again"] == "done"


def test_picture_is_gone_after_moving_the_file(blender, photo):
    played = blender.play("capture.moved_file", source=photo).value
    assert played["after"] == played["before"]
    assert_failed(played, "not there")


def assert_failed(played: dict, word: str) -> None:
    message = played["message"] or played["reports"][-1]
    assert_sentence(message)
    assert word in message
    # The panel has the name before the message, the report all in one sentence.
    assert any(message[1:] in line for line in played["reports"])
    if played["message"]:
        assert any(message in text for text in played["details"])
