"""Films of a chessboard on a screen, through a lens that is known."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np

from handfit_core.geometry.lens import Lens
from handfit_core.media.chessboard import board_png

SCREEN = 0.53
"""metres, the width of the board's picture on a screen of 24 inches"""


class Filmed:
    """Pictures (H, W) of the board, through OpenCV's distortion, at twice the size and then made smaller."""

    def __init__(self, lens: Lens) -> None:
        self.lens, k = lens, lens.intrinsics
        self._board = cv2.imdecode(np.frombuffer(board_png(), np.uint8), cv2.IMREAD_GRAYSCALE)
        # Pixels have their centres at halves here and at whole numbers in OpenCV.
        matrix = np.array([[k.fx, 0.0, k.cx], [0.0, k.fy, k.cy], [0.0, 0.0, 1.0]])
        xs, ys = ((np.arange(2 * side) + 0.5) / 2.0 for side in (lens.width, lens.height))
        grid = np.stack(np.meshgrid(xs, ys), axis=-1).reshape(-1, 1, 2)
        until = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 200, 1e-10)
        rays = cv2.undistortPointsIter(grid, matrix, np.array(lens.distortion), np.eye(3), np.eye(3), until)
        self._rays = np.concatenate([rays[:, 0], np.ones((len(rays), 1))], axis=-1)

    def picture(self, rotvec: np.ndarray, place: np.ndarray) -> np.ndarray:
        """The board, turned about its middle, which lies at `place` in the camera frame, metres."""
        rotation, _ = cv2.Rodrigues(np.asarray(rotvec, dtype=float))
        height, width = self._board.shape
        metre = width / SCREEN
        to_board = np.linalg.inv(np.column_stack([rotation[:, 0], rotation[:, 1], place]))
        on_board = self._rays @ to_board.T
        at = on_board[:, :2] / on_board[:, 2:] * metre + np.array([width, height]) / 2.0 - 0.5
        at = at.astype(np.float32).reshape(2 * self.lens.height, 2 * self.lens.width, 2)
        seen = cv2.remap(
            self._board, at, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=60
        )
        seen = cv2.resize(seen, (self.lens.width, self.lens.height), interpolation=cv2.INTER_AREA)
        grain = np.random.default_rng(seen.size + int(seen[::7, ::7].sum())).normal(0.0, 2.0, seen.shape)
        return np.clip(cv2.GaussianBlur(seen, (0, 0), 0.7) * 0.8 + 20.0 + grain, 0, 255).astype(np.uint8)


Pose = tuple[np.ndarray, np.ndarray]


def all_around(lens: Lens, frames: int, *, tilt: float = 0.6) -> list[Pose]:
    """Poses (rotation vector, place) all over the picture and up to `tilt` radians."""
    rng = np.random.default_rng(0)
    k, poses = lens.intrinsics, []
    for _ in range(frames):
        depth = SCREEN * k.fx / lens.width / rng.uniform(0.45, 0.9)
        away = rng.uniform(-1.0, 1.0, 2) * (lens.width, lens.height) * 0.28
        place = np.array([away[0] / k.fx, away[1] / k.fy, 1.0]) * depth
        poses.append((rng.uniform(-tilt, tilt, 3) * (1.0, 1.0, 0.4), place))
    return poses


def film(
    path: Path, lens: Lens, poses: list[Pose], *, still: int = 2, change: Callable | None = None
) -> Path:
    """Write a film in which each pose is held for `still` frames; `change` gets each picture first."""
    filmed = Filmed(lens)
    video = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"mp4v"), 30.0, (lens.width, lens.height))
    for rotvec, place in poses:
        picture = filmed.picture(rotvec, place)
        for _ in range(still):
            video.write(cv2.cvtColor(picture if change is None else change(picture), cv2.COLOR_GRAY2BGR))
    video.release()
    return path
