"""The captured picture as a Blender image: photo, image sequence or movie, upright, frame by frame."""

from __future__ import annotations

import contextlib
from collections.abc import Generator
from dataclasses import dataclass, replace
from math import floor
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from handfit_core.common.errors import InputError
from handfit_core.common.files import is_file
from handfit_core.common.slices import run_to_completion
from handfit_core.media.copies import copy_path
from handfit_core.media.opening import numbered_like, sequence_numbers
from handfit_core.media.size_limit import check_for_blender, common_limit, is_picture, is_video
from handfit_core.take import Take

from ..common import preferences
from ..common.blender_versions import turns_movies
from .timing import Timing

_UPRIGHT = {
    1: (False, False, 0),
    2: (True, False, 0),
    3: (True, True, 0),
    4: (False, True, 0),
    5: (True, False, -1),
    6: (False, False, 1),
    7: (True, False, 1),
    8: (False, False, -1),
}
"""By EXIF orientation: whether the stored picture is flipped in x and in y, and how many quarter turns
clockwise it is given then, so that it is upright"""
_AFTER_BLENDERS_TURN = {2: 4, 4: 4, 5: 2, 7: 2}
"""By the orientation of a movie, the one that is left where Blender has turned it: it takes a display matrix
for the rotation of the picture's x axis, and knows no reflections"""

_WHOLE = 1e-6
"""Frames within which a moment counts as that of a frame"""


@dataclass(frozen=True)
class Plate:
    """An image and the settings with which scene frame n shows the source's frame n."""

    image: bpy.types.Image
    frame_start: int = 1
    frame_offset: int = 0
    frame_duration: int = 1
    offset_driver: str = ""
    """The expression that drives the offset where scene frames are not the source's: a simple one of `frame`,
    which Blender evaluates without Python"""
    orientation: int = 1
    """The EXIF orientation (1-8) that the image has, and that is undone where it is shown"""

    @property
    def placing(self) -> tuple[bool, bool, int]:
        """Return whether the image is flipped in x, and in y, where it is shown, and the number of quarter
        turns clockwise (-1, 0 or 1) that it is given after that."""
        return _UPRIGHT[self.orientation]

    def mirrored(self) -> Plate:
        """Return the plate with left and right exchanged where it is shown."""
        return replace(self, orientation=(self.orientation - 1 ^ 1) + 1)

    def places(self, uv: np.ndarray) -> np.ndarray:
        """Return texture coordinates (N, 2) in the image of texture coordinates (N, 2) in the upright
        picture."""
        flip_x, flip_y, turns = self.placing
        x, y = np.asarray(uv).T - 0.5
        for _ in range(turns % 4):
            x, y = -y, x
        return 0.5 + np.stack([-x if flip_x else x, -y if flip_y else y], axis=-1)

    def apply_timing(self, user: bpy.types.ImageUser) -> None:
        """Give the plate's timing to an image user (of a background image or of a texture node)."""
        user.frame_duration = self.frame_duration
        user.frame_start = self.frame_start
        user.frame_offset = self.frame_offset
        user.use_auto_refresh = True
        drive_offset(user, self.offset_driver)


def drive_offset(user: bpy.types.ImageUser, expression: str) -> None:
    """Drive an image user's offset by a simple expression of `frame`; by nothing where that is empty."""
    user.driver_remove("frame_offset")
    if expression:
        driver = user.driver_add("frame_offset").driver
        driver.type, driver.expression = "SCRIPTED", expression


def offset_driver(user: bpy.types.ImageUser) -> str:
    """Return the expression that drives an image user's offset; empty where nothing does."""
    owner = user.id_data
    data = owner.animation_data if owner is not None else None
    curve = data.drivers.find(user.path_from_id("frame_offset")) if data is not None else None
    return curve.driver.expression if curve is not None and curve.driver is not None else ""


def load_plate(
    take: Take, timing: Timing | None = None, max_megapixels: float | None = None
) -> tuple[Plate | None, list[str]]:
    """Load a take's picture at once, as `loading_plate` does in steps."""
    return run_to_completion(loading_plate(take, timing, max_megapixels))


def loading_plate(
    take: Take, timing: Timing | None = None, max_megapixels: float | None = None
) -> Generator[None, None, tuple[Plate | None, list[str]]]:
    """Load the take's picture in steps; return it, and what the user should know about it.

    `timing` says where the clip's frames lie in the scene's time; without it, on its own frame numbers.
    `max_megapixels` is how large it may be, instead of what the preferences say.
    Hands of another program may have none, and a file that is missing, unreadable or too large gives no plate
    and a warning.
    """
    timing = timing or Timing()
    if take.source.kind == "data":
        return None, []
    path, is_copy = shown_file(take)
    if not is_file(path):
        return None, [f"{path}: the picture is not there any more, so nothing is shown behind the hands"]
    refused = yield from _checking(path, take, max_megapixels or preferences.get().max_megapixels or None)
    if refused:
        return None, [refused]
    try:
        # `check_existing` stays off: another take's copy of the same picture may be timed differently.
        image = bpy.data.images.load(str(path), check_existing=False)
    except RuntimeError:
        return None, [_unreadable(path)]
    if take.source.kind == "video":
        image.source = "MOVIE"
    with contextlib.suppress(OSError, TypeError):  # a studio's own OpenColorIO may have no such name
        if _is_video_dpx(path):
            image.colorspace_settings.name = "sRGB"
    size = tuple(image.size)  # asked here, since as a sequence it is that of a frame not yet chosen
    if 0 in size:
        bpy.data.images.remove(image)
        return None, [_unreadable(path)]
    if take.source.kind == "video":
        plate = movie_plate(image, take, timing)
    elif take.source.kind == "sequence":
        image.source = "SEQUENCE"
        # Blender shows file number (scene frame - start + 1 + offset): both ends on the same numbers.
        first, last = int(take.frame_numbers[0]), int(take.frame_numbers[-1])
        plate = Plate(image, _first_scene_frame(take, timing), first - 1, last - first + 1)
    else:
        plate = Plate(image)
    orientation = 1 if is_copy else take.source.orientation
    if is_copy and take.source.kind == "photo":
        image.name = take.source.name
        image.pack()
    if take.source.kind == "video" and turns_movies():
        orientation = _AFTER_BLENDERS_TURN.get(orientation, 1)
    plate = replace(plate, orientation=orientation)
    turned = plate.placing[2] != 0
    pixel = size[1] / size[0] * (1.0 / picture_aspect(take) if turned else picture_aspect(take))
    image.display_aspect = (max(1.0, pixel), max(1.0, 1.0 / pixel))
    return plate, _mismatches(path, size[::-1] if turned else size, take)


def _is_video_dpx(path: Path) -> bool:
    """True if the file is a DPX that holds values as they are shown, all of which Blender takes for linear
    ones; it makes film densities linear itself."""
    with open(path, "rb") as stream:
        head = stream.read(802)
    return head[:4] in (b"SDPX", b"XPDS") and head[801:] not in (b"\1", b"\3")  # SMPTE 268M: transfer


def shown_file(take: Take) -> tuple[Path, bool]:
    """Return the file that Blender shows, and whether it is an upright copy of one that it cannot read."""
    copy = copy_path(take.source)
    if copy is not None and is_file(copy):
        return copy, True
    # Absolute, since Blender's FFmpeg takes a relative name that begins with "http:" for an address.
    return Path(take.source.files[0]).absolute(), False


def picture_aspect(take: Take) -> float:
    """Return the width of the upright picture over its height, as the scene was seen."""
    return take.width * take.intrinsics.fy / (take.height * take.intrinsics.fx)


def _checking(path: Path, take: Take, max_megapixels: float | None) -> Generator[None, None, str]:
    """Look at the first bytes of every file that Blender will open for this plate; why one must not be
    opened, or nothing. A take may name any file, and Blender opens pictures of a sequence that no take
    names."""
    files = [path]
    if take.source.kind == "sequence":
        first, last = int(take.frame_numbers[0]), int(take.frame_numbers[-1])
        files += [file for number, file in numbered_like(path) if first <= number <= last]
    limit = common_limit(files, max_megapixels)
    for file in files:
        yield
        try:
            if not is_picture(file) and not is_video(file):
                return _unreadable(file)
            check_for_blender(file, limit)
        except InputError as error:
            return f"{error}; nothing is shown behind the hands"
    return ""


def _unreadable(path: Path) -> str:
    return f"{path}: Blender cannot read this picture, so nothing is shown behind the hands"


def _mismatches(path: Path, size: tuple[int, ...], take: Take) -> list[str]:
    """Return a sentence for each point in which the picture that Blender shows is not the one that the
    capture saw."""
    files = [Path(f) for f in take.source.files]
    if take.source.kind == "sequence" and sequence_numbers(files) != [int(n) for n in take.frame_numbers]:
        return [
            f"{path.parent}: the pictures' names are not one numbered sequence, so Blender cannot show "
            "them one after the other behind the hands; number them to see them"
        ]
    # The capture stretches one side of a clip whose pixels are not square.
    same = [a == b for a, b in zip(size, (take.width, take.height), strict=True)]
    if not (any(same) if take.source.kind == "video" else all(same)):
        return [
            f"{path}: Blender reads {size[0]} x {size[1]} pixels where the capture had {take.width} x "
            f"{take.height}, so the picture may not fit behind the hands"
        ]
    return []


def movie_plate(image: bpy.types.Image, take: Take, timing: Timing) -> Plate:
    """Blender shows frame (scene frame - start + 1): the take's first frame where its first keys are."""
    last = max(image.frame_duration, int(take.frame_numbers[-1]))
    if timing.scale != 1.0:
        return retimed_plate(image, take, timing, last)
    start = _first_scene_frame(take, timing) - int(take.frame_numbers[0]) + 1
    return Plate(image, frame_start=start, frame_duration=last)


def retimed_plate(image: bpy.types.Image, take: Take, timing: Timing, last: int) -> Plate:
    """Return the plate of a video of `last` frames at another rate than its own: on every scene frame it
    shows the picture whose moment is the nearest, as `handfit_core.capturing.retiming.shown_numbers` has
    it."""
    number, first = int(take.frame_numbers[0]), _first_scene_frame(take, timing)
    start = first - int((number - 1) * timing.scale)
    duration = int((last - 1) * timing.scale) + 1
    at = _beginning(take, timing)
    wanted = f"floor({number} + (frame - ({at})) / {timing.scale!r} + 0.5)"
    plain = f"max(0, min({duration}, frame - ({start - 1})))"
    return Plate(image, start, 0, duration, f"max(1, min({last}, {wanted})) - {plain}")


def _beginning(take: Take, timing: Timing) -> float:
    """Return the scene frame of the first picture; a further view's lies between two scene frames."""
    first, exact = _first_scene_frame(take, timing), float(timing.scene_frames(take.frame_numbers[:1])[0])
    return first if abs(exact - first) < _WHOLE else round(exact, 6)


def shown_number(take: Take, timing: Timing, frame: int) -> int:
    """Return the number of the picture that the plate of a take shows on a scene frame; a number that the
    clip lacks, before its beginning and after its end."""
    number = int(take.frame_numbers[0])
    if take.source.kind == "video" and timing.scale != 1.0:
        return floor(number + (frame - _beginning(take, timing)) / timing.scale + 0.5)
    return number + frame - _first_scene_frame(take, timing)


def _first_scene_frame(take: Take, timing: Timing) -> int:
    return round(float(timing.scene_frames(take.frame_numbers[:1])[0]))


def path_of(block: Any) -> Path:
    """Return the path of the file of an image or a movie clip."""
    return Path(bpy.path.abspath(block.filepath, library=block.library)).absolute()


def rows_of(image: bpy.types.Image) -> np.ndarray:
    """Return an image's own values, (H, W, 4), with the first row on top; Blender's first row is the bottom
    one."""
    width, height = image.size
    pixels = np.empty(width * height * 4, dtype=np.float32)
    image.pixels.foreach_get(pixels)
    return pixels.reshape(height, width, 4)[::-1]


def missing_picture(camera: bpy.types.Object | None) -> str:
    """Return the name of the picture that the camera should show and that is not where it was; empty if all
    is well. Cheap enough for drawing."""
    backgrounds = camera.data.background_images if camera is not None and camera.type == "CAMERA" else ()
    for background in backgrounds:
        image = background.image if background.source == "IMAGE" else None
        if image is None or image.packed_file or image.source not in {"FILE", "SEQUENCE", "MOVIE"}:
            continue
        if not is_file(path_of(image)):
            return path_of(image).name
    return ""
