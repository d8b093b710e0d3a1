"""The size that a picture file claims, read from its first bytes without decoding anything.

A small file can claim to be enormous, and decoders believe it: whoever wants to refuse such a file must do so
before a decoder sees it. Standard library only, since Blender's process asks, too.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Callable
from dataclasses import dataclass
from typing import BinaryIO, Final

_MOST_STEPS: Final = 100_000
"""Markers, chunks or tags that are looked through; no camera and no program writes as many"""


@dataclass(frozen=True)
class PictureHeader:
    """What a picture claims to be."""

    width: int
    height: int
    """Pixels as stored, before any orientation is undone"""
    cost: float = 1
    """How much memory decoding takes, in units of a picture with 8 bits per channel that is decoded row by
    row: three times as much with 16 bits, which Blender makes floats of, four times with floats, and 1.4
    times where a decoder must keep all coefficients (progressive JPEG)"""


def read_picture_header(stream: BinaryIO) -> PictureHeader | None:
    """The header of a JPEG, PNG, WebP, BMP, TIFF, JPEG 2000, PNM or Radiance picture.

    `stream` can be sought in; where it stands afterwards is not defined. None where it is none of these, or
    is damaged before its size is told.
    """
    stream.seek(0)
    start = stream.read(16)
    for signature, read in _READERS:
        if re.match(signature, start, re.DOTALL):
            try:
                header = read(stream)
            except (struct.error, ValueError, IndexError, OverflowError):
                return None
            return header if header is not None and header.width > 0 and header.height > 0 else None
    return None


def _unpack(stream: BinaryIO, layout: str, at: int | None = None) -> tuple[int, ...]:
    """Whole numbers that stand at `at`, or where the stream is. Raises struct.error at the file's end."""
    if at is not None:
        stream.seek(at)
    return struct.unpack(layout, stream.read(struct.calcsize(layout)))


