"""Biovision motion capture: a skeleton per file."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import BinaryIO

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

    def write(self, path: Path, hands: Sequence[HandObjects], _preset: Preset, /) -> None:
        """Write the one hand's bones."""
        armature = hands[0].armature
        scene = bpy.context.scene
        layer = bpy.context.view_layer
        layer.objects.active = armature
        armature.select_set(True, view_layer=layer)
        bpy.ops.export_anim.bvh(
            filepath=str(path),
            check_existing=False,
            frame_start=scene.frame_start,
            frame_end=scene.frame_end,
            rotate_mode="NATIVE",
            root_transform_only=hands[0].side
            is not None,  # only a hand's wrist moves; fingers have rotations alone
        )

    def is_whole(self, stream: BinaryIO, _size: int, /) -> bool:
        """As many lines as the file says, the last with a number for every channel, and ended."""
        hierarchy, motion, frames = stream.read().partition(b"MOTION\n")
        lines = frames.split(b"\n")
        channels = sum(int(line.split()[1]) for line in hierarchy.splitlines() if b"CHANNELS" in line)
        said = int(lines[0].removeprefix(b"Frames:"))
        if not motion or lines.pop() != b"" or not lines[-1].strip():
            return False
        return said == len(lines) - 2 and len(lines[-1].split()) == channels
