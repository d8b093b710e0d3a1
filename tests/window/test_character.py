"""The panel Character in the window: recognised, changed by mouse, applied, undone, saved."""

from __future__ import annotations


def test_motion_on_a_rigify_character(blender, make_long_take, tmp_path):
    seen = blender.play(
        "character.applied", take=make_long_take(100), blend=tmp_path / "character.blend", timeout=400
    ).value
    print(seen)
