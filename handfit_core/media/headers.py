"""Headers of pictures and videos: format and size by a file's first bytes, without decoding anything.

A small file can claim to be enormous, and decoders believe it, so such a file must be refused before a
decoder sees it. And FFmpeg opens whatever it recognises, whatever the file is called: playlists (HLS, DASH,
concat, SDP) that name other files or addresses, which it then opens. So it is given a file only if that
begins as a container which holds its frames itself. Standard library only, since Blender's process uses this,
too.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import BinaryIO, Final

_MAX_STEPS: Final = 100_000
"""Markers, chunks, boxes or tags that are read; no camera and no program writes as many"""

_SCAN_BYTES: Final = 1 << 20
"""Bytes of a stream without a header that are scanned; FFmpeg reads as many to recognise a file"""

_MAX_HEADER_BYTES: Final = 1 << 20
"""Of a header that is read at once"""


@dataclass(frozen=True)
class Header:
    """Size and cost that a picture, or a video's largest track, claims."""

    width: int = 0
    height: int = 0
    """Pixels as stored, before any orientation is undone; 0 where a video's container has none"""
    cost: float = 1
    """Memory of decoding, relative to a picture with 8 bits per channel that is decoded row by row: 3 with 16
    bits, which Blender makes floats of, 4 with floats, and 1.4 where a decoder must keep all coefficients
    (progressive JPEG)"""
    frames: int = field(default=0, compare=False)
    """Frames that a video claims, good for an estimate of its time; 0: unknown"""


_Readers = tuple[tuple[bytes, Callable[[BinaryIO], Header | None]], ...]


class _InvalidHeader(ValueError):
    """The header claims more than its file can hold."""


def read_picture_header(stream: BinaryIO) -> Header | None:
    """The header of a JPEG, PNG, WebP, BMP, TIFF, JPEG 2000, PNM or Radiance picture.

    `stream` must be seekable; its position afterwards is undefined. None where it is none of these, or is
    damaged before its size.
    """
    header = _read(stream, _PICTURES)
    return header if header is not None and header.width > 0 and header.height > 0 else None


def read_video_header(stream: BinaryIO) -> Header | None:
    """The header of an MP4, QuickTime, Matroska, WebM, AVI, GIF, Windows Media, MPEG, Ogg, Flash or MXF file.

    `stream` must be seekable; its position afterwards is undefined. None where it is none of these, holds no
    picture, or claims more than it can hold.
    """
    return _read(stream, _VIDEOS)


def _read(stream: BinaryIO, readers: _Readers) -> Header | None:
    start = _read_at(stream, 0, 4096)
    for signature, read in readers:
        if re.match(signature, start, re.DOTALL):
            try:
                return read(stream)
            except (struct.error, ValueError, IndexError, OverflowError):
                return None
    return None


def _read_at(stream: BinaryIO, position: int, count: int) -> bytes:
    stream.seek(position)
    return stream.read(count)


# Pictures


def _unpack(stream: BinaryIO, layout: str, at: int | None = None) -> tuple[int, ...]:
    """Unpack whole numbers at `at`, or at the stream's position. Raises struct.error at the file's end."""
    if at is not None:
        stream.seek(at)
    return struct.unpack(layout, stream.read(struct.calcsize(layout)))


