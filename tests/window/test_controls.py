"""Controls of a captured hand, in Blender's window."""

from __future__ import annotations

from tests.window.blender_window import ROOT

TAKE = ROOT / "samples" / "rendered_hand" / "truth.take.npz"


def test_a_finger_is_grabbed_and_curled_by_mouse(blender):
    played = blender.play("controls.animated", take=TAKE).value
    assert played["bones"] == [16, 24]
    assert played["picked"] == "index.R"
    assert played["curled"] > 0.01
    assert played["undone"] < 1e-6
    assert played["baked"] < 1e-5
