"""What an FBX file says about itself, read with the parser of Blender's own importer."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import bpy  # noqa: F401  (Blender's add-ons can be imported once it is)
from io_scene_fbx import parse_fbx


@dataclass
class Node:
    """One record: its values and the records in it."""

    name: str
    values: list[Any]
    children: list[Node]

    def all(self, name: str) -> list[Node]:
        return [child for child in self.children if child.name == name]

    def first(self, name: str) -> Node:
        return self.all(name)[0]

    def properties(self) -> dict[str, Any]:
        """Properties70: name -> value, or a tuple of three."""
        entries = [entry.values for block in self.all("Properties70") for entry in block.all("P")]
        return {name: rest[0] if len(rest) == 1 else tuple(rest) for name, _, _, _, *rest in entries}


def read_fbx(path: Path) -> Node:
    """The whole file as one record."""
    return _node(parse_fbx.parse(str(path), use_namedtuple=True)[0])


def models_of(path: Path) -> dict[str, tuple[str, dict[str, Any]]]:
    """Name -> (kind, properties) of the file's objects and bones."""
    nodes = read_fbx(path).first("Objects").all("Model")
    return {node.values[1].split("\x00")[0]: (node.values[2], node.properties()) for node in nodes}


def _node(record: Any) -> Node:
    values = [v.decode(errors="replace") if isinstance(v, bytes) else v for v in record.props]
    return Node(record.id.decode(), values, [_node(child) for child in record.elems])
