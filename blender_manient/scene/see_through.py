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

from .. import preferences
from ..remembered import Remembered

_COPIED_STRUCTS = ("image_user", "clip_user")

_active: SeeThrough | None = None


class Copied(bpy.types.PropertyGroup):
    """A picture of which a camera has a copy: one of the two."""

    image: bpy.props.PointerProperty(type=bpy.types.Image)  # type: ignore
    clip: bpy.props.PointerProperty(type=bpy.types.MovieClip)  # type: ignore


class SeeThrough:
    """One camera's picture over what is in front of it, until `leave`."""

    def __init__(self, camera: bpy.types.Camera, opacity: Callable[[], float]) -> None:
        """Show the pictures through; `opacity` tells that of the hand, 0..1, whenever it is asked."""
        global _active
        self._camera = Remembered.of("cameras", camera)
        self._opacity = opacity
        _active = self
        self.show()

    def show(self) -> None:
        """Show as much as the opacity asks for now."""
        camera = self._camera.find()
        if camera is not None:
            lay_over(camera, self._opacity())

    def hide(self) -> None:
        """Show the camera's pictures as the artist had them."""
        camera = self._camera.find()
        if camera is not None:
            take_away(camera)

    def leave(self) -> None:
        """Leave nothing behind. May be called twice."""
        global _active
        self.hide()
        if _active is self:
            _active = None


def opacity_changed() -> None:
    """Follow the slider."""
    if _active is not None:
        _active.show()


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
                camera.background_images.remove(background)
                break
    camera.manient_see_through.clear()


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


@bpy.app.handlers.persistent
def _on_change(*_args) -> None:
    """An undo, a redo or a file may have brought copies."""
    for camera in bpy.data.cameras:
        take_away(camera)
    opacity_changed()


@bpy.app.handlers.persistent
def _before_save(*_args) -> None:
    if _active is not None:
        _active.hide()


@bpy.app.handlers.persistent
def _after_save(*_args) -> None:
    opacity_changed()


_HANDLERS = {
    "undo_post": _on_change,
    "redo_post": _on_change,
    "load_post": _on_change,
    "save_pre": _before_save,
    "save_post": _after_save,
    "save_post_fail": _after_save,
}


def register() -> None:
    """Let cameras remember their copies, and look after them."""
    bpy.types.Camera.manient_see_through = bpy.props.CollectionProperty(
        type=Copied, description="Background images that are copies, with which keypoints are edited"
    )
    for name, handler in _HANDLERS.items():
        getattr(bpy.app.handlers, name).append(handler)
    preferences.listeners["hand_opacity"] = opacity_changed


def unregister() -> None:
    """Leave no copies behind."""
    preferences.listeners.pop("hand_opacity", None)
    for name, handler in _HANDLERS.items():
        handlers = getattr(bpy.app.handlers, name)
        if handler in handlers:
            handlers.remove(handler)
    if _active is not None:
        _active.leave()
    del bpy.types.Camera.manient_see_through
