"""Object mode for work that other modes would get in the way of."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator

import bpy


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
