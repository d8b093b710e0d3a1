"""A captured hand in the Graph Editor and the Timeline."""

from __future__ import annotations


def test_curves_fill_the_view_and_the_error_is_drawn_beside_them(blender, make_clip):
    played = blender.play("time_editors.curves_and_error", source=make_clip(60), timeout=240).value
    assert played["inside"]
    assert played["filled"] > 0.7
    assert played["changed_in_graph"] > 2000
    assert played["changed_in_timeline"] > 2000
