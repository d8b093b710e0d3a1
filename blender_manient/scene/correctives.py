"""Shape keys that fill out bent joints, for models with pose blend shapes (MANO)."""

from __future__ import annotations

from collections.abc import Iterator

import bpy
import numpy as np

from handfit_core.hand_model import HandModel, axes
from handfit_core.skeleton import NUM_JOINTS

from ..rigs.rig import Rig

_LEAST_OFFSET = 1e-6
"""metres. A key that moves no vertex by more, at a full turn, is left out"""

_ELEMENTS = (
    ((-1, "2*(y*y+z*z)"), (1, "2*(x*y-w*z)"), (1, "2*(x*z+w*y)")),
    ((1, "2*(x*y+w*z)"), (-1, "2*(x*x+z*z)"), (-1, "2*(w*x-y*z)")),
    ((1, "2*(x*z-w*y)"), (1, "2*(y*z+w*x)"), (-1, "2*(x*x+y*y)")),
)
"""R - I of a unit quaternion (w, x, y, z) as sign times expression, element by element.

The signs make every value that bending towards the palm gives positive, because some programs clamp
shape keys to 0..1. Blender calls these simple expressions: it evaluates them itself, so they work
with scripts disabled."""


def add_correctives(mesh: bpy.types.Object, rig: Rig, model: HandModel) -> int:
    """Give the mesh up to 135 shape keys, each driven by one element of one bone's rotation.

    With them the evaluated mesh is exactly the model's (`HandModel.posed`), under any pose that is
    set on the bones. Returns how many keys were made.
    """
    return sum(adding_correctives(mesh, rig, axes.corrective_offsets(model, rig.rest.frames)))


def adding_correctives(mesh: bpy.types.Object, rig: Rig, offsets: np.ndarray) -> Iterator[int]:
    """The same a key at a time, from `axes.corrective_offsets` (15, 3, 3, V, 3). Yields how many keys each
    step made: 1, or 0 for a joint's elements that are left out."""
    names = rig.bones
    basis = np.empty((len(mesh.data.vertices), 3), dtype=np.float32)
    mesh.data.vertices.foreach_get("co", basis.ravel())
    mesh.shape_key_add(name="Basis", from_mix=False)
    for joint in range(1, NUM_JOINTS):
        for row in range(3):
            for column in range(3):
                offset = offsets[joint - 1, row, column]
                if np.abs(offset).max() < _LEAST_OFFSET:
                    continue
                key = mesh.shape_key_add(name=f"{names[joint]} {row}{column}", from_mix=False)
                sign, expression = _ELEMENTS[row][column]
                key.data.foreach_set("co", (basis + sign * offset).astype(np.float32).ravel())
                key.slider_min, key.slider_max = -1.0, 2.0
                _drive(key, expression, rig.armature, names[joint])
                yield 1
        yield 0


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
