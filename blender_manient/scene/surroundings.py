"""What stands around the capturing camera and hides the picture behind the hand."""

from __future__ import annotations

from collections.abc import Iterator

import bpy

from .start_up import is_untouched

_SOLID = {"MESH", "CURVE", "SURFACE", "META", "FONT"}


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
