"""What the scenarios are given to capture and to build."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np

from handfit_core.edit import landmark_points
from handfit_core.geometry.camera import Intrinsics
from handfit_core.geometry.rotations import rotmat_to_rotvec, rotvec_to_rotmat
from handfit_core.hand_model import load_model
from handfit_core.media.source import Source
from handfit_core.skeleton import KEYPOINT_PARENTS, SIDES
from handfit_core.take import Take
from scripts.benchmark.kinematics import RightHand, hand_pose_from_angles
from scripts.benchmark.poses import random_pose
from tests.takes import correctable, take_of, track_of

RENDERED_HAND = Path(__file__).resolve().parents[2] / "samples" / "rendered_hand"


def write_clip(
    python: str, path: Path, frames: int, blank_from: int | None = None, fps: float = 25.0, bar: int = 0
) -> None:
    """A video of the bundled hand, to and fro; its frames from `blank_from` on show nothing. Where `bar` is
    not 0, a white bar of so many pixels along the upper edge grows from the left by a part of the width with
    each frame. `python` has OpenCV."""
    blank = frames if blank_from is None else blank_from
    arguments = [str(RENDERED_HAND), str(path), *map(str, (frames, blank, fps, bar))]
    subprocess.run([python, "-c", _WRITE_CLIP, *arguments], check=True, timeout=120)


def write_long_take(path: Path, frames: int, away: float = 0.6) -> Path:
    """Two hands, as a take file: again and again the same hundred frames. `frames`: hundreds; `away`: metres
    from the camera, which make them small and leave them where they are in the picture."""
    t = np.linspace(0.0, 2 * np.pi, 100)
    camera = Intrinsics.assumed(1280, 720)
    tracks = []

    def again(values: np.ndarray) -> np.ndarray:
        return np.concatenate([values] * (frames // len(t)))

    for side in SIDES:
        orient = np.stack([0.3 * np.sin(t), 0.2 * np.cos(t), t * 0], axis=-1)
        bend = 0.4 + 0.4 * np.sin(t)
        pose = np.tile([0.0, 0.0, 1.0 if side == "right" else -1.0], 15) * bend[:, None]
        transl = np.stack([0.1 * np.sin(t), 0.1 * np.cos(t), 0.6 + 0 * t], axis=-1) * (away / 0.6)
        tracks.append(track_of(side, again(orient), again(pose), again(transl), camera))
    take = take_of(tracks, camera, 1280, 720, source=Source("video", ("gone.mp4",)))
    return take.save(path)


def write_far_take(path: Path) -> Path:
    """Two hands far away, which can be corrected: some 40 of the picture's 1280 pixels."""
    return correctable(Take.load(write_long_take(path, 100, away=5.2))).save(path)


_WRITE_CLIP = """
import pathlib, sys
import cv2, numpy as np
folder, output, frames, blank = sys.argv[1], sys.argv[2], int(sys.argv[3]), int(sys.argv[4])
fps, bar = float(sys.argv[5]), int(sys.argv[6])
pictures = [cv2.imread(str(p)) for p in sorted(pathlib.Path(folder).glob("*.jpg"))]
pictures += pictures[-2:0:-1]
height, width = pictures[0].shape[:2]
writer = cv2.VideoWriter(output, cv2.VideoWriter_fourcc(*"mp4v"), fps, (width, height))
for i in range(frames):
    picture = pictures[i % len(pictures)].copy() if i < blank else np.full_like(pictures[0], 90)
    if bar:
        picture[:bar] = 0
        picture[:bar, : round((i + 1) * width / frames)] = 255
        cv2.putText(picture, str(i + 1), (10, bar + 60), cv2.FONT_HERSHEY_SIMPLEX, 2.0, (255, 255, 255), 4)
    writer.write(picture)
writer.release()
"""


def write_robot_hand(path: Path) -> np.ndarray:
    """A drawing of a robot's right hand that points, in which no network sees a hand. Returns where its 21
    keypoints are, (21, 2) pixels."""
    camera = Intrinsics.assumed(900, 700)
    angles = random_pose("point", RightHand(np.zeros(10)), np.random.default_rng(3))
    upright, aside = (rotvec_to_rotmat(np.radians(a)) for a in ([-90.0, 0.0, 0.0], [10.0, -30.0, 25.0]))
    pose = rotmat_to_rotvec(aside @ upright)[None], hand_pose_from_angles(angles, "right")[None]
    points = landmark_points(
        load_model("open-hand", "right"), np.zeros(10), *pose, np.array([[-0.1, 0.07, 0.4]])
    )
    points[..., :2] -= points[..., :2].mean(axis=1, keepdims=True)
    pixels = camera.project(points)[0]
    drawn = json.dumps(pixels.round(1).tolist())
    arguments = [str(path), drawn, json.dumps(KEYPOINT_PARENTS)]
    subprocess.run([sys.executable, "-c", _DRAW_ROBOT, *arguments], check=True, timeout=60)
    return pixels


_DRAW_ROBOT = """
import json, sys
import cv2, numpy as np
path, points, parents = sys.argv[1], np.array(json.loads(sys.argv[2])), json.loads(sys.argv[3])
paper = np.full((700, 900, 3), (214, 232, 238), np.uint8)
palm = cv2.convexHull(points[[0, 1, 5, 9, 13, 17]].round().astype(np.int32))
cv2.fillConvexPoly(paper, palm, (150, 130, 110), cv2.LINE_AA)
cv2.polylines(paper, [palm], True, (60, 50, 40), 5, cv2.LINE_AA)
for k in range(20, 0, -1):
    if k % 4 != 1:
        ends = [tuple(points[i].round().astype(int).tolist()) for i in (parents[k], k)]
        cv2.line(paper, *ends, (60, 50, 40), 36, cv2.LINE_AA)
        cv2.line(paper, *ends, (190, 165, 140), 26, cv2.LINE_AA)
for point in points:
    at = tuple(point.round().astype(int).tolist())
    cv2.circle(paper, at, 11, (60, 50, 40), -1, cv2.LINE_AA)
    cv2.circle(paper, at, 5, (120, 200, 255), -1, cv2.LINE_AA)
cv2.imwrite(path, paper)
"""