def _cost(bits: int) -> int:
    """Of so many bits per channel."""
    if bits <= 8:
        return 1
    return 3 if bits <= 16 else -(-bits // 8)


def _png(stream: BinaryIO) -> PictureHeader | None:
    _, kind, width, height, depth = struct.unpack(">I4sIIB", _at(stream, 8, 17))
    return PictureHeader(width, height, _cost(depth)) if kind == b"IHDR" else None


def _at(stream: BinaryIO, position: int, count: int) -> bytes:
    stream.seek(position)
    return stream.read(count)


_FRAME_MARKERS: Final = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
_PROGRESSIVE: Final = frozenset({0xC2, 0xC6, 0xCA, 0xCE})
_PROGRESSIVE_COST: Final = 1.4
_WITHOUT_LENGTH: Final = frozenset({0x01, *range(0xD0, 0xD8)})


def _jpeg(stream: BinaryIO) -> PictureHeader | None:
    stream.seek(2)
    frame: tuple[int, int, int, int] | None = None  # marker, width, height, components
    for _ in range(_MOST_STEPS):
        # Padding before a marker is allowed.
        (byte,) = _unpack(stream, "B")
        if byte != 0xFF:
            continue
        while byte == 0xFF:
            (byte,) = _unpack(stream, "B")
        if byte == 0 or byte in _WITHOUT_LENGTH:
            continue
        (length,) = _unpack(stream, ">H")
        after = stream.tell() + length - 2
        if byte in _FRAME_MARKERS:
            _, height, width, components = _unpack(stream, ">BHHB")
            frame = byte, width, height, components
        elif byte == 0xDA:
            if frame is None:
                return None
            (in_scan,) = _unpack(stream, "B")
            marker, width, height, components = frame
            kept_whole = marker in _PROGRESSIVE or in_scan < components
            return PictureHeader(width, height, _PROGRESSIVE_COST if kept_whole else 1)
        stream.seek(after)
    return None


def _webp(stream: BinaryIO) -> PictureHeader | None:
    kind, start = _at(stream, 12, 4), _at(stream, 20, 10)
    if kind == b"VP8X":
        width, height = (int.from_bytes(start[i : i + 3], "little") + 1 for i in (4, 7))
        return PictureHeader(width, height, 2)  # it may be of either kind inside, or move
    if kind == b"VP8L" and start[:1] == b"\x2f":
        (bits,) = struct.unpack("<I", start[1:5])
        return PictureHeader((bits & 0x3FFF) + 1, (bits >> 14 & 0x3FFF) + 1, 2)
    if kind == b"VP8 " and start[3:6] == b"\x9d\x01\x2a":
        width, height = struct.unpack("<HH", start[6:10])
        return PictureHeader(width & 0x3FFF, height & 0x3FFF)
    return None


def _bmp(stream: BinaryIO) -> PictureHeader:
    (size,) = _unpack(stream, "<I", 14)
    width, height = _unpack(stream, "<HH" if size == 12 else "<ii", 18)
    return PictureHeader(width, abs(height))


_LOGARITHMIC: Final = (34676, 34677)
"""Compressions that are floats once they are decoded"""
_TIFF_NUMBERS: Final = {1: "B", 3: "H", 4: "I"}


def _tiff(stream: BinaryIO) -> PictureHeader | None:
    order = "<" if _at(stream, 0, 2) == b"II" else ">"
    (directory,) = _unpack(stream, order + "I", 4)
    (count,) = _unpack(stream, order + "H", directory)
    tags: dict[int, int] = {}
    for i in range(count):
        tag, kind, values = _unpack(stream, order + "HHI", directory + 2 + 12 * i)
        if kind in _TIFF_NUMBERS and tag not in tags:
            layout = order + _TIFF_NUMBERS[kind]
            if values * struct.calcsize(layout) > 4:
                (elsewhere,) = _unpack(stream, order + "I")
                stream.seek(elsewhere)
            (tags[tag],) = _unpack(stream, layout)
    width, height = tags.get(256, 0), tags.get(257, 0)
    if not width or not height:
        return None
    bits = 32 if tags.get(259) in _LOGARITHMIC else tags.get(258, 1)
    samples = tags.get(277, 1)
    # A decoder holds a whole tile, which may be larger than the picture.
    width, height = max(width, tags.get(322, 0)), max(height, tags.get(323, 0))
    return PictureHeader(width, height, _cost(bits) * max(1, -(-samples // 4)))


_JP2_SAMPLE: Final = 4
"""Bytes; decoders of JPEG 2000 hold every sample as a 32-bit number"""


def _jp2(stream: BinaryIO) -> PictureHeader | None:
    position, end, channels = 0, stream.seek(0, 2), 1
    for _ in range(_MOST_STEPS):
        if position >= end:
            return None
        size, kind = struct.unpack(">I4s", _at(stream, position, 8))
        head = 8
        if size == 1:
            (size,) = _unpack(stream, ">Q")
            head = 16
        if kind == b"jp2c":
            return _jp2_codestream(stream, position + head, channels)
        if kind == b"jp2h":  # its boxes come one after another
            position += head
            continue
        if kind == b"pclr":  # a palette of many columns makes as many channels
            (channels,) = _unpack(stream, "B", position + head + 2)
        if size < head:
            return None
        position += size
    return None


def _jp2_codestream(stream: BinaryIO, start: int = 0, channels: int = 1) -> PictureHeader | None:
    soc, siz, _, _, right, bottom, left, top = _unpack(stream, ">HHHHIIII", start)
    if (soc, siz) != (0xFF4F, 0xFF51):
        return None
    (components,) = _unpack(stream, ">H", start + 40)
    return PictureHeader(right - left, bottom - top, _JP2_SAMPLE * -(-max(components, channels) // 4))


def _pnm(stream: BinaryIO) -> PictureHeader | None:
    text = re.sub(rb"#[^\n\r]*", b" ", _at(stream, 0, 4096)).split()
    depth = 1 if text[0] in (b"P1", b"P4") else int(text[3]).bit_length()
    return PictureHeader(int(text[1]), int(text[2]), _cost(depth))


def _hdr(stream: BinaryIO) -> PictureHeader | None:
    size = re.search(rb"\n[-+]([XY]) +(\d{1,9}) +[-+][XY] +(\d{1,9})\s*\n", _at(stream, 0, 65536))
    if size is None:
        return None
    first, second = int(size[2]), int(size[3])
    width, height = (second, first) if size[1] == b"Y" else (first, second)
    return PictureHeader(width, height, 4)


_READERS: Final[tuple[tuple[bytes, Callable[[BinaryIO], PictureHeader | None]], ...]] = (
    (rb"\xff\xd8\xff", _jpeg),
    (rb"\x89PNG\r\n\x1a\n", _png),
    (rb"RIFF....WEBP", _webp),
    (rb"BM", _bmp),
    (rb"II\*\x00|MM\x00\*", _tiff),
    (rb"\x00\x00\x00\x0cjP  \r\n\x87\n", _jp2),
    (rb"\xff\x4f\xff\x51", _jp2_codestream),
    (rb"P[1-6]\s", _pnm),
    (rb"#\?(RADIANCE|RGBE)", _hdr),
)
"""What a file begins with, and who reads it"""
