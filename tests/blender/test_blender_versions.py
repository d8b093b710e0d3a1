"""The same calls do the same in every version of Blender."""

from __future__ import annotations

import bpy
import pytest

from blender_manient.common.blender_versions import (
    action_slot,
    assign_action,
    channels,
    first_slot,
    gltf_left_out,
    has_operator,
    new_slot,
    property_group,
    use_nodes,
)

from .conftest import action_curves


@pytest.fixture(autouse=True)
def clean(empty_file):
    """Every test starts in an empty file."""


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


def test_assigning_again_finds_the_same_channels():
    thing, action = new_object(), bpy.data.actions.new("wave")
    assign_action(thing, action).fcurves.new("location", index=0)
    again = assign_action(thing, action)
    assert [c.data_path for c in again.fcurves] == ["location"]
    assert [c.data_path for c in channels(action, action_slot(thing.animation_data)).fcurves] == ["location"]


def test_a_new_slot_has_no_channels_until_they_are_made():
    action = bpy.data.actions.new("pose")
    slot = new_slot(action, "thing")
    before = channels(action, slot)
    assert (before is None) == (slot is not None)  # before Blender 4.4 the action itself holds the curves
    assert len(channels(action, slot, make=True).fcurves) == 0
    assert channels(action, slot) is not None


@pytest.mark.parametrize("kind", ["materials", "worlds"])
def test_nodes(kind):
    block = getattr(bpy.data, kind).new("surface")
    tree = use_nodes(block)
    assert tree == block.node_tree
    assert len(tree.nodes) > 1
    count = len(tree.nodes)
    assert len(use_nodes(block).nodes) == count


def test_operators():
    assert has_operator("export_scene.gltf")
    assert not has_operator("export_scene.no_such_format")
    assert not has_operator("no_such_module.at_all")


def test_the_exporters_own_list_is_found():
    left_out = gltf_left_out()
    assert "cycles" in left_out
    assert gltf_left_out() is left_out


def test_only_groups_are_groups():
    thing = new_object()
    thing["marks"] = {"0": "abc"}
    thing["number"] = 3
    assert property_group(thing, "marks") == {"0": "abc"}
    assert property_group(thing, "number") == {}
    assert property_group(thing, "missing") == {}
