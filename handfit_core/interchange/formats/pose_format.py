"""Sign language's .pose files (pose-format): holistic landmarks of whole clips, in binary."""

from __future__ import annotations

import math
import struct
from typing import Final, NamedTuple

import numpy as np

from handfit_core.common.skeleton import NUM_KEYPOINTS, SIDES
from handfit_core.interchange.document import Document
from handfit_core.interchange.point_hands import ParsedHands, ParsedPoints
from handfit_core.interchange.point_reader import PointLayout
from handfit_core.interchange.settings import LIMITS

_VERSIONS: Final = (0.0, 0.1, 0.2)


class _Component(NamedTuple):
    """A part of a body, whose points stand after one another."""

    name: str
    format: str
    """The letters of a point's numbers: X, Y, maybe Z, and C, the confidence"""
    points: list[str]


class _Stream:
    """Little-endian numbers and texts, one after another. Raises struct.error where they end."""

    def __init__(self, data: bytes) -> None:
        self.data, self.at = data, 0

    def numbers(self, layout: str) -> tuple[float, ...]:
        found = struct.unpack_from("<" + layout, self.data, self.at)
        self.at += struct.calcsize("<" + layout)
        return found

    def text(self) -> str:
        (count,) = self.numbers("H")
        return self.numbers(f"{int(count)}s")[0].decode("utf-8")  # type: ignore[attr-defined]


def _header(stream: _Stream) -> tuple[float, tuple[int, int], list[_Component]]:
    """The version, the picture's size, and the components. Raises struct.error and ValueError for what is no
    .pose file."""
    version, width, height, _, count = stream.numbers("f4H")
    if round(version, 3) not in _VERSIONS or not 0 < count <= LIMITS.hands:
        raise ValueError("no .pose file")
    components = []
    for _ in range(int(count)):
        name, letters = stream.text(), stream.text()
        points, limbs, colours = map(int, stream.numbers("3H"))
        components.append(_Component(name, letters, [stream.text() for _ in range(points)]))
        stream.at += 4 * limbs + 6 * colours
        if letters[:2] != "XY" or letters[-1] != "C":
            raise ValueError("no .pose file")
    return round(version, 3), (int(width), int(height)), components


def _is_pose(document: Document) -> bool:
    try:
        return bool(document.bytes) and bool(_header(_Stream(document.bytes)))
    except (struct.error, ValueError):
        return False


def _hands(document: Document) -> ParsedPoints:
    """The hands of all frames and people. Raises ValueError."""
    stream = _Stream(document.bytes)
    try:
        version, size, components = _header(stream)
        if version == 0.0:
            raise ValueError("it is of version 0.0, which is not read; write it anew with pose-format")
        fps, _, people = stream.numbers("fIH" if version > 0.1 else "3H")
    except struct.error as error:
        raise ValueError("it breaks off") from error
    people, width = int(people), max(len(component.format) for component in components) - 1
    count = sum(len(component.points) for component in components)
    # The count of frames of version 0.1 is too short for long clips, so the file's length tells it.
    frames = (len(stream.data) - stream.at) // (4 * max(1, people * count * (width + 1)))
    LIMITS.check(document.path, frames, 2 * people)
    shape = frames, people, count
    numbers = np.frombuffer(stream.data, "<f4", math.prod(shape) * (width + 1), stream.at).astype(np.float64)
    points = np.full((*shape, 4), np.nan)
    points[..., :width] = numbers[: math.prod(shape) * width].reshape(*shape, width)
    points[..., 3] = numbers[math.prod(shape) * width :].reshape(shape)
    told, first = [], 0
    row, person = (each.ravel() for each in np.divmod(np.arange(frames * people), max(1, people)))
    for component in components:
        side = next((i for i, side in enumerate(SIDES) if side in component.name.lower()), None)
        if "hand" in component.name.lower() and side is not None and len(component.points) == NUM_KEYPOINTS:
            mine = points[:, :, first : first + NUM_KEYPOINTS].reshape(-1, NUM_KEYPOINTS, 4)
            mine[mine[..., 3] == 0.0] = np.nan
            told.append((row, np.full(len(row), side), 2 * person + side, mine))
        first += len(component.points)
    if not told:
        raise ValueError(f"of its parts ({', '.join(c.name for c in components)[:200]}) none is a hand's")
    row, side, hand, points = (np.concatenate(each) for each in zip(*told, strict=True))
    hands = ParsedHands.of(row, side, hand, np.full(len(row), np.nan), points)
    return ParsedPoints(np.arange(1, frames + 1), hands, float(fps), size if all(size) else None)


POSE_FORMAT: Final = PointLayout(
    "pose-format",
    "pose-format",
    "sign language's .pose, of MediaPipe's or OpenPose's hands",
    "https://github.com/sign-language-processing/pose/tree/master/docs/specs",
    recognises=_is_pose,
    read=_hands,
    order="mediapipe",
    met="its own samples (2026-11)",
    assumes="sides are those of the person",
)
