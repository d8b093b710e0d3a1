"""Building in slices: none holds the window up, and whatever comes between leaves nothing half built."""

from __future__ import annotations

import time

import bpy
import numpy as np
import pytest

from blender_manient.scene.build import BuildOptions, build_take, building
from blender_manient.scene.keys import CURVES
from handfit_core.errors import BuildInterrupted

from .conftest import action_curves

LONGEST_SLICE = 0.055
"""of the whole build of 10 000 frames, of which Blender's
copy of an action is the longest step, and cannot be divided"""


def blocks() -> dict[str, list[str]]:
    """All data-blocks of the file, by kind."""
    kinds = (
        "objects",
        "collections",
        "armatures",
        "meshes",
        "actions",
        "cameras",
        "images",
        "materials",
        "scenes",
    )
    return {kind: sorted(block.name for block in getattr(bpy.data, kind)) for kind in kinds}


def halfway(steps, part: float = 0.5) -> None:
    """Build until more than that part is done."""
    for done in steps:
        if done > part:
            return
    raise AssertionError("it was already built")


def test_slices_make_what_building_at_once_makes(make_take, model, registered):
    made = make_take(model=model)
    at_once = build_take(made.take)
    done = []
    steps = building(made.take)
    while True:
        try:
            done.append(next(steps))
        except StopIteration as stop:
            built = stop.value
            break
    assert done == sorted(done)
    assert 0.0 <= done[0] < done[-1] <= 1.0
    for hand, other in zip(built.hands, at_once.hands, strict=True):
        curves, others = action_curves(hand.action), action_curves(other.action)
        assert len(curves) == len(others) == CURVES
        assert [c.data_path for c in curves] == [c.data_path for c in others]
        assert [g.name for g in hand.mesh.vertex_groups] == [g.name for g in other.mesh.vertex_groups]
        assert bool(hand.mesh.data.shape_keys) == bool(other.mesh.data.shape_keys)


def slice_times(steps) -> list[float]:
    """Processor time of each step, in seconds."""
    times = []
    while True:
        start = time.thread_time()
        try:
            next(steps)
        except StopIteration:
            return times
        finally:
            times.append(time.thread_time() - start)


@pytest.mark.parametrize("frames", [10_000])
def test_no_slice_of_a_long_take_holds_the_window_up(make_take, imitation_mano, registered, frames):
    """Two hands with 135 shape keys each. Parts of the whole, so that no machine's speed decides."""
    made = make_take(model=str(imitation_mano), frame_numbers=np.arange(1, frames + 1))
    data = made.take.to_bytes(compact=True)
    # The quietest of three alike: processor time, too, is longer while others use the memory.
    parts = []
    for _ in range(3):
        bpy.ops.wm.read_homefile(use_empty=True)
        times = slice_times(building(made.take, BuildOptions(data=data)))
        parts.append(np.array(times) / sum(times))
        print(f"{len(times)} slices, {sum(times):.2f} s: {np.median(times):.4f} (median), {max(times):.4f}")
    assert min(part.max() for part in parts) < LONGEST_SLICE
    assert min(np.median(part) for part in parts) < 0.02


def test_nothing_is_seen_of_half_a_build(make_take, imitation_mano):
    steps = building(make_take(model=str(imitation_mano)).take)
    halfway(steps, 0.6)
    scene = bpy.context.scene
    assert not scene.collection.all_objects
    assert scene.camera is None
    assert len(bpy.data.scenes) == 1


def test_closing_it_early_removes_what_it_made(make_take, imitation_mano):
    bpy.ops.mesh.primitive_cube_add()
    before = blocks()
    for part in (0.05, 0.3, 0.7):
        steps = building(make_take(model=str(imitation_mano)).take)
        halfway(steps, part)
        steps.close()
        assert blocks() == before


def test_a_failing_build_removes_what_it_made(make_take, monkeypatch):
    """As where a disk error or a defect ends it in the middle."""
    from blender_manient.scene import build

    before = blocks()

    def fails(*_args):
        raise MemoryError

    monkeypatch.setattr(build, "computing_keys", fails)
    with pytest.raises(MemoryError):
        build_take(make_take().take)
    assert blocks() == before


@pytest.mark.parametrize("what", ["a deletion", "another file"])
def test_what_takes_the_half_built_away_is_an_interruption(make_take, what):
    made = make_take()
    before = blocks()
    steps = building(made.take)
    halfway(steps, 0.6)
    if what == "another file":
        bpy.ops.wm.read_factory_settings(use_empty=True)
        before = blocks()
    else:
        bpy.data.objects.remove(next(o for o in bpy.data.objects if o.type == "ARMATURE"))
    with pytest.raises(BuildInterrupted):
        for _ in steps:
            pass
    assert blocks() == before
    assert len(build_take(made.take).hands) == 2


def test_an_undo_in_the_middle_is_an_interruption(make_take, registered):
    made = make_take()
    bpy.context.preferences.edit.use_global_undo = True
    bpy.ops.ed.undo_push(message="before")
    steps = building(made.take)
    halfway(steps, 0.4)
    bpy.ops.mesh.primitive_cube_add()
    bpy.ops.ed.undo_push(message="artist's cube")
    halfway(steps, 0.6)
    bpy.ops.ed.undo()
    with pytest.raises(BuildInterrupted):
        for _ in steps:
            pass
    assert not [o for o in bpy.context.scene.objects if o.type == "ARMATURE"]
    built = build_take(made.take)
    assert len(built.hands) == 2
    for hand in built.hands:
        assert len(action_curves(hand.action)) == CURVES


@pytest.mark.parametrize("mode", ["OBJECT", "POSE", "EDIT"])
def test_the_artists_mode_and_selection_stay(make_take, mode):
    bpy.ops.object.armature_add()
    rig = bpy.context.object
    bpy.ops.mesh.primitive_cube_add()
    cube = bpy.context.object
    bpy.context.view_layer.objects.active = rig
    rig.select_set(True)
    bpy.ops.object.mode_set(mode=mode)
    if mode == "EDIT":
        rig.data.edit_bones[0].tail = (0.0, 0.0, 7.0)  # not yet taken over into the bones
    selected = set(bpy.context.selected_objects)
    build_take(make_take().take)
    assert rig.mode == mode
    assert bpy.context.view_layer.objects.active == rig
    assert set(bpy.context.view_layer.objects.selected) == selected == {rig, cube} or mode != "OBJECT"
    if mode == "EDIT":
        assert rig.data.edit_bones[0].tail.z == pytest.approx(7.0)
        bpy.ops.object.mode_set(mode="OBJECT")
        assert rig.data.bones[0].tail_local.z == pytest.approx(7.0)
    bpy.ops.object.mode_set(mode="OBJECT")


def test_hands_are_built_where_the_collection_is_excluded(make_take):
    """The active layer collection being hidden must not matter."""
    hidden = bpy.data.collections.new("hidden")
    bpy.context.scene.collection.children.link(hidden)
    layer = bpy.context.view_layer.layer_collection.children["hidden"]
    bpy.context.view_layer.active_layer_collection = layer
    layer.exclude = True
    assert len(build_take(make_take().take).hands) == 2
