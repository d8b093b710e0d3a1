"""Pictures and clips that the file already holds, as a source to capture."""

from __future__ import annotations

import uuid
from dataclasses import dataclass
from pathlib import Path

import bpy
import numpy as np

from handfit_core.errors import InputError

from ..cache import cache_folder
from ..scene.plate import rows_of
from ..scene.preview import write_png
from .mixins import errors_reported


@dataclass(frozen=True)
class Offer:
    """Something in the file that can be captured."""

    kind: str
    """IMAGE or CLIP"""
    name: str
    """of the data-block"""
    where: str
    """for people: where it is seen"""
    icon: str


def offers(context: bpy.types.Context) -> list[Offer]:
    """What is in the open file: images in image editors, the active camera's background, movie clips."""
    found: list[Offer] = []
    screen = context.screen
    for area in screen.areas if screen else ():
        space = area.spaces.active
        if area.type == "IMAGE_EDITOR" and space.image is not None and _usable(space.image):
            found.append(Offer("IMAGE", space.image.name, "Image Editor", "IMAGE"))
    camera = context.scene.camera
    if camera is not None and camera.type == "CAMERA":
        for background in camera.data.background_images:
            if background.source == "IMAGE" and background.image and _usable(background.image):
                found.append(Offer("IMAGE", background.image.name, "Camera Background", "CAMERA_DATA"))
            elif background.source == "MOVIE_CLIP" and background.clip:
                found.append(Offer("CLIP", background.clip.name, "Camera Background", "CAMERA_DATA"))
    found += [Offer("CLIP", clip.name, "Movie Clip", "TRACKER") for clip in bpy.data.movieclips]
    return list({(offer.kind, offer.name): offer for offer in reversed(found)}.values())[::-1]


def _usable(image: bpy.types.Image) -> bool:
    return image.source in {"FILE", "SEQUENCE", "MOVIE", "GENERATED"}


class MANIENT_OT_use_source(bpy.types.Operator):
    bl_idname = "manient.use_source"
    bl_label = "Use as Source"
    bl_description = "Capture the hands in a picture or clip that this file already has"
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012

    kind: bpy.props.EnumProperty(  # type: ignore
        items=(("IMAGE", "Image", ""), ("CLIP", "Movie Clip", "")), options={"SKIP_SAVE"}
    )
    name: bpy.props.StringProperty(name="Name", options={"SKIP_SAVE"})  # type: ignore

    @errors_reported
    def execute(self, context):
        """Put its file into the panel."""
        settings = context.scene.manient
        if self.kind == "IMAGE":
            path, sequence = _image_path(self.name)
        else:
            path, sequence = _clip_path(self.name)
        settings.source = path
        settings.as_sequence = sequence
        return {"FINISHED"}


def _image_path(name: str) -> tuple[str, bool]:
    image = bpy.data.images.get(name)
    if image is None:
        raise InputError(f"there is no image {name} in this file any more")
    path = Path(bpy.path.abspath(image.filepath, library=image.library)) if image.filepath else None
    if path is not None and path.is_file() and not image.is_dirty:
        return str(path), image.source == "SEQUENCE"
    if not image.has_data and not image.packed_file and image.source != "GENERATED":
        raise InputError(f"the file of the image {name} is not there any more: find it again, or pack it")
    # Painted, generated or packed: a copy that the worker can read.
    # A name of its own each time: a capture that waits may still want the one before.
    copy = cache_folder() / f"{bpy.path.clean_name(image.name)}-{uuid.uuid4().hex[:6]}.png"
    _write_png(image, copy)
    return str(copy), False


def _write_png(image: bpy.types.Image, path: Path) -> None:
    """Write what the image shows now, painted or not, and leave it as it is: before Blender 4.3 saving
    changes an image's own path."""
    rows = rows_of(image)[..., :3]
    write_png(np.clip(rows, 0.0, 1.0) ** np.float32(1 / 2.2) if image.is_float else rows, path)  # else linear


def _clip_path(name: str) -> tuple[str, bool]:
    clip = bpy.data.movieclips.get(name)
    if clip is None:
        raise InputError(f"there is no movie clip {name} in this file any more")
    path = Path(bpy.path.abspath(clip.filepath, library=clip.library))
    if not path.is_file():
        raise InputError(f"{path}: the clip's file is not there any more; find it again")
    return str(path), clip.source == "SEQUENCE"


class MANIENT_MT_sources(bpy.types.Menu):
    bl_idname = "MANIENT_MT_sources"
    bl_label = "From This File"
    bl_description = "Use a picture or clip that this file already has"

    def draw(self, context):
        """One entry per picture or clip."""
        layout = self.layout
        found = offers(context)
        for offer in found:
            entry = layout.operator(
                MANIENT_OT_use_source.bl_idname,
                text=f"{offer.name}  ({offer.where})",
                icon=offer.icon,
                translate=False,
            )
            entry.kind, entry.name = offer.kind, offer.name
        if not found:
            layout.label(text="No Images or Movie Clips in This File", icon="INFO")
