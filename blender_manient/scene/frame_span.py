"""The frames that a scene plays."""

from __future__ import annotations

import bpy


def span_of(scene: bpy.types.Scene) -> tuple[int, int]:
    """First and last scene frame: the preview range where it is used, else the scene's own."""
    if scene.use_preview_range:
        return scene.frame_preview_start, scene.frame_preview_end
    return scene.frame_start, scene.frame_end
