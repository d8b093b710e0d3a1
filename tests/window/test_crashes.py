"""Blender crashes in a scenario: what the harness makes of it."""

from __future__ import annotations

import pytest

from tests.window.blender_window import BlenderCrash


def test_a_crash_of_blenders_own_is_tried_again_once_and_shown(own_blender, tmp_path):
    assert own_blender.play("crashing.outside_the_addon", mark=tmp_path / "mark").value == "played again"
    (crash,) = own_blender.crashes
    own_blender.crashes.clear()  # It was made: the run's summary is for those that were not.
    assert "ended with 136 in crashing.outside_the_addon" in str(crash)
    native, python = str(crash).split("# Python backtrace")
    assert "libc.so" in native.split("# backtrace")[1]
    assert "crashing.py" in python
    with pytest.raises(BlenderCrash, match="in_the_addon"):
        own_blender.play("crashing.in_the_addon")
    assert own_blender.crashes == []


def test_a_scenario_that_crashes_twice_fails(own_blender):
    with pytest.raises(BlenderCrash):
        own_blender.play("crashing.outside_the_addon")
    assert len(own_blender.crashes) == 1
    own_blender.crashes.clear()
