"""The options of a capture in Blender: its properties and its batch against the core's table."""

from __future__ import annotations

import argparse

import bpy
import pytest

import blender_manient
from blender_manient.batch.arguments import add_arguments
from handfit_core.options import OPTIONS, CaptureOptions


@pytest.fixture
def settings(empty_file):
    blender_manient.register()
    yield bpy.context.scene.manient
    blender_manient.unregister()


@pytest.mark.parametrize(("name", "units"), [("smoothing", 1.0), ("threshold", 1.0), ("hand_length", 100.0)])
def test_what_a_property_takes_its_option_takes(settings, name, units):
    shown, option = settings.bl_rna.properties[name], OPTIONS[name]
    for value in (shown.hard_min, shown.hard_max):
        setattr(settings, name, value)
        assert option.least <= option.read(getattr(settings, name) / units) <= option.most


def test_the_hands_to_choose_from_are_the_options(settings):
    shown = settings.bl_rna.properties["hands"]
    assert OPTIONS["hands"].choices is not None
    assert [item.identifier for item in shown.enum_items] == list(OPTIONS["hands"].choices())
    assert shown.default == CaptureOptions.hands


def test_a_batch_has_every_option():
    parser = argparse.ArgumentParser()
    add_arguments(parser)
    assert {option.flag for option in OPTIONS.values()} <= set(parser._option_string_actions)
