"""The artist's clip behind the scene's camera, or the one in which Blender's tracker has found its motion."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from handfit_core.media.opening import sequence_numbers

from .background import offset_driver, path_of
from .camera import frame_aspect
from .matching import is_of_a_capture
from .timing import Timing


@dataclass(frozen=True)
class CameraClip:
    """A movie, or an image sequence, that belongs to the scene's camera."""

    path: Path
    is_sequence: bool
    timing: Timing
    """Where its frames lie in the scene's time: Blender plays one on each scene frame, at any rate"""
    is_solved: bool
    """True if Blender's tracker has solved the camera's motion from the clip"""
    is_shown: bool
    """True if the clip is in the camera's background"""

    def is_of(self, files: Sequence[str]) -> bool:
        """True if a source of these files is this clip."""
        folder = Path(files[0]).parent
        same = os.path.normpath(folder) == os.path.normpath(self.path.parent)
        return same and str(folder / self.path.name) in files


def camera_clips(scene: bpy.types.Scene) -> list[CameraClip]:
    """Return the clips in the background of the scene's camera, and the solved ones that move it; none of a
    camera that a capture has built. Cheap enough for drawing."""
    camera = scene.camera
    if camera is None or camera.type != "CAMERA" or is_of_a_capture(camera):
        return []
    found: dict[Path, CameraClip] = {}
    for block, placed, background in _clips(scene, camera):
        path = path_of(block)
        is_movie_clip = isinstance(block, bpy.types.MovieClip)
        # A movie clip's first frame is the file that it names, an image's is the number 1.
        first = (sequence_numbers([path]) or [1])[0] if is_movie_clip and block.source == "SEQUENCE" else 1
        timing = Timing(float(placed.frame_start - placed.frame_offset - first))
        is_solved = is_movie_clip and _is_solved(block)
        found.setdefault(
            path, CameraClip(path, block.source == "SEQUENCE", timing, is_solved, background is not None)
        )
    return list(found.values())


def part_of_frame(scene: bpy.types.Scene, clip: CameraClip) -> tuple[float, float]:
    """Return the parts of the frame's width and height that the clip's picture takes where the scene's camera
    shows it."""
    for block, _, background in _clips(scene, scene.camera):
        if background is None or path_of(block) != clip.path:
            continue
        still = bpy.data.images.load(str(clip.path))  # a sequence has no size before it was drawn
        width, height = np.multiply(still.size, block.display_aspect)
        bpy.data.images.remove(still)
        if not width or background.rotation:  # unreadable, or turned, as `show_behind` does to the full width
            break
        ratio = 1.0 if background.frame_method == "STRETCH" else width / height / frame_aspect(scene)
        of_width = (ratio > 1.0) == (background.frame_method == "FIT")  # else of its height
        part = (1.0, 1.0 / ratio) if of_width else (ratio, 1.0)
        return part[0] * background.scale, part[1] * background.scale
    return 1.0, 1.0


def _clips(scene: bpy.types.Scene, camera: bpy.types.Object) -> Iterator[tuple[Any, Any, Any]]:
    """Yield the movie clip or image, the settings with its `frame_start` and `frame_offset`, and the
    background image; None where it is in none."""
    solvers = [each for each in camera.constraints if each.type == "CAMERA_SOLVER" and not each.mute]
    solving = [scene.active_clip if each.use_active_clip else each.clip for each in solvers]
    for background in camera.data.background_images:
        image, clip = background.image, background.clip
        if not background.show_background_image:
            continue
        if background.source == "MOVIE_CLIP":
            if background.use_camera_clip:
                clip = next(iter(solving), scene.active_clip)
            if clip is not None:
                yield clip, clip, background
        elif image is not None and image.source in ("MOVIE", "SEQUENCE"):
            user = background.image_user
            if not offset_driver(user):
                yield image, user, background
    if not solving and camera.animation_data is not None:
        solving = list(bpy.data.movieclips)
    for clip in solving:
        if clip is not None and _is_solved(clip):
            yield clip, clip, None


def _is_solved(clip: bpy.types.MovieClip) -> bool:
    return any(each.is_camera and each.reconstruction.is_valid for each in clip.tracking.objects)
