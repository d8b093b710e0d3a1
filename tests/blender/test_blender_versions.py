"""The same calls do the same in every version of Blender."""

from __future__ import annotations

import bpy
import pytest

from blender_manient.blender_versions import (
    action_slot,
    assign_action,
    channels,
    first_slot,
    new_slot,
    property_group,
)

from .conftest import action_curves


def new_object(name: str = "thing") -> bpy.types.Object:
    return bpy.data.objects.new(name, None)


def test_an_assigned_action_moves_its_object():
    thing, action = new_object(), bpy.data.actions.new("wave")
    curve = assign_action(thing, action).fcurves.new("location", index=2)
    curve.keyframe_points.insert(1.0, 0.0)
    curve.keyframe_points.insert(11.0, 2.0).interpolation = "LINEAR"
    curve.update()
    bpy.context.scene.collection.objects.link(thing)
    bpy.context.scene.frame_set(11)
    assert thing.location.z == pytest.approx(2.0)
    assert action_curves(action) == [curve]
    assert first_slot(action) == action_slot(thing.animation_data)


def test_assigned_again_its_channels_are_the_same():
    thing, action = new_object(), bpy.data.actions.new("wave")
    assign_action(thing, action).fcurves.new("location", index=0)
    assert [c.data_path for c in assign_action(thing, action).fcurves] == ["location"]
    assert [c.data_path for c in channels(action, action_slot(thing.animation_data)).fcurves] == ["location"]
    pose = bpy.data.actions.new("pose")
    slot = new_slot(pose, "thing")
    before = channels(pose, slot)
    assert (before is None) == (slot is not None)  # before Blender 4.4 the action itself holds the curves
    assert len(channels(pose, slot, make=True).fcurves) == 0
    assert channels(pose, slot) is not None


def test_only_groups_are_groups():
    thing = new_object()
    thing["marks"] = {"0": "abc"}
    thing["number"] = 3
    assert property_group(thing, "marks") == {"0": "abc"}
    assert property_group(thing, "number") == {}
    assert property_group(thing, "missing") == {}
