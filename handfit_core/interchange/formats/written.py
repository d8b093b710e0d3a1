"""Writers of points: this project's JSON and table, and MediaPipe's landmarks."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any, Final

import numpy as np

from handfit_core.common.skeleton import KEYPOINT_NAMES
from handfit_core.interchange.recording import known
from handfit_core.interchange.writers import Writer
from handfit_core.take import HandTrack, Take

COLUMNS: Final = "frame time hand side point x_px y_px confidence x_m y_m z_m width height".split()


def _seconds(take: Take) -> list[float]:
    return ((take.frame_numbers - take.frame_numbers[0]) / take.fps).tolist()


def _write_points(take: Take, path: Path) -> None:
    hands = [
        {
            "side": hand.side,
            "keypoints_2d": _rows(hand.keypoints_2d, 3),
            "keypoints_3d": _rows(hand.joints_3d, 6),
            "score": [None if np.isnan(s) else round(float(s), 4) for s in hand.score],
        }
        for hand in take.hands
    ]
    content = {
        **{
            "format": "handfit-points",
            "version": 1,
            "fps": take.fps,
            "width": take.width,
            "height": take.height,
        },
        **{
            "intrinsics": vars(take.intrinsics),
            "frames": take.frame_numbers.tolist(),
            "keypoints": KEYPOINT_NAMES,
        },
        "hands": hands,
    }
    path.write_text(json.dumps(content), encoding="utf-8")


def _rows(points: np.ndarray, digits: int) -> list[Any]:
    return [np.round(row, digits).tolist() if known(row).all() else None for row in points]


def _write_table(take: Take, path: Path) -> None:
    with path.open("w", encoding="utf-8", newline="") as stream:
        writer = csv.writer(stream)
        writer.writerow(COLUMNS)
        for row, (number, time) in enumerate(zip(take.frame_numbers.tolist(), _seconds(take), strict=True)):
            for count, hand in enumerate(take.hands):
                pixels, joints = hand.keypoints_2d[row], hand.joints_3d[row]
                if not known(pixels).any() and not known(joints).any():
                    continue
                score = _text(hand.score[row], 4)
                for name, seen, joint in zip(KEYPOINT_NAMES, pixels, joints, strict=True):
                    plane, space = [_text(value, 3) for value in seen], [_text(value, 6) for value in joint]
                    before = [number, f"{time:.6f}", count, hand.side, name]
                    writer.writerow([*before, *plane, score, *space, take.width, take.height])


def _text(value: float, digits: int) -> str:
    return "" if np.isnan(value) else f"{value:.{digits}f}"


def _write_landmarks(take: Take, path: Path) -> None:
    """MediaPipe's Tasks of what was fitted: parts of the picture with a depth from the wrist, and metres."""
    frames = []
    for row, (number, time) in enumerate(zip(take.frame_numbers.tolist(), _seconds(take), strict=True)):
        found = [h for h in take.hands if known(h.keypoints_2d[row]).all() or known(h.joints_3d[row]).all()]
        world = [hand.joints_3d[row] - hand.joints_3d[row].mean(axis=0) for hand in found]
        names = [{"category_name": h.side.capitalize(), "score": _round(h.score[row])} for h in found]
        frames.append(
            {
                "frame": number,
                "timestamp_ms": round(time * 1000.0, 3),
                "landmarks": [_objects(_in_picture(take, hand, row)) for hand in found],
                "world_landmarks": [_objects(points) for points in world],
                "handedness": [[name] for name in names],
            }
        )
    header = {"format": "mediapipe-hands", "fps": take.fps, "width": take.width, "height": take.height}
    path.write_text(json.dumps({**header, "frames": frames}), encoding="utf-8")


def _in_picture(take: Take, hand: HandTrack, row: int) -> np.ndarray:
    """(21, 3) parts of the picture, the depth on the scale of x and from the wrist."""
    points = hand.joints_3d[row]
    depth = (points[:, 2] - points[0, 2]) * take.intrinsics.fx / points[0, 2]
    return np.column_stack([take.intrinsics.project(points), depth]) / [take.width, take.height, take.width]


def _objects(points: np.ndarray) -> list[dict[str, float]]:
    return [dict(zip("xyz", map(_round, point), strict=True)) for point in points]


def _round(value: float) -> float:
    return 0.0 if np.isnan(value) else round(float(value), 7)


POINTS: Final = Writer("Points", (".points.json", ".json"), _write_points)
POINTS_TABLE: Final = Writer("Points as a table", (".points.csv", ".csv"), _write_table)
MEDIAPIPE: Final = Writer("MediaPipe's landmarks", (".mediapipe.json",), _write_landmarks)
