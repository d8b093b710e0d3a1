"""Fewer keys, all of them back, and a layer on top, by the panel's buttons."""

from __future__ import annotations

import numpy as np


def test_simplify_follows_its_sliders_and_undo(blender, make_long_take):
    seen = blender.play("simplifying.simplified", take=make_long_take(100), timeout=300).value
    every, left = seen["keys"][0], seen["keys"][1]
    assert seen["left"][1] < seen["left"][0] < every
    assert left == seen["left"][1]
    # Simplified, undone, redone; all keys back, and that undone; a layer put on top and ended.
    assert seen["keys"] == [every, left, every, left, every, left, left]
    assert seen["layer"] == [1, 0, 0]


def test_what_was_merged_is_simplified_after_opening(blender, make_long_take, tmp_path):
    captured, merged, simplified = np.array(
        blender.play("simplifying.merged", take=make_long_take(100), folder=str(tmp_path), timeout=300).value
    )
    assert _degrees(captured, merged) > 10.0
    assert _degrees(merged, simplified) <= 2.0  # as the panel's slider says


def _degrees(one: np.ndarray, other: np.ndarray) -> float:
    """Between two unit quaternions."""
    return float(np.degrees(2.0 * np.arccos(min(1.0, abs(one @ other)))))
