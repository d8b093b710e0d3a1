"""Shape, pose and export through Blender's window."""

from __future__ import annotations


def test_proportions_follow_the_slider_and_undo(blender, photo):
    played = blender.play("shaping.proportions", source=str(photo)).value
    assert played["moved"] > 1e-3  # metres
    assert played["knuckle"] > 1e-4
    assert played["undone"] < 1e-6
    assert max(map(abs, played["betas"])) < 5.0


def test_buttons(blender, photo):
    played = blender.play("shaping.buttons", source=str(photo)).value
    assert played["hands"] == ["left", "right"]
    assert len(played["assets"]) == 1
    assert played["exported"][0] == "FINISHED"
    assert played["exported"][1] > 10_000


def test_the_first_render_shows_the_hand_in_the_picture(blender, photo):
    played = blender.play("shaping.first_render", source=str(photo)).value
    assert played["engine"].startswith("BLENDER_EEVEE")
    assert played["lights"] == 3
    assert played["like the photo"] > 0.5
    assert 0.02 < played["hand"] < 0.5
    assert played["forearm"] > 0.002, "the forearm can be hidden"
