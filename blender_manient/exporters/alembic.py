"""Alembic: the baked mesh."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from pathlib import Path
from typing import BinaryIO

import bpy

from handfit_core.errors import OptionError
from handfit_core.files import check_room

from .exporter import Exporter, HandObjects, Preset, blank


class AlembicExporter(Exporter):
    """Alembic: the baked mesh."""

    name = "abc"
    label = "Alembic"
    description = "Baked mesh cache"
    suffix = ".abc"
    bakes = False
    operator = "wm.alembic_export"

    def write(self, path: Path, hands: Sequence[HandObjects], _preset: Preset, _final: Path, /) -> None:
        """Write it where there is room for it."""
        scene = bpy.context.scene
        if not any(hand.meshes for hand in hands):
            raise OptionError("Alembic needs a mesh to hold, and there is none: choose another format")
        # Where the disk is full, Alembic ends Blender.
        check_room(path, _alembic_size([mesh for hand in hands for mesh in hand.meshes]))
        bpy.ops.wm.alembic_export(
            filepath=str(path),
            check_existing=False,
            start=scene.frame_start,
            end=scene.frame_end,
            as_background_job=False,
            uvs=True,
            evaluation_mode="RENDER",
        )
        blank(path, Path(bpy.data.filepath).parent)  # the description names the open file

    def is_whole(self, stream: BinaryIO, size: int, /) -> bool:
        """Ogawa's second field says whether the file was finished; the root, which it points to, ends it."""
        magic, finished, root = struct.unpack("<5sB2xQ", stream.read(16))
        if magic != b"Ogawa" or finished != 0xFF or not 16 <= root < size:
            return False
        stream.seek(root)
        (children,) = struct.unpack("<Q", stream.read(8))
        return root + 8 * (1 + children) == size


def _alembic_size(meshes: Sequence[bpy.types.Object]) -> int:
    """Bytes that the context's scene with these meshes takes at most as Alembic, rather too many."""
    scene = bpy.context.scene
    frames = scene.frame_end - scene.frame_start + 1
    graph = bpy.context.evaluated_depsgraph_get()
    size = 1 << 16
    for obj in meshes:
        shown = obj.evaluated_get(graph)
        mesh = shown.to_mesh()
        points, corners, faces = len(mesh.vertices), len(mesh.loops), len(mesh.polygons)
        layers, smooth = len(mesh.uv_layers), mesh.normals_domain == "POINT"
        shown.to_mesh_clear()
        finer = 4 ** sum(
            max(0, m.render_levels - (m.levels if m.show_viewport else 0))
            for m in obj.modifiers
            if m.type in {"SUBSURF", "MULTIRES"} and m.show_render
        )
        # Every frame has the points and, of what is not all smooth, the corners' normals; the first also the
        # points before any bone moved them, and what the faces are made of.
        each = 12 * points + (0 if smooth else 12 * corners)
        once = 24 * points + (8 + 12 * layers) * corners + 4 * faces
        size += finer * (frames * each + once) + frames * 1024
    return size + size // 4
