"""The options of a capture in Blender: its properties and its batch against the core's table."""

from __future__ import annotations

import argparse

import bpy
import pytest

from blender_manient.batch.arguments import add_arguments
from handfit_core.options import OPTIONS, CaptureOptions


@pytest.mark.parametrize(("name", "units"), [("smoothing", 1.0), ("threshold", 1.0), ("hand_length", 100.0)])
def test_what_a_property_takes_its_option_takes(registered, name, units):
    settings, option = bpy.context.scene.manient, OPTIONS[name]
    shown = settings.bl_rna.properties[name]
    for value in (shown.hard_min, shown.hard_max):
        setattr(settings, name, value)
        assert option.least <= option.read(getattr(settings, name) / units) <= option.most


def test_the_panel_has_the_hands_to_choose_from_and_a_batch_every_option(registered):
    shown = bpy.context.scene.manient.bl_rna.properties["hands"]
    assert [item.identifier for item in shown.enum_items] == list(OPTIONS["hands"].choices())
    assert shown.default == CaptureOptions.hands
    parser = argparse.ArgumentParser()
    add_arguments(parser)
    assert {option.flag for option in OPTIONS.values()} <= set(parser._option_string_actions)
