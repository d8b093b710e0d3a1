"""A hand before a camera, as a label and as a perfect detector would see it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from handfit_core.common.skeleton import Side
from handfit_core.detect.keypoints import Detections
from handfit_core.evaluate import ProtocolName
from handfit_core.evaluate.detections import UnitDetections
from handfit_core.evaluate.labels import Entry, HandLabel, Labels, units_of
from handfit_core.evaluate.rows import Rows, rows_of
from handfit_core.geometry.camera import Intrinsics
from handfit_core.geometry.rotations import rotmat_to_rotvec
from handfit_core.hand_model import load_model

WIDTH, HEIGHT = 640, 480
CAMERA = Intrinsics(600.0, 600.0, 320.0, 240.0)
PALM_TO_CAMERA = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
"""A right hand's palm to the camera, fingers up"""


def joints(side: Side = "right", at: tuple[float, float, float] = (0.1, 0.08, 0.5)) -> np.ndarray:
    """(21, 3) metres in the camera frame: a relaxed hand, its wrist near `at`."""
    model = load_model(None, side)
    mirror = 1.0 if side == "right" else -1.0
    facing = PALM_TO_CAMERA * np.array([mirror, 1.0, 1.0]) * np.array([1.0, mirror, 1.0])[:, None]
    wrist = model.shaped().joints[0]
    return model.keypoints(None, rotmat_to_rotvec(facing), model.hands_mean, np.array(at) - wrist)


def seen(points: np.ndarray, side: Side = "right", camera: Intrinsics = CAMERA) -> Detections:
    """What a detector without any error makes of (21, 3) points in metres."""
    depth = points[:, 2] - points[0, 2]
    pixels = np.concatenate(
        [camera.project(points), (depth * camera.fx / points[:, 2].mean())[:, None]], axis=1
    )
    return Detections.hand(side, 0.9, pixels, points - points.mean(axis=0))


def label(points: np.ndarray, side: Side | None = "right", camera: Intrinsics = CAMERA) -> HandLabel:
    """(21, 3) points as a label; NaN points stay unlabelled."""
    pixels = np.full((21, 2), np.nan)
    there = np.isfinite(points).all(axis=-1)
    pixels[there] = camera.project(points[there])
    return HandLabel(side, points, pixels)


def entry(
    name: str,
    *hands: HandLabel,
    camera: Intrinsics | None = CAMERA,
    clip: str | None = None,
    time: float = 0.0,
) -> Entry:
    """A picture of a data set; its file need not exist where nothing reads it."""
    return Entry(name, Path(f"{name}.png"), lambda: Labels(tuple(hands), camera), clip, time)


def found(*frames: tuple[Detections, ...]) -> UnitDetections:
    """What was detected in a unit's pictures."""
    return UnitDetections(Detections.of(frames), np.tile([WIDTH, HEIGHT], (len(frames), 1)))


def rows(
    entries: Sequence[Entry],
    *detections: UnitDetections,
    protocol: ProtocolName = "strict",
    camera: str = "assumed",
) -> Rows:
    """The labelled hands of units in which these detections were made."""
    made = iter(detections)
    return rows_of(units_of(entries), lambda _: next(made), protocol=protocol, camera=camera)
