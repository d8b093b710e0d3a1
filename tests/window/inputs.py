"""What the scenarios are given to capture and to build."""

from __future__ import annotations

import subprocess
from pathlib import Path

import numpy as np

from handfit_core.geometry.camera import Intrinsics
from handfit_core.media.source import Source
from handfit_core.skeleton import SIDES
from tests.takes import take_of, track_of

RENDERED_HAND = Path(__file__).resolve().parents[2] / "samples" / "rendered_hand"


def write_clip(python: str, path: Path, frames: int, blank_from: int | None = None) -> None:
    """A video of the bundled hand, to and fro; its frames from `blank_from` on show nothing. `python` has
    OpenCV."""
    blank = frames if blank_from is None else blank_from
    arguments = [str(RENDERED_HAND), str(path), str(frames), str(blank)]
    subprocess.run([python, "-c", _WRITE_CLIP, *arguments], check=True, timeout=120)


def write_long_take(path: Path, frames: int) -> Path:
    """Two hands, as a take file: again and again the same hundred frames. `frames`: hundreds."""
    t = np.linspace(0.0, 2 * np.pi, 100)
    camera = Intrinsics.assumed(1280, 720)
    tracks = []

    def again(values: np.ndarray) -> np.ndarray:
        return np.concatenate([values] * (frames // len(t)))

    for side in SIDES:
        orient = np.stack([0.3 * np.sin(t), 0.2 * np.cos(t), t * 0], axis=-1)
        bend = 0.4 + 0.4 * np.sin(t)
        pose = np.tile([0.0, 0.0, 1.0 if side == "right" else -1.0], 15) * bend[:, None]
        transl = np.stack([0.1 * np.sin(t), 0.1 * np.cos(t), 0.6 + 0 * t], axis=-1)
        tracks.append(track_of(side, again(orient), again(pose), again(transl), camera))
    take = take_of(tracks, camera, 1280, 720, source=Source("video", ("gone.mp4",)))
    return take.save(path)


_WRITE_CLIP = """
import pathlib, sys
import cv2, numpy as np
folder, output, frames, blank = sys.argv[1], sys.argv[2], int(sys.argv[3]), int(sys.argv[4])
pictures = [cv2.imread(str(p)) for p in sorted(pathlib.Path(folder).glob("*.jpg"))]
pictures += pictures[-2:0:-1]
height, width = pictures[0].shape[:2]
writer = cv2.VideoWriter(output, cv2.VideoWriter_fourcc(*"mp4v"), 25.0, (width, height))
for i in range(frames):
    writer.write(pictures[i % len(pictures)] if i < blank else np.full_like(pictures[0], 90))
writer.release()
"""
