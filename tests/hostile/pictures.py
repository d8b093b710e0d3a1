"""Pictures: damaged ones of every format, headers that claim what is not there, EXIF without an end."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable, Iterator
from functools import cache, partial
from typing import Any

import cv2
import numpy as np

from tests import plates
from tests.hostile.engine import Case, Place, table
from tests.hostile.mutations import mutants
from tests.hostile.npz import some

DOOR = "core.media"
PLATE = "blender.import_of"


@cache
def encoded(suffix: str) -> bytes:
    pixels = np.add.outer(np.arange(48), np.arange(64) * 2)[..., None].repeat(3, 2).astype(np.uint8)
    if suffix == "gif":
        return gif(64, 48)
    if suffix == "exr":
        return plates.exr(pixels.astype(np.float16) / 255)
    if suffix == "dpx":
        return plates.dpx(pixels)
    if suffix == "heic":
        return grid(100, 90)
    if suffix == "hdr":
        return bytes(cv2.imencode(".hdr", pixels.astype(np.float32) / 255)[1])
    return bytes(cv2.imencode(f".{suffix}", pixels[..., 0] if suffix == "pgm" else pixels)[1])


def gif(width: int, height: int, frames: int = 2) -> bytes:
    """Grey frames of one code each; the canvas is as large as one likes."""
    picture = b"\x2c" + struct.pack("<4HB", 0, 0, min(width, 8), min(height, 8), 0) + b"\x02\x02\x4c\x01\x00"
    screen = struct.pack("<2H3B", width, height, 0x80, 0, 0) + b"\x80\x80\x80\x00\x00\x00"
    return b"GIF89a" + screen + picture * frames + b"\x3b"


def jpeg(width: int, height: int) -> bytes:
    """A small JPEG that claims another size."""
    data = bytearray(encoded("jpg"))
    at = data.index(b"\xff\xc0") + 5
    data[at : at + 4] = struct.pack(">2H", height, width)
    return bytes(data)


def png(
    width: int, height: int, depth: int = 8, colour: int = 0, rows: bytes = bytes(1000), interlace: int = 0
) -> bytes:
    header = _chunk(b"IHDR", struct.pack(">2I5B", width, height, depth, colour, 0, 0, interlace))
    return b"\x89PNG\r\n\x1a\n" + header + _chunk(b"IDAT", zlib.compress(rows, 9)) + _chunk(b"IEND", b"")


def _chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def _claiming(name: str) -> bytes:
    """A PNG with a chunk that claims 2 GB."""
    data = bytearray(png(64, 48))
    at = data.index(b"IDAT") - 4
    data[at : at + 8] = struct.pack(">I", 0x7FFF_FF00) + name.encode()
    return bytes(data)


def animated(width: int, height: int, across: int, down: int) -> bytes:
    """A PNG of a frame of another size than the picture's."""
    whole = png(width, height)
    at = whole.index(b"IDAT") - 4
    frame = _chunk(b"fcTL", struct.pack(">5I2H2B", 0, across, down, 0, 0, 1, 10, 0, 0))
    return whole[:at] + _chunk(b"acTL", struct.pack(">2I", 2, 0)) + frame + whole[at:]


def grid(width: int, height: int, columns: int = 2, rows: int = 2, tiles: int = 4, side: int = 64) -> bytes:
    """A phone's photo of tiles."""
    tile = plates.tile((200, 90, 20))
    return plates.heic([tile] * tiles, (width, height), grid=(columns, rows), tile_size=(side, side))


def plate(channels: int, value: float = 1.0, size: int = 64) -> bytes:
    names = [f"c{i:03}" for i in range(channels - 3)]
    return plates.exr(np.full((size, size, channels), value, dtype=np.float32), ["B", "G", "R", *names])


def crowd(place: Place) -> dict[str, Any]:
    """A folder of 100 000 pictures."""
    data = encoded("png")
    (place.folder / "crowd").mkdir()
    for number in range(100_000):
        (place.folder / "crowd" / f"f_{number}.png").write_bytes(data)
    return {"path": str(place.folder / "crowd")}


def slim(width: int, height: int) -> bytes:
    return bytes(cv2.imencode(".png", np.full((height, width, 3), 128, np.uint8))[1])


def tiff(width: int, height: int, bits: int = 8, samples: int = 1, **other: int) -> bytes:
    tags = {256: width, 257: height, 258: bits, 259: 1, 262: 1, 273: 8, 277: samples, 278: height, 279: 4000}
    tags |= {int(tag[1:]): value for tag, value in other.items()}
    entries = b"".join(struct.pack("<HHII", tag, 4, 1, value) for tag, value in sorted(tags.items()))
    strip = b"II*\0" + struct.pack("<I", 4008) + bytes(4000)
    return strip + struct.pack("<H", len(tags)) + entries + bytes(4)


