"""What makes a capture's first render show the hands, lit, in their picture.

The picture glows on a card far behind the hands rather than in the compositor: that works alike in every
engine and every Blender, follows clips as the camera's background does, and leaves the artist's compositing
alone. Where there are several captures, renders show what belongs to the one whose camera the scene has.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import bpy
import numpy as np
from mathutils import Vector

from handfit_core.hand_model import axes
from handfit_core.take import Take

from ..common.blender_versions import use_nodes
from ..common.wording import named_after
from .background import Plate
from .camera import put_before
from .matching import is_untouched
from .store import has_properties

SUNS = ((-40.0, 42.0, 3.4), (55.0, 10.0, 1.0), (160.0, 40.0, 1.8))
"""The key, fill and rim lights: each its degrees from the camera's axis (to the right, up), then its strength
in W/m2"""
OURS = "hand_render_setup"
"""Custom property of the cards and suns, by which they are found again"""
_CARD_PLACE = 0.9
"""Where the card stands, as a share of the camera's far clip distance"""
_BEYOND = 0.05
"""How far the card reaches beyond the view, as a share of the picture's width and height"""


def set_up(
    scene: bpy.types.Scene, name: str, camera: bpy.types.Object, take: Take, plate: Plate | None
) -> list[bpy.types.Object]:
    """Lights and a card with the picture, hung on the camera of the capture of that name; linked to no
    collection yet.

    There are no lights where the scene has its own, and no card without a plate. Call `put_in_force` for the
    scene that gets them.
    """
    made = []
    if not _is_lit(scene):
        made = [sun(named_after(name, "light"), *placed) for placed in SUNS]
    for thing in made:
        thing[OURS] = True
        put_before(thing, camera)
    if plate is not None:
        made.append(add_picture_plane(name, camera, take, plate))
    return made


def add_picture_plane(name: str, camera: bpy.types.Object, take: Take, plate: Plate) -> bpy.types.Object:
    """Make a card with the picture, which only renders see, hung on the camera of a capture or view of that
    name; linked to no collection yet."""
    card = picture_card(named_after(name, "picture"), plate, take, _CARD_PLACE * camera.data.clip_end)
    card.hide_viewport = card.hide_select = True  # there the camera's background shows the picture
    # It is a picture, not a thing: it neither lights the hands nor stands in a light's way.
    card.visible_diffuse = card.visible_glossy = card.visible_transmission = False
    card.visible_volume_scatter = card.visible_shadow = False
    card[OURS] = True
    put_before(card, camera)
    return card


def put_in_force(scene: bpy.types.Scene, made: list[bpy.types.Object]) -> None:
    """Have renders show what `set_up` has made for the scene's camera. A card's picture keeps its colours if
    nobody has chosen how the scene shows colours: what Blender starts with washes pictures out."""
    follow_camera(scene)
    if all(thing.type != "MESH" for thing in made):
        return
    view = scene.view_settings
    untouched = view.look == "None" and view.exposure == 0.0 and view.gamma == 1.0
    if view.view_transform == "AgX" and untouched:
        view.view_transform = "Standard"


def follow_camera(scene: bpy.types.Scene) -> None:
    """Have renders show the picture card and the suns of one capture, each kind for itself.

    It is the capture whose camera is the scene's; else the one chosen last; else the one shown so far; else
    the latest. While that stays the same nothing is changed, so a hidden card stays hidden. A kind that this
    capture lacks stays as it is."""
    objects = list(scene.objects)
    ours = [thing for thing in objects if OURS in thing]
    cameras = [thing.parent for thing in ours if thing.parent in objects]
    shown = scene.manient.rendered_camera if has_properties() else None
    active = scene.manient.capture.manient.camera if has_properties() and scene.manient.capture else None
    chosen = next((c for wanted in (scene.camera, active, shown) for c in cameras if c == wanted), None)
    chosen = chosen or (cameras[-1] if cameras else None)
    if chosen is None or chosen == shown:
        return
    kinds = {thing.type for thing in ours if thing.parent == chosen}
    for thing in ours:
        if thing.type in kinds:
            thing.hide_render = thing.parent != chosen
    if has_properties():
        scene.manient.rendered_camera = chosen


