"""Biovision motion capture: a skeleton per file."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import bpy

from .exporter import Exporter, HandObjects, Preset


class BvhExporter(Exporter):
    """Biovision motion capture: a skeleton per file."""

    name = "bvh"
    label = "BVH"
    description = "Biovision motion capture, a file per hand"
    suffix = ".bvh"
    operator = "export_anim.bvh"
    per_hand = True

    def write(self, path: Path, hands: Sequence[HandObjects], _preset: Preset, _final: Path, /) -> None:
        """Write the one hand's bones."""
        scene = bpy.context.scene
        bpy.ops.export_anim.bvh(
            filepath=str(path),
            check_existing=False,
            frame_start=scene.frame_start,
            frame_end=scene.frame_end,
            rotate_mode="NATIVE",
            root_transform_only=hands[0].side
            is not None,  # only a hand's wrist moves; fingers have rotations alone
        )
