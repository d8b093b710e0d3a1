"""Universal Scene Description."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from pathlib import Path
from typing import BinaryIO

import bpy

from .exporter import Exporter, HandObjects, Preset


class UsdExporter(Exporter):
    """Universal Scene Description."""

    name = "usd"
    label = "USD"
    description = "Universal Scene Description"
    suffix = ".usdc"
    operator = "wm.usd_export"
    other_endings = (".usd",)

    def write(self, path: Path, _hands: Sequence[HandObjects], _preset: Preset, _final: Path, /) -> None:
        """Write it as Blender renders it."""
        bpy.ops.wm.usd_export(
            filepath=str(path),
            check_existing=False,
            export_animation=True,
            export_armatures=True,
            export_shapekeys=True,
            export_uvmaps=True,
            export_custom_properties=False,  # USD has no type for the ten betas
            evaluation_mode="RENDER",
        )

    def is_whole(self, stream: BinaryIO, size: int, /) -> bool:
        """The header, written last, tells where the table of the sections is, which ends the file."""
        magic, contents = struct.unpack("<8s8xq", stream.read(24))
        if magic != b"PXR-USDC" or not 24 <= contents < size:
            return False
        stream.seek(contents)
        (count,) = struct.unpack("<Q", stream.read(8))
        if count == 0 or contents + 8 + 32 * count != size:
            return False
        end = None
        for _ in range(count):
            start, length = struct.unpack("<16xqq", stream.read(32))
            if start < 24 or end not in (None, start):
                return False
            end = start + length
        return end == contents
