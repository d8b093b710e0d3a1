"""What stands around the capturing camera."""

from __future__ import annotations

import pytest

bpy = pytest.importorskip("bpy", reason="needs one of the bpy wheels")

from blender_manient.scene.matching import clear_view  # noqa: E402


@pytest.fixture
def capture():
    """A camera at the world's origin, in a collection of its own."""
    collection = bpy.data.collections.new("capture")
    bpy.context.scene.collection.children.link(collection)
    camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    collection.objects.link(camera)
    return camera, collection


def cube(name: str = "Cube", **options) -> bpy.types.Object:
    bpy.ops.mesh.primitive_cube_add(**options)
    thing = bpy.context.view_layer.objects.active
    thing.name = name
    bpy.context.view_layer.update()
    return thing


def said_of(capture) -> list[str]:
    return clear_view(*capture, bpy.context.view_layer)


def test_the_start_up_cube_is_hidden(capture):
    thing = cube()
    assert said_of(capture) == [
        "Cube is hidden now, in renders too, since the capture's camera stands inside it"
    ]
    assert thing.hide_get()
    assert thing.hide_render
    assert said_of(capture) == []


@pytest.mark.parametrize(
    ("name", "options"), [("Room", {}), ("Cube", {"size": 5.0, "location": (0.5, 0.0, 0.0)})]
)
def test_what_the_artist_has_made_is_only_named(capture, name, options):
    thing = cube(name, **options)
    assert said_of(capture) == [f"the capture's camera stands inside {name}: hide that to see the picture"]
    assert not thing.hide_get()


def test_what_stands_elsewhere_or_is_seen_through_is_left_alone(capture):
    cube(location=(3.0, 0.0, 0.0))
    cube("Bounds").display_type = "BOUNDS"
    cube("Hidden").hide_set(True)
    cube("Flat", scale=(1.0, 1.0, 0.0))
    own = cube("Own")
    bpy.context.scene.collection.objects.unlink(own)
    capture[1].objects.link(own)
    assert said_of(capture) == []
