"""Whether a file is a video, and how large its frames claim to be, by its own bytes.

FFmpeg opens whatever it recognises, whatever the file is called: playlists (HLS, DASH, concat, SDP) that name
other files or addresses, which it then opens. So a file is given to it only if it begins as a container does
that holds its frames itself. Standard library only, since Blender's process asks, too.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import BinaryIO, Final

_MOST_STEPS: Final = 100_000
"""Boxes, elements or chunks that are looked through before a file counts as damaged"""

_LOOKED_AT: Final = 1 << 20
"""Bytes of a stream without a header that are searched; FFmpeg looks at as many to tell what a file is"""

_LARGEST_PART: Final = 1 << 20
"""Bytes of a header's part that are read at once"""


@dataclass(frozen=True)
class VideoHeader:
    """What a video claims to be."""

    width: int = 0
    height: int = 0
    """Pixels of its largest track; 0 where the container does not tell"""


class _Lies(ValueError):
    """The header claims what its file cannot hold."""


def read_video_header(stream: BinaryIO) -> VideoHeader | None:
    """The header of an MP4, QuickTime, Matroska, WebM, AVI, GIF, Windows Media, MPEG, Ogg, Flash or MXF file.

    `stream` can be sought in; where it stands afterwards is not defined. None where it is none of these,
    holds no picture, or claims more than it can hold.
    """
    end = stream.seek(0, 2)
    start = _at(stream, 0, 4096)
    for signature, read in _READERS:
        if re.match(signature, start, re.DOTALL):
            try:
                return read(stream, end)
            except (struct.error, ValueError, IndexError, OverflowError):
                return None
    return None


def _at(stream: BinaryIO, position: int, count: int) -> bytes:
    stream.seek(position)
    return stream.read(count)


def _largest(sizes: list[tuple[int, int]]) -> VideoHeader | None:
    width, height = max(sizes, key=lambda size: size[0] * size[1], default=(0, 0))
    return VideoHeader(width, height) if width > 0 and height > 0 else None


# MP4 and QuickTime: boxes of a size and a name; some hold boxes again.

_BOXES_WITH_BOXES: Final = frozenset({b"moov", b"trak", b"mdia", b"minf", b"stbl", b"moof", b"traf"})


def _boxes(stream: BinaryIO, end: int) -> Iterator[tuple[bytes, int, int]]:
    """Name, start and end of the contents of every box, those that hold boxes before what they hold."""
    position = 0
    for _ in range(_MOST_STEPS):
        if position + 8 > end:
            return
        size, name = struct.unpack(">I4s", _at(stream, position, 8))
        head = 8
        if size == 1:
            (size,) = struct.unpack(">Q", stream.read(8))
            head = 16
        box_end = position + size if size else end
        if name == b"cmov":
            raise _Lies("a header that has to be unpacked first")
        if size and size < head:
            return
        yield name, position + head, min(box_end, end)
        position = position + head if name in _BOXES_WITH_BOXES else box_end
    raise _Lies("more boxes than anybody writes")


def _mp4(stream: BinaryIO, end: int) -> VideoHeader | None:
    sizes: list[tuple[int, int]] = []
    handler, claimed, frames = b"", (0, 0), 0
    for name, start, box_end in _boxes(stream, end):
        if name == b"trak":
            handler, claimed = b"", (0, 0)
        elif name == b"tkhd":
            version = _at(stream, start, 1)
            width, height = struct.unpack(">II", _at(stream, start + (88 if version == b"\1" else 76), 8))
            claimed = width >> 16, height >> 16
        elif name == b"hdlr":
            kind, subtype = struct.unpack("4s4s", _at(stream, start + 4, 8))
            if kind != b"dhlr":  # QuickTime's second one, which tells how the data are kept
                handler = subtype
        elif name == b"stsd" and handler == b"vide":
            sizes += _sample_entries(stream, start + 8, box_end, claimed)
        elif name == b"stsz":
            frames += struct.unpack(">I", _at(stream, start + 8, 4))[0]
        elif name == b"trun":
            frames += struct.unpack(">I", _at(stream, start + 4, 4))[0]
        if frames > end:  # FFmpeg makes a list of them
            raise _Lies("more frames than bytes")
    return _largest(sizes)


def _sample_entries(
    stream: BinaryIO, position: int, end: int, claimed: tuple[int, int]
) -> Iterator[tuple[int, int]]:
    while position + 36 <= end:
        size, *_, width, height = struct.unpack(">I4s24xHH", _at(stream, position, 36))
        yield (width, height) if width and height else claimed
        if size < 36:
            return
        position += size


# Matroska and WebM: elements of an identifier and a size.

_SEGMENT, _TRACKS, _ENTRY, _VIDEO, _WIDTH, _HEIGHT = 0x18538067, 0x1654AE6B, 0xAE, 0xE0, 0xB0, 0xBA
_WITHIN: Final = frozenset({_SEGMENT, _TRACKS, _ENTRY, _VIDEO})