def picture_card(name: str, plate: Plate, take: Take, distance: float) -> bpy.types.Object:
    """Make a glowing card that fills the view of a camera at the world's origin with the picture, at that
    distance before it. It reaches a little beyond the view, since a render's outermost pixels see beyond it
    too."""
    uv = np.array([[0, 0], [1, 0], [1, 1], [0, 1]]) * (1.0 + 2.0 * _BEYOND) - _BEYOND
    corners = (uv * [1.0, -1.0] + [0.0, 1.0]) * [take.width, take.height]
    mesh = bpy.data.meshes.new(name)
    points = distance * axes.points_to_world(take.intrinsics.rays(corners))
    mesh.from_pydata(points.tolist(), [], [(0, 1, 2, 3)])
    mesh.uv_layers.new(name="UVMap").data.foreach_set("uv", plate.places(uv).astype(np.float32).ravel())

    material = bpy.data.materials.new(name)
    tree = use_nodes(material)
    tree.nodes.clear()
    texture = tree.nodes.new("ShaderNodeTexImage")
    texture.image = plate.image
    texture.interpolation = "Closest"
    texture.extension = "EXTEND"
    plate.apply_timing(texture.image_user)
    glow = tree.nodes.new("ShaderNodeEmission")
    output = tree.nodes.new("ShaderNodeOutputMaterial")
    tree.links.new(texture.outputs["Color"], glow.inputs["Color"])
    tree.links.new(glow.outputs["Emission"], output.inputs["Surface"])
    mesh.materials.append(material)
    return bpy.data.objects.new(name, mesh)


def sun(name: str, right: float, up: float, strength: float) -> bpy.types.Object:
    """Make a soft sun from behind a camera at the world's origin that looks along +Y; see `SUNS`."""
    light = bpy.data.lights.new(name, "SUN")
    light.energy = strength
    light.angle = math.radians(20.0)
    obj = bpy.data.objects.new(name, light)
    azimuth, elevation = math.radians(right), math.radians(up)
    towards = Vector((-math.sin(azimuth), math.cos(azimuth) * math.cos(elevation), -math.sin(elevation)))
    obj.rotation_mode = "QUATERNION"
    obj.rotation_quaternion = towards.to_track_quat("-Z", "Y")
    return obj


def _is_lit(scene: bpy.types.Scene) -> bool:
    """True if the artist has seen to light: with a lamp that renders show, or a sky or a picture as world."""
    lamps = (o for layer in scene.view_layers for o in _rendered(layer.layer_collection) if o.type == "LIGHT")
    if any(not (OURS in o or is_untouched(o)) for o in lamps):
        return True
    tree = scene.world.node_tree if scene.world is not None else None
    return tree is not None and any(n.type in ("TEX_ENVIRONMENT", "TEX_SKY") for n in tree.nodes)


def _rendered(part: bpy.types.LayerCollection) -> Iterator[bpy.types.Object]:
    """Yield the objects of a collection and those in it that renders show. A view layer's own list of objects
    would lack what was linked since it was last updated."""
    if part.collection.hide_render:
        return
    if not part.exclude:
        yield from (o for o in part.collection.objects if not o.hide_render)
    for child in part.children:
        yield from _rendered(child)


_seen: dict[int, tuple[int, int, int]] = {}
"""By a scene's session_uid, the state in which `follow_camera` last saw that scene"""


def _on_update(scene: bpy.types.Scene, *_args) -> None:
    """Follow another camera, or a deletion. Blender calls this after every step: what it compares is
    cheap."""
    settings = scene.manient
    if not settings.is_property_set("rendered_camera"):
        return

    def state() -> tuple[int, int, int]:
        uids = [camera.session_uid if camera else 0 for camera in (settings.rendered_camera, scene.camera)]
        return uids[0], uids[1], len(bpy.data.objects)

    if _seen.get(scene.session_uid) != state():
        follow_camera(scene)
        _seen[scene.session_uid] = state()


HANDLERS = {"depsgraph_update_post": _on_update}


def unregister() -> None:
    """Forget the states in which scenes were last seen."""
    _seen.clear()
