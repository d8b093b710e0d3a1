"""The camera, as far as a picture file tells about its lens."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Final

from handfit_core.geometry.camera import Intrinsics
from handfit_core.media.exif import read_focal_35mm
from handfit_core.media.opening import Media

FILM_DIAGONAL: Final = math.hypot(36.0, 24.0)
"""mm; equivalent focal lengths are defined by equal diagonals (CIPA DCG-001)"""
_HEAD: Final = 1 << 20
"""Bytes; EXIF tags stand at a file's beginning"""


def known_intrinsics(media: Media) -> Intrinsics | None:
    """The camera of a photo or image sequence whose first file names its focal length (EXIF, 35 mm film);
    None where it does not, and for videos. A picture that was cropped afterwards misleads: nothing in it
    tells."""
    if media.source.kind == "video":
        return None
    try:
        with open(Path(media.source.files[0]), "rb") as stream:
            focal_mm = read_focal_35mm(stream.read(_HEAD))
    except OSError:
        return None
    if focal_mm is None:
        return None
    focal = focal_mm / FILM_DIAGONAL * math.hypot(media.width, media.height)
    return Intrinsics(focal, focal, media.width / 2.0, media.height / 2.0)