def bmp(width: int, height: int, bits: int = 24, compression: int = 0) -> bytes:
    fields = struct.pack("<IiiHHIIiiII", 40, width, height, 1, bits, compression, 0, 1, 1, 0, 0)
    return b"BM" + struct.pack("<IHHI", 54 + 300, 0, 0, 54) + fields + bytes(300)


def webp(width: int, height: int) -> bytes:
    whole = encoded("webp")
    canvas = (width - 1).to_bytes(3, "little") + (height - 1).to_bytes(3, "little")
    chunks = b"WEBPVP8X" + struct.pack("<I", 10) + bytes(4) + canvas + whole[12:]
    return b"RIFF" + struct.pack("<I", len(chunks)) + chunks


def exif(entries: list[tuple[int, int, int, int]], following: int = 0, order: bytes = b"II") -> bytes:
    """A JPEG whose EXIF directory has these entries (tag, type, count, value)."""
    mark = "<" if order == b"II" else ">"
    block = order + struct.pack(f"{mark}HI", 42, 8) + struct.pack(f"{mark}H", len(entries))
    block += b"".join(struct.pack(f"{mark}HHII", *entry) for entry in entries)
    block += struct.pack(f"{mark}I", following)
    segment = b"Exif\0\0" + block
    return b"\xff\xd8\xff\xe1" + struct.pack(">H", len(segment) + 2) + segment + encoded("jpg")[2:]


_SIZES = (
    (32000, 32000), (65500, 16000), (65535, 65535), (30000, 30000), (1, 65535), (65535, 1), (0, 0), (0, 5),
)  # fmt: skip
_LARGER = (*_SIZES, (2**31 - 1, 2**31 - 1), (2**31 - 1, 1), (2**32 - 1, 2**32 - 1), (1 << 20, 1 << 10))

