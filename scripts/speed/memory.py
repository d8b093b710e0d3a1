"""Whether a long clip takes more memory than a short one. `python -m scripts.speed.memory CLIP` captures one
clip and prints the peaks of its own process as JSON."""

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
from handfit_core.pipeline import Progress, capture

SHORT = 300
LONG = 10_000
SMALL = 320
"""Longer side of the clips, pixels: frames that are thrown away must not hide those that are kept"""
MB = 1_000_000


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
    source: str, lengths: tuple[int, ...] = (SHORT, LONG), on_clip: Callable[[int], None] = lambda _: None
) -> list[Peak]:
    """Repeat an input's frames to clips of these lengths and capture each in a process of its own.

    `on_clip` is called with the number of frames of the clip that comes next. Raises HandfitError.
    """
    peaks: list[Peak] = []
    with tempfile.TemporaryDirectory(prefix="handfit-memory-") as folder:
        for frames in lengths:
            on_clip(frames)
            clip = write_clip(source, Path(folder) / f"{frames}.mp4", frames)
            command = [sys.executable, "-m", "scripts.speed.memory", str(clip)]
            root = Path(__file__).resolve().parents[2]
            done = subprocess.run(command, capture_output=True, text=True, cwd=root, check=False)
            if done.returncode != 0:
                reason = (done.stderr.strip().splitlines() or ["?"])[-1]
                raise InputError(f"capturing a clip of {frames} frames failed: {reason}")
            peaks.append(Peak(frames, **json.loads(done.stdout.splitlines()[-1])))
            clip.unlink()
    return peaks


def write_clip(source: str, path: Path, frames: int, largest: int = SMALL, scale: float = 1.0) -> Path:
    """Write an .mp4 of `frames` frames, with sides of at most `largest` pixels: the first of `source`, there
    and back again, which no tracker loses. Raises HandfitError."""
    import cv2

    media = open_media(source)
    scale = min(scale, largest / max(media.width, media.height))
    # Video codecs want even sides.
    width, height = (max(2, 2 * round(side * scale / 2)) for side in (media.width, media.height))
    with closing(read_ahead(media.frames())) as pictures:
        small = [
            cv2.resize(frame.rgb, (width, height), interpolation=cv2.INTER_AREA)[..., ::-1]
            for frame in islice(pictures, SHORT)
            if frame.rgb is not None
        ]
    if not small:
        raise InputError(f"{source}: no frame could be read from it")
    turning = small + small[-2:0:-1]
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"mp4v"), media.fps, (width, height))
    if not writer.isOpened():
        raise OutputError(f"{path}: OpenCV cannot write an MPEG-4 video here; use a build with FFmpeg")
    for i in range(frames):
        writer.write(turning[i % len(turning)].copy())
    writer.release()
    return path


def peak_memory() -> float:
    """The most resident memory that this process has held so far, in MB (10^6 bytes)."""
    try:
        # Not getrusage: on Linux it starts with the parent's peak.
        with open("/proc/self/status", encoding="ascii", errors="replace") as stream:
            return next(int(line.split()[1]) for line in stream if line.startswith("VmHWM:")) * 1024 / MB
    except OSError:
        import resource  # not on Windows, where the benchmark of memory does not run

        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / MB


def main(clip: str) -> None:
    """Capture the clip in this process."""
    after_detection = 0.0

    def look(progress: Progress) -> None:
        nonlocal after_detection
        if progress.stage == "detect":
            after_detection = peak_memory()

    take = capture(clip, progress=look)
    arrays = [value for hand in take.hands for value in vars(hand).values() if hasattr(value, "nbytes")]
    size = sum(array.nbytes for array in arrays) / MB
    print(json.dumps({"detection": after_detection, "whole": peak_memory(), "take": size}))


if __name__ == "__main__":
    main(sys.argv[1])
