"""The hand's mesh: faces, texture coordinates and vertex groups; shape keys that fill out bent
joints, for models with pose blend shapes; skin and nails as plain materials that look
like a hand in EEVEE, Cycles and Solid shading."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import bpy
import numpy as np

from handfit_core.hand_model import HandModel, ShapedHand, axes
from handfit_core.hand_model.forearm import forearm_share
from handfit_core.hand_model.nails import nail_polygons

from ..common.blender_versions import use_nodes
from ..rigs.arm import skin_bone
from ..rigs.rig import Rig

_LEAST_WEIGHT = 1e-6
"""The least weight that is kept: lower ones move nothing visibly; they would only make every export larger"""
IN_RENDERS = "Round in Renders"
"""Name of the modifier that subdivides the mesh where it is rendered: bent joints and the thumb's root show
edges"""
_ALONE = 1e-3
"""The wrist's weight on skin that follows the forearm, which moves it once the artist has deleted the arm"""
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


def build_mesh(name: str, model: HandModel, shaped: ShapedHand, rig: Rig) -> bpy.types.Object:
    """Build a smooth-shaded mesh object of the shaped hand that hangs on the rig, with a vertex group per
    bone.

    It is not linked to any collection.
    """
    mesh = bpy.data.meshes.new(name)
    polygons = model.polygons
    mesh.from_pydata(axes.points_to_rest(shaped.vertices).tolist(), [], polygons.tolist())
    mesh.polygons.foreach_set("use_smooth", np.ones(len(polygons), dtype=bool))
    uv, uv_faces = _texture_coordinates(model)
    mesh.uv_layers.new(name="UVMap").data.foreach_set("uv", uv[uv_faces].astype(np.float32).ravel())
    nails = nail_polygons(model)
    # New ones: the artist's own of these names are left alone.
    mesh.materials.append(_material("Hand Skin", _SKIN, (0.80, 0.56, 0.45, 1.0)))
    if nails.any():
        mesh.materials.append(_material("Hand Nails", _NAILS, (0.87, 0.66, 0.58, 1.0)))
    mesh.polygons.foreach_set("material_index", nails.astype(np.int32))
    mesh.update()

    obj = bpy.data.objects.new(name, mesh)
    for bone, weights in zip(rig.bones, model.weights.T, strict=True):
        group = obj.vertex_groups.new(name=bone)
        for vertex in np.flatnonzero(weights > _LEAST_WEIGHT).tolist():
            group.add([vertex], float(weights[vertex]), "REPLACE")
    obj.parent = rig.armature
    obj.modifiers.new("Armature", "ARMATURE").object = rig.armature
    rounded: Any = obj.modifiers.new(IN_RENDERS, "SUBSURF")
    rounded.levels, rounded.render_levels = 0, 2
    return obj


def follow_arm(mesh: bpy.types.Object, model: HandModel, armature: bpy.types.Object) -> None:
    """Have the skin behind the wrist follow the arm, where the armature has one and the mesh is the model's.

    What the bone takes is added to the wrist's own weight, so that without the bone all follows the wrist.
    """
    bone = skin_bone(armature)
    if bone is None or len(mesh.data.vertices) != len(model.v_template):
        return
    group = mesh.vertex_groups.get(bone.name) or mesh.vertex_groups.new(name=bone.name)
    wrist = mesh.vertex_groups.get(bone.parent.name)
    share = forearm_share(model)
    group.remove(range(len(share)))
    for vertex in np.flatnonzero(share > _LEAST_WEIGHT).tolist():
        group.add([vertex], float(share[vertex]), "REPLACE")
        wrist.add([vertex], max(float(model.weights[vertex, 0] - share[vertex]), _ALONE), "REPLACE")


def _texture_coordinates(model: HandModel) -> tuple[np.ndarray, np.ndarray]:
    """Return texture coordinates (U, 2) and, per polygon corner, the index into them.

    For models without them the palm is flattened into the left half, the back of the hand into the right."""
    if model.uv is not None and model.uv_faces is not None:
        return model.uv, model.uv_faces
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


def corrective_names(rig: Rig) -> list[list[str]]:
    """Return (15, 9) names of the shape keys of `axes.corrective_offsets`: a bone's name and a product of two
    components of its quaternion, as in `index_proximal.R wx`."""
    products = [product.replace("*", "") for product in axes.QUATERNION_PRODUCTS]
    return [[f"{bone} {product}" for product in products] for bone in rig.bones[1:]]


def adding_correctives(mesh: bpy.types.Object, rig: Rig, offsets: np.ndarray) -> Iterator[int]:
    """Give the mesh up to 135 shape keys, each driven by one product of one bone's quaternion.

    With them the evaluated mesh is the model's (`HandModel.posed`), under any pose that is set on the
    bones. `offsets`: `axes.corrective_offsets` (15, 9, V, 3). Yields how many keys each step made: 1, or 0
    for a product that moves hardly anything. Blender calls the drivers simple expressions: it evaluates them
    itself, so they work with scripts disabled.
    """
    basis = np.empty((len(mesh.data.vertices), 3), dtype=np.float32)
    mesh.data.vertices.foreach_get("co", basis.ravel())
    mesh.shape_key_add(name="Basis", from_mix=False)
    for bone, names, of_joint in zip(rig.bones[1:], corrective_names(rig), offsets, strict=True):
        for name, product, offset in zip(names, axes.QUATERNION_PRODUCTS, of_joint, strict=True):
            if not offset.any():
                yield 0
                continue
            key = mesh.shape_key_add(name=name, from_mix=False)
            key.data.foreach_set("co", (basis + offset).astype(np.float32).ravel())
            key.slider_min, key.slider_max = -1.0, 1.0
            _drive(key, product, rig.armature, bone)
            yield 1


def _drive(key: bpy.types.ShapeKey, expression: str, armature: bpy.types.Object, bone: str) -> None:
    driver = key.driver_add("value").driver
    driver.type = "SCRIPTED"
    for name in "wxyz":
        if name not in expression:
            continue
        variable = driver.variables.new()
        variable.name = name
        variable.type = "TRANSFORMS"
        target = variable.targets[0]
        target.id = armature
        target.bone_target = bone
        target.transform_type = f"ROT_{name.upper()}"
        target.rotation_mode = "QUATERNION"
        target.transform_space = "LOCAL_SPACE"
    driver.expression = expression
