"""A scene of its own to work in, so that the user's is neither seen nor changed."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator

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
