"""Whether a file that Blender wrote is whole.

Some of Blender's writers say nothing when the disk is full and leave the beginning of a file. Every format
has something that is written last, or that says how long the file is, and that is what is looked at here.
"""

from __future__ import annotations

import io
import os
import struct
from collections.abc import Callable
from pathlib import Path
from typing import BinaryIO

from handfit_core.errors import OutputError
from handfit_core.files import shown


def prove_whole(path: Path, beside: Path) -> None:
    """Raise OutputError, which names `path`, unless the file `beside` is a whole one of its suffix."""
    with beside.open("rb") as stream:
        size = os.fstat(stream.fileno()).st_size
        if size == 0:
            raise OutputError(
                f"{shown(path)}: Blender wrote nothing; see its console for the reason, free some space or "
                "choose another folder"
            )
        try:
            whole = _ENDS[beside.suffix](stream, size)
        except (struct.error, ValueError, IndexError, OSError):  # shorter than its own numbers say
            whole = False
    if not whole:
        raise OutputError(
            f"{shown(path)}: Blender wrote only a part of it, as on a full disk, so what was there is kept; "
            "free some space or choose another folder"
        )


def _blend(stream: BinaryIO, size: int) -> bool:
    """Compressed frames, then a table of their lengths: zstd's seekable format."""
    stream.seek(-9, io.SEEK_END)
    count, flags, magic = struct.unpack("<IBI", stream.read(9))
    entry = 12 if flags & 0x80 else 8
    table = 8 + count * entry + 9
    if magic != 0x8F92EAB1 or count == 0 or table > size:
        return False
    stream.seek(size - table)
    skippable, length = struct.unpack("<II", stream.read(8))
    entries = stream.read(count * entry)
    if skippable != 0x184D2A5E or length != table - 8:
        return False
    start = 0
    for number in range(count):
        stream.seek(start)
        if stream.read(4) != b"\x28\xb5\x2f\xfd":
            return False
        start += struct.unpack_from("<I", entries, number * entry)[0]
    return start == size - table


def _glb(stream: BinaryIO, size: int) -> bool:
    """The header tells the length of the file, and each chunk its own."""
    magic, _version, length = struct.unpack("<4sII", stream.read(12))
    if magic != b"glTF" or length != size:
        return False
    place = 12
    while place < size:
        stream.seek(place)
        place += 8 + struct.unpack("<I", stream.read(4))[0]
    return place == size


def _fbx(stream: BinaryIO, _size: int) -> bool:
    """A mark of sixteen bytes at the end."""
    if not stream.read(23).startswith(b"Kaydara FBX Binary"):
        return False
    stream.seek(-16, io.SEEK_END)
    return stream.read() == bytes.fromhex("f85a8c6adef5d97eece90ce3758f290b")


def _usdc(stream: BinaryIO, size: int) -> bool:
    """The header, which is written last, tells where the table of the sections is, which ends the file."""
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


def _bvh(stream: BinaryIO, _size: int) -> bool:
    """As many lines as the file says, the last with a number for every channel and the end of the line."""
    hierarchy, motion, frames = stream.read().partition(b"MOTION\n")
    lines = frames.split(b"\n")
    channels = sum(int(line.split()[1]) for line in hierarchy.splitlines() if b"CHANNELS" in line)
    said = int(lines[0].removeprefix(b"Frames:"))
    if not motion or lines.pop() != b"" or not lines[-1].strip():
        return False
    return said == len(lines) - 2 and len(lines[-1].split()) == channels


def _abc(stream: BinaryIO, size: int) -> bool:
    """Ogawa's second field says whether the file was finished; the root, which it points to, ends it."""
    magic, finished, root = struct.unpack("<5sB2xQ", stream.read(16))
    if magic != b"Ogawa" or finished != 0xFF or not 16 <= root < size:
        return False
    stream.seek(root)
    (children,) = struct.unpack("<Q", stream.read(8))
    return root + 8 * (1 + children) == size


def _png(stream: BinaryIO, _size: int) -> bool:
    """An empty chunk at the end."""
    if stream.read(8) != b"\x89PNG\r\n\x1a\n":
        return False
    stream.seek(-12, io.SEEK_END)
    return stream.read() == b"\0\0\0\0IEND\xaeB`\x82"


_ENDS: dict[str, Callable[[BinaryIO, int], bool]] = {
    ".blend": _blend,
    ".glb": _glb,
    ".fbx": _fbx,
    ".usdc": _usdc,
    ".bvh": _bvh,
    ".abc": _abc,
    ".png": _png,
}