HEADERS: dict[str, Callable[[], bytes]] = {
    **{f"jpg-{w}x{h}": lambda w=w, h=h: jpeg(w, h) for w, h in _SIZES},
    **{f"png-{w}x{h}": lambda w=w, h=h: png(w, h) for w, h in _LARGER},
    **{f"gif-{w}x{h}": lambda w=w, h=h: gif(w, h) for w, h in _SIZES},
    **{f"webp-{w}x{h}": lambda w=w, h=h: webp(w, h) for w, h in ((16383, 16383), (1 << 24, 1 << 24), (1, 1))},
    **{f"tif-{w}x{h}": lambda w=w, h=h: tiff(w, h) for w, h in _LARGER},
    **{f"tif-{bits}-bits-{n}": lambda b=bits, n=n: tiff(20000, 20000, b, n) for bits in (1, 16, 32, 64) for n in (1, 4, 200)},
    "tif-tiles": lambda: tiff(30000, 30000, t322=65536, t323=65536, t324=8, t325=100),
    "tif-strip": lambda: tiff(30000, 30000, t278=1, t279=2**32 - 1),
    "tif-loop": lambda: b"II*\0" + struct.pack("<I", 8) + struct.pack("<HI", 0, 8) * 20,
    **{f"bmp-{w}x{h}": lambda w=w, h=h: bmp(min(w, 2**31 - 1), min(h, 2**31 - 1)) for w, h in _LARGER},
    **{f"bmp-minus-{w}": lambda w=w: bmp(w, -w, 32) for w in (30000, 2**31 - 1)},
    **{f"bmp-packed-{n}": lambda n=n: bmp(30000, 30000, (4, 8)[n % 2], 1 + n % 2) for n in range(2)},
    **{f"ppm-{w}x{h}": lambda w=w, h=h: b"P6\n%d %d\n255\n" % (w, h) + bytes(99) for w, h in _LARGER},
    "ppm-minus": lambda: b"P6\n-5 -5\n255\n" + bytes(99),
    "ppm-long": lambda: b"P5 " + b"9" * 100_000,
    **{f"hdr-{w}x{h}": lambda w=w, h=h: b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y %d +X %d\n" % (h, w) + bytes(99) for w, h in _LARGER},
    "jp2-huge": lambda: encoded("jp2").replace(struct.pack(">2I", 48, 64), struct.pack(">2I", 32000, 32000)).replace(struct.pack(">2I", 64, 48), struct.pack(">2I", 32000, 32000)),
    "png-true-zeros": lambda: png(20000, 20000, rows=bytes(20001 * 20000)),
    "png-deep-zeros": lambda: png(9000, 9000, 16, 6, rows=bytes((9000 * 8 + 1) * 9000)),
    "png-interlaced": lambda: png(30000, 30000, 8, 6, interlace=1),
    **{f"png-{name}-says-2-gb": lambda name=name: _claiming(name) for name in ("IDAT", "tEXt", "PLTE", "acTL")},
    "png-frame-beyond": lambda: animated(64, 48, 16000, 16000),
    "png-frames-far": lambda: animated(8000, 8000, 8000, 8000),
    "exr-200-channels": lambda: plate(200),
    "exr-200-large": lambda: _sized(plate(200), 64, 8000),
    **{f"exr-{value}": lambda value=value: plate(3, float(value)) for value in ("nan", "inf", "-inf", "1e-40", "-5")},
    **{f"exr-{w}": lambda w=w: _sized(plate(3), 64, w) for w in (0, 20_000, 2**31 - 1)},
    "exr-attributes": lambda: plate(3)[:8] + b"a\0b\0\0\0\0\0" * 200_000,
    "exr-attribute-of-4-gb": lambda: plate(3)[:8] + b"a\0b\0\xff\xff\xff\xff" + bytes(99),
    **{f"dpx-{w}": lambda w=w: _sized(encoded("dpx"), 64, w, ">I") for w in (0, 20_000, 2**32 - 1)},
    "heic-20000": lambda: grid(20_000, 20_000, side=10_000),
    "heic-20000-of-small": lambda: grid(20_000, 20_000, 256, 256, 4),
    "heic-missing-tiles": lambda: grid(100, 90, tiles=3),
    "heic-damaged-tiles": lambda: grid(100, 90).replace(plates.tile((200, 90, 20))[1], bytes(40), 2),
    "heic-65536-tiles": lambda: grid(65_000, 65_000, 255, 255, 65_025, 256),
    "heic-larger-tiles": lambda: plates.heic([plates.tile((9, 9, 9), 2048, 2048)], (16, 16), tile_size=(16, 16)),
    "exif-loop": lambda: exif([(0x8769, 4, 1, 8)], following=8),
    "exif-huge-count": lambda: exif([(0x112, 3, 2**32 - 1, 6), (0x920A, 5, 2**31, 2**31), (0xA405, 3, 1, 0)]),
    "exif-far": lambda: exif([(0x8769, 4, 1, 2**32 - 8), (0xA404, 5, 1, 2**32 - 1)], order=b"MM"),
    "exif-orientation-99": lambda: exif([(0x112, 3, 1, 99)]),
    "exif-many": lambda: exif([(0x8769, 4, 1, 8)] * 5000),
}  # fmt: skip


def _sized(data: bytes, old: int, new: int, order: str = "<I") -> bytes:
    """A plate that claims another size: an OpenEXR window's last pixel lies before its end."""
    less = order == "<I"
    return data.replace(struct.pack(order, old - less), struct.pack(order, (new - less) % 2**32))


_KNOWN = (
    "jpg-32000x32000",
    "png-true-zeros",
    "gif-30000x30000",
    "png-IDAT-says-2-gb",
    "png-frame-beyond",
    "heic-20000",
    "exr-200-channels",
)
_SLIM = ((5000, 1), (1, 65500), (65535, 2), (3, 20000), (1, 1))
SUFFIXES = ("jpg", "png", "webp", "bmp", "tif", "jp2", "ppm", "pgm", "hdr", "gif", "exr", "dpx", "heic")
DISGUISES = ("png-as-mp4", "jpg-as-png", "gif-as-jpg", "webp-as-mov", "png-as-npz", "bmp-as-nothing")


def _file(header: str) -> str:
    return f"picture.{header.split('-')[0].replace('exif', 'jpg')}"


def cases() -> Iterator[Case]:
    for suffix in SUFFIXES:
        good = partial(encoded, suffix.replace("tif", "tiff"))
        yield from mutants(suffix, DOOR, good, f"picture.{suffix}", 4)
        yield from mutants(f"plate-{suffix}", PLATE, good, f"a.{suffix}", 1, kind="photo")
    good_exif = [(0x112, 3, 1, 6), (0x8769, 4, 1, 38), (0xA405, 3, 1, 35)]
    yield from mutants("exif", DOOR, lambda: exif(good_exif), "picture.jpg", 4)
    yield from table("picture", DOOR, _file, HEADERS, known=_KNOWN)
    shown = {name: data for name, data in HEADERS.items() if some(name, 3) or name in _KNOWN}
    yield from table("plate", PLATE, _file, shown, kind="photo")  # as a take names it, in Blender
    slims = {f"{width}x{height}": partial(slim, width, height) for width, height in _SLIM}
    for verb in ("capture", "find"):
        refused = verb == "capture"
        yield from table(f"slim-{verb}", f"core.{verb}", "a.png", slims, refused=refused, known=["5000x1"])
    yield Case("picture-crowd", DOOR, crowd)
    for disguise in DISGUISES:
        right, _, wrong = disguise.partition("-as-")
        file, content = f"x.{wrong.replace('nothing', '')}", {disguise: partial(encoded, right)}
        yield from table("picture", DOOR, file, content)