def _cost(bits: int) -> int:
    """The cost of a picture with so many bits per channel."""
    if bits <= 8:
        return 1
    return 3 if bits <= 16 else -(-bits // 8)


def _png(stream: BinaryIO) -> Header | None:
    end = stream.seek(0, 2)
    _, kind, width, height, depth = struct.unpack(">I4sIIB", _read_at(stream, 8, 17))
    position = 8
    for _ in range(_MAX_STEPS):
        size, name = struct.unpack(">I4s", _read_at(stream, position, 8).ljust(8, b"\0"))
        if name == b"IEND" or position + 8 > end:
            return Header(width, height, _cost(depth)) if kind == b"IHDR" else None
        if size > end:  # OpenCV would allocate that
            raise _InvalidHeader("more bytes than the file has")
        if name == b"fcTL":  # OpenCV 4.11 does not check where a frame of an animation lies
            across, down, left, top = _unpack(stream, ">4x4I")
            if left + across > width or top + down > height:
                raise _InvalidHeader("a frame beyond the picture")
        position += 12 + size
    raise _InvalidHeader("more chunks than anybody writes")


_FRAME_MARKERS: Final = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
_PROGRESSIVE: Final = frozenset({0xC2, 0xC6, 0xCA, 0xCE})
_PROGRESSIVE_COST: Final = 1.4
_WITHOUT_LENGTH: Final = frozenset({0x01, *range(0xD0, 0xD8)})


def _jpeg(stream: BinaryIO) -> Header | None:
    stream.seek(2)
    frame: tuple[int, int, int, int] | None = None  # marker, width, height, components
    for _ in range(_MAX_STEPS):
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
            return Header(width, height, _PROGRESSIVE_COST if kept_whole else 1)
        stream.seek(after)
    return None


def _webp(stream: BinaryIO) -> Header | None:
    kind, start = _read_at(stream, 12, 4), _read_at(stream, 20, 10)
    if kind == b"VP8X":
        width, height = (int.from_bytes(start[i : i + 3], "little") + 1 for i in (4, 7))
        return Header(width, height, 2)  # lossy, lossless or animated inside
    if kind == b"VP8L" and start[:1] == b"\x2f":
        (bits,) = struct.unpack("<I", start[1:5])
        return Header((bits & 0x3FFF) + 1, (bits >> 14 & 0x3FFF) + 1, 2)
    if kind == b"VP8 " and start[3:6] == b"\x9d\x01\x2a":
        width, height = struct.unpack("<HH", start[6:10])
        return Header(width & 0x3FFF, height & 0x3FFF)
    return None


def _bmp(stream: BinaryIO) -> Header:
    (size,) = _unpack(stream, "<I", 14)
    width, height = _unpack(stream, "<HH" if size == 12 else "<ii", 18)
    return Header(width, abs(height))


_LOGARITHMIC: Final = (34676, 34677)
"""Compressions that are floats once they are decoded"""
_TIFF_NUMBERS: Final = {1: "B", 3: "H", 4: "I"}


def _tiff(stream: BinaryIO) -> Header | None:
    order = "<" if _read_at(stream, 0, 2) == b"II" else ">"
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
    return Header(width, height, _cost(bits) * max(1, -(-samples // 4)))


_JP2_SAMPLE: Final = 4
"""Bytes; decoders of JPEG 2000 hold every sample as a 32-bit number"""


def _jp2(stream: BinaryIO) -> Header | None:
    position, end, channels = 0, stream.seek(0, 2), 1
    for _ in range(_MAX_STEPS):
        if position >= end:
            return None
        size, kind = struct.unpack(">I4s", _read_at(stream, position, 8))
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


def _jp2_codestream(stream: BinaryIO, start: int = 0, channels: int = 1) -> Header | None:
    soc, siz, _, _, right, bottom, left, top = _unpack(stream, ">HHHHIIII", start)
    if (soc, siz) != (0xFF4F, 0xFF51):
        return None
    (components,) = _unpack(stream, ">H", start + 40)
    return Header(right - left, bottom - top, _JP2_SAMPLE * -(-max(components, channels) // 4))


def _pnm(stream: BinaryIO) -> Header | None:
    text = re.sub(rb"#[^\n\r]*", b" ", _read_at(stream, 0, 4096)).split()
    depth = 1 if text[0] in (b"P1", b"P4") else int(text[3]).bit_length()
    return Header(int(text[1]), int(text[2]), _cost(depth))


def _hdr(stream: BinaryIO) -> Header | None:
    size = re.search(rb"\n[-+]([XY]) +(\d{1,9}) +[-+][XY] +(\d{1,9})\s*\n", _read_at(stream, 0, 65536))
    if size is None:
        return None
    first, second = int(size[2]), int(size[3])
    width, height = (second, first) if size[1] == b"Y" else (first, second)
    return Header(width, height, 4)


_PICTURES: Final[_Readers] = (
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
"""Regular expressions for a picture's first bytes, and readers of its header"""


# Videos

_MAX_FRAMES: Final = 1e9
"""Half a year at 60 a second; what claims more is damaged"""


def _largest_track(sizes: list[tuple[int, int]], frames: float = 0) -> Header | None:
    width, height = max(sizes, key=lambda size: size[0] * size[1], default=(0, 0))
    count = round(frames) if 0 < frames < _MAX_FRAMES else 0
    return Header(width, height, frames=count) if width > 0 and height > 0 else None


# MP4 and QuickTime: boxes with a size and a name; some hold boxes again.

_BOXES_WITH_BOXES: Final = frozenset({b"moov", b"trak", b"mdia", b"minf", b"stbl", b"moof", b"traf"})


def _boxes(stream: BinaryIO, end: int) -> Iterator[tuple[bytes, int, int]]:
    """Name, start and end of the contents of every box; a box comes before the boxes that it holds."""
    position = 0
    for _ in range(_MAX_STEPS):
        if position + 8 > end:
            return
        size, name = struct.unpack(">I4s", _read_at(stream, position, 8))
        head = 8
        if size == 1:
            (size,) = struct.unpack(">Q", stream.read(8))
            head = 16
        box_end = position + size if size else end
        if name == b"cmov":
            raise _InvalidHeader("a header that has to be unpacked first")
        if size and size < head:
            return
        yield name, position + head, min(box_end, end)
        position = position + head if name in _BOXES_WITH_BOXES else box_end
    raise _InvalidHeader("more boxes than anybody writes")


def _mp4(stream: BinaryIO) -> Header | None:
    end = stream.seek(0, 2)
    sizes: list[tuple[int, int]] = []
    handler, claimed, frames, shown = b"", (0, 0), 0, 0
    for name, start, box_end in _boxes(stream, end):
        if name == b"trak":
            handler, claimed = b"", (0, 0)
        elif name == b"tkhd":
            version = _read_at(stream, start, 1)
            width, height = struct.unpack(
                ">II", _read_at(stream, start + (88 if version == b"\1" else 76), 8)
            )
            claimed = width >> 16, height >> 16
        elif name == b"hdlr":
            kind, subtype = struct.unpack("4s4s", _read_at(stream, start + 4, 8))
            if kind != b"dhlr":  # QuickTime's data handler, which names no track
                handler = subtype
        elif name == b"stsd" and handler == b"vide":
            sizes += _sample_entries(stream, start + 8, box_end, claimed)
        elif name == b"stsz":
            samples = struct.unpack(">I", _read_at(stream, start + 8, 4))[0]
            frames += samples
            shown = max(shown, samples) if handler == b"vide" else shown
        elif name == b"trun":
            frames += struct.unpack(">I", _read_at(stream, start + 4, 4))[0]
        if frames > end:  # FFmpeg would allocate a list of them
            raise _InvalidHeader("more frames than bytes")
    return _largest_track(sizes, shown)


def _sample_entries(
    stream: BinaryIO, position: int, end: int, claimed: tuple[int, int]
) -> Iterator[tuple[int, int]]:
    while position + 36 <= end:
        size, *_, width, height = struct.unpack(">I4s24xHH", _read_at(stream, position, 36))
        yield (width, height) if width and height else claimed
        if size < 36:
            return
        position += size


# Matroska and WebM: elements with an identifier and a size.

_SEGMENT, _TRACKS, _ENTRY, _VIDEO, _WIDTH, _HEIGHT = 0x18538067, 0x1654AE6B, 0xAE, 0xE0, 0xB0, 0xBA
_INFO, _UNIT, _DURATION, _FRAME_TIME = 0x1549A966, 0x2AD7B1, 0x4489, 0x23E383
_CONTAINERS: Final = frozenset({_SEGMENT, _TRACKS, _ENTRY, _VIDEO, _INFO})


def _matroska(stream: BinaryIO) -> Header | None:
    end = stream.seek(0, 2)
    sizes: list[tuple[int, int]] = []
    position, width = 0, 0
    unit, duration, frame_time, of_video = 1_000_000, 0.0, 0, 0  # the second in units, the others in ns
    for _ in range(_MAX_STEPS):
        if position >= end:
            break
        head = _read_at(stream, position, 12)
        id_length = 9 - head[0].bit_length()
        size_length = 9 - head[id_length].bit_length()
        name = int.from_bytes(head[:id_length], "big")
        size = int.from_bytes(head[id_length : id_length + size_length], "big") - (1 << 7 * size_length)
        position += id_length + size_length
        if name in _CONTAINERS:
            width, frame_time = (0, 0) if name == _ENTRY else (width, frame_time)
            continue
        if name in (_WIDTH, _HEIGHT, _UNIT, _FRAME_TIME):
            value = int.from_bytes(_read_at(stream, position, min(size, 8)), "big")
            width = value if name == _WIDTH else width
            unit = value if name == _UNIT else unit
            frame_time = value if name == _FRAME_TIME else frame_time
            if name == _HEIGHT:
                sizes.append((width, value))
        elif name == _DURATION and size in (4, 8):
            (duration,) = struct.unpack(">f" if size == 4 else ">d", _read_at(stream, position, size))
        if name in (_HEIGHT, _FRAME_TIME) and width:  # of a track either may stand first
            of_video = frame_time or of_video
        if size == (1 << 7 * size_length) - 1:  # of unknown size, as live recordings have: frames begin
            break
        position += size
    return _largest_track(sizes, unit * duration / of_video if of_video else 0)


# AVI: chunks with a name and a size.


def _avi(stream: BinaryIO) -> Header | None:
    end = stream.seek(0, 2)
    sizes: list[tuple[int, int]] = []
    position, kind, length, frames = 12, b"", 0, 0
    for _ in range(_MAX_STEPS):
        if position + 8 > end:
            break
        name, size = struct.unpack("<4sI", _read_at(stream, position, 8))
        if name == b"LIST":
            if _read_at(stream, position + 8, 4) == b"movi":
                break
            position += 12
            continue
        if name == b"strh":
            kind = _read_at(stream, position + 8, 4)
            length = int.from_bytes(_read_at(stream, position + 40, 4), "little") if size >= 36 else 0
        elif name == b"strf" and kind == b"iavs":  # DV interleaved with sound has its size in the stream
            return Header()
        elif name == b"strf" and kind == b"vids":
            width, height = struct.unpack("<ii", _read_at(stream, position + 12, 8))
            sizes.append((width, abs(height)))
            frames = max(frames, length)
        position += 8 + size + size % 2
    return _largest_track(sizes, frames)


_ASF_STREAM: Final = bytes.fromhex("9107dcb7b7a9cf118ee600c00c205365")
_ASF_VIDEO: Final = bytes.fromhex("c0ef19bc4d5bcf11a8fd00805f5c442b")


def _asf(stream: BinaryIO) -> Header | None:
    (size,) = struct.unpack("<Q", _read_at(stream, 16, 8))
    header = _read_at(stream, 0, min(size, _MAX_HEADER_BYTES))
    sizes: list[tuple[int, int]] = []
    position = 30
    while position + 24 <= len(header):
        (size,) = struct.unpack_from("<Q", header, position + 16)
        if header[position : position + 16] == _ASF_STREAM and header[position + 24 :].startswith(_ASF_VIDEO):
            sizes.append(struct.unpack_from("<II", header, position + 78))
        if size < 24:
            break
        position += size
    return _largest_track(sizes)


def _gif(stream: BinaryIO) -> Header | None:
    return _largest_track([struct.unpack("<HH", _read_at(stream, 6, 4))])


def _ogg(stream: BinaryIO) -> Header:
    theora = re.search(rb"\x80theora...(..)(..)", _read_at(stream, 0, _SCAN_BYTES), re.DOTALL)
    if theora is None:
        return Header()
    return Header(*(16 * int.from_bytes(part, "big") for part in theora.groups()))


_SEQUENCE_HEADER: Final = re.compile(rb"\x00\x00\x01\xb3(...)", re.DOTALL)
_PLAYLIST: Final = re.compile(rb"c=IN IP|<MPD|#EXTM3U|ffconcat", re.IGNORECASE)


def _mpeg(stream: BinaryIO) -> Header | None:
    """Program streams, transport streams and bare ones; H.264 in them tells its size to its decoder only."""
    start = _read_at(stream, 0, _SCAN_BYTES)
    # A transport stream's few fixed bytes can be had in a text, too. FFmpeg takes a file for a text up to the
    # first zero byte; a stream has some soon, and anything by chance behind them.
    if _PLAYLIST.search(start.partition(b"\0")[0]):
        return None
    found = [int.from_bytes(match[1], "big") for match in _SEQUENCE_HEADER.finditer(start)]
    return _largest_track([(value >> 12, value & 0xFFF) for value in found]) or Header()


def _unknown_size(_stream: BinaryIO) -> Header:
    return Header()


_VIDEOS: Final[_Readers] = (
    (rb"....(ftyp|moov|mdat|free|skip|wide|pnot|styp)", _mp4),
    (rb"\x1a\x45\xdf\xa3.{,60}(matroska|webm)", _matroska),
    (rb"RIFF....AVI ", _avi),
    (rb"GIF8[79]a", _gif),
    (rb"\x30\x26\xb2\x75\x8e\x66\xcf\x11\xa6\xd9\x00\xaa\x00\x62\xce\x6c", _asf),
    (rb"\x00\x00\x01[\xba\xb3]", _mpeg),
    (rb"G(.{187}G){3}", _mpeg),
    (rb"....G(.{191}G){3}", _mpeg),
    (rb"OggS\x00", _ogg),
    (rb"FLV\x01", _unknown_size),
    (rb"\x06\x0e\x2b\x34\x02\x05\x01\x01\x0d\x01\x02", _unknown_size),
)
"""Regular expressions for a video's first bytes, and readers of its header"""
