"""Building in slices: none holds the window up, and whatever comes between leaves nothing half built."""

from __future__ import annotations

import bpy
import pytest

from blender_manient.scene.build import build_take, building
from blender_manient.scene.keys import CURVES
from handfit_core.common.errors import BuildInterrupted

from .conftest import action_curves, blocks


def halfway(steps, part: float = 0.5) -> None:
    """Build until more than that part is done."""
    for done in steps:
        if done > part:
            return
    raise AssertionError("it was already built")


def test_slices_make_what_building_at_once_makes(make_take, model, registered):
    made = make_take(model=model)
    at_once, steps, done, built = build_take(made.take), building(made.take), [], None
    while built is None:
        try:
            done.append(next(steps))
        except StopIteration as stop:
            built = stop.value
    assert done == sorted(done)
    assert 0.0 <= done[0] < done[-1] <= 1.0
    for hand, other in zip(built.hands, at_once.hands, strict=True):
        curves, others = action_curves(hand.action), action_curves(other.action)
        assert len(curves) == len(others) == CURVES
        assert [c.data_path for c in curves] == [c.data_path for c in others]
        assert [g.name for g in hand.mesh.vertex_groups] == [g.name for g in other.mesh.vertex_groups]
        assert bool(hand.mesh.data.shape_keys) == bool(other.mesh.data.shape_keys)


def test_half_a_build_is_unseen_and_closing_it_removes_it(make_take, imitation_mano):
    scene, before = bpy.context.scene, blocks()
    for part in (0.05, 0.3, 0.7):
        steps = building(make_take(model=str(imitation_mano)).take)
        halfway(steps, part)
        assert not scene.collection.all_objects
        assert (scene.camera, len(bpy.data.scenes)) == (None, 1)
        steps.close()
        assert blocks() == before


@pytest.mark.parametrize("what", ["a deletion", "another file", "an undo"])
def test_what_takes_the_half_built_away_is_an_interruption(make_take, what, registered):
    made, before = make_take(), blocks()
    bpy.context.preferences.edit.use_global_undo = True
    bpy.ops.ed.undo_push(message="before")
    steps = building(made.take)
    halfway(steps, 0.4)
    if what == "an undo":
        bpy.ops.mesh.primitive_cube_add()
        bpy.ops.ed.undo_push(message="artist's cube")
    halfway(steps, 0.6)
    if what == "an undo":
        bpy.ops.ed.undo()
    elif what == "another file":
        bpy.ops.wm.read_factory_settings(use_empty=True)
        before = blocks()
    else:
        bpy.data.objects.remove(next(o for o in bpy.data.objects if o.type == "ARMATURE"))
    with pytest.raises(BuildInterrupted):
        list(steps)
    assert blocks() == before
    for hand in build_take(made.take).hands:
        assert len(action_curves(hand.action)) == CURVES


@pytest.mark.parametrize("mode", ["OBJECT", "POSE", "EDIT"])
def test_the_artists_mode_and_selection_stay(make_take, mode):
    bpy.ops.mesh.primitive_cube_add()
    bpy.ops.object.armature_add()
    rig = bpy.context.object
    bpy.ops.object.mode_set(mode=mode)
    if mode == "EDIT":
        rig.data.edit_bones[0].tail = (0.0, 0.0, 7.0)  # not yet taken over into the bones
    selected = bpy.context.selected_objects
    build_take(make_take().take)
    assert rig.mode == mode
    assert bpy.context.view_layer.objects.active == rig
    assert mode == "EDIT" or list(bpy.context.view_layer.objects.selected) == selected
    bpy.ops.object.mode_set(mode="OBJECT")
    assert rig.data.bones[0].tail_local.z == pytest.approx(7.0 if mode == "EDIT" else 1.0)