def _matroska(stream: BinaryIO, end: int) -> VideoHeader | None:
    sizes: list[tuple[int, int]] = []
    position, width = 0, 0
    for _ in range(_MOST_STEPS):
        if position >= end:
            return _largest(sizes)
        head = _at(stream, position, 12)
        id_length = 9 - head[0].bit_length()
        size_length = 9 - head[id_length].bit_length()
        name = int.from_bytes(head[:id_length], "big")
        size = int.from_bytes(head[id_length : id_length + size_length], "big") - (1 << 7 * size_length)
        position += id_length + size_length
        if name in _WITHIN:
            continue
        if name in (_WIDTH, _HEIGHT):
            value = int.from_bytes(_at(stream, position, min(size, 8)), "big")
            width = value if name == _WIDTH else width
            if name == _HEIGHT:
                sizes.append((width, value))
        if size == (1 << 7 * size_length) - 1:  # of unknown size, as live recordings have: frames begin
            return _largest(sizes)
        position += size
    return _largest(sizes)


# AVI: chunks of a name and a size.


def _avi(stream: BinaryIO, end: int) -> VideoHeader | None:
    sizes: list[tuple[int, int]] = []
    position, kind = 12, b""
    for _ in range(_MOST_STEPS):
        if position + 8 > end:
            break
        name, size = struct.unpack("<4sI", _at(stream, position, 8))
        if name == b"LIST":
            if _at(stream, position + 8, 4) == b"movi":
                break
            position += 12
            continue
        if name == b"strh":
            kind = _at(stream, position + 8, 4)
        elif name == b"strf" and kind == b"iavs":  # DV with its sound in one stream tells its size itself
            return VideoHeader()
        elif name == b"strf" and kind == b"vids":
            width, height = struct.unpack("<ii", _at(stream, position + 12, 8))
            sizes.append((width, abs(height)))
        position += 8 + size + size % 2
    return _largest(sizes)


_ASF_STREAM: Final = bytes.fromhex("9107dcb7b7a9cf118ee600c00c205365")
_ASF_VIDEO: Final = bytes.fromhex("c0ef19bc4d5bcf11a8fd00805f5c442b")


def _asf(stream: BinaryIO, end: int) -> VideoHeader | None:  # noqa: ARG001 (one call for all)
    (size,) = struct.unpack("<Q", _at(stream, 16, 8))
    header = _at(stream, 0, min(size, _LARGEST_PART))
    sizes: list[tuple[int, int]] = []
    position = 30
    while position + 24 <= len(header):
        (size,) = struct.unpack_from("<Q", header, position + 16)
        if header[position : position + 16] == _ASF_STREAM and header[position + 24 :].startswith(_ASF_VIDEO):
            sizes.append(struct.unpack_from("<II", header, position + 78))
        if size < 24:
            break
        position += size
    return _largest(sizes)


def _gif(stream: BinaryIO, end: int) -> VideoHeader | None:  # noqa: ARG001
    return _largest([struct.unpack("<HH", _at(stream, 6, 4))])


def _ogg(stream: BinaryIO, end: int) -> VideoHeader:  # noqa: ARG001
    theora = re.search(rb"\x80theora...(..)(..)", _at(stream, 0, _LOOKED_AT), re.DOTALL)
    if theora is None:
        return VideoHeader()
    return VideoHeader(*(16 * int.from_bytes(part, "big") for part in theora.groups()))


_SEQUENCE_HEADER: Final = re.compile(rb"\x00\x00\x01\xb3(...)", re.DOTALL)
_PLAYLIST: Final = re.compile(rb"c=IN IP|<MPD|#EXTM3U|ffconcat", re.IGNORECASE)


def _mpeg(stream: BinaryIO, end: int) -> VideoHeader | None:  # noqa: ARG001
    """Program streams, transport streams and bare ones; H.264 in them tells its size to its decoder only."""
    start = _at(stream, 0, _LOOKED_AT)
    # A transport stream's few fixed bytes can be had in a text, too. FFmpeg takes a file for a text up to the
    # first zero byte; a stream has some soon, and anything by chance behind them.
    if _PLAYLIST.search(start.partition(b"\0")[0]):
        return None
    found = [int.from_bytes(match[1], "big") for match in _SEQUENCE_HEADER.finditer(start)]
    return _largest([(value >> 12, value & 0xFFF) for value in found]) or VideoHeader()


def _untold(stream: BinaryIO, end: int) -> VideoHeader:  # noqa: ARG001
    return VideoHeader()


_READERS: Final[tuple[tuple[bytes, Callable[[BinaryIO, int], VideoHeader | None]], ...]] = (
    (rb"....(ftyp|moov|mdat|free|skip|wide|pnot|styp)", _mp4),
    (rb"\x1a\x45\xdf\xa3.{,60}(matroska|webm)", _matroska),
    (rb"RIFF....AVI ", _avi),
    (rb"GIF8[79]a", _gif),
    (rb"\x30\x26\xb2\x75\x8e\x66\xcf\x11\xa6\xd9\x00\xaa\x00\x62\xce\x6c", _asf),
    (rb"\x00\x00\x01[\xba\xb3]", _mpeg),
    (rb"G(.{187}G){3}", _mpeg),
    (rb"....G(.{191}G){3}", _mpeg),
    (rb"OggS\x00", _ogg),
    (rb"FLV\x01", _untold),
    (rb"\x06\x0e\x2b\x34\x02\x05\x01\x01\x0d\x01\x02", _untold),
)
"""What a file begins with, and who reads it"""
