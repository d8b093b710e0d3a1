"""What Blender's start-up file holds, as long as nobody has done anything to it."""

from __future__ import annotations

import bpy
from mathutils import Matrix, Vector

_CAMERA = (7.358891, -6.925791, 4.958309, 1.109319, 0.0, 0.814928, 50.0)
"""Place, rotation and lens"""
_LIGHT = (4.07625, 1.00545, 5.90386)
"""Place; too far off to light a hand"""


def is_untouched(thing: bpy.types.Object) -> bool:
    """Whether it is the start-up file's camera, light or cube, as Blender made it."""
    data = thing.data
    if thing.name == "Camera" and isinstance(data, bpy.types.Camera):
        found = (*thing.location, *thing.rotation_euler, data.lens)
        free = thing.parent is None and not thing.constraints
        return free and all(abs(a - b) < 1e-4 for a, b in zip(found, _CAMERA, strict=True))
    if thing.name == "Light" and isinstance(data, bpy.types.PointLight):
        moved = (thing.matrix_world.translation - Vector(_LIGHT)).length > 1e-3
        return not moved and thing.animation_data is None and data.energy == 1000.0
    if thing.name == "Cube" and isinstance(data, bpy.types.Mesh):
        return len(data.vertices) == 8 and not thing.modifiers and thing.matrix_world == Matrix.Identity(4)
    return False
