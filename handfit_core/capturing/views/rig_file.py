"""Calibrations of cameras in aniposelib's TOML layout, which FreeMoCap, caliscope and Pose2Sim write, too.

A table for each camera has `name`, `size` (width, height), `matrix` (3, 3), `distortions` (k1, k2, p1, p2,
k3), `rotation` (Rodrigues) and `translation`, with x_camera = R x_world + t. OpenCV's pixels have their
origin at a pixel's centre, half a pixel from ours. FreeMoCap's lengths are millimetres.
"""

from __future__ import annotations

import json
import os
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from handfit_core.common.errors import InputError, OptionError
from handfit_core.common.files import read_file, shown, written_whole
from handfit_core.geometry.camera import Intrinsics
from handfit_core.geometry.lens import Lens
from handfit_core.geometry.rotations import rotmat_to_rotvec, rotvec_to_rotmat
from handfit_core.take import Take

LARGEST_FILE: Final = 1 << 20
FARTHEST_APART: Final = 20.0
"""Two cameras whose distance is a larger number stand in millimetres"""


@dataclass(frozen=True, eq=False)
class Rig:
    """Two calibrated cameras."""

    lenses: tuple[Lens, Lens]
    rotation: np.ndarray
    """(3, 3)"""
    translation: np.ndarray
    """(3,) metres; x_2 = rotation x_1 + translation"""


def read_rig(path: str | os.PathLike[str], names: Sequence[str], sizes: Sequence[tuple[int, int]]) -> Rig:
    """The cameras of two clips with those names (stems of their files) and sizes (width, height): those that
    are called so, or else both that there are. Raises InputError, and OptionError for pictures of another
    shape."""
    try:
        cameras = _tables(tomllib.loads(read_file(Path(path), LARGEST_FILE).decode()))
        chosen = _chosen(cameras, names)
        lenses = tuple(_lens(camera) for camera in chosen)
        (r0, t0), (r1, t1) = (_place(camera) for camera in chosen)
    except (OSError, ValueError, KeyError, TypeError) as error:
        why = f"it lacks {error}" if isinstance(error, KeyError) else error
        raise InputError(
            f"{shown(path)}: not a calibration of two cameras in aniposelib's TOML layout ({why}); give one "
            "with name, size, matrix, distortions, rotation and translation for each camera"
        ) from error
    scaled = []
    for nth, name, lens, size in zip(("first", "second"), names, lenses, sizes, strict=True):
        try:
            scaled.append(lens.scaled(*size))
        except OptionError as error:
            raise OptionError(
                f"{shown(path)}: the {nth} view's camera was calibrated for {lens.width}x{lens.height}, and "
                f"{name} has another shape, {size[0]}x{size[1]}: calibrate the camera as it films"
            ) from error
    rotation = r1 @ r0.T
    translation = t1 - rotation @ t0
    if np.linalg.norm(translation) > FARTHEST_APART:
        translation = translation / 1000.0
    return Rig((scaled[0], scaled[1]), rotation, translation)


def _tables(document: dict[str, Any]) -> list[dict[str, Any]]:
    found = [table for name, table in document.items() if isinstance(table, dict) and "matrix" in table]
    if len(found) < 2:
        raise ValueError(f"it has {len(found) or 'no'} camera")
    return found


def _chosen(cameras: list[dict[str, Any]], names: Sequence[str]) -> list[dict[str, Any]]:
    def named(name: str) -> list[dict[str, Any]]:
        return [camera for camera in cameras if str(camera.get("name", "")) == name]

    matching = [named(name) for name in names]
    if all(len(each) == 1 for each in matching):
        return [each[0] for each in matching]
    if len(cameras) > len(names):
        listed = ", ".join(str(camera.get("name", "?")) for camera in cameras)
        raise ValueError(f"it has {len(cameras)} cameras, {listed}: name two of them as the clips are called")
    return cameras


def _lens(camera: dict[str, Any]) -> Lens:
    matrix = _array(camera["matrix"], (3, 3))
    width, height = (int(side) for side in camera["size"])
    distortion = np.zeros(5)
    given = np.ravel(np.asarray(camera.get("distortions", ()), dtype=np.float64))[:5]
    distortion[: len(given)] = given
    centre = matrix[:2, 2] + 0.5
    measured = Intrinsics(matrix[0, 0], matrix[1, 1], centre[0], centre[1])
    k1, k2, p1, p2, k3 = distortion.tolist()
    return Lens(measured, (k1, k2, p1, p2, k3), width, height)


def _place(camera: dict[str, Any]) -> tuple[np.ndarray, np.ndarray]:
    return rotvec_to_rotmat(_array(camera["rotation"], (3,))), _array(camera["translation"], (3,))


def _array(value: Any, shape: tuple[int, ...]) -> np.ndarray:
    array = np.asarray(value, dtype=np.float64)
    if array.shape != shape or not np.isfinite(array).all():
        raise ValueError(f"an array of {shape} numbers is {array.shape}")
    return array


def write_rig(path: str | os.PathLike[str], take: Take) -> None:
    """Write the cameras of a take of several views; metres. Raises OutputError, and OptionError where there
    is one view."""
    if take.cameras is None:
        raise OptionError("there are no cameras to write: the take has one view")
    clips = [take, *take.cameras.views]
    lines = []
    for i, (clip, camera) in enumerate(zip(clips, take.cameras.intrinsics, strict=True)):
        fx, fy, cx, cy = (float(value) for value in camera)
        lines += [
            f"[cam_{i}]",
            f"name = {json.dumps(clip.source.name, ensure_ascii=False)}",
            f"size = [{clip.width}, {clip.height}]",
            f"matrix = {[[fx, 0.0, cx - 0.5], [0.0, fy, cy - 0.5], [0.0, 0.0, 1.0]]}",
            "distortions = [0.0, 0.0, 0.0, 0.0, 0.0]",
            f"rotation = {rotmat_to_rotvec(take.cameras.rotation[i]).tolist()}",
            f"translation = {take.cameras.translation[i].tolist()}",
            "",
        ]
    with written_whole(path) as beside:
        beside.write_text("\n".join([*lines, "[metadata]", 'unit = "m"', ""]), encoding="utf-8")
