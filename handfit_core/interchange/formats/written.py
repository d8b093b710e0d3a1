"""Writers of takes: points as JSON and as a table, MediaPipe's landmarks, and MANO's parameters."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any, Final

import numpy as np

from handfit_core.common.skeleton import KEYPOINT_NAMES, SIDES, Side
from handfit_core.geometry.rotations import rotmat_to_rotvec, rotvec_to_rotmat
from handfit_core.hand_model.motion import POSE_ARRAYS
from handfit_core.interchange.every_frame import EveryFrame
from handfit_core.interchange.recording import known
from handfit_core.interchange.skeletons import UP_AXES
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
    """Write what was fitted as MediaPipe's Tasks write landmarks: in parts of the picture with a depth from
    the wrist, and in metres."""
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
    """Return a hand's keypoints (21, 3) in one frame as parts of the picture, the depth counted from the
    wrist on the scale of x."""
    points = hand.joints_3d[row]
    depth = (points[:, 2] - points[0, 2]) * take.intrinsics.fx / points[0, 2]
    return np.column_stack([take.intrinsics.project(points), depth]) / [take.width, take.height, take.width]


def _objects(points: np.ndarray) -> list[dict[str, float]]:
    return [dict(zip("xyz", map(_round, point), strict=True)) for point in points]


def _round(value: float) -> float:
    return 0.0 if np.isnan(value) else round(float(value), 7)


_OF_A_BODY: Final[dict[Side, tuple[slice, slice]]] = {
    "left": (slice(60, 63), slice(75, 120)),
    "right": (slice(63, 66), slice(120, 165)),
}
"""For each side, the columns of the wrist and of its fingers in the poses of a body"""


def _write_smplx(take: Take, path: Path) -> None:
    """Write the hands as a body of SMPL-X that stands still with its arms out, y up; the wrists' places are
    not kept, as they depend on the body."""
    frames = EveryFrame.of(take)
    poses = np.zeros((len(frames.numbers), 165))
    present = np.zeros((len(poses), 2), dtype=bool)
    for side, hand in frames.hands.items():
        wrist, fingers = _OF_A_BODY[side]
        poses[:, wrist] = rotmat_to_rotvec(UP_AXES["y"] @ rotvec_to_rotmat(hand.global_orient))
        poses[:, fingers] = hand.hand_pose
        present[:, SIDES.index(side)] = frames.present[side]
    _written(
        path,
        trans=np.zeros((len(poses), 3)),
        gender=np.array("neutral"),
        betas=np.zeros(16),
        poses=poses,
        mocap_frame_rate=np.array(frames.fps),
        surface_model_type=np.array("smplx"),
        hands_present=present,
    )


def _write_keywords(take: Take, path: Path) -> None:
    frames, camera = EveryFrame.of(take), take.intrinsics
    arrays: dict[str, Any] = {
        "frame_numbers": frames.numbers,
        "fps": np.array(frames.fps),
        "picture_size": np.array([take.width, take.height]),
        "intrinsics": np.array([camera.fx, camera.fy, camera.cx, camera.cy]),
        "flat_hand_mean": np.array(True),
    }
    for side, hand in frames.hands.items():
        for name, rows in zip(POSE_ARRAYS, hand.pose, strict=True):
            arrays[f"{side}_{name}"] = rows
        arrays[f"{side}_betas"] = hand.betas[None]
        arrays[f"{side}_present"] = frames.present[side]
    _written(path, **arrays)


def _written(path: Path, **arrays: Any) -> None:
    with path.open("wb") as stream:  # to a path, np.savez would add an ending
        np.savez_compressed(stream, **arrays)


def _write_take(take: Take, path: Path) -> None:
    take.save(path)


TAKE: Final = Writer("Take", (".take.npz", ".npz"), _write_take)
SMPLX: Final = Writer("SMPL-X", (".smplx.npz",), _write_smplx)
SMPLX_KEYWORDS: Final = Writer("smplx's parameters", (".mano.npz",), _write_keywords)
POINTS: Final = Writer("Points", (".points.json", ".json"), _write_points)
POINTS_TABLE: Final = Writer("Points as a table", (".points.csv", ".csv"), _write_table)
MEDIAPIPE: Final = Writer("MediaPipe's landmarks", (".mediapipe.json",), _write_landmarks)
