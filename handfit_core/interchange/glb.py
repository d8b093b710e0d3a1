"""Binary glTF 2.0 with nodes and animations, as its specification lays it out."""

from __future__ import annotations

import json
import struct
from typing import Any

import numpy as np

from handfit_core.version import __version__


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
        """Add numbers (N,), (N, 3) or (N, 4), stored with 32 bits; returns the accessor's number."""
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
        """The file."""
        content = {**self.json, "buffers": [{"byteLength": len(self._buffer)}]}
        text = json.dumps(content, separators=(",", ":")).encode()
        text += b" " * (-len(text) % 4)
        chunks = struct.pack("<I4s", len(text), b"JSON") + text
        chunks += struct.pack("<I4s", len(self._buffer), b"BIN\0") + bytes(self._buffer)
        return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks
