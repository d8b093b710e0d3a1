"""Decides whether a scene takes over the footage's rate, range, size and camera, and says so.

An artist's shot keeps its own unless the artist wants otherwise. A scene counts as nobody's shot while its
settings are those that Blender starts with, or those of the last footage that it was matched to, while no
camera was set and nothing moves in it. What of Blender's start-up file stands in the way is known, too.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import bpy
from mathutils import Matrix, Vector

from handfit_core.capturing.retiming import check_rate
from handfit_core.common.errors import OptionError
from handfit_core.take import Take

from ..common.blender_versions import has_strips
from ..common.wording import capitalised
from .store import has_properties
from .timing import Timing, frame_rate, has_rate, is_retimed, nearest_rate

Choice = Literal["AUTO", "MATCH", "KEEP"]

CHOICES = (
    ("AUTO", "Auto", "Match a scene in which nothing moves and nothing was set up; retime to any other"),
    (
        "MATCH",
        "Match Scene to Clip",
        "Give the scene the footage's frame rate, frame range, size and camera; with Ready to Render "
        "also suns if nothing lights it, and colors as the picture has them",
    ),
    (
        "KEEP",
        "Retime to Scene",
        "The scene stays as it is: the hand begins at the current frame, with a key on every frame of the "
        "scene, and the clip plays behind it at the speed at which it was filmed",
    ),
)
"""The items of the properties in which artists choose whether a scene is matched"""

_TIME = ("fps", "fps_base", "frame_start", "frame_end")
_SIZE = ("resolution_x", "resolution_y", "resolution_percentage", "pixel_aspect_x", "pixel_aspect_y")


@dataclass(frozen=True)
class Footage:
    """The properties that a scene can take over from a clip or picture."""

    fps: float = 0.0
    first: int = 0
    last: int = 0
    """The last source frame; equal to `first` for a picture, which has no time"""
    width: int = 0
    """The width of the picture in pixels; 0 before a camera of the scene's own, whose size stays"""
    height: int = 0
    timed: bool = True
    """True if the footage has a rate of its own; photos and image sequences have none"""
    placed: Timing | None = None
    """Where the footage's frames lie in the scene's time, which stays, as it does for the clip of the scene's
    own camera; None where the scene takes over its time"""

    @classmethod
    def of_take(cls, take: Take, *, own_camera: bool = False, placed: Timing | None = None) -> Footage:
        """Return the footage that `build_take` gives to a scene for a take."""
        numbers, size = take.frame_numbers, (0, 0) if own_camera else (take.width, take.height)
        return cls(take.fps, int(numbers[0]), int(numbers[-1]), *size, has_rate(take), placed)

    def is_applied_to(self, scene: bpy.types.Scene) -> bool:
        """True if a clip's rate, range and size are the scene's already."""
        render = scene.render
        return (
            self.last > self.first
            and nearest_rate(self.fps) == (render.fps, render.fps_base)
            and (self.first, self.last) == (scene.frame_start, scene.frame_end)
            and (self.width, self.height) == (render.resolution_x, render.resolution_y)
        )

    def __str__(self) -> str:
        size = f"{self.width}×{self.height}" if self.width else ""
        time = f"{self.fps:.5g} fps, {self.first}-{self.last}" if self.last > self.first else ""
        return ", ".join(filter(None, (time, size)))


def matches(scene: bpy.types.Scene, choice: Choice, footage: Footage | None = None) -> bool:
    """True if the scene is matched to the footage under this choice."""
    if footage is not None and footage.placed is not None:
        return False
    return choice == "MATCH" or (choice == "AUTO" and not why_kept(scene, footage))


def why_kept(scene: bpy.types.Scene, footage: Footage | None = None) -> str:
    """Return why the scene counts as somebody's shot, as part of a sentence; empty where it does not.

    A scene that has the footage's rate, range and size already loses nothing by it."""
    camera = scene.camera
    if camera is not None and not is_untouched(camera) and not is_of_a_capture(camera):
        return f"its camera is {camera.name}"
    if footage is not None and footage.is_applied_to(scene):
        return ""
    if not _untouched(scene):
        return "it has settings of its own"
    if scene.use_preview_range or len(scene.timeline_markers):
        return "it has a preview range" if scene.use_preview_range else "it has markers"
    if has_strips(scene):
        return "it has strips in the sequencer"
    moving = next(_moving(scene), None)
    return "" if moving is None else f"{moving} is animated"


