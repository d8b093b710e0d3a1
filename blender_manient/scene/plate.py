"""The captured picture as a Blender image: photo, image sequence or movie, upright, frame by frame."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import bpy
import numpy as np

from handfit_core.exif import upright
from handfit_core.files import is_file
from handfit_core.media import sequence_numbers
from handfit_core.take import Take

from .timing import Timing


@dataclass(frozen=True)
class Plate:
    """An image and the settings with which scene frame n shows the source's frame n."""

    image: bpy.types.Image
    frame_start: int = 1
    frame_offset: int = 0
    frame_duration: int = 1

    def apply_timing(self, user: bpy.types.ImageUser) -> None:
        """Set an image user (of a background image or of a texture node)."""
        user.frame_duration = self.frame_duration
        user.frame_start = self.frame_start
        user.frame_offset = self.frame_offset
        user.use_auto_refresh = True


def load_plate(take: Take, timing: Timing | None = None) -> tuple[Plate | None, list[str]]:
    """The take's picture, and what the user should know about it.

    `timing` says where the take lies in the scene's time; without it, on its own frame numbers.
    A file that is missing or unreadable gives no plate and a warning.
    """
    timing = timing or Timing()
    path = Path(take.source.files[0])
    if not is_file(path):
        return None, [f"{path}: the picture is not there any more, so nothing is shown behind the hands"]
    try:
        # `check_existing` stays off: another take's copy of the same picture may be timed differently.
        image = bpy.data.images.load(str(path), check_existing=False)
    except RuntimeError:
        return None, [_unreadable(path)]
    size = tuple(image.size)  # asked here, since as a sequence it is that of a frame not yet chosen
    if 0 in size:
        bpy.data.images.remove(image)
        return None, [_unreadable(path)]
    if take.source.kind == "video":
        image.source = "MOVIE"
        plate = _movie(image, take, timing)
    elif take.source.kind == "sequence":
        image.source = "SEQUENCE"
        plate = _sequence(image, take, timing)
    else:
        plate = Plate(image)
    if take.source.kind == "photo" and take.source.orientation != 1:
        plate = Plate(_upright_copy(image, take.source.orientation))
        bpy.data.images.remove(image)
        size = tuple(plate.image.size)
    return plate, _mismatches(path, size, take) + _other_rate(path, take, timing)


def _unreadable(path: Path) -> str:
    return f"{path}: Blender cannot read this picture, so nothing is shown behind the hands"


def _mismatches(path: Path, size: tuple[int, ...], take: Take) -> list[str]:
    """Where what Blender shows is not what the capture saw."""
    files = [Path(f) for f in take.source.files]
    if take.source.kind == "sequence":
        if sequence_numbers(files) != [int(n) for n in take.frame_numbers]:
            return [
                f"{path.parent}: the pictures' names are not one numbered sequence, so Blender cannot show "
                "them one after the other behind the hands; number them to see them"
            ]
        if take.source.orientation != 1:
            return [
                f"{path}: the pictures are stored turned (EXIF orientation {take.source.orientation}), which "
                "Blender does not undo in sequences; save them upright to see them behind the hands"
            ]
    if size != (take.width, take.height):
        return [
            f"{path}: Blender reads {size[0]} x {size[1]} pixels where the capture had {take.width} x "
            f"{take.height}, so the picture may not fit behind the hands"
        ]
    return []


def _other_rate(path: Path, take: Take, timing: Timing) -> list[str]:
    if timing.scale == 1.0 or take.source.kind != "video":
        return []
    return [
        f"{path}: the video has {take.fps:g} frames per second, the scene {take.fps * timing.scale:g}, and "
        "Blender shows one video frame per scene frame, so only the first frame fits its hands; match the "
        "scene to the footage to see them together"
    ]


def _movie(image: bpy.types.Image, take: Take, timing: Timing) -> Plate:
    """Blender shows frame (scene frame - start + 1): the take's first frame where its first keys are."""
    start = _first_scene_frame(take, timing) - int(take.frame_numbers[0]) + 1
    return Plate(
        image, frame_start=start, frame_duration=max(image.frame_duration, int(take.frame_numbers[-1]))
    )


def _sequence(image: bpy.types.Image, take: Take, timing: Timing) -> Plate:
    """Blender shows file number (scene frame - start + 1 + offset): both ends on the same numbers."""
    first, last = int(take.frame_numbers[0]), int(take.frame_numbers[-1])
    start = _first_scene_frame(take, timing)
    return Plate(image, frame_start=start, frame_offset=first - 1, frame_duration=last - first + 1)


def _first_scene_frame(take: Take, timing: Timing) -> int:
    return round(float(timing.scene_frames(take.frame_numbers[:1])[0]))


def _upright_copy(image: bpy.types.Image, orientation: int) -> bpy.types.Image:
    """Blender ignores EXIF orientation: a packed copy of the pixels, turned as the camera was held."""
    width, height = image.size
    pixels = np.empty(width * height * 4, dtype=np.float32)
    image.pixels.foreach_get(pixels)
    # Blender's first row is the bottom one.
    rows = upright(pixels.reshape(height, width, 4)[::-1], orientation)
    copy = bpy.data.images.new(f"{image.name} upright", rows.shape[1], rows.shape[0], alpha=False)
    copy.colorspace_settings.name = image.colorspace_settings.name
    copy.pixels.foreach_set(np.ascontiguousarray(rows[::-1], dtype=np.float32).ravel())
    copy.update()
    copy.pack()
    return copy


def missing_picture(camera: bpy.types.Object | None) -> str:
    """The name of the picture that the camera should show and that is not where it was; empty if all is
    well. Cheap enough for drawing."""
    backgrounds = camera.data.background_images if camera is not None and camera.type == "CAMERA" else ()
    for background in backgrounds:
        image = background.image if background.source == "IMAGE" else None
        if image is None or image.packed_file or image.source not in {"FILE", "SEQUENCE", "MOVIE"}:
            continue
        path = Path(bpy.path.abspath(image.filepath, library=image.library))
        if not is_file(path):
            return path.name
    return ""
