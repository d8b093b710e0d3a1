"""Fewer keys, all of them back, and a layer on top, by the panel's buttons."""

from __future__ import annotations


def test_simplify_follows_its_sliders_and_undo(blender, make_long_take):
    seen = blender.play("simplifying.simplified", take=make_long_take(100), timeout=300).value
    every, left = seen["keys"][0], seen["keys"][1]
    assert seen["left"][1] < seen["left"][0] < every
    assert left == seen["left"][1]
    # Simplified, undone, redone; all keys back, and that undone; a layer put on top and ended.
    assert seen["keys"] == [every, left, every, left, every, left, left]
    assert seen["layer"] == [1, 0, 0]
