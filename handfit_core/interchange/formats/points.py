"""Points of this project, for everybody: 21 keypoints a hand and frame as JSON (docs/interchange.md)."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, Final

import numpy as np

from handfit_core.arrays import LARGEST
from handfit_core.doors.values import number, whole
from handfit_core.errors import InputError
from handfit_core.files import shown
from handfit_core.geometry.camera import Intrinsics
from handfit_core.interchange.document import Document
from handfit_core.interchange.readers import Reader
from handfit_core.interchange.recording import Asked, PointsHand, Recording, SeenHands, known
from handfit_core.interchange.writers import Writer
from handfit_core.skeleton import KEYPOINT_NAMES, NUM_KEYPOINTS, SIDES, Side
from handfit_core.take import Take

FORMAT_NAME: Final = "handfit-points"
FORMAT_VERSION: Final = 1


def _recognises(document: Document) -> bool:
    return isinstance(document.json, dict) and document.json.get("format") == FORMAT_NAME


def _read(document: Document, _asked: Asked) -> Recording:
    header = document.json
    if whole("version", header.get("version"), 1) > FORMAT_VERSION:
        raise InputError(
            f"{shown(document.path)}: a newer version wrote these points; read them with that version"
        )
    numbers = np.array([whole("frames", n) for n in header["frames"]])
    hands: list[tuple[Side, dict[str, Any]]] = [(hand["side"], hand) for hand in header["hands"]]
    if any(side not in SIDES for side, _ in hands):
        raise ValueError("a hand's side is neither left nor right")
    size, camera = None, None
    if "width" in header:
        size = whole("width", header["width"], 1, 1 << 24), whole("height", header["height"], 1, 1 << 24)
    if "intrinsics" in header:
        said = header["intrinsics"]
        camera = Intrinsics(*(number(name, said[name]) for name in ("fx", "fy", "cx", "cy")))
    count = len(numbers)
    in_space = bool(hands) and all("keypoints_3d" in hand for _, hand in hands)
    seen = None if in_space else _seen(hands, count)
    points = [PointsHand(side, _points(hand["keypoints_3d"], count, 3)) for side, hand in hands if in_space]
    fps = number("fps", header["fps"], 1e-3, 1e6) if "fps" in header else 0.0
    files = (str(document.path.absolute()),)
    return Recording("points", files, fps, numbers, seen, tuple(points), size=size, intrinsics=camera)


def _points(rows: Any, count: int, size: int) -> np.ndarray:
    """(T, 21, size); null stands for what is missing, a point as well as a frame's hand."""
    nothing = [None] * size
    points = np.array(
        [[p or nothing for p in (row or [nothing] * NUM_KEYPOINTS)] for row in rows], dtype=np.float64
    )
    if points.shape != (count, NUM_KEYPOINTS, size):
        raise ValueError(f"points have the shape {points.shape}, expected {(count, NUM_KEYPOINTS, size)}")
    if np.any(np.abs(points) > LARGEST):
        raise ValueError(f"points lie beyond {LARGEST:g}")
    return points


def _seen(hands: list[tuple[Side, dict[str, Any]]], count: int) -> SeenHands:
    rows, parts = [], []
    for side, hand in hands:
        points = _points(hand["keypoints_2d"], count, 2)
        there = known(points)
        sure = (
            np.array(hand["confidence"], dtype=np.float64) if "confidence" in hand else np.ones(there.shape)
        )
        if sure.shape != there.shape:
            raise ValueError(f"confidence has the shape {sure.shape}, expected {there.shape}")
        at = np.flatnonzero(there.sum(axis=1))
        rows.append(at)
        parts.append((np.full(len(at), side == "left"), points[at], np.where(there, sure, 0.0)[at]))
    row = np.concatenate(rows) if rows else np.zeros(0, dtype=int)
    order = np.argsort(row, kind="stable")
    if not parts:
        raise ValueError("there is no hand")
    left, points, sure = (np.concatenate(column)[order] for column in zip(*parts, strict=True))
    return SeenHands(row[order], left, sure.mean(axis=1).clip(0.0, 1.0), points, sure.clip(0.0, 1.0))


def _write(take: Take, path: Path) -> None:
    content = {
        "format": FORMAT_NAME,
        "version": FORMAT_VERSION,
        "fps": take.fps,
        "width": take.width,
        "height": take.height,
        "intrinsics": vars(take.intrinsics),
        "frames": take.frame_numbers.tolist(),
        "keypoints": KEYPOINT_NAMES,
        "hands": [
            {
                "side": hand.side,
                "keypoints_2d": _rows(hand.keypoints_2d, 3),
                "keypoints_3d": _rows(hand.joints_3d, 6),
                "score": [None if np.isnan(s) else round(float(s), 4) for s in hand.score],
            }
            for hand in take.hands
        ],
    }
    path.write_text(json.dumps(content), encoding="utf-8")


def _rows(points: np.ndarray, digits: int) -> list[Any]:
    there = known(points.reshape(len(points), -1))
    return [
        np.round(row, digits).tolist() if known else None for row, known in zip(points, there, strict=True)
    ]


READER = Reader("Points", "the JSON of docs/interchange.md", _recognises, _read)
WRITER = Writer("Points", (".points.json", ".json"), _write)
