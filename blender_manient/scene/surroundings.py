"""What stands around the capturing camera, and what of it Blender's start-up file brings."""

from __future__ import annotations

from collections.abc import Iterator

import bpy
from mathutils import Matrix, Vector

_CAMERA = (7.358891, -6.925791, 4.958309, 1.109319, 0.0, 0.814928, 50.0)
"""Place, rotation and lens"""
_LIGHT = (4.07625, 1.00545, 5.90386)
"""Place; too far off to light a hand"""
_SOLID = {"MESH", "CURVE", "SURFACE", "META", "FONT"}


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


def clear_view(
    camera: bpy.types.Object, collection: bpy.types.Collection, layer: bpy.types.ViewLayer
) -> list[str]:
    """Hide the cube of Blender's start-up file where the camera stands inside it; returns a sentence for
    each object around the camera, hidden or not.

    `collection`: the capture's own, which is passed over. The cube is hidden in renders too: it would be all
    that they show. Whatever somebody has made is only named.
    """
    said = []
    for thing in list(_around(camera, collection, layer)):
        if is_untouched(thing):
            thing.hide_set(True, view_layer=layer)
            thing.hide_render = True
            said.append(
                f"{thing.name} is hidden now, in renders too, since the capture's camera stands inside it"
            )
        else:
            said.append(f"the capture's camera stands inside {thing.name}: hide that to see the picture")
    return said


def _around(
    camera: bpy.types.Object, collection: bpy.types.Collection, layer: bpy.types.ViewLayer
) -> Iterator[bpy.types.Object]:
    """The visible solid objects in whose bounding box the camera is."""
    place = camera.matrix_world.translation
    for thing in layer.objects:
        if thing.type not in _SOLID or not thing.visible_get(view_layer=layer):
            continue
        if thing.name in collection.all_objects or thing.display_type in ("BOUNDS", "WIRE"):
            continue
        inside = thing.matrix_world.inverted_safe() @ place
        corners = list(zip(*thing.bound_box, strict=True))
        if all(min(axis) < x < max(axis) for axis, x in zip(corners, inside, strict=True)):
            yield thing
