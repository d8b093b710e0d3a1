"""What a file claims to be by its first bytes: a picture and its size, or a video's container.

A small file can claim to be enormous, and decoders believe it, so such a file must be refused before a
decoder sees it. And FFmpeg opens whatever it recognises, whatever the file is called: playlists (HLS, DASH,
concat, SDP) that name other files or addresses, which it then opens. So it is given a file only if that
begins as a container which holds its frames itself. Standard library only, since Blender's process uses this,
too.
"""

from __future__ import annotations

import contextlib
import io
import re
import struct
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO, Final

from handfit_core.common.files import is_file
from handfit_core.media.heif import HEIF, boxes_of, read_at, read_heif

PICTURES: Final = {
    "JPEG": rb"\xff\xd8\xff",
    "PNG": rb"\x89PNG",
    "TIFF": rb"II\*\0|MM\0\*",
    "WebP": rb"RIFF....WEBP",
    "OpenEXR": rb"v/1\x01",
    "DPX": rb"SDPX|XPDS",
    "HEIC": HEIF,
}
"""Pattern of a picture's first bytes, by the picture's kind"""
_MAX_STEPS: Final = 100_000
"""Most markers, chunks or boxes of a file that are read; no camera and no program writes as many"""
_SCAN_BYTES: Final = 1 << 20
"""Bytes of a stream that are searched for a playlist; FFmpeg reads as many to recognise a file"""


@dataclass(frozen=True)
class Header:
    """Size and cost that a picture claims; only its decoder knows a video's size, but for a GIF's."""

    width: int = 0
    height: int = 0
    """Height in pixels as stored, with `width` beside it, before any orientation is undone; 0 for a video"""
    cost: int = 1
    """Memory of decoding, relative to a picture with 8 bits per channel: 3 with 16 bits, which Blender makes
    floats of, and 4 with floats"""


def read_picture_header(stream: BinaryIO) -> Header | None:
    """Return the header of a JPEG, PNG, WebP, BMP, TIFF, PNM, Radiance, OpenEXR, DPX, HEIC or AVIF picture;
    None for any other file, or one that is damaged before its size.

    `stream` must be seekable; its position afterwards is undefined.
    """
    start = read_at(stream, 0, 65536)
    header = None
    try:
        for kind, read in _WALKED.items():
            header = read(stream) if re.match(PICTURES[kind], start, re.DOTALL) else header
    except (struct.error, ValueError, LookupError):
        return None
    for pattern, read in _FIXED.items():
        if header is None and (match := re.match(pattern, start, re.DOTALL)):
            header = read(*match.groups())
    return header if header is not None and header.width > 0 and header.height > 0 else None


def read_video_header(stream: BinaryIO) -> Header | None:
    """Return a header without a size for an MP4, QuickTime, Matroska, WebM, AVI, Windows Media, MPEG, DV,
    Ogg, Flash or MXF file, and a GIF's with its size; None for any other file, or one that claims more frames
    than it can hold.

    `stream` must be seekable; its position afterwards is undefined.
    """
    start = read_at(stream, 0, _SCAN_BYTES)
    # A transport stream's few fixed bytes can be had in a text, too. FFmpeg takes a file for a text up to the
    # first zero byte; a stream has some soon, and anything by chance behind them.
    if not re.match(CONTAINERS, start, re.DOTALL) or _PLAYLIST.search(start.partition(b"\0")[0]):
        return None
    if start.startswith(b"GIF8"):
        header = Header(_little(start[6:8]), _little(start[8:10]))
        return header if header.width and header.height else None
    try:
        return Header() if not re.match(_MP4, start, re.DOTALL) or _holds_its_frames(stream) else None
    except (struct.error, ValueError):
        return None


_MP4: Final = rb"....(ftyp|moov|mdat|free|skip|wide|pnot|styp)"
CONTAINERS: Final = (
    rb"%s|\x1a\x45\xdf\xa3.{,60}(matroska|webm)|RIFF....AVI |GIF8[79]a|\x30\x26\xb2\x75\x8e\x66\xcf\x11"
    rb"|\x00\x00\x01[\xba\xb3]|\x1f\x07\x00[\x3f\xbf]|G(.{187}G){3}|....G(.{191}G){3}"
    rb"|OggS\x00|FLV\x01|\x06\x0e\x2b\x34\x02\x05" % _MP4
)
"""Pattern of the first bytes of videos that hold their frames themselves"""
_PLAYLIST: Final = re.compile(rb"c=IN IP|<MPD|#EXTM3U|ffconcat", re.IGNORECASE)


