"""Skin and nails: plain materials that look like a hand in EEVEE, Cycles and Solid shading."""

from __future__ import annotations

from typing import Any

import bpy

from ..blender_versions import use_nodes

_SKIN = {
    "Base Color": (0.54, 0.28, 0.185, 1.0),
    "Roughness": 0.48,
    "Subsurface Weight": 0.1,
    "Subsurface Radius": (1.0, 0.35, 0.2),
    "Subsurface Scale": 0.004,
    "Specular IOR Level": 0.4,
}
_NAILS = {
    "Base Color": (0.58, 0.335, 0.26, 1.0),
    "Roughness": 0.22,
    "Subsurface Weight": 0.1,
    "Subsurface Radius": (1.0, 0.45, 0.35),
    "Subsurface Scale": 0.002,
}


def hand_materials(nails: bool) -> list[bpy.types.Material]:
    """New materials, skin first; the artist's own of these names are left alone."""
    skin = _material("Hand Skin", _SKIN, (0.80, 0.56, 0.45, 1.0))
    return [skin, _material("Hand Nails", _NAILS, (0.87, 0.66, 0.58, 1.0))] if nails else [skin]


def _material(
    name: str, inputs: dict[str, Any], in_solid: tuple[float, float, float, float]
) -> bpy.types.Material:
    material = bpy.data.materials.new(name)
    material.diffuse_color = in_solid
    shader = next(n for n in use_nodes(material).nodes if n.type == "BSDF_PRINCIPLED")
    for name_of_socket, value in inputs.items():
        socket = shader.inputs.get(name_of_socket)
        if socket is not None:  # their names have changed between Blenders before
            socket.default_value = value
    return material
