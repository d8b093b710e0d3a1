"""Where to work so that the user's scene is neither seen nor changed: a scene of its own, in Object mode."""

from __future__ import annotations

import contextlib
from collections.abc import Collection, Iterable, Iterator
from typing import Any

import bpy
import numpy as np


def remove_blocks(blocks: Iterable[bpy.types.ID], ours: Collection[bpy.types.ID] = ()) -> None:
    """Remove data-blocks, and all that nobody but these uses, however deep: data, actions, materials. Scenes,
    collections and what lies in one stay, and so does what has a fake user, unless it is one of `ours`."""
    gone = set(blocks)
    unused = {block: them for block, them in bpy.data.user_map().items() if them and _may_go(block, ours)}
    while more := {block for block, them in unused.items() if them <= gone} - gone:
        gone |= more
    bpy.data.batch_remove([block for block in gone if not isinstance(block, bpy.types.Key)])  # go with meshes


def _may_go(block: bpy.types.ID, ours: Collection[bpy.types.ID]) -> bool:
    if isinstance(block, bpy.types.Collection | bpy.types.Scene):
        return False
    if isinstance(block, bpy.types.Object) and block.users_collection:
        return False
    return not block.use_fake_user or block in ours


@contextlib.contextmanager
def object_mode() -> Iterator[None]:
    """Leave edit, sculpt and paint modes, whose data is not in the object yet and would be written over what
    is; go back there afterwards. Pose mode may stay."""
    active = bpy.context.view_layer.objects.active
    mode = active.mode if active is not None else "OBJECT"
    if mode in ("OBJECT", "POSE"):
        yield
        return
    bpy.ops.object.mode_set(mode="OBJECT")
    try:
        yield
    finally:
        bpy.ops.object.mode_set(mode=mode)


@contextlib.contextmanager
def unseen_scene(name: str) -> Iterator[bpy.types.Scene]:
    """Make a new, empty scene that no window opens, and remove it afterwards.

    `sampling.sample` evaluates objects in it, of which Blender writes nothing back to them. No editor changes
    its region, tool or render engine below an operator.
    """
    scene = bpy.data.scenes.new(name)
    try:
        yield scene
    finally:
        bpy.data.scenes.remove(scene)


@contextlib.contextmanager
def own_scene(name: str) -> Iterator[bpy.types.Scene]:
    """Make a new, empty scene the context's, as exporters want it, while windows go on showing the user's;
    afterwards remove it, and have the user's on its frame again, with every pose as it was, also where a pose
    has no keys yet.
    """
    before = bpy.context.scene
    frame, subframe = before.frame_current, before.frame_subframe
    with _transforms_kept():
        try:
            with (
                unseen_scene(name) as scene,
                bpy.context.temp_override(scene=scene, view_layer=scene.view_layers[0], active_object=None),
            ):
                yield scene
        finally:
            before.frame_set(frame, subframe=subframe)


_TRANSFORMS = {
    "location": 3,
    "rotation_quaternion": 4,
    "rotation_euler": 3,
    "rotation_axis_angle": 4,
    "scale": 3,
}
"""Properties of objects and of pose bones, each with how many numbers it has"""


@contextlib.contextmanager
def _transforms_kept() -> Iterator[None]:
    """Have animated objects and bones stand afterwards as they stood, whatever frames were shown in between:
    what the artist moved and did not key yet would be lost with the first frame."""
    before = [(obj, _transforms(obj)) for obj in bpy.data.objects if obj.animation_data is not None]
    try:
        yield
    finally:
        for obj, kept in before:
            if _set_transforms(obj, kept):
                obj.update_tag(refresh={"OBJECT", "DATA"})


def _transforms(obj: bpy.types.Object) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Return for each property the object's own numbers (n,), and those of its bones one after the other."""
    bones = obj.pose.bones if obj.pose is not None else None
    found = {}
    for name, count in _TRANSFORMS.items():
        posed = np.empty(len(bones) * count if bones is not None else 0, dtype=np.float32)
        if bones is not None:
            bones.foreach_get(name, posed)
        found[name] = (np.array(getattr(obj, name), dtype=np.float32), posed)
    return found


def _set_transforms(obj: bpy.types.Object, kept: dict[str, tuple[np.ndarray, np.ndarray]]) -> bool:
    """Set the transforms that differ from `kept`, which `_transforms` gave; return whether any did."""
    changed = False
    for name, (own, posed) in _transforms(obj).items():
        kept_own, kept_posed = kept[name]
        if not np.array_equal(own, kept_own):
            setattr(obj, name, kept_own)
            changed = True
        if not np.array_equal(posed, kept_posed):
            obj.pose.bones.foreach_set(name, kept_posed)
            changed = True
    return changed


@contextlib.contextmanager
def with_values(values: Iterable[tuple[Any, str, Any]]) -> Iterator[None]:
    """Give attributes of data-blocks and their parts these values within: owner, name, value."""
    before = []
    try:
        for owner, name, value in values:
            if (present := getattr(owner, name)) != value:
                setattr(owner, name, value)
                before.append((owner, name, present))
        yield
    finally:
        for owner, name, value in before:
            setattr(owner, name, value)


def shown_in_pose(
    objects: Iterable[bpy.types.Object | None],
) -> contextlib.AbstractContextManager[None]:
    """Have objects that the artist hid, and armatures left in Rest Position, be shown as they move within.

    Blender evaluates nothing that is hidden: it would be read as it stood when it was hidden."""
    there = [obj for obj in objects if obj is not None]
    values: list[tuple[Any, str, Any]] = [(obj, "hide_viewport", False) for obj in there]
    values += [(obj, "hide_render", False) for obj in there]
    values += [(obj.data, "pose_position", "POSE") for obj in there if obj.type == "ARMATURE"]
    return with_values(values)
