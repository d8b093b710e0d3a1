"""Checks that a file that Blender wrote is whole.

Blender's writers in C++ say nothing when the disk is full and leave the beginning of a file. Their formats
have something that is written last, or that says how long the file is, and that is what is looked at here.
"""

from __future__ import annotations

import io
import os
import struct
from collections.abc import Callable
from pathlib import Path
from typing import BinaryIO

from handfit_core.common.errors import OutputError
from handfit_core.common.files import shown


def prove_whole(path: Path, beside: Path, is_whole: Callable[[BinaryIO, int], bool]) -> None:
    """Raise OutputError, which names `path`, unless the file `beside` is whole: `Exporter.is_whole` tells."""
    with beside.open("rb") as stream:
        size = os.fstat(stream.fileno()).st_size
        if size == 0:
            raise OutputError(
                f"{shown(path)}: Blender wrote nothing; see its console for the reason, free some space or "
                "choose another folder"
            )
        try:
            whole = is_whole(stream, size)
        except (struct.error, ValueError, IndexError, OSError):  # shorter than its own numbers say
            whole = False
    if not whole:
        raise OutputError(
            f"{shown(path)}: Blender wrote only a part of it, as on a full disk, so what was there is kept; "
            "free some space or choose another folder"
        )


def is_whole_png(stream: BinaryIO, _size: int) -> bool:
    """True if a PNG has the empty chunk at its end."""
    if stream.read(8) != b"\x89PNG\r\n\x1a\n":
        return False
    stream.seek(-12, io.SEEK_END)
    return stream.read() == b"\0\0\0\0IEND\xaeB`\x82"
