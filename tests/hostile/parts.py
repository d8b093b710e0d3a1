"""Parts of clips: damaged files, lies in the zip, in every array, and in every field of the header."""

from __future__ import annotations

import io
import tempfile
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import numpy as np

from handfit_core.detect.chunks import Chunk
from handfit_core.detect.clips import TrackedHand
from handfit_core.detect.shot_boundary import Thumbnail
from handfit_core.options import CaptureOptions
from handfit_core.parts import Part
from tests.hostile.engine import Case
from tests.hostile.mutations import mutants
from tests.hostile.npz import header_lies, lies
from tests.hostile.takes import FRAMES, good_take

_FIELDS = "format version input fingerprint made_by options options.threshold first ended"
HEADER: list[tuple[str, ...]] = [tuple(field.split(".")) for field in _FIELDS.split(" ")]


@cache
def good_bytes() -> bytes:
    """Two hands in the frames of the first of two chunks."""
    tracks = good_take().hands
    rows = [[track.detection(row) for track in tracks] for row in range(FRAMES)]
    frames = [tuple(hand for hand in row if hand is not None) for row in rows]
    thumbnail = Thumbnail(np.full((18, 24, 3), 99, dtype=np.uint8))
    tracked = [TrackedHand.of(frames[-1][0], 0.5, np.array([1.0, -2.0]))]
    numbers = list(range(1, FRAMES + 1))
    chunks = [
        Chunk(numbers, frames, tracked, [2, 2], [3], thumbnail, thumbnail),
        Chunk([n + FRAMES for n in numbers], [()] * FRAMES, [], [], [], None, None),
    ]
    part = Part(["/nowhere/a.mp4"], "0" * 64, "none", CaptureOptions(), 0, chunks, ended=True)
    with tempfile.TemporaryDirectory() as folder:
        return part.save(Path(folder) / "a.npz").read_bytes()


@cache
def arrays() -> dict[str, np.ndarray]:
    with np.load(io.BytesIO(good_bytes())) as archive:
        return {name: archive[name] for name in archive.files}


def cases() -> Iterator[Case]:
    yield from mutants("part", "core.part", good_bytes, "a.part.npz", 12)
    yield from lies("part", "core.part", arrays, "a.part.npz")
    yield from header_lies("part", "core.part", arrays, "a.part.npz", HEADER)
