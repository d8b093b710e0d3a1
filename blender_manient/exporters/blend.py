""".blend files: the whole capture, for Blender itself."""

from __future__ import annotations

import io
import struct
from collections.abc import Sequence
from pathlib import Path
from typing import BinaryIO

import bpy
import numpy as np

from .exporter import Exporter, HandObjects, Preset


class BlendExporter(Exporter):
    """.blend files: the whole capture, for Blender itself."""

    name = "blend"
    label = "Blend"
    description = "Blender's own file, with camera and picture"
    suffix = ".blend"
    writes = "collection"

    def write(self, path: Path, hands: Sequence[HandObjects], _preset: Preset, _final: Path, /) -> None:
        """Write the context's scene with all that it uses; of a character the whole open file."""
        if any(hand.side is None for hand in hands):
            path.unlink(missing_ok=True)  # Blender would keep what stands there as an older version
            bpy.ops.wm.save_as_mainfile(
                filepath=str(path), check_existing=False, copy=True, compress=True, relative_remap=True
            )
            return
        try:
            # Picture paths become relative to the file wherever both lie on one drive.
            bpy.data.libraries.write(
                str(path), {bpy.context.scene}, path_remap="RELATIVE_ALL", fake_user=False, compress=True
            )
        except OSError as error:  # with words only, as operators' errors have
            raise RuntimeError(str(error)) from error

    def is_whole(self, stream: BinaryIO, size: int, /) -> bool:
        """True if the file has its compressed frames, and then a table of their lengths: zstd's seekable
        format."""
        stream.seek(-9, io.SEEK_END)
        count, flags, magic = struct.unpack("<IBI", stream.read(9))
        width = 3 if flags & 0x80 else 2
        table = 8 + 4 * width * count + 9
        stream.seek(size - table)
        skippable, length = struct.unpack("<II", stream.read(8))
        lengths = np.frombuffer(stream.read(4 * width * count), dtype="<u4").reshape(count, width)[:, 0]
        known = (magic, skippable, length) == (0x8F92EAB1, 0x184D2A5E, table - 8)
        return known and int(lengths.sum(dtype=np.uint64)) + table == size
