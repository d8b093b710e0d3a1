"""Random skins, fabrics and surfaces as Blender materials, from procedural textures only."""

from __future__ import annotations

from typing import Any, Final

import bpy
import numpy as np

from blender_manient.common.blender_versions import use_nodes

from .tint import random_colour

TINT: Final = "tint"
"""The colour attribute that skin is multiplied with"""

_TEXTURES: Final = ("Noise", "Voronoi", "Brick", "Checker", "Wave", "Gradient", "Magic")


def skin(tone: np.ndarray, rng: np.random.Generator) -> bpy.types.Material:
    """Skin of that tone (3,): mottled a little, with fine bumps, lighter and redder where `TINT` says so."""
    material, tree, shader = _principled("skin")
    vector = _node(tree, "TexCoord").outputs["Object"]
    blotches = _texture(tree, "Noise", rng.uniform(18, 45), vector, rng)
    ramp = _ramp(
        tree, blotches, [tone * np.array([0.94, 0.87, 0.84]), tone, tone * np.array([1.05, 1.03, 1.02])]
    )
    tint = _node(tree, "VertexColor")
    tint.layer_name = TINT
    product = _node(tree, "VectorMath", {0: ramp, 1: tint.outputs["Color"]})
    product.operation = "MULTIPLY"
    roughness, specular = rng.uniform(0.45, 0.75), rng.uniform(0.2, 0.45)
    fine = _texture(tree, "Noise", rng.uniform(350, 700), vector, rng)
    bump = _node(tree, "Bump", {"Strength": rng.uniform(0.03, 0.15), "Distance": 0.0008, "Height": fine})
    _set(
        tree,
        shader,
        {
            "Base Color": product.outputs["Vector"],
            "Roughness": roughness,
            "Specular IOR Level": specular,
            "Normal": bump.outputs["Normal"],
        },
    )
    return material


def surface(
    name: str, rng: np.random.Generator, scale: tuple[float, float] = (1.0, 30.0)
) -> bpy.types.Material:
    """Any surface: one texture or two mixed, between random colours; `scale` in features per metre."""
    material, tree, shader = _principled(name)
    vector = _node(tree, "TexCoord").outputs["Object"]
    colour = _coloured_texture(tree, vector, scale, rng)
    if rng.random() < 0.5:
        other = _coloured_texture(tree, vector, scale, rng)
        mask = _texture(tree, "Noise", _log_uniform(scale, rng), vector, rng)
        mix = _node(tree, "Mix", {0: mask})
        mix.data_type = "RGBA"
        for given, socket in zip((colour, other), (s for s in mix.inputs if s.type == "RGBA"), strict=True):
            tree.links.new(given, socket)
        colour = next(s for s in mix.outputs if s.type == "RGBA")
    _set(tree, shader, {"Base Color": colour, "Roughness": rng.uniform(0.25, 1.0)})
    return material


def _coloured_texture(tree, vector, scale: tuple[float, float], rng: np.random.Generator):
    kind = _TEXTURES[rng.integers(len(_TEXTURES))]
    value = _texture(tree, kind, _log_uniform(scale, rng), vector, rng)
    colours = [random_colour(rng) for _ in range(int(rng.integers(2, 5)))]
    return _ramp(tree, value, colours)


def _log_uniform(ends: tuple[float, float], rng: np.random.Generator) -> float:
    return float(np.exp(rng.uniform(*np.log(ends))))


def _principled(name: str):
    material = bpy.data.materials.new(name)
    tree = use_nodes(material)
    return material, tree, next(n for n in tree.nodes if n.type == "BSDF_PRINCIPLED")


def _node(tree, kind: str, inputs: dict[str | int, Any] | None = None):
    node = tree.nodes.new(f"ShaderNode{kind}")
    _set(tree, node, inputs or {})
    return node


def _set(tree, node, inputs: dict[str | int, Any]) -> None:
    """Link inputs with sockets, or set their values."""
    for name, value in inputs.items():
        if isinstance(value, bpy.types.NodeSocket):
            tree.links.new(value, node.inputs[name])
        else:
            node.inputs[name].default_value = value


def _texture(tree, kind: str, scale: float, vector, rng: np.random.Generator):
    """A texture's first output; turned, moved and scaled at random."""
    moved = {"Location": rng.uniform(-5, 5, 3), "Rotation": rng.uniform(-3.1, 3.1, 3), "Scale": (scale,) * 3}
    mapping = _node(tree, "Mapping", {**moved, "Vector": vector})
    node = _node(tree, f"Tex{kind}", {"Vector": mapping.outputs["Vector"]})
    looks = {"Scale": 1.0, "Detail": rng.uniform(0, 2.5), "Distortion": rng.uniform(0, 2.5)}
    _set(tree, node, {name: value for name, value in looks.items() if name in node.inputs})
    return node.outputs[0]


def _ramp(tree, value, colours: list[np.ndarray]):
    node = _node(tree, "ValToRGB", {0: value})
    elements = node.color_ramp.elements
    places = np.linspace(0.2, 0.8, len(colours))
    while len(elements) < len(colours):
        elements.new(0.5)
    for element, place, colour in zip(elements, places.tolist(), colours, strict=True):
        element.position = place
        element.color = (*colour.tolist(), 1.0)
    return node.outputs["Color"]
