"""Render a built scene's frame to a JPEG file, with a sensor's noise."""

from __future__ import annotations

import tempfile
from pathlib import Path

import bpy
import numpy as np

from handfit_core.common.errors import OutputError
from handfit_core.common.files import written_whole

from .shots import Shot


def draw(shot: Shot, picture: int, path: Path) -> None:
    """Render picture number `picture` of the shot that the open scene was built from.

    Raises OutputError.
    """
    # The camera is the shot's: a clip's pictures share the sensor's gain and the JPEG quality.
    settings = np.random.default_rng((*shot.look_seed, 0))
    gain = float(settings.uniform(0.0, 0.03))
    quality = int(settings.integers(60, 96))
    rgb = _render(picture + shot.lead)
    noise = np.random.default_rng((*shot.look_seed, 1, picture))
    # Shot noise grows with the root of the light, read noise does not; `gain` is the deviation at white.
    spread = gain * np.sqrt(np.clip(rgb, 0.0, 1.0)) + 0.25 * gain
    _write_jpeg(np.clip(rgb + spread * noise.standard_normal(rgb.shape), 0.0, 1.0), path, quality)


def _render(frame: int) -> np.ndarray:
    """(H, W, 3) sRGB values 0..1, the first row on top."""
    scene = bpy.context.scene
    scene.frame_set(frame)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "picture.png"
        scene.render.filepath = str(file)
        bpy.ops.render.render(write_still=True)
        picture = bpy.data.images.load(str(file))
        picture.colorspace_settings.name = "Non-Color"  # the bytes as they are
        values = np.empty(len(picture.pixels), dtype=np.float32)
        picture.pixels.foreach_get(values)  # only now does Blender read the file
        columns, rows = picture.size
    bpy.data.images.remove(picture)
    return values.reshape(rows, columns, 4)[::-1, :, :3]


def _write_jpeg(rgb: np.ndarray, path: Path, quality: int) -> None:
    height, width = rgb.shape[:2]
    pixels = np.ones((height, width, 4), dtype=np.float32)
    pixels[..., :3] = rgb[::-1]
    image = bpy.data.images.new("picture", width, height, alpha=False)
    try:
        image.pixels.foreach_set(pixels.ravel())
        with written_whole(path) as beside:
            image.file_format = "JPEG"
            try:
                image.save(filepath=str(beside), quality=quality)
            except RuntimeError as error:
                raise OutputError(f"{path}: Blender could not write the picture ({error})") from error
    finally:
        bpy.data.images.remove(image)
