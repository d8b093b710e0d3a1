"""The hand's mesh: faces, texture coordinates, vertex groups and skin."""

from __future__ import annotations

import bpy
import numpy as np

from handfit_core.hand_model import HandModel, ShapedHand, axes
from handfit_core.hand_model.nails import nail_polygons

from ..rigs.rig import Rig
from .materials import hand_materials

_LEAST_WEIGHT = 1e-6
"""Weights below this move nothing visibly; they would only make every export larger"""


def build_mesh(name: str, model: HandModel, shaped: ShapedHand, rig: Rig) -> bpy.types.Object:
    """A smooth-shaded mesh object of the shaped hand in rest space, with a vertex group per bone of the rig.

    It is not linked to any collection and has no modifier yet.
    """
    mesh = bpy.data.meshes.new(name)
    polygons = model.polygons
    mesh.from_pydata(axes.points_to_rest(shaped.vertices).tolist(), [], polygons.tolist())
    mesh.polygons.foreach_set("use_smooth", np.ones(len(polygons), dtype=bool))
    _set_uvs(mesh, *_texture_coordinates(model))
    nails = nail_polygons(model)
    for material in hand_materials(nails=bool(nails.any())):
        mesh.materials.append(material)
    mesh.polygons.foreach_set("material_index", nails.astype(np.int32))
    mesh.update()

    obj = bpy.data.objects.new(name, mesh)
    for bone, weights in zip(rig.bones, model.weights.T, strict=True):
        group = obj.vertex_groups.new(name=bone)
        for vertex in np.flatnonzero(weights > _LEAST_WEIGHT).tolist():
            group.add([vertex], float(weights[vertex]), "REPLACE")
    return obj


def _texture_coordinates(model: HandModel) -> tuple[np.ndarray, np.ndarray]:
    """UVs (U, 2) and, per polygon corner, the index into them."""
    if model.uv is not None and model.uv_faces is not None:
        return model.uv, model.uv_faces
    return _palm_and_back(model)


def _palm_and_back(model: HandModel) -> tuple[np.ndarray, np.ndarray]:
    """For models without UVs: the palm flattened into the left half, the back into the right."""
    flat = model.v_template[:, [0, 2]]
    low, high = flat.min(axis=0), flat.max(axis=0)
    size = (high - low).max()
    square = (flat - low) / size * 0.98 + 0.01  # (V, 2) within the unit square
    half = square * np.array([0.5, 1.0])
    uv = np.concatenate([half, half + np.array([0.5, 0.0])])

    corners = model.v_template[model.polygons]  # (P, 3 or 4, 3)
    normal_y = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])[:, 1]
    is_back = normal_y > 0
    return uv, model.polygons + np.where(is_back, len(flat), 0)[:, None]


def _set_uvs(mesh: bpy.types.Mesh, uv: np.ndarray, uv_faces: np.ndarray) -> None:
    layer = mesh.uv_layers.new(name="UVMap")
    layer.data.foreach_set("uv", uv[uv_faces].astype(np.float32).ravel())
