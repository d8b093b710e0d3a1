"""Reads what an FBX file says about itself: Autodesk's binary container, version 7.x."""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

_NUMBERS = {b"Y": "<h", b"C": "<?", b"I": "<i", b"F": "<f", b"D": "<d", b"L": "<q"}
_ARRAYS = {b"f": "<f4", b"d": "<f8", b"l": "<i8", b"i": "<i4", b"b": "?"}


@dataclass
class Node:
    """One record: its values and the records in it."""

    name: str
    values: list[Any]
    children: list[Node] = field(default_factory=list)

    def all(self, name: str) -> list[Node]:
        return [child for child in self.children if child.name == name]

    def first(self, name: str) -> Node:
        return self.all(name)[0]

    def properties(self) -> dict[str, Any]:
        """Properties70: name -> value, or a tuple of three."""
        found = {}
        for block in self.all("Properties70"):
            for entry in block.all("P"):
                rest = entry.values[4:]
                found[entry.values[0]] = rest[0] if len(rest) == 1 else tuple(rest)
        return found


def read_fbx(path: Path) -> Node:
    data = path.read_bytes()
    assert data.startswith(b"Kaydara FBX Binary  \x00")
    (version,) = struct.unpack_from("<I", data, 23)
    wide = version >= 7500
    root, at = Node("", []), 27
    while True:
        node, at = _record(data, at, wide)
        if node is None:
            return root
        root.children.append(node)


def _record(data: bytes, at: int, wide: bool) -> tuple[Node | None, int]:
    head = "<QQQB" if wide else "<IIIB"
    end, count, _, length = struct.unpack_from(head, data, at)
    at += struct.calcsize(head)
    if end == 0:
        return None, at
    node = Node(data[at : at + length].decode(), [])
    at += length
    for _ in range(count):
        value, at = _value(data, at)
        node.values.append(value)
    while at < end:
        child, at = _record(data, at, wide)
        if child is None:
            break
        node.children.append(child)
    return node, end


def _value(data: bytes, at: int) -> tuple[Any, int]:
    kind, at = data[at : at + 1], at + 1
    if kind in _NUMBERS:
        size = struct.calcsize(_NUMBERS[kind])
        return struct.unpack_from(_NUMBERS[kind], data, at)[0], at + size
    if kind in b"SR":
        (size,) = struct.unpack_from("<I", data, at)
        raw = data[at + 4 : at + 4 + size]
        return raw.decode(errors="replace") if kind == b"S" else raw, at + 4 + size
    count, packed, size = struct.unpack_from("<III", data, at)
    raw = data[at + 12 : at + 12 + size]
    values = np.frombuffer(zlib.decompress(raw) if packed else raw, dtype=_ARRAYS[kind])
    assert len(values) == count
    return values, at + 12 + size
