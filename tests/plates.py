"""Photos of phones and plates of studios, small ones: HEIC, OpenEXR and DPX."""

from __future__ import annotations

import io
import struct
from collections.abc import Sequence
from fractions import Fraction
from functools import cache

import numpy as np


def box(name: bytes, *inside: bytes) -> bytes:
    return struct.pack(">I4s", 8 + sum(map(len, inside)), name) + b"".join(inside)


@cache
def tile(colour: tuple[int, int, int], width: int = 64, height: int = 64) -> tuple[bytes, bytes]:
    """A picture of one RGB colour in HEVC: what its decoder needs, and the picture."""
    import av

    file = io.BytesIO()
    with av.open(file, "w", format="mp4") as container:
        stream = container.add_stream("libx265", rate=25, options={"x265-params": "log-level=none"})
        stream.width, stream.height, stream.pix_fmt = width, height, "yuv420p"
        frame = av.VideoFrame.from_ndarray(np.full((height, width, 3), colour, np.uint8), format="rgb24")
        for packet in (*stream.encode(frame), *stream.encode(None)):
            packet.pts = packet.dts = 0
            container.mux(packet)
    with av.open(io.BytesIO(file.getvalue()), "r") as coded:
        (packet, *_) = coded.demux(video=0)
        return coded.streams.video[0].codec_context.extradata or b"", bytes(packet)


def heic(
    tiles: Sequence[tuple[bytes, bytes]],
    size: tuple[int, int],
    *,
    grid: tuple[int, int] | None = None,
    tile_size: tuple[int, int] = (64, 64),
    more: Sequence[bytes] = (),
) -> bytes:
    """A photo of `size`, of one tile or a `grid` of (columns, rows); `more` boxes turn or crop it."""
    count = len(tiles)
    layout = struct.pack(">4B2H", 0, 0, grid[1] - 1, grid[0] - 1, *size) if grid else b""
    main = count + bool(grid)
    kinds = [b"hvc1"] * count + [b"grid"] * (main - count)
    entries = [
        box(b"infe", b"\2\0\0\0", struct.pack(">HH", i, 0), kind, b"\0") for i, kind in enumerate(kinds, 1)
    ]
    spaces = [box(b"ispe", bytes(4), struct.pack(">II", *each)) for each in (tile_size, size)]
    known = box(b"ipco", box(b"hvcC", tiles[0][0]), *spaces, *more)
    turned = [4 + i for i in range(len(more))]
    of_tile, of_main = [1, 2], [1, 3, *turned]
    links = [struct.pack(">HB", i, len(of_tile)) + bytes(of_tile) for i in range(1, count + 1)][: main - 1]
    links.append(struct.pack(">HB", main, len(of_main)) + bytes(of_main))

    def meta(start: int) -> bytes:
        places = []
        for i, (_, data) in enumerate(tiles, 1):
            places.append(struct.pack(">HHHHII", i, 0, 0, 1, start, len(data)))
            start += len(data)
        if grid:  # in a box beside the list, as phones have it
            places.append(struct.pack(">HHHHII", main, 1, 0, 1, 0, len(layout)))
        refers = struct.pack(f">HH{count}H", main, count, *range(1, count + 1))
        return box(
            b"meta",
            bytes(4),
            box(b"pitm", bytes(4), struct.pack(">H", main)),
            box(b"iloc", b"\1\0\0\0", b"\x44\0", struct.pack(">H", main), *places),
            box(b"iinf", bytes(4), struct.pack(">H", main), *entries),
            box(b"iprp", known, box(b"ipma", bytes(4), struct.pack(">I", main), *links)),
            box(b"idat", layout),
            *([box(b"iref", bytes(4), box(b"dimg", refers))] if grid else []),
        )

    kind = box(b"ftyp", b"heic", bytes(4), b"mif1heic")
    return kind + meta(len(kind) + len(meta(0)) + 8) + box(b"mdat", *(data for _, data in tiles))


def exr(
    pixels: np.ndarray, names: Sequence[str] = "BGR", *, shown: tuple[int, int, int, int] | None = None
) -> bytes:
    """(H, W, C) float16 or float32 as an uncompressed OpenEXR picture whose channels have these names, in
    alphabetical order; `shown` is the display window."""
    height, width, _ = pixels.shape

    def attribute(name: bytes, kind: bytes, value: bytes) -> bytes:
        return name + b"\0" + kind + b"\0" + struct.pack("<I", len(value)) + value

    number = {np.dtype(np.float16): 1, np.dtype(np.float32): 2}[pixels.dtype]
    channels = b"".join(name.encode() + struct.pack("<xIIII", number, 0, 1, 1) for name in names)
    window = 0, 0, width - 1, height - 1
    header = b"v/1\1\2\0\0\0" + b"".join(
        attribute(*each)
        for each in (
            (b"channels", b"chlist", channels + b"\0"),
            (b"compression", b"compression", b"\0"),
            (b"dataWindow", b"box2i", struct.pack("<4i", *window)),
            (b"displayWindow", b"box2i", struct.pack("<4i", *(shown or window))),
            (b"lineOrder", b"lineOrder", b"\0"),
            (b"pixelAspectRatio", b"float", struct.pack("<f", 1)),
            (b"screenWindowCenter", b"v2f", bytes(8)),
            (b"screenWindowWidth", b"float", struct.pack("<f", 1)),
        )
    )
    rows = [row.T.tobytes() for row in pixels]
    start, size = len(header) + 1 + 8 * height, len(rows[0]) + 8
    places = struct.pack(f"<{height}Q", *(start + y * size for y in range(height)))
    lines = (struct.pack("<iI", y, len(row)) + row for y, row in enumerate(rows))
    return header + b"\0" + places + b"".join(lines)


def dpx(rgb: np.ndarray, form: str = "gbrp10be") -> bytes:
    """(H, W, 3) uint8 in a form that FFmpeg knows."""
    import av

    context = av.CodecContext.create("dpx", "w")
    context.height, context.width = rgb.shape[:2]
    context.pix_fmt, context.time_base = form, Fraction(1, 25)
    frame = av.VideoFrame.from_ndarray(rgb, format="rgb24").reformat(format=form)
    return b"".join(map(bytes, [*context.encode(frame), *context.encode(None)]))
