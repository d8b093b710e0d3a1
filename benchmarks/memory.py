"""Whether a long clip takes more memory than a short one."""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

from handfit_core.errors import InputError, OutputError
from handfit_core.media.opening import open_media
from handfit_core.media.read_ahead import read_ahead

SHORT = 300
LONG = 10_000
SMALL = 320
"""Longer side of the clips, pixels: frames that are thrown away must not hide those that are kept"""

MOST_MORE_MB = 200.0
"""What the long clip may take more"""


@dataclass(frozen=True)
class Peak:
    """The most memory that one run held at a time, in MB (10^6 bytes) of resident memory."""

    frames: int
    detection: float
    """until the last frame's detection"""
    whole: float
    """until the take"""
    take: float
    """the take's own arrays"""


def measure_memory(
    source: str,
    lengths: tuple[int, ...] = (SHORT, LONG),
    *,
    solver: str = "fast",
    on_clip: Callable[[int], None] = lambda _: None,
) -> list[Peak]:
    """Repeat an input's frames to clips of these lengths and capture each in a process of its own.

    `on_clip` is called with the number of frames of the clip that comes next. Raises HandfitError.
    """
    peaks: list[Peak] = []
    with tempfile.TemporaryDirectory(prefix="handfit-memory-") as folder:
        for frames in lengths:
            on_clip(frames)
            clip = write_clip(source, Path(folder) / f"{frames}.mp4", frames)
            peaks.append(_peak_of(clip, frames, solver))
            clip.unlink()
    return peaks


def write_clip(source: str, path: Path, frames: int) -> Path:
    """Write a small .mp4 of `frames` frames: the first of `source`, there and back again, which no
    tracker loses. Raises HandfitError."""
    import cv2

    media = open_media(source)
    size = _small(media.width, media.height)
    with closing(read_ahead(media.frames())) as pictures:
        small = [
            cv2.cvtColor(cv2.resize(frame.rgb, size, interpolation=cv2.INTER_AREA), cv2.COLOR_RGB2BGR)
            for frame in islice(pictures, SHORT)
            if frame.rgb is not None
        ]
    if not small:
        raise InputError(f"{source}: no frame could be read from it")
    turning = small + small[-2:0:-1]
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"mp4v"), media.fps, size)
    if not writer.isOpened():
        raise OutputError(f"{path}: OpenCV cannot write an MPEG-4 video here; use a build with FFmpeg")
    for i in range(frames):
        writer.write(turning[i % len(turning)])
    writer.release()
    return path


def _small(width: int, height: int) -> tuple[int, int]:
    """Even sides, as video codecs want them."""
    scale = min(1.0, SMALL / max(width, height))
    return max(2, 2 * round(width * scale / 2)), max(2, 2 * round(height * scale / 2))


def _peak_of(clip: Path, frames: int, solver: str) -> Peak:
    done = subprocess.run(
        [sys.executable, "-m", "benchmarks.memory_child", str(clip), solver],
        capture_output=True,
        text=True,
        cwd=Path(__file__).resolve().parent.parent,
        check=False,
    )
    if done.returncode != 0:
        raise InputError(
            f"capturing a clip of {frames} frames failed: {(done.stderr.strip().splitlines() or ['?'])[-1]}"
        )
    return Peak(frames=frames, **json.loads(done.stdout.splitlines()[-1]))