def _unpack(stream: BinaryIO, layout: str, at: int | None = None) -> tuple[int, ...]:
    """Unpack whole numbers at `at`, or at the stream's position. Raises struct.error at the file's end."""
    if at is not None:
        stream.seek(at)
    return struct.unpack(layout, stream.read(struct.calcsize(layout)))


def _cost(bits: int) -> int:
    """Return the cost of a picture with so many bits per channel, as `Header.cost`."""
    if bits <= 8:
        return 1
    return 3 if bits <= 16 else -(-bits // 8)


def _png(stream: BinaryIO) -> Header | None:
    end = stream.seek(0, 2)
    _, kind, width, height, depth = _unpack(stream, ">I4sIIB", 8)
    position = 8
    for _ in range(_MAX_STEPS):
        size, name = struct.unpack(">I4s", read_at(stream, position, 8).ljust(8, b"\0"))
        if name == b"IEND" or position + 8 > end:
            return Header(width, height, _cost(depth)) if kind == b"IHDR" else None
        if size > end:  # OpenCV would allocate that
            raise ValueError("a chunk has more bytes than the file")
        if name == b"fcTL":  # OpenCV 4.11 does not check where a frame of an animation lies
            across, down, left, top = _unpack(stream, ">4x4I")
            if left + across > width or top + down > height:
                raise ValueError("a frame lies beyond the picture")
        position += 12 + size
    raise ValueError("more chunks than anybody writes")


_JPEG_FRAMES: Final = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
_JPEG_WITHOUT_LENGTH: Final = frozenset({0x00, 0x01, *range(0xD0, 0xD8)})


def _jpeg(stream: BinaryIO) -> Header | None:
    stream.seek(2)
    for _ in range(_MAX_STEPS):
        (byte,) = _unpack(stream, "B")
        if byte != 0xFF:  # padding before a marker is allowed
            continue
        while byte == 0xFF:
            (byte,) = _unpack(stream, "B")
        if byte in _JPEG_WITHOUT_LENGTH:
            continue
        (length,) = _unpack(stream, ">H")
        if byte in _JPEG_FRAMES:
            _, height, width = _unpack(stream, ">BHH")
            return Header(width, height)
        stream.seek(length - 2, 1)
    return None


_LOGARITHMIC: Final = (34676, 34677)
"""Numbers of TIFF's compressions whose pictures are floats once they are decoded"""
_TIFF_NUMBERS: Final = {1: "B", 3: "H", 4: "I"}


def read_tiff_tags(stream: BinaryIO, directory: int | None = None) -> dict[int, int]:
    """Return the first number of each tag of a TIFF or EXIF directory that has whole numbers. `directory` is
    its place in bytes; None: the first one. Raises struct.error for a damaged one."""
    order = "<" if read_at(stream, 0, 2) == b"II" else ">"
    if directory is None:
        (directory,) = _unpack(stream, order + "I", 4)
    (count,) = _unpack(stream, order + "H", directory)
    tags: dict[int, int] = {}
    for i in range(count):
        tag, kind, values = _unpack(stream, order + "HHI", directory + 2 + 12 * i)
        if kind in _TIFF_NUMBERS and tag not in tags:
            layout = order + _TIFF_NUMBERS[kind]
            with contextlib.suppress(struct.error):  # it lies beyond what there is of the file
                if values * struct.calcsize(layout) > 4:
                    stream.seek(*_unpack(stream, order + "I"))
                (tags[tag],) = _unpack(stream, layout)
    return tags


def _tiff(stream: BinaryIO) -> Header | None:
    tags = read_tiff_tags(stream)
    bits = 32 if tags.get(259) in _LOGARITHMIC else tags.get(258, 1)
    channels = max(1, -(-tags.get(277, 1) // 4))
    if not tags.get(256) or not tags.get(257):
        return None
    # A decoder holds a whole tile, which may be larger than the picture.
    return Header(max(tags[256], tags.get(322, 0)), max(tags[257], tags.get(323, 0)), _cost(bits) * channels)


_LONGEST_ATTRIBUTE: Final = 1 << 20
"""Most bytes of one attribute of an OpenEXR picture that are read"""


def read_exr_attributes(stream: BinaryIO) -> dict[bytes, tuple[int, bytes]]:
    """Return for each attribute of an OpenEXR picture, in a file of several parts the first part's, where its
    value begins, in bytes, and the value. Raises struct.error and ValueError for damaged ones."""
    found: dict[bytes, tuple[int, bytes]] = {}
    position = 8
    for _ in range(_MAX_STEPS):
        name, _, rest = read_at(stream, position, 600).partition(b"\0")
        if not name:
            return found
        kind, _, rest = rest.partition(b"\0")
        (size,) = struct.unpack_from("<I", rest)
        position += len(name) + len(kind) + 6
        found[name] = position, read_at(stream, position, min(size, _LONGEST_ATTRIBUTE))
        position += size
    raise ValueError("more attributes than anybody writes")


def exr_channels(channels: bytes) -> list[str]:
    """Return the names of the channels in an OpenEXR picture's attribute `channels`."""
    return [name.decode("utf-8", "replace") for name in re.findall(rb"([^\0]+)\0.{16}", channels, re.DOTALL)]


def _exr(stream: BinaryIO) -> Header:
    attributes = read_exr_attributes(stream)
    left, top, right, bottom = struct.unpack("<4i", attributes[b"dataWindow"][1])
    count = len(exr_channels(attributes[b"channels"][1]))
    return Header(right - left + 1, bottom - top + 1, 4 * max(1, -(-count // 4)))


def _heif(stream: BinaryIO) -> Header | None:
    found = read_heif(stream)
    if found is None:
        return None
    # A decoder holds a whole tile, which may be larger than the picture.
    return Header(max(found.width, found.tile_width), max(found.height, found.tile_height), _cost(found.bits))


_WALKED: Final = {"JPEG": _jpeg, "PNG": _png, "TIFF": _tiff, "OpenEXR": _exr, "HEIC": _heif}
"""Functions that read the header of pictures whose size may stand anywhere, by kind"""


def _little(data: bytes) -> int:
    return int.from_bytes(data, "little")


def _bmp(width: bytes, height: bytes) -> Header:
    """Return a BMP's header; a height below zero means rows that go upwards."""
    across, down = (int.from_bytes(side, "little", signed=len(side) == 4) for side in (width, height))
    return Header(across, abs(down))


def _webp_lossless(bits: bytes) -> Header:
    return Header(_little(bits) % 0x4000 + 1, (_little(bits) >> 14) % 0x4000 + 1, 2)


def _webp_lossy(width: bytes, height: bytes) -> Header:
    return Header(_little(width) % 0x4000, _little(height) % 0x4000)


_GAP: Final = rb"(?:\s|#[^\n\r]*+)++"
_FIXED: Final[dict[bytes, Callable[..., Header]]] = {
    rb"RIFF....WEBPVP8X.{8}(...)(...)": lambda w, h: Header(_little(w) + 1, _little(h) + 1, 2),
    rb"RIFF....WEBPVP8L.{4}/(....)": _webp_lossless,
    rb"RIFF....WEBPVP8 .{7}\x9d\x01\x2a(..)(..)": _webp_lossy,
    rb"BM.{12}\x0c\0\0\0(..)(..)": _bmp,
    rb"BM.{12}(?!\x0c\0\0\0).{4}(....)(....)": _bmp,
    rb"P[14]%s(\d{1,9})%s(\d{1,9})\s" % (_GAP, _GAP): lambda w, h: Header(int(w), int(h)),
    rb"P[2356]%s(\d{1,9})%s(\d{1,9})%s(\d{1,5})\s" % (_GAP, _GAP, _GAP): lambda w, h, most: Header(
        int(w), int(h), _cost(int(most).bit_length())
    ),
    rb"SDPX.{768}(....)(....).{23}(.)": lambda w, h, bits: Header(
        int.from_bytes(w), int.from_bytes(h), _cost(bits[0])
    ),
    rb"XPDS.{768}(....)(....).{23}(.)": lambda w, h, bits: Header(_little(w), _little(h), _cost(bits[0])),
    rb"#\?(?:RADIANCE|RGBE).*?\n[-+][XY] +(\d{1,9}) +[-+][XY] +(\d{1,9})\s*\n": lambda h, w: Header(
        int(w), int(h), 4
    ),
}
"""Patterns of pictures whose size stands in one place, and what they say there"""


def begins(path: Path, pattern: bytes) -> bool:
    """Return True if a file begins with bytes that match `pattern`; False for a file that cannot be read."""
    try:
        with open(path, "rb") if is_file(path) else io.BytesIO() as stream:
            return bool(re.match(pattern, stream.read(65536), re.DOTALL))
    except OSError:
        return False


def is_animated(path: Path) -> bool:
    """True if a PNG, WebP or AVIF picture has several frames."""
    # A PNG's chunk of its animation stands before its pixels.
    return begins(path, rb"\x89PNG\r\n\x1a\n(?:(?!IDAT).)*acTL|RIFF....WEBPVP8X.*ANIM|....ftypavis")


# MP4 and QuickTime: boxes with a size and a name; some hold boxes again.

_BOXES_WITH_BOXES: Final = frozenset({b"moov", b"trak", b"mdia", b"minf", b"stbl", b"moof", b"traf", b"meta"})
_TABLES: Final = (b"keys", b"ilst")
_LARGEST_TABLE: Final = 1 << 16
"""Most bytes of a table of metadata that are read"""
_COUNTS: Final = {b"stsz": 8, b"stz2": 8, b"trun": 4}
"""Place, in bytes from its beginning, at which each kind of box that lists frames says how many they are"""


def _holds_its_frames(stream: BinaryIO) -> bool:
    """Return True if an MP4 has at least a byte for each frame that it claims: FFmpeg would allocate a list
    of them, and unpack a compressed header to whatever size it claims."""
    end, frames = stream.seek(0, 2), 0
    for name, start, _ in boxes_of(stream, _BOXES_WITH_BOXES):
        if name in _COUNTS:
            frames += _unpack(stream, ">I", start + _COUNTS[name])[0]
        if name == b"cmov" or frames > end:
            return False
    return True


_FOCAL_35MM: Final = b"mdtacom.apple.quicktime.camera.focal_length.35mm_equivalent"
_NUMBERS: Final = {23: ">f", 24: ">d"}


def read_video_focal_35mm(stream: BinaryIO) -> float | None:
    """Return the focal length in mm as on 35 mm film, of the width of a picture, which phones note in a
    QuickTime file; None where there is none, and in damaged metadata. `stream` must be seekable."""
    number = 0
    try:
        for name, start, end in boxes_of(stream, _BOXES_WITH_BOXES):
            data = read_at(stream, start, min(end - start, _LARGEST_TABLE)) if name in _TABLES else b""
            if name == b"keys":
                number, at = 0, 8
                for i in range(1, 1 + int.from_bytes(data[4:8])):
                    size = int.from_bytes(data[at : at + 4])
                    if data[at + 4 : at + size] == _FOCAL_35MM:
                        number = i
                    if size < 8 or number:
                        break
                    at += size
            elif name == b"ilst" and number:
                at = 0
                while at + 24 <= len(data):
                    size, item, of_data, kind = struct.unpack_from(">III4xI", data, at)
                    value = data[at + 24 : at + 8 + of_data]
                    if item == number:
                        return _number(kind, value)
                    at += max(size, 8)
    except (struct.error, ValueError, OverflowError):
        pass
    return None


def _number(kind: int, value: bytes) -> float:
    """Return a value of one of QuickTime's well-known types as a number. Raises struct.error, ValueError and
    OverflowError for damaged values."""
    if kind == 1:
        return float(value.decode("ascii").removesuffix("mm"))
    return struct.unpack(_NUMBERS[kind], value)[0] if kind in _NUMBERS else float(int.from_bytes(value))
