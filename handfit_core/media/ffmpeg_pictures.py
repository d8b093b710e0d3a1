"""Pictures that FFmpeg decodes and OpenCV does not: HEIC, AVIF, OpenEXR and DPX."""

from __future__ import annotations

import contextlib
import io
import re
import struct
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from handfit_core.common.errors import InputError
from handfit_core.media.headers import PICTURES, exr_channels, read_exr_attributes
from handfit_core.media.heif import read_heif
from handfit_core.media.kinds import unreadable

if TYPE_CHECKING:
    import av

_MORE_PIXELS = 64
"""Coded pictures are whole blocks of up to so many pixels a side"""


def decoded_by_ffmpeg(path: Path, data: bytes) -> tuple[np.ndarray, int] | None:
    """Return (H, W) or (H, W, 3) BGR as stored, uint8 or linear float16 or float32, and the EXIF orientation
    to undo; None for a picture of another kind. Raises InputError for a damaged one."""
    try:
        if re.match(PICTURES["HEIC"], data, re.DOTALL):
            return _heif(path, data)
        if re.match(PICTURES["OpenEXR"], data):
            return _exr(path, data), 1
        if re.match(PICTURES["DPX"], data):
            # Logarithmic film densities, too, are taken as they would be shown.
            return _one("dpx", data).to_ndarray(format="bgr24"), 1
    except (ValueError, LookupError, struct.error) as error:
        raise unreadable(path) from error
    return None


def _frames(decoder: str, packets: Sequence[bytes], **options: object) -> Iterator[tuple[int, av.VideoFrame]]:
    """Yield those pictures of the packets that can be read, each with its packet's index."""
    import av
    from av.error import FFmpegError

    context: Any = av.CodecContext.create(decoder, "r")
    context.thread_type = "AUTO"
    context.extradata = options.pop("extradata", None)
    context.options = {name: str(value) for name, value in options.items()}
    for index, data in enumerate((*packets, None)):
        packet = None
        if data is not None:
            # Its memory is FFmpeg's own: to free Python's, a thread waits for the lock that closing it holds.
            packet = av.Packet(len(data))
            packet.update(data)
            packet.pts = index
        with contextlib.suppress(FFmpegError):
            for frame in context.decode(packet):
                if not frame.is_corrupt and frame.pts is not None:
                    yield frame.pts, frame


def _one(decoder: str, data: bytes, **options: object) -> av.VideoFrame:
    for _, frame in _frames(decoder, [data], **options):
        return frame
    raise ValueError("no picture")


def _exr(path: Path, data: bytes) -> np.ndarray:
    attributes = read_exr_attributes(io.BytesIO(data))
    # All that was drawn is read, whatever part of it is to be shown, as Blender does.
    at = attributes[b"displayWindow"][0]
    data = data[:at] + attributes[b"dataWindow"][1] + data[at + 16 :]
    names = exr_channels(attributes[b"channels"][1])
    layers = sorted({name.rpartition(".")[0] for name in names}, key=_likely_beauty)
    for layer in layers:
        dot = f"{layer}." if layer else ""
        if f"{dot}Y" in names or all(dot + colour in names for colour in "RGB"):
            break
    else:
        raise InputError(
            f"{path}: this is an OpenEXR picture without colours (it has {', '.join(names[:6])}); "
            "export R, G and B"
        )
    frame = _one("exr", data, **({"layer": layer} if layer else {}))
    kind = np.float16 if "f16" in frame.format.name else np.float32
    planes: list[Any] = list(frame.planes)
    planes = [np.frombuffer(each, kind).reshape(each.height, -1)[:, : each.width] for each in planes]
    if len(planes) < 3:
        return planes[0].copy()
    return np.stack([planes[1], planes[0], planes[2]], axis=-1)  # FFmpeg has green, blue, red


def _likely_beauty(layer: str) -> tuple[bool, bool, str]:
    """Sort key that puts the layer first which holds the picture itself: the one without a name, or with a
    usual one."""
    return layer != "", not re.search("combined|rgba?$|beauty", layer, re.IGNORECASE), layer


def _heif(path: Path, data: bytes) -> tuple[np.ndarray, int]:
    found = read_heif(io.BytesIO(data))
    if found is None:
        raise ValueError("an unusual layout")
    packets = [b"".join(data[at : at + length] for at, length in tile) for tile in found.tiles]
    wide, high = found.tile_width, found.tile_height
    pixels = np.zeros((found.height, found.width, 3), dtype=np.uint8)
    missing = set(range(len(packets)))
    most = (wide + _MORE_PIXELS) * (high + _MORE_PIXELS)
    for index, frame in _frames(found.decoder, packets, extradata=found.extradata, max_pixels=most):
        row, column = divmod(index, found.columns)
        place = pixels[row * high : (row + 1) * high, column * wide : (column + 1) * wide]
        tile = frame.to_ndarray(format="bgr24")[: place.shape[0], : place.shape[1]]
        place[: tile.shape[0], : tile.shape[1]] = tile
        missing.discard(index)
    if missing:
        raise InputError(
            f"{path}: this is a HEIC or AVIF photo of which {len(missing)} of {len(packets)} tiles are "
            "damaged or missing; copy it again, or export it as JPEG"
        )
    left, top, right, bottom = found.crop
    return pixels[top:bottom, left:right], found.orientation
