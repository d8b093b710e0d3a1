"""Where a take's frames lie in a scene's time."""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction

import bpy
import numpy as np

from handfit_core.capturing.retiming import check_rate, is_other_rate, retimed
from handfit_core.common.errors import TakeError
from handfit_core.take import Take

LAST_FRAME = 1_048_574
"""The last frame of Blender's timeline, in both directions"""


@dataclass(frozen=True)
class Timing:
    """Where a source's frames lie in the scene's time: scene frame = offset + scale * source frame."""

    offset: float = 0.0
    scale: float = 1.0

    def scene_frames(self, frame_numbers: np.ndarray) -> np.ndarray:
        """Return the scene frames (T,) of source frame numbers (T,); they may lie between whole ones."""
        return self.offset + self.scale * np.asarray(frame_numbers, dtype=np.float64)

    def source_frames(self, frames: np.ndarray) -> np.ndarray:
        """Return the source frame numbers (N,), whole or not, of scene frames (N,): the inverse of
        `scene_frames`."""
        return (np.asarray(frames, dtype=np.float64) - self.offset) / (self.scale or 1.0)


def check_range(take: Take, timing: Timing) -> None:
    """Raise TakeError where the take would lie beyond Blender's timeline."""
    first, last = timing.scene_frames(take.frame_numbers[[0, -1]])
    if max(abs(first), abs(last)) > LAST_FRAME:
        raise TakeError(
            f"the take's frames would lie at {first:.0f} to {last:.0f}, and Blender's timeline ends at "
            f"{LAST_FRAME}; number the pictures from 1, or build the hands in the scene's own time"
        )


def has_rate(take: Take) -> bool:
    """True if the take's pictures have times of their own; photos and image sequences have none."""
    return take.source.kind in ("video", "data")


def frame_rate(scene: bpy.types.Scene) -> float:
    """Return the scene's rate in frames per second."""
    return scene.render.fps / scene.render.fps_base


def span_of(scene: bpy.types.Scene) -> tuple[int, int]:
    """Return the first and last scene frame: of the preview range where it is used, else of the scene's
    own."""
    if scene.use_preview_range:
        return scene.frame_preview_start, scene.frame_preview_end
    return scene.frame_start, scene.frame_end


def timing_in(scene: bpy.types.Scene, take: Take, frame: float | None = None) -> Timing:
    """Return where the take lies in the scene's own time: its first frame at `frame` (None: the current one),
    as fast as it was filmed.

    Photos and image sequences have no rate of their own: each of their pictures is a scene frame.
    """
    scale = frame_rate(scene) / take.fps if has_rate(take) and is_retimed(scene, take.fps) else 1.0
    return Timing(
        (scene.frame_current if frame is None else frame) - scale * float(take.frame_numbers[0]), scale
    )


def in_scene(scene: bpy.types.Scene, take: Take, frame: float | None = None) -> tuple[Take, Timing, Timing]:
    """Return the take in the scene's own time, as `timing_in` says, with a row on each of the scene's whole
    frames where the clip has another rate. Returns it, where its rows lie, and where the clip's own frames
    lie.

    Raises OptionError for rates that no clip is retimed to.
    """
    clip = timing_in(scene, take, frame)
    if clip.scale == 1.0:
        return take, clip, clip
    check_rate(frame_rate(scene))
    number = int(take.frame_numbers[0])
    first = round(float(clip.scene_frames(np.array([number]))[0]))
    return (
        retimed(take, clip.scale),
        Timing(float(first - number)),
        Timing(first - clip.scale * number, clip.scale),
    )


def view_timing(take: Take, clip: Timing) -> Timing:
    """Return where the frames of a take's second view lie in the time of a scene in which the first view's
    lie as `clip` says."""
    assert take.cameras is not None
    view = take.cameras.views[0]
    rate = clip.scale * take.fps
    scale = rate / view.fps if is_other_rate(rate, view.fps) else 1.0
    began = float(clip.scene_frames(take.frame_numbers[:1])[0]) + rate * float(take.cameras.time_offset[1])
    return Timing(began - scale * float(view.frame_numbers[0]), scale)


def is_retimed(scene: bpy.types.Scene, fps: float) -> bool:
    """True if a clip of `fps` frames per second is retimed in a scene that keeps its own rate."""
    return is_other_rate(frame_rate(scene), fps)


def nearest_rate(fps: float) -> tuple[int, float]:
    """Return a rate in frames per second as scenes keep it, a whole rate and its divisor: 30 and 1.001 for
    29.97."""
    nearest = max(1, round(fps))
    return nearest, float(np.float32(1 / Fraction(fps / nearest).limit_denominator(1001)))


def set_timing(scene: bpy.types.Scene, take: Take) -> None:
    """Give the scene the take's frame rate and range."""
    scene.render.fps, scene.render.fps_base = nearest_rate(take.fps)
    scene.frame_start = int(take.frame_numbers[0])
    scene.frame_end = int(take.frame_numbers[-1])
