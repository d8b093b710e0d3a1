"""What inputs may be, and how they are read."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final


@dataclass(frozen=True)
class MediaSettings:
    """Rates, numbers and sizes of pictures and videos, and how many are read at once."""

    chunk_frames: int = 96
    """Frames of a clip that are detected together at most (`Media.chunk_frames`). A chunk begins with a palm
    detection in the whole picture, as every 24th frame has one"""
    max_range_chars: int = 40
    """Most characters of a frame range; numbers beyond any clip's frames fit in"""
    max_frame_number: int = 1_048_574
    """Blender's last frame."""
    max_frame_gap: int = 10
    """Largest mean distance of the frame numbers of one sequence"""
    max_fps: float = 1000.0
    min_seek_frames: int = 500
    """Frames from which on a place in a clip is sought; nearer ones are read as fast as they are sought"""
    reordered_frames: int = 4
    """Frames by which a damaged video's decoder may give pictures too early"""
    break_seconds: float = 1.0
    """Seconds between two pictures of a clip from which the user is told of a break"""
    max_gap_seconds: float = 60.0
    """Most seconds between two pictures of a clip; what is behind a longer gap is another clip"""
    missing_frames: int = 2
    """Frames by which a header may be wrong about a clip's length, as lengths are rounded"""
    square_pixels: float = 0.005
    """Share by which the width of pixels may differ from their height without being meant to"""
    max_animation_pixels: float = 2.5e8
    """Most pixels of all pictures of an animated WebP together, which is decoded at once"""
    max_aspect: float = 8.0
    """Greatest ratio of a pixel's width to its height, or the other way round, that is believed"""
    rows_at_once: int = 256
    """Rows of a picture that are brought to 8-bit RGB at once, so that little memory is needed besides the
    picture"""
    exposure_pixels: int = 100_000
    """Number of pixels of a picture by which the range of its values is told"""
    darkest: float = 0.1
    brightest: float = 1.5
    """Least and greatest value, `darkest` and `brightest`, between which the bright parts of a linear picture
    lie if its exposure needs no change"""
    kept_bytes: int = 30_000_000
    """Bytes of freed memory that stay the process's own; glibc allows less than 32 MiB"""
    read_ahead_frames: int = 2
    """Frames that are decoded ahead; decoding is steady enough that more gain nothing, and each is a whole
    picture"""
    exif_bytes: int = 1 << 20
    """Bytes at a file's beginning in which EXIF tags are searched"""


MEDIA: Final = MediaSettings()
