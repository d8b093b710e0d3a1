"""Previews: the captured picture, and the same with the fitted hands rendered over it.

Rendered by Cycles on the CPU, which works without a window or a graphics card. Everything happens in
a scene that is removed afterwards.
"""

from __future__ import annotations

import contextlib
import tempfile
from collections.abc import Iterator
from pathlib import Path

import bpy
import numpy as np

from handfit_core.common.errors import OutputError
from handfit_core.common.files import check_room, written_whole
from handfit_core.take import Take

from .background import Plate, load_plate, rows_of
from .build import BuiltTake
from .camera import build_camera, frame_scene
from .own_scene import unseen_scene, with_values
from .proof import is_whole_png, prove_whole
from .render_setup import SUNS, picture_card, sun

LONGEST_SIDE = 1200
"""Pixels of the longer side of each half of a preview, at most"""
MISSING = (0.18, 0.18, 0.18)
"""The sRGB colour that is shown where the picture file is gone"""
_SAMPLES = 16
_SKIN_SAMPLES = 64
"""How many samples per pixel Cycles takes of hands: their skin scatters light"""


def render_preview(
    built: BuiltTake, take: Take, frame: int, path: Path, *, max_megapixels: float | None = None
) -> Path:
    """Write a PNG: left the picture, right the same with the hands over it through the solved camera, opaque
    and in their own materials.

    `frame` is a source frame number, `max_megapixels` as in `build_take`. The longer side of each half is at
    most `LONGEST_SIDE` pixels. Raises OutputError.
    """
    return write_png(preview_rows(built, take, frame, max_megapixels=max_megapixels), path)


def preview_rows(
    built: BuiltTake, take: Take, frame: int, *, max_megapixels: float | None = None
) -> np.ndarray:
    """Return the preview of a frame as rows (H, 2 W, 3) of sRGB values 0..1, the first row on top."""
    scale = min(1.0, LONGEST_SIDE / max(take.width, take.height))
    plate, _ = load_plate(take, max_megapixels=max_megapixels)
    try:
        hands = render_hands(built, take, frame, scale)
        if plate is None:
            picture = np.broadcast_to(np.array(MISSING), (*hands.shape[:2], 3))
        else:
            picture = render_plate(plate, take, frame, scale)[..., :3]
    finally:
        if plate is not None:
            bpy.data.images.remove(plate.image)
    alpha = hands[..., 3:]
    return np.concatenate([picture, picture * (1 - alpha) + hands[..., :3] * alpha], axis=1)


def render_plate(plate: Plate, take: Take, frame: int, scale: float) -> np.ndarray:
    """Return the picture of one frame as rows (H, W, 4) of sRGB values 0..1, the first row on top.

    Rendering is the one way to a movie's frames that works in every Blender without a window. Each sample
    stays within its pixel, so at scale 1 the picture comes out as it went in."""
    with _scene(take, scale) as scene:
        camera = build_camera("preview plate", take, None)
        card = picture_card("preview card", plate, take, 1.0)
        try:
            for obj in (camera, card):
                scene.collection.objects.link(obj)
            scene.camera = camera
            scene.cycles.pixel_filter_type = "BOX"
            scene.cycles.samples = 1 if scale == 1.0 else _SAMPLES
            return _render(scene, frame)
        finally:
            remove_with_data(camera, card)


def write_png(rows: np.ndarray, path: Path) -> Path:
    """Write rows (H, W, 3) of sRGB values 0..1, the first row on top. Raises OutputError."""
    height, width = rows.shape[:2]
    pixels = np.ones((height, width, 4), dtype=np.float32)
    pixels[..., :3] = rows[::-1]
    image = bpy.data.images.new("preview", width, height, alpha=False)
    try:
        image.pixels.foreach_set(pixels.ravel())
        with written_whole(path) as beside:
            image.filepath_raw = str(beside)
            image.file_format = "PNG"
            try:
                image.save()
            except RuntimeError as error:
                check_room(beside, 1 << 16)
                reason = " ".join(str(error).split())
                raise OutputError(f"{path}: Blender could not write the picture ({reason})") from error
            prove_whole(path, beside, is_whole_png)
    finally:
        bpy.data.images.remove(image)
    return path


def spread_frames(take: Take, count: int) -> list[int]:
    """Return up to `count` source frame numbers with a hand in them, evenly spread over the take."""
    seen = np.any([track.present for track in take.hands], axis=0)
    numbers = np.asarray(take.frame_numbers)[seen]
    picked = np.linspace(0, len(numbers) - 1, min(count, len(numbers))).round().astype(int)
    return [int(n) for n in numbers[np.unique(picked)]]


def render_hands(built: BuiltTake, take: Take, frame: int, scale: float) -> np.ndarray:
    """Return the hands of that frame over nothing, through the solved camera: rows (H, W, 4) of sRGB values
    0..1 with straight alpha."""
    row = int(np.searchsorted(take.frame_numbers, frame))
    with _scene(take, scale) as scene:
        lights = [sun("preview light", *placed) for placed in SUNS]
        try:
            for light in lights:
                scene.collection.objects.link(light)
            for hand, track in zip(built.hands, take.hands, strict=True):
                if track.present[row]:
                    scene.collection.objects.link(hand.armature)
                    scene.collection.objects.link(hand.mesh)
            scene.camera = built.camera
            scene.render.film_transparent = True
            scene.cycles.samples = _SKIN_SAMPLES
            scene.cycles.max_bounces = 2
            return _render(scene, frame)
        finally:
            remove_with_data(*lights)


@contextlib.contextmanager
def _scene(take: Take, scale: float) -> Iterator[bpy.types.Scene]:
    """Make a scene of the take's picture size that shows colours as they are, removed afterwards.

    It is the open one meanwhile, since movies and image sequences follow that one's frame whichever scene is
    rendered. Blender has no window here that an artist looks at.
    """
    with unseen_scene("preview") as scene:
        frame_scene(scene, take, scale)
        scene.render.engine = "CYCLES"
        scene.render.use_sequencer = False
        scene.render.use_compositing = False
        scene.render.dither_intensity = 0.0
        scene.render.image_settings.file_format = "PNG"
        scene.render.image_settings.color_mode = "RGBA"
        scene.render.image_settings.compression = 0
        scene.view_settings.view_transform = "Standard"
        scene.view_settings.look = "None"
        scene.cycles.device = "CPU"
        scene.cycles.use_denoising = False
        scene.cycles.use_adaptive_sampling = False
        with with_values([(bpy.context.window, "scene", scene)]):
            yield scene


def _render(scene: bpy.types.Scene, frame: int) -> np.ndarray:
    """Render one frame of the scene: rows (H, W, 4), the first row on top."""
    scene.frame_set(frame)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "render.png"
        scene.render.filepath = str(path)
        bpy.ops.render.render(write_still=True)
        image = bpy.data.images.load(str(path), check_existing=False)
        try:
            # The bytes as they are: no colour space, no premultiplied alpha.
            image.colorspace_settings.name = "Non-Color"
            image.alpha_mode = "CHANNEL_PACKED"
            return rows_of(image)
        finally:
            bpy.data.images.remove(image)


def remove_with_data(*objects: bpy.types.Object) -> None:
    """Remove objects, their data and the materials of that."""
    for obj in objects:
        data = obj.data
        materials = list(getattr(data, "materials", ()))
        bpy.data.batch_remove([obj, data, *materials])
