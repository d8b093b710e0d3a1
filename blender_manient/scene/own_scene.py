"""A scene of its own to work in, so that the user's is neither seen nor changed."""

from __future__ import annotations

import contextlib
from collections.abc import Iterable, Iterator

import bpy


@contextlib.contextmanager
def own_scene(name: str) -> Iterator[bpy.types.Scene]:
    """Open a new, empty scene; afterwards remove it and open the user's again, on its frame.

    It has to be the open one: exporters write what is open, and movies and image sequences follow
    the open scene's frame even while another scene is rendered.
    """
    window = bpy.context.window
    before = window.scene
    frame, subframe = before.frame_current, before.frame_subframe
    scene = bpy.data.scenes.new(name)
    try:
        window.scene = scene
        yield scene
    finally:
        window.scene = before
        bpy.data.scenes.remove(scene)
        before.frame_set(frame, subframe=subframe)


@contextlib.contextmanager
def shown_in_pose(objects: Iterable[bpy.types.Object | None]) -> Iterator[None]:
    """Objects that the artist hid, and armatures left in Rest Position, are shown as they move meanwhile.

    Blender evaluates nothing that is hidden: it would be read as it stood when it was hidden.
    """
    wanted: list[tuple[bpy.types.ID, str, object]] = []
    for obj in objects:
        if obj is None:
            continue
        wanted += [(obj, "hide_viewport", False), (obj, "hide_render", False)]
        if obj.type == "ARMATURE":
            wanted.append((obj.data, "pose_position", "POSE"))
    changed = []
    try:
        for block, name, value in wanted:
            before = getattr(block, name)
            if before != value:
                setattr(block, name, value)
                changed.append((block, name, before))
        yield
    finally:
        for block, name, before in changed:
            setattr(block, name, before)
