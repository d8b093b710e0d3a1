"""HEIC and AVIF: the coded tiles of a file's main picture, and how it is turned (ISO 14496-12, 23008-12).

A phone's HEIC is a grid of tiles, each of which is a picture of its own. Standard library only, since
Blender's process asks for the size, too.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from typing import BinaryIO, Final

HEIF: Final = rb"....ftyp(?:hei[cxms]|mif[12]|avif)"
"""Pattern of the first bytes of a HEIC or AVIF file"""
_DECODERS: Final = {b"hvc1": ("hevc", b"hvcC"), b"av01": ("libdav1d", b"av1C")}
"""FFmpeg's decoder of each kind of item, and the name of the property that the decoder needs"""
_MOST_BOXES: Final = 100_000
_MOST_BYTES: Final = 1 << 22
"""Most bytes of the list of items that are read"""
_TURNS: Final = {None: (1, 8, 3, 6), 0: (4, 5, 2, 7), 1: (2, 7, 4, 5)}
"""EXIF's orientation by the mirroring (up to down is 0, left to right 1) that follows quarter turns to the
left, and their number"""


@dataclass(frozen=True)
class Heif:
    """The main picture of a HEIC or AVIF file."""

    width: int
    height: int
    """Height in pixels, with `width` beside it, before the picture is cropped and turned"""
    crop: tuple[int, int, int, int]
    """Left, top, right and bottom, in pixels, of what is to be seen"""
    orientation: int
    """Orientation as EXIF counts, 1-8; whatever the file's EXIF says is done already"""
    tile_width: int
    tile_height: int
    tiles: tuple[tuple[tuple[int, int], ...], ...]
    """For each tile, row by row, the places in the file at which its bytes lie: starts and lengths in
    bytes"""
    decoder: str
    extradata: bytes
    bits: int

    @property
    def columns(self) -> int:
        """Number of tiles in a row."""
        return -(-self.width // self.tile_width)


def read_heif(stream: BinaryIO) -> Heif | None:
    """Return the main picture of a HEIC or AVIF; None where its layout is another one than a picture or a
    grid of them. Raises struct.error, ValueError, IndexError and KeyError for damaged files."""
    start, end = next((place for name, *place in boxes_of(stream, frozenset()) if name == b"meta"), (0, 0))
    meta = read_at(stream, start, min(end - start, _MOST_BYTES))
    boxes = {name: (at, data) for name, at, data in _boxes(meta, 4, start)}
    (primary,) = struct.unpack_from(">I" if boxes[b"pitm"][1][0] else ">H", boxes[b"pitm"][1], 4)
    kinds = dict(_kinds(boxes[b"iinf"][1]))
    properties = dict(_properties(boxes[b"iprp"][1]))
    size = stream.seek(0, 2)
    places = dict(_places(boxes[b"iloc"][1], boxes.get(b"idat", (0, b""))[0], size))
    of_main = properties[primary]
    width, height = struct.unpack_from(">4xII", dict(of_main)[b"ispe"])
    tiles, told = (primary,), (1, 1)
    if kinds[primary] == b"grid":
        tiles = dict(_tiles(boxes[b"iref"][1]))[primary]
        ((at, length),) = places[primary]
        stream.seek(at)
        _, wide, rows, columns, *output = stream.read(length)
        width, height = struct.unpack_from(">II" if wide & 1 else ">HH", bytes(output))
        told = columns + 1, rows + 1
    of_tile = dict(properties[tiles[0]])
    tile_width, tile_height = struct.unpack_from(">4xII", of_tile[b"ispe"])
    if kinds[tiles[0]] not in _DECODERS or not (tile_width and tile_height and width and height):
        return None
    decoder, needed = _DECODERS[kinds[tiles[0]]]
    found = Heif(
        *(width, height, _crop(dict(of_main).get(b"clap"), width, height)),
        *(_orientation(of_main), tile_width, tile_height),
        tuple(places[tile] for tile in tiles),
        *(decoder, of_tile[needed], max(of_tile.get(b"pixi", bytes(5) + b"\x08")[5:])),
    )
    grid = found.columns, -(-height // tile_height)
    return found if grid == told and len(tiles) == told[0] * told[1] else None


def read_at(stream: BinaryIO, position: int, count: int) -> bytes:
    """Return so many bytes at a place in a file, or fewer at its end."""
    stream.seek(position)
    return stream.read(count)


def boxes_of(stream: BinaryIO, with_boxes: frozenset[bytes]) -> Iterator[tuple[bytes, int, int]]:
    """Yield the name of each box of a file, and where its contents begin and end, in bytes. Boxes of the
    names `with_boxes` are entered: what they hold follows them. Raises struct.error, and ValueError beyond
    `_MOST_BOXES`."""
    end, position = stream.seek(0, 2), 0
    for _ in range(_MOST_BOXES):
        if position + 8 > end:
            return
        head, (size, name) = 8, struct.unpack(">I4s", read_at(stream, position, 8))
        if size == 1:
            head, (size,) = 16, struct.unpack(">Q", stream.read(8))
        if 0 < size < head:
            return
        after = position + size if size else end
        yield name, position + head, min(after, end)
        if name == b"meta":  # MP4's has a version and flags; QuickTime's begins with a box
            head += 4 * (read_at(stream, position + head, 4) == bytes(4))
        position = position + head if name in with_boxes else after
    raise ValueError("more boxes than anybody writes")


def _boxes(data: bytes, at: int = 0, start: int = 0) -> Iterator[tuple[bytes, int, bytes]]:
    """Yield the name of each box, where its contents lie in the file that holds `data` at `start`, and these
    contents."""
    while at + 8 <= len(data):
        size, name = struct.unpack_from(">I4s", data, at)
        if size < 8:
            return
        yield name, start + at + 8, data[at + 8 : at + size]
        at += size


def _kinds(data: bytes) -> Iterator[tuple[int, bytes]]:
    """Yield the number and the kind of each item."""
    for _, _, entry in _boxes(data, 8 if data[0] else 6):
        yield struct.unpack_from(">4xH2x4s" if entry[0] < 3 else ">4xI2x4s", entry)


def _properties(data: bytes) -> Iterator[tuple[int, list[tuple[bytes, bytes]]]]:
    """Yield for each item its number, and the name and contents of its properties in their order."""
    boxes = {name: inside for name, _, inside in _boxes(data)}
    known = [(name, inside) for name, _, inside in _boxes(boxes[b"ipco"])]
    links, at = boxes[b"ipma"], 8
    item, index = (">IB" if links[0] else ">HB"), ("H" if links[3] & 1 else "B")
    for _ in range(*struct.unpack_from(">4xI", links)):
        number, count = struct.unpack_from(item, links, at)
        at += struct.calcsize(item)
        found = struct.unpack_from(f">{count}{index}", links, at)
        at += struct.calcsize(f">{count}{index}")
        last = 0x7FFF if index == "H" else 0x7F  # the first bit says whether a reader must know it
        yield number, [known[(each & last) - 1] for each in found if each & last]


def _tiles(data: bytes) -> Iterator[tuple[int, tuple[int, ...]]]:
    """Yield for each grid its number, and the numbers of the items of which it is made."""
    number = "I" if data[0] else "H"
    for name, _, links in _boxes(data, 4):
        if name == b"dimg":
            grid, count = struct.unpack_from(f">{number}H", links)
            yield grid, struct.unpack_from(f">{count}{number}", links, struct.calcsize(f">{number}H"))


def _places(data: bytes, idat: int, end: int) -> Iterator[tuple[int, tuple[tuple[int, int], ...]]]:
    """Yield for each item its number, and the starts and lengths of its bytes, which are no more than the
    file has."""
    version, at = data[0], 6
    if not data[4] & 15:  # each would reach to the end of the file
        return
    sizes = data[4] >> 4, data[4] & 15, data[5] >> 4, data[5] & 15

    def number(size: int) -> int:
        nonlocal at
        if at + size > len(data):
            raise IndexError("items beyond their list")
        at += size
        return int.from_bytes(data[at - size : at])

    for _ in range(number(2 if version < 2 else 4)):
        item = number(2 if version < 2 else 4)
        start = idat if version and number(2) & 15 == 1 else 0
        number(2)
        start += number(sizes[2])
        extents = []
        for _ in range(number(2)):
            number(sizes[3] if version else 0)
            extents.append((start + number(sizes[0]), number(sizes[1])))
        if sum(length for _, length in extents) <= end:
            yield item, tuple(extents)


def _crop(aperture: bytes | None, width: int, height: int) -> tuple[int, int, int, int]:
    """Return the left, top, right and bottom in pixels of the part to be seen of a picture of that size; the
    part's middle and size are stored as fractions."""
    if aperture is None:
        return 0, 0, width, height
    values = struct.unpack(">4I4i", aperture[:32])
    first, last = [], []
    for i, whole in enumerate((width, height)):
        part, away = (values[at] / max(values[at + 1], 1) for at in (2 * i, 2 * i + 4))
        first.append(min(max(round((whole - part) / 2 + away), 0), whole - 1))
        last.append(min(max(first[i] + round(part), first[i] + 1), whole))
    return first[0], first[1], last[0], last[1]


def _orientation(properties: list[tuple[bytes, bytes]]) -> int:
    turns, mirror = 0, None
    for name, data in properties:
        if name == b"irot":
            turns = (data[0] & 3) * (1 if mirror is None else -1) % 4
        elif name == b"imir":
            mirror = data[0] & 1
    return _TURNS[mirror][turns]
