"""Sign language's .pose files (pose-format): holistic landmarks of whole clips, in binary."""

from __future__ import annotations

import math
import struct
from typing import Final, NamedTuple

import numpy as np

from handfit_core.common.skeleton import NUM_KEYPOINTS
from handfit_core.interchange.document import Document
from handfit_core.interchange.frames import Frames
from handfit_core.interchange.point_reader import PointLayout
from handfit_core.interchange.settings import LIMITS

_VERSIONS: Final = (0.0, 0.1, 0.2)


class _Component(NamedTuple):
    """A part of a body, such as a hand, whose points stand after one another in the file."""

    name: str
    format: str
    """The letters of a point's numbers in their order: X, Y, maybe Z, and C, the confidence"""
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
    """Read the version, the picture's size (width, height) in pixels, and the components. Raises struct.error
    and ValueError for what is no .pose file."""
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


def _frames(document: Document) -> Frames:
    """Read the hands of all people in each frame. Raises ValueError."""
    stream = _Stream(document.bytes)
    try:
        version, size, components = _header(stream)
        if version == 0.0:
            raise ValueError("it is of version 0.0, which is not read; write it anew with pose-format")
        fps, told, people = stream.numbers("fIH" if version > 0.1 else "3H")
    except struct.error as error:
        raise ValueError("it breaks off") from error
    people, width = max(1, int(people)), max(len(each.format) for each in components) - 1
    count = sum(len(component.points) for component in components)
    frames, rest = divmod(len(stream.data) - stream.at, 4 * people * count * (width + 1) or 1)
    # Version 0.1 counts frames in two bytes.
    if rest or frames % (1 << 16 if version < 0.2 else 1 << 32) != told:
        raise ValueError(f"it breaks off: of {int(told)} frames it has {frames}")
    LIMITS.check(document.path, frames, 2 * people)
    shape = frames, people, count
    numbers = np.frombuffer(stream.data, "<f4", math.prod(shape) * (width + 1), stream.at).astype(np.float64)
    places, sure = np.split(np.nan_to_num(numbers), [math.prod(shape) * width])
    points = np.concatenate([places.reshape(*shape, width), sure.reshape(*shape, 1)], axis=-1)
    ends = np.cumsum([len(component.points) for component in components])
    hands = {
        component.name.lower(): points[:, :, end - NUM_KEYPOINTS : end]
        for component, end in zip(components, ends, strict=True)
        if len(component.points) == NUM_KEYPOINTS and "hand" in component.name.lower()
    }
    if not hands or not frames:
        parts = ", ".join(component.name for component in components)
        raise ValueError(f"it has no frame, or none of its parts ({parts[:200]}) is a hand's")
    contents = [
        {
            "people": [
                {name: of[t, p].tolist() for name, of in hands.items() if of[t, p, :, -1].any()}
                for p in range(people)
            ]
        }
        for t in range(frames)
    ]
    header = {"fps": float(fps), "width": size[0], "height": size[1]}
    return Frames(np.arange(1, frames + 1), contents, header)


POSE_FORMAT: Final = PointLayout(
    "pose-format",
    "pose-format",
    "sign language's .pose, of MediaPipe's or OpenPose's hands",
    "https://github.com/sign-language-processing/pose/tree/master/docs/specs",
    recognises=_is_pose,
    read=_frames,
    columns="xyc xyzc",
    people="people",
    order="mediapipe",
    persons="told",
    met="its own samples (2026-11)",
    assumes="sides are the person's",
)
