"""Calibrations of cameras in aniposelib's TOML layout, which FreeMoCap, caliscope and Pose2Sim write, too.

A table for each camera has `name`, `size` (width, height), `matrix` (3, 3), `distortions` (k1, k2, p1, p2,
k3), `rotation` (Rodrigues) and `translation`, with x_camera = R x_world + t. OpenCV's pixels have their
origin at a pixel's centre, half a pixel from ours. FreeMoCap's lengths are millimetres. Other models of
cameras than OpenCV's first one (fisheye, rational, skewed) are refused.
"""

from __future__ import annotations

import json
import os
import tomllib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from handfit_core.common.errors import InputError, OptionError
from handfit_core.common.files import read_file, shown, why, written_whole
from handfit_core.common.values import number, shortly
from handfit_core.geometry.camera import Intrinsics
from handfit_core.geometry.lens import Lens
from handfit_core.geometry.rotations import rotmat_to_rotvec, rotvec_to_rotmat
from handfit_core.take import Take

LARGEST_FILE: Final = 1 << 20
_MOST_DOTS: Final = 200
"""Dots in one line of the file: a key of many parts would cost the reader gigabytes. A camera's numbers, all
in one line, have 20"""
_LARGEST_NUMBER: Final = 1e6
"""pixels, millimetres"""
_WIDEST_PIXEL: Final = 3.0
"""By which factor fx and fy may differ: pixels of anamorphic lenses are up to twice as wide as high"""
_LARGEST_SKEW: Final = 1e-3
"""of fx; half a pixel at the edge"""
_MOST_DISTORTIONS: Final = 14
"""of OpenCV's; those after the fifth must be 0"""
_MOST_LISTED: Final = 8
"""cameras in a sentence"""
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
        chosen = _chosen(_tables(_read(path)), names)
        lenses = tuple(_lens(camera) for camera in chosen)
        (r0, t0), (r1, t1) = (_place(camera) for camera in chosen)
    except (OSError, ValueError, KeyError, TypeError, OptionError) as error:
        reason = why(error) if isinstance(error, OSError) else error
        reason = f"it lacks {error}" if isinstance(error, KeyError) else reason
        raise InputError(
            f"{shown(path)}: not a calibration of two cameras in aniposelib's TOML layout ({reason}); give "
            "one with name, size, matrix, distortions, rotation and translation for each camera"
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


def _read(path: str | os.PathLike[str]) -> dict[str, Any]:
    text = read_file(Path(path), LARGEST_FILE).decode("utf-8-sig")
    try:
        if max(line.count(".") for line in text.split("\n")) > _MOST_DOTS:
            raise RecursionError
        return tomllib.loads(text)
    except RecursionError:
        raise ValueError("it is nested deeper, or has longer lines of numbers, than any") from None


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
        listed = ", ".join(shortly(camera.get("name", "?")) for camera in cameras[:_MOST_LISTED])
        more = " and others" if len(cameras) > _MOST_LISTED else ""
        raise ValueError(
            f"it has {len(cameras)} cameras, {listed}{more}: name two of them as the clips are called"
        )
    return cameras


def _lens(camera: dict[str, Any]) -> Lens:
    name = shortly(camera.get("name", "?"))
    if camera.get("fisheye"):
        raise ValueError(f"camera {name} is a fisheye, which is not known here: use the ordinary model")
    (fx, skew, cx), (*below, fy, cy), *last = _numbers("matrix", camera["matrix"], 9).reshape(3, 3).tolist()
    if (below, last) != ([0.0], [[0.0, 0.0, 1.0]]) or abs(skew) > _LARGEST_SKEW * abs(fx):
        raise ValueError(f"the matrix of camera {name} is not [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]")
    measured = Intrinsics(fx, fy, cx + 0.5, cy + 0.5)
    if max(fx / fy, fy / fx) > _WIDEST_PIXEL:
        raise ValueError(f"camera {name} has fx {fx:g} and fy {fy:g}, which are almost equal in cameras")
    given = _numbers("distortions", camera.get("distortions", ()))
    if len(given) > _MOST_DISTORTIONS or given[5:].any():
        raise ValueError(f"camera {name} has {len(given)} distortions, and k1, k2, p1, p2, k3 are known here")
    k1, k2, p1, p2, k3 = np.append(given, np.zeros(5))[:5].tolist()
    width, height = _numbers("size", camera["size"], 2)
    return Lens(measured, (k1, k2, p1, p2, k3), int(width), int(height))


def _place(camera: dict[str, Any]) -> tuple[np.ndarray, np.ndarray]:
    rotation, translation = (_numbers(name, camera[name], 3) for name in ("rotation", "translation"))
    return rotvec_to_rotmat(rotation), translation


def _numbers(name: str, value: Any, count: int | None = None) -> np.ndarray:
    """(N,) the numbers in a list of numbers or of lists of them; `count`: how many there must be."""

    def listed(value: Any) -> Iterator[float]:
        for each in value:
            yield from listed(each) if isinstance(each, list) else [number(name, each, -most, most)]

    most = _LARGEST_NUMBER
    found = np.array(list(listed(value)))
    if count not in (None, len(found)):
        raise ValueError(f"{name} has {len(found)} numbers, and must have {count}")
    return found


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