def scene_sentence(
    scene: bpy.types.Scene,
    choice: Choice,
    footage: Footage | None,
    frame: float,
    *,
    done: bool | None = None,
) -> str:
    """Return a sentence on what a capture does to the scene, the main thing in a short first one; with
    `done`, whether the scene was matched, on what it has done."""
    if footage is not None and footage.placed is not None:
        first = footage.placed.offset + footage.placed.scale * footage.first
        return f"Hand at frame {first:g}, with the camera's clip"
    if matches(scene, choice, footage) if done is None else done:
        news = "rate and size of the footage" if footage is None else str(footage)
        if footage is not None and not news:
            return f"Hand at frame {footage.first}"
        camera = ". It looks through the footage's camera" if footage is None or footage.width else ""
        return f"Scene{':' if done is None else ' became'} {news}{camera}"
    stays = f"Scene stays, hand at frame {frame:g}, {frame_rate(scene):.5g} fps"
    if why := why_kept(scene, footage) if choice == "AUTO" and done is None else "":
        stays += f". It stays, as {why}"
    moves = footage is not None and footage.timed and footage.last > footage.first
    if footage is None or not moves or not is_retimed(scene, footage.fps):
        return stays
    try:
        check_rate(frame_rate(scene))
    except OptionError as error:
        return capitalised(str(error))
    return f"{stays}. The clip of {footage.fps:.5g} fps {'is' if done is None else 'was'} retimed to it"


def note_matched(scene: bpy.types.Scene, footage: Footage) -> None:
    """Remember which of the scene's present settings are the footage's, and not the artist's."""
    if not has_properties():
        return
    if footage.last > footage.first:
        scene.manient.matched_time = _settings(scene, _TIME)
    if footage.width:
        scene.manient.matched_size = _settings(scene, _SIZE)


def has_matched_size(scene: bpy.types.Scene) -> bool:
    """True if the scene's picture size is still what footage has given to it."""
    return has_properties() and _settings(scene, _SIZE) == scene.manient.matched_size


def has_matched_time(scene: bpy.types.Scene) -> bool:
    """True if the scene's rate and range are still what footage has given to it."""
    return has_properties() and _settings(scene, _TIME) == scene.manient.matched_time


def _untouched(scene: bpy.types.Scene) -> bool:
    matched = (scene.manient.matched_time, scene.manient.matched_size) if has_properties() else ("", "")
    return all(
        _settings(scene, names) in (_settings(None, names), noted)
        for names, noted in zip((_TIME, _SIZE), matched, strict=True)
    )


def _settings(scene: bpy.types.Scene | None, names: tuple[str, ...]) -> str:
    """Return settings that matching changes, as text; of no scene: those that Blender starts with."""
    found = []
    for name in names:
        cls = bpy.types.Scene if name.startswith("frame") else bpy.types.RenderSettings
        owner = scene and (scene if cls is bpy.types.Scene else scene.render)
        value = getattr(owner, name) if owner else cls.bl_rna.properties[name].default
        found.append(f"{value:.6g}")
    return " ".join(found)


def is_of_a_capture(camera: bpy.types.Object) -> bool:
    """True if a capture built the camera: one of the artist's own lies in no capture's collection."""
    return has_properties() and any(
        camera in (c.manient.camera, c.manient.view_camera) for c in camera.users_collection
    )


def _moving(scene: bpy.types.Scene) -> Iterator[str]:
    """Yield the names of what is animated in the scene; a hand captured from one picture only stands
    there."""
    if len(bpy.data.actions) == 0:  # panels ask at every redraw
        return
    for block in _blocks(scene):
        data = getattr(block, "animation_data", None)
        if block is None or data is None:
            continue
        action = data.action
        is_hand = has_properties() and isinstance(block, bpy.types.Object) and block.manient.is_hand
        still = action is not None and is_hand and action.frame_range[0] == action.frame_range[1]
        if (action is not None and not still) or any(len(track.strips) for track in data.nla_tracks):
            yield block.name


def _blocks(scene: bpy.types.Scene) -> Iterator[bpy.types.ID | None]:
    """Yield the data-blocks that can be animated in a scene; None for one that is not there."""
    yield from (scene, scene.world, scene.world and scene.world.node_tree)
    for obj in scene.objects:
        yield from (obj, obj.data, getattr(obj.data, "shape_keys", None))
        for slot in obj.material_slots:
            yield from (slot.material, slot.material and slot.material.node_tree)


_CAMERA = (7.358891, -6.925791, 4.958309, 1.109319, 0.0, 0.814928, 50.0)
"""The place, rotation and lens of the camera in Blender's start-up file"""
_LIGHT = (4.07625, 1.00545, 5.90386)
"""The place of the light in Blender's start-up file, which is too far off to light a hand"""
_SOLID = {"MESH", "CURVE", "SURFACE", "META", "FONT"}


def is_untouched(thing: bpy.types.Object) -> bool:
    """True if a thing is the start-up file's camera, light or cube, as Blender made it."""
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
    """Yield the visible solid objects in whose bounding box the camera is."""
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
