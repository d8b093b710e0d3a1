"""The second camera of a take of two views: where it stood, before its own picture, in the scene's time."""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import dataclass

import bpy
import numpy as np
from mathutils import Matrix

from handfit_core.capturing.retiming import is_other_rate
from handfit_core.hand_model import axes
from handfit_core.take import Take

from ..common.wording import named_after
from .background import Plate, loading_plate, shown_number
from .camera import build_camera, put_before
from .store import captured_take, clip_timing
from .timing import Timing, check_range

VIEW_DISPLAY_SIZE = 0.1
"""share of Blender's usual one: either camera may stand in the other's picture, before the hand"""


@dataclass(frozen=True)
class BuiltView:
    """What `building_view` made, linked to no collection yet."""

    camera: bpy.types.Object
    take: Take
    """The view's clip, without hands"""
    plate: Plate | None
    warnings: tuple[str, ...]


def view_timing(take: Take, clip: Timing) -> Timing:
    """Where the frames of a take's second view lie in the time of a scene in which its own lie as `clip`
    says."""
    assert take.cameras is not None
    view = take.cameras.views[0]
    rate = clip.scale * take.fps
    scale = rate / view.fps if is_other_rate(rate, view.fps) else 1.0
    began = float(clip.scene_frames(take.frame_numbers[:1])[0]) + rate * float(take.cameras.time_offset[1])
    return Timing(began - scale * float(view.frame_numbers[0]), scale)


def row_of_view(collection: bpy.types.Collection, frame: float) -> int | None:
    """The row, among the frames of a capture's second view, of the picture that its plate shows on a scene
    frame; None where the clip has none. Raises TakeError."""
    captured = captured_take(collection)
    view, timing = captured.view(1), view_timing(captured, clip_timing(collection))
    rows = np.flatnonzero(view.frame_numbers == shown_number(view, timing, int(np.floor(frame + 1e-3))))
    return int(rows[0]) if len(rows) else None


def building_view(
    take: Take,
    clip: Timing,
    *,
    picture: bool,
    scene: bpy.types.Scene | None,
    units_per_metre: float,
    before: bpy.types.Object | None,
    max_megapixels: float | None,
) -> Generator[None, None, BuiltView]:
    """The camera of the take's second view, in small steps. `scene`: one that keeps its own size, as in
    `build_camera`; `before`: the artist's camera that the hands hang on, on which it hangs, too. Raises
    TakeError."""
    assert take.cameras is not None
    view, timing = take.view(1), view_timing(take, clip)
    check_range(view, timing)
    plate, warnings = None, []
    if picture:
        plate, warnings = yield from loading_plate(view, timing, max_megapixels)
    if plate is not None and take.cameras.views[0].mirrored:
        plate = plate.mirrored()
    name = named_after(view.source.name, "camera")
    camera = build_camera(name, view, plate, scene=scene, units_per_metre=units_per_metre)
    place = axes.camera_in_world(take.cameras.rotation[1], take.cameras.translation[1])
    place[:3, 3] *= units_per_metre
    camera.matrix_basis = Matrix(place.tolist())
    if before is not None:
        put_before(camera, before)
    return BuiltView(camera, view, plate, tuple(warnings))
