"""The sidebar in the window: every section is drawn."""

from __future__ import annotations


def test_every_section_is_drawn(blender, make_clip):
    drawn = blender.play("panels.all_sections", source=make_clip(60)).value
    sections = ("source", "hand", "capture", "result", "refine", "shape", "export")
    assert [s for s in sections if not any(name.startswith(f"{s}.") for name in drawn)] == []


def test_preferences_are_drawn(blender):
    calls = blender.play("panels.preferences").blocked["calls"]
    assert any(name.startswith("preferences.") and name.endswith(".draw") for name in calls), calls
