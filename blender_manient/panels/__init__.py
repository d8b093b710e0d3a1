"""The sidebar tab "Hand Capture" in the 3D viewport, one section per file, in the order of the work."""

from __future__ import annotations

import bpy

from . import capture, export, hand, installation, refine, result, shape, source

_CLASSES = (
    installation.MANIENT_PT_installation,
    source.MANIENT_PT_source,
    hand.MANIENT_PT_hand,
    capture.MANIENT_PT_capture,
    capture.MANIENT_PT_capture_advanced,
    result.MANIENT_PT_result,
    refine.MANIENT_PT_refine,
    shape.MANIENT_PT_shape,
    shape.MANIENT_PT_proportions,
    shape.MANIENT_PT_other_proportions,
    export.MANIENT_PT_export,
)


def register() -> None:
    """Add the panels."""
    for cls in _CLASSES:
        bpy.utils.register_class(cls)


def unregister() -> None:
    """Take them away again."""
    for cls in reversed(_CLASSES):
        bpy.utils.unregister_class(cls)
