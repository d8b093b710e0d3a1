"""How a hand is shown while its keypoints are edited: where it was captured, with the picture through it.

Behind a hand the capture camera shows its picture as a background image. Here a copy of that is laid over
the hand, as opaque as the hand is to be see-through; where there is no hand, picture over picture looks as
before. Constraints put the hand before the camera, whatever has moved, turned or scaled it since.

Copies and constraints are kept out of files that are saved meanwhile, and where an undo or a file that
Blender saved by itself brings them back later, they are taken away again: the camera remembers the pictures
of which it has copies, and the constraints have a name.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import bpy
from mathutils import Matrix

from ..common.block_reference import BlockReference
from .background import drive_offset, offset_driver

_COPIED_STRUCTS = ("image_user", "clip_user")
_AS_CAPTURED = "As Captured"
"""The name of the constraints that put a hand before its camera"""
_LIMITS = {"LIMIT_LOCATION": "use_{}_{}", "LIMIT_ROTATION": "use_limit_{1}", "LIMIT_SCALE": "use_{}_{}"}
"""By type of constraint, the name of the property that switches its limit on, at `min` or `max`, of an
axis"""


@dataclass(frozen=True)
class _Shown:
    camera: BlockReference
    """The camera before which the hand is shown"""
    hand: BlockReference
    """The armature of the hand that is shown"""
    place: Matrix
    """The matrix of the hand as it was captured, in the camera's frame"""
    opacity: Callable[[], float]


_shown: _Shown | None = None


class Copied(bpy.types.PropertyGroup):
    """A picture of which a camera has a copy: either an image or a movie clip."""

    image: bpy.props.PointerProperty(type=bpy.types.Image)  # type: ignore
    clip: bpy.props.PointerProperty(type=bpy.types.MovieClip)  # type: ignore


def begin(
    camera: bpy.types.Object, hand: bpy.types.Object, place: Matrix, opacity: Callable[[], float]
) -> None:
    """Show an armature before a camera, at a `place` in its frame, and its picture over it, until `end`;
    `opacity` tells the hand's, 0..1, whenever it is asked."""
    global _shown
    _shown = _Shown(BlockReference.of("objects", camera), BlockReference.of("objects", hand), place, opacity)
    follow()


def follow(*_: object) -> None:
    """Show the hand as opaque as `opacity` says now."""
    if _shown is None or (camera := _shown.camera.find()) is None:
        return
    lay_over(camera.data, _shown.opacity())
    if (hand := _shown.hand.find()) is not None:
        put_before(hand, camera, _shown.place)


def hide(*_: object) -> None:
    """Show the camera's pictures as the artist had them, and the hand where the artist has it."""
    if _shown is None:
        return
    if (camera := _shown.camera.find()) is not None:
        take_away(camera.data)
    if (hand := _shown.hand.find()) is not None:
        put_back(hand)


def end() -> None:
    """Take the copies and the constraints away. May be called twice."""
    global _shown
    hide()
    _shown = None


def lay_over(camera: bpy.types.Camera, opacity: float) -> None:
    """Lay copies of the camera's pictures over what is in front of them; `opacity` 1..0 is the hand's. Does
    nothing where the camera shows no picture or belongs to another file."""
    take_away(camera)
    backgrounds = camera.background_images
    behind = [index for index, background in enumerate(backgrounds) if _is_behind(background)]
    if not _is_own(camera) or not camera.show_background_images or opacity >= 1.0:
        return
    for index in behind:
        copy = backgrounds.new()
        _copy(backgrounds[index], copy)
        drive_offset(copy.image_user, offset_driver(backgrounds[index].image_user))
        copy.display_depth = "FRONT"
        copy.alpha *= 1.0 - opacity
        copy.show_expanded = False
        noted = camera.manient_see_through.add()
        noted.image, noted.clip = _picture(copy)


def take_away(camera: bpy.types.Camera) -> None:
    """Take the copies away, and nothing that the artist has added meanwhile."""
    if not len(camera.manient_see_through) or not _is_own(camera):
        return
    # The originals tell nothing: the artist may have removed them meanwhile.
    for noted in camera.manient_see_through:
        for background in reversed(list(camera.background_images)):
            if background.display_depth == "FRONT" and _picture(background) == _picture(noted):
                drive_offset(background.image_user, "")
                camera.background_images.remove(background)
                break
    camera.manient_see_through.clear()
    camera.update_tag()


def put_before(hand: bpy.types.Object, camera: bpy.types.Object, place: Matrix) -> None:
    """Have constraints put an armature before a camera, whose scale does not count, at a place in its
    frame."""
    put_back(hand)
    limits = zip(_LIMITS.items(), ((0.0,) * 3, (0.0,) * 3, place.to_scale()), strict=True)
    for (kind, switch), values in limits:  # to the world's origin
        limit = hand.constraints.new(kind)
        limit.name = _AS_CAPTURED
        for axis, value in zip("xyz", values, strict=True):
            for end in ("min", "max"):
                setattr(limit, switch.format(end, axis), True)
                setattr(limit, f"{end}_{axis}", value)
    child = hand.constraints.new("CHILD_OF")
    child.name, child.target = _AS_CAPTURED, camera
    child.use_scale_x = child.use_scale_y = child.use_scale_z = False
    child.inverse_matrix = place.normalized()


def put_back(hand: bpy.types.Object) -> None:
    """Have an armature stand where the artist has it."""
    for constraint in reversed(list(hand.constraints)):
        if constraint.name.startswith(_AS_CAPTURED) and hand.is_editable:
            hand.constraints.remove(constraint)


def _is_own(camera: bpy.types.Camera) -> bool:
    return camera.is_editable and camera.override_library is None


def _is_behind(background: bpy.types.CameraBackgroundImage) -> bool:
    return (
        background.show_background_image
        and background.display_depth == "BACK"
        and any(block is not None for block in _picture(background))
    )


def _picture(
    background: bpy.types.CameraBackgroundImage | Copied,
) -> tuple[bpy.types.ID | None, bpy.types.ID | None]:
    return background.image, background.clip


def _copy(source: bpy.types.bpy_struct, target: bpy.types.bpy_struct) -> None:
    """Copy all settings of one struct to another of its kind."""
    for setting in source.bl_rna.properties:
        name = setting.identifier
        if not setting.is_readonly:
            setattr(target, name, getattr(source, name))
        elif name in _COPIED_STRUCTS and getattr(source, name) is not None:
            _copy(getattr(source, name), getattr(target, name))


def _on_change(*_args) -> None:
    """Take copies and constraints away that an undo, a redo or a file has brought back."""
    for camera in bpy.data.cameras:
        take_away(camera)
    for obj in bpy.data.objects:
        if obj.type == "ARMATURE" and obj.manient.is_hand:
            put_back(obj)
    follow()


HANDLERS = {
    "undo_post": _on_change,
    "redo_post": _on_change,
    "load_post": _on_change,
    "save_pre": hide,
    "save_post": follow,
    "save_post_fail": follow,
}
LISTENERS = {"hand_opacity": follow}


PROPERTIES = {
    (bpy.types.Camera, "manient_see_through"): lambda: bpy.props.CollectionProperty(
        type=Copied, description="Background images that are copies, with which keypoints are edited"
    )
}


def unregister() -> None:
    """Take all copies away when the add-on is disabled."""
    end()
