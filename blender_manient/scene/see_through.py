"""The picture shown through the hand, in every kind of shading, without touching the hand or the viewport.

Behind a hand the capture camera shows its picture as a background image. Here a copy of that is laid over
the hand, as opaque as the hand is to be see-through; where there is no hand, picture over picture looks as
before. The copies are there while keypoints are edited. They are kept out of files that are saved
meanwhile, and where an undo or a file that Blender saved by itself brings them back later, they are taken
away again: the camera remembers the pictures of which it has copies.
"""

from __future__ import annotations

from collections.abc import Callable

import bpy

from ..common.block_reference import BlockReference
from .background import drive_offset, offset_driver

_COPIED_STRUCTS = ("image_user", "clip_user")

_shown: tuple[BlockReference, Callable[[], float]] | None = None
"""The camera whose picture lies over the hand, and what tells the hand's opacity"""


class Copied(bpy.types.PropertyGroup):
    """A picture of which a camera has a copy: one of the two."""

    image: bpy.props.PointerProperty(type=bpy.types.Image)  # type: ignore
    clip: bpy.props.PointerProperty(type=bpy.types.MovieClip)  # type: ignore


def begin(camera: bpy.types.Camera, opacity: Callable[[], float]) -> None:
    """Lay one camera's picture over what is in front of it until `end`; `opacity` tells the hand's, 0..1,
    whenever it is asked."""
    global _shown
    _shown = BlockReference.of("cameras", camera), opacity
    follow()


def follow(*_: object) -> None:
    """Show as much as the opacity asks for now."""
    if _shown is not None and (camera := _shown[0].find()) is not None:
        lay_over(camera, _shown[1]())


def hide(*_: object) -> None:
    """Show the camera's pictures as the artist had them."""
    if _shown is not None and (camera := _shown[0].find()) is not None:
        take_away(camera)


def end() -> None:
    """Leave nothing behind. May be called twice."""
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
    """All settings of one struct to another of its kind."""
    for setting in source.bl_rna.properties:
        name = setting.identifier
        if not setting.is_readonly:
            setattr(target, name, getattr(source, name))
        elif name in _COPIED_STRUCTS and getattr(source, name) is not None:
            _copy(getattr(source, name), getattr(target, name))


def _on_change(*_args) -> None:
    """An undo, a redo or a file may have brought copies."""
    for camera in bpy.data.cameras:
        take_away(camera)
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
    """Leave no copies behind."""
    end()
