"""VRM animation 1.0 (.vrma): binary glTF 2.0 with a humanoid in VRM's T-pose and its hands' animation."""

from __future__ import annotations

import json
import struct
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from handfit_core.common.version import __version__
from handfit_core.interchange.humanoid import HumanoidHand, hands_of, humanoid_bones
from handfit_core.interchange.writers import Writer
from handfit_core.take import Take

_EXTENSION: Final = "VRMC_vrm_animation"


class GlbContent:
    """A glTF file that is being put together: `json` may be added to until `to_bytes`."""

    def __init__(self) -> None:
        self.json: dict[str, Any] = {
            "asset": {"version": "2.0", "generator": f"Manient {__version__}"},
            "accessors": [],
            "bufferViews": [],
        }
        self._buffer = bytearray()

    def accessor(self, values: np.ndarray) -> int:
        """Add numbers (N,), (N, 3) or (N, 4), stored as 32-bit floats; returns the accessor's number."""
        values = np.ascontiguousarray(values, dtype="<f4")
        kind = "SCALAR" if values.ndim == 1 else f"VEC{values.shape[1]}"
        columns = values.reshape(len(values), -1)
        view = {"buffer": 0, "byteOffset": len(self._buffer), "byteLength": values.nbytes}
        self._buffer += values.tobytes()  # a multiple of four bytes, as all of it is
        self.json["bufferViews"].append(view)
        self.json["accessors"].append(
            {
                "bufferView": len(self.json["bufferViews"]) - 1,
                "componentType": 5126,
                "count": len(values),
                "type": kind,
                "min": columns.min(axis=0).tolist(),
                "max": columns.max(axis=0).tolist(),
            }
        )
        return len(self.json["accessors"]) - 1

    def to_bytes(self) -> bytes:
        """Return the bytes of the whole file."""
        content = {**self.json, "buffers": [{"byteLength": len(self._buffer)}]}
        text = json.dumps(content, separators=(",", ":")).encode()
        text += b" " * (-len(text) % 4)
        chunks = struct.pack("<I4s", len(text), b"JSON") + text
        chunks += struct.pack("<I4s", len(self._buffer), b"BIN\0") + bytes(self._buffer)
        return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


def vrm_animation(hands: Sequence[HumanoidHand]) -> bytes:
    """Return the bytes of a .vrma file with hands of different sides. All bones that are animated are there
    as nodes, and the body's; the times are the hands' own, and between them bones turn evenly."""
    bones = humanoid_bones({hand.side: hand.heads for hand in hands})
    numbers = {name: number for number, name in enumerate(bones)}
    nodes: list[dict[str, Any]] = []
    for name, (parent, place) in bones.items():
        offset = place - bones[parent][1] if parent else place
        nodes.append({"name": name, "translation": offset.tolist()})
        children = [numbers[other] for other, (above, _) in bones.items() if above == name]
        if children:  # an empty list is no glTF
            nodes[-1]["children"] = children
    content = GlbContent()
    samplers, tracks = [], []
    for hand in hands:
        times = content.accessor(hand.times)
        for name, quats in hand.quats.items():
            turned = content.accessor(np.roll(quats, -1, axis=1))  # glTF has (x, y, z, w)
            tracks.append({"sampler": len(samplers), "target": {"node": numbers[name], "path": "rotation"}})
            samplers.append({"input": times, "output": turned, "interpolation": "LINEAR"})
    humanoid = {"humanBones": {name: {"node": number} for name, number in numbers.items()}}
    content.json |= {
        "extensionsUsed": [_EXTENSION],
        "scene": 0,
        "scenes": [{"nodes": [numbers["hips"]]}],
        "nodes": nodes,
        "animations": [{"name": "hands", "channels": tracks, "samplers": samplers}],
        "extensions": {_EXTENSION: {"specVersion": "1.0", "humanoid": humanoid}},
    }
    return content.to_bytes()


WRITER = Writer(
    "VRM animation",
    (".vrma",),
    lambda take, path: _write(take, path, wrist=False),
    lambda take, path: _write(take, path, wrist=True),
)


def _write(take: Take, path: Path, *, wrist: bool) -> None:
    path.write_bytes(vrm_animation(hands_of(take, wrist=wrist)))
