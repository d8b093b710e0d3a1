"""Copies of photos and clips that Blender cannot read: the capture writes them, and the add-on shows them."""

from __future__ import annotations

import contextlib
import hashlib
import logging
import time
from fractions import Fraction
from pathlib import Path
from typing import Any, Final

import numpy as np

from handfit_core.common.errors import HandfitError, InputError
from handfit_core.common.files import cache_dir, written_whole
from handfit_core.media.headers import PICTURES, begins
from handfit_core.media.opening import open_media
from handfit_core.media.source import Media, Source

log = logging.getLogger("handfit")

_SUFFIXES: Final = {"photo": ".jpg", "video": ".mp4"}
_UNREAD: Final = {"photo": PICTURES["HEIC"], "video": PICTURES["PNG"] + b"|" + PICTURES["WebP"]}
"""First bytes, by kind of source, of files that Blender does not read, or not in every version: HEIC and
AVIF, and pictures that move, of which it shows the first frame alone"""
_KEPT: Final = 100
"""Number of the newest copies that are always kept"""
_NEEDED: Final = 24 * 3600.0
"""Seconds for which a copy is kept in any case; a batch shows copies when all of its inputs are captured"""


def copies_folder() -> Path:
    """Return the folder in which all copies lie."""
    return cache_dir() / "plates"


def copy_path(source: Source) -> Path | None:
    """Return the path of the copy of a photo or clip, whether or not there is one; None where none is
    needed."""
    path = Path(source.files[0])
    if source.kind not in _UNREAD or not begins(path, _UNREAD[source.kind]):
        return None
    state = path.stat()
    key = f"{path.resolve()} {state.st_size} {state.st_mtime_ns}"
    name = hashlib.sha256(key.encode("utf-8", "surrogateescape")).hexdigest()[:24]
    return copies_folder() / (name + _SUFFIXES[source.kind])


def write_copy(source: Source, max_megapixels: float | None = None) -> None:
    """Write the copy of a photo or clip where Blender needs one: upright, frame for frame. Logs a warning
    where that fails."""
    path = copy_path(source)
    if path is None or path.is_file():
        return
    try:
        media = open_media(source.files[0], max_megapixels=max_megapixels)
        with contextlib.closing(media), written_whole(path) as beside:
            (_write_photo if source.kind == "photo" else _write_clip)(beside, media)
    except HandfitError as error:
        log.warning("%s; so there will be no picture behind the hands", error)
        return
    _remove_old(path.parent)


def _remove_old(folder: Path) -> None:
    """Remove copies that are neither recent nor among the newest. Other processes may do the same."""
    ages: list[tuple[float, Path]] = []
    for path in folder.iterdir():
        with contextlib.suppress(OSError):
            ages.append((time.time() - path.stat().st_mtime, path))
    for age, path in sorted(ages)[_KEPT:]:
        if age > _NEEDED:
            path.unlink(missing_ok=True)


def _write_photo(path: Path, media: Media) -> None:
    import cv2

    rgb = next((frame.rgb for frame in media.frames()), None)
    if rgb is None:
        raise InputError(f"{media.source.files[0]}: cannot be read")
    encoded = cv2.imencode(".jpg", cv2.cvtColor(rgb, cv2.COLOR_RGB2BGR), [cv2.IMWRITE_JPEG_QUALITY, 98])[1]
    path.write_bytes(encoded.tobytes())


def _write_clip(path: Path, media: Media) -> None:
    """Write the copy of a clip; a picture is written again on every frame on which it is shown."""
    import av

    shown = np.zeros((media.height, media.width, 3), dtype=np.uint8)
    with av.open(str(path), "w", format="mp4") as output:
        rate = Fraction(media.fps).limit_denominator(1001)
        stream: Any = output.add_stream("libx264", rate=rate, options={"crf": "12", "preset": "veryfast"})
        stream.width, stream.height, stream.pix_fmt = media.width, media.height, "yuv444p"
        for frame in media.frames():
            shown = shown if frame.rgb is None else frame.rgb
            output.mux(stream.encode(av.VideoFrame.from_ndarray(shown, format="rgb24")))
        output.mux(stream.encode(None))
