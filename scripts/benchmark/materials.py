"""Random skins, fabrics and surfaces as Blender materials, from procedural textures only."""

from __future__ import annotations

from typing import Final

import bpy
import numpy as np

from blender_manient.blender_versions import use_nodes

_TONES: Final = np.array(
    [
        (0.045, 0.022, 0.013),
        (0.11, 0.05, 0.028),
        (0.24, 0.115, 0.062),
        (0.42, 0.22, 0.13),
        (0.60, 0.36, 0.24),
        (0.74, 0.49, 0.37),
    ]
)
"""Skin from dark to light, linear RGB"""

TINT: Final = "tint"
"""The colour attribute that skin is multiplied with"""

_TEXTURES: Final = ("Noise", "Voronoi", "Brick", "Checker", "Wave", "Gradient", "Magic")


def skin_tone(rng: np.random.Generator) -> np.ndarray:
    """(3,) linear RGB, as often dark as light."""
    place = rng.uniform(0, len(_TONES) - 1)
    below = int(place)
    tone = _TONES[below] + (place - below) * (_TONES[min(below + 1, len(_TONES) - 1)] - _TONES[below])
    return np.clip(tone * rng.normal(1.0, [0.04, 0.06, 0.08]), 0.01, 0.9)


def skin(tone: np.ndarray, rng: np.random.Generator) -> bpy.types.Material:
    """Skin of that tone (3,): mottled a little, with fine bumps, lighter and redder where `TINT` says so."""
    material, tree, shader = _principled("skin")
    coordinates = tree.nodes.new("ShaderNodeTexCoord")
    blotches = _texture(tree, "Noise", rng.uniform(18, 45), coordinates.outputs["Object"], rng)
    ramp = _ramp(
        tree, blotches, [tone * np.array([0.94, 0.87, 0.84]), tone, tone * np.array([1.05, 1.03, 1.02])]
    )
    tint = tree.nodes.new("ShaderNodeVertexColor")
    tint.layer_name = TINT
    product = tree.nodes.new("ShaderNodeVectorMath")
    product.operation = "MULTIPLY"
    tree.links.new(ramp, product.inputs[0])
    tree.links.new(tint.outputs["Color"], product.inputs[1])
    tree.links.new(product.outputs["Vector"], shader.inputs["Base Color"])
    shader.inputs["Roughness"].default_value = rng.uniform(0.45, 0.75)
    shader.inputs["Specular IOR Level"].default_value = rng.uniform(0.2, 0.45)
    fine = _texture(tree, "Noise", rng.uniform(350, 700), coordinates.outputs["Object"], rng)
    bump = tree.nodes.new("ShaderNodeBump")
    bump.inputs["Strength"].default_value = rng.uniform(0.03, 0.15)
    bump.inputs["Distance"].default_value = 0.0008
    tree.links.new(fine, bump.inputs["Height"])
    tree.links.new(bump.outputs["Normal"], shader.inputs["Normal"])
    return material


def surface(
    name: str, rng: np.random.Generator, scale: tuple[float, float] = (1.0, 30.0)
) -> bpy.types.Material:
    """Any surface: one texture or two mixed, between random colours; `scale` in features per metre."""
    material, tree, shader = _principled(name)
    vector = tree.nodes.new("ShaderNodeTexCoord").outputs["Object"]
    colour = _coloured_texture(tree, vector, scale, rng)
    if rng.random() < 0.5:
        other = _coloured_texture(tree, vector, scale, rng)
        mask = _texture(tree, "Noise", _log_uniform(scale, rng), vector, rng)
        mix = tree.nodes.new("ShaderNodeMix")
        mix.data_type = "RGBA"
        inputs = [s for s in mix.inputs if s.type == "RGBA"]
        tree.links.new(mask, mix.inputs[0])
        tree.links.new(colour, inputs[0])
        tree.links.new(other, inputs[1])
        colour = next(s for s in mix.outputs if s.type == "RGBA")
    tree.links.new(colour, shader.inputs["Base Color"])
    shader.inputs["Roughness"].default_value = rng.uniform(0.25, 1.0)
    return material


def random_colour(rng: np.random.Generator) -> np.ndarray:
    """(3,) linear RGB of things: greys as often as colours."""
    value = rng.uniform(0.02, 0.75)
    return np.clip(value * (1 + rng.uniform(0.0, 0.9) * rng.uniform(-1, 1, 3)), 0.01, 0.85)


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


def _texture(tree, kind: str, scale: float, vector, rng: np.random.Generator):
    """A texture's first output; turned, moved and scaled at random."""
    mapping = tree.nodes.new("ShaderNodeMapping")
    mapping.inputs["Location"].default_value = rng.uniform(-5, 5, 3)
    mapping.inputs["Rotation"].default_value = rng.uniform(-3.1, 3.1, 3)
    mapping.inputs["Scale"].default_value = (scale, scale, scale)
    tree.links.new(vector, mapping.inputs["Vector"])
    node = tree.nodes.new(f"ShaderNodeTex{kind}")
    for name, value in (("Scale", 1.0), ("Detail", rng.uniform(0, 2.5)), ("Distortion", rng.uniform(0, 2.5))):
        socket = node.inputs.get(name)
        if socket is not None:
            socket.default_value = value
    tree.links.new(mapping.outputs["Vector"], node.inputs["Vector"])
    return node.outputs[0]


def _ramp(tree, value, colours: list[np.ndarray]):
    node = tree.nodes.new("ShaderNodeValToRGB")
    elements = node.color_ramp.elements
    places = np.linspace(0.2, 0.8, len(colours))
    while len(elements) < len(colours):
        elements.new(0.5)
    for element, place, colour in zip(elements, places.tolist(), colours, strict=True):
        element.position = place
        element.color = (*colour.tolist(), 1.0)
    tree.links.new(value, node.inputs[0])
    return node.outputs["Color"]
