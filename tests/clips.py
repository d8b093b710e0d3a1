"""Small clips, written as phones, cameras and programs write them."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

MATRICES = {
    1: (1, 0, 0, 1),
    2: (-1, 0, 0, 1),
    3: (-1, 0, 0, -1),
    4: (1, 0, 0, -1),
    5: (0, 1, 1, 0),
    6: (0, 1, -1, 0),
    7: (0, -1, -1, 0),
    8: (0, -1, 1, 0),
}
"""a, b, c and d of the display matrix that means an EXIF orientation"""
_RATE = 25


def written_clip(
    path: Path,
    pictures: Sequence[np.ndarray],
    *,
    times: Sequence[float] | None = None,
    codec: str = "libx264",
    orientation: int = 1,
    aspect: Fraction | None = None,
    trimmed: int = 0,
    group: int = 250,
) -> Path:
    """Write pictures (H, W, 3) uint8 RGB at `times`, in frames of 25 a second; None: one a frame. `aspect` is
    the width of a pixel by its height, and `orientation` is EXIF's, which an MP4's display matrix tells. Its
    edit list hides the first `trimmed` frames. Every picture after `group` others is decoded without them."""
    import av

    height, width = pictures[0].shape[:2]
    formats = {"gif": "rgb8", "apng": "rgb24", "mjpeg": "yuvj444p", "prores_ks": "yuv422p10le"}
    finer = 1 if times is None else 600
    options = {"crf": "1"} if codec.startswith("libx26") else {}
    options |= {"g": str(group)}
    with av.open(str(path), "w") as output:
        stream: Any = output.add_stream(codec, rate=_RATE, options=options)
        stream.width, stream.height, stream.pix_fmt = width, height, formats.get(codec, "yuv420p")
        stream.time_base = stream.codec_context.time_base = Fraction(1, _RATE * finer)
        if aspect is not None:
            stream.codec_context.sample_aspect_ratio = aspect
        for picture, time in zip(pictures, times or range(len(pictures)), strict=True):
            frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(picture), format="rgb24")
            frame.pts, frame.time_base = round(finer * time), Fraction(1, _RATE * finer)
            output.mux(stream.encode(frame))
        output.mux(stream.encode(None))
    if trimmed:
        data = bytearray(path.read_bytes())
        at, mdhd = data.index(b"elst") + 12, data.index(b"mdhd") + 16
        length, begin = struct.unpack_from(">Ii", data, at)
        (second,) = struct.unpack_from(">I", data, mdhd)
        begin, length = begin + trimmed * second // _RATE, length - trimmed * 1000 // _RATE
        struct.pack_into(">Ii", data, at, length, begin)
        path.write_bytes(data)
    if orientation != 1:
        a, b, c, d = (value << 16 for value in MATRICES[orientation])
        data = bytearray(path.read_bytes())
        struct.pack_into(">9i", data, data.index(b"tkhd") + 44, a, b, 0, c, d, 0, 0, 0, 1 << 30)
        path.write_bytes(data)
    return path
