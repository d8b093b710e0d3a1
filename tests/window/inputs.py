"""What the scenarios are given to capture and to build."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from handfit_core.common.skeleton import KEYPOINT_PARENTS, SIDES
from handfit_core.edit import landmark_points
from handfit_core.geometry.camera import Intrinsics
from handfit_core.geometry.rotations import rotmat_to_rotvec, rotvec_to_rotmat
from handfit_core.hand_model import load_model
from handfit_core.media.source import Source
from scripts.benchmark.kinematics import RightHand, hand_pose_from_angles
from scripts.benchmark.poses import random_pose
from tests.conftest import samples_dir
from tests.takes import correctable, take_of, track_of

RENDERED_HAND = Path(__file__).resolve().parents[2] / "samples" / "rendered_hand"


@dataclass(frozen=True)
class Inputs:
    """Files that are made in `folder` when they are asked for."""

    folder: Path

    @property
    def photo(self) -> Path:
        """One picture with a right hand."""
        return Path(shutil.copy(RENDERED_HAND / "hand.0001.jpg", self.folder / "hand.jpg"))

    @property
    def portrait(self) -> Path:
        """The same hand in a picture of 300 x 480 pixels."""
        code = "cv2.imwrite(sys.argv[2], cv2.imread(sys.argv[1])[:, 160:460])"
        return self._written("portrait.jpg", code, RENDERED_HAND / "hand.0001.jpg")

    @property
    def four_hands(self) -> Path:
        """A picture of two right hands and two left ones."""
        code = "hand = cv2.imread(sys.argv[1]); row = np.hstack([hand, hand[:, ::-1]])\n"
        code += "cv2.imwrite(sys.argv[2], np.vstack([row, row]))"
        return self._written("four.jpg", code, RENDERED_HAND / "hand.0007.jpg")

    @property
    def words(self) -> Path:
        """A file that is no picture."""
        path = self.folder / "broken.jpg"
        path.write_text("these are words")
        return path

    @property
    def take(self) -> Path:
        """A take of the bundled hand."""
        return RENDERED_HAND / "truth.take.npz"

    @property
    def two_cameras(self) -> dict[str, Path]:
        """Two clips of one hand, seen by cameras that stand 76 degrees apart."""
        folder = samples_dir() / "two_cameras" / "apart75"
        if not folder.is_dir():
            pytest.skip(f"the clips of two cameras are not here ({folder}); set HANDFIT_SAMPLES")
        given = {"source": "clip1_a.mp4", "second": "clip1_b.mp4"}
        return {name: Path(shutil.copy(folder / file, self.folder)) for name, file in given.items()}

    def clip(self, frames: int, blank_from: int | None = None) -> Path:
        """A video of the bundled hand, to and fro; from `blank_from` on it shows nothing."""
        return self._written("clip.mp4", _WRITE_CLIP, RENDERED_HAND, frames, blank_from)

    def two_hands(self, away: float = 0.6) -> Path:
        """A take of two moving hands over a hundred frames, which can be corrected; `away` metres from the
        camera, which make them small and leave them where they are in the picture."""
        t = np.linspace(0.0, 2 * np.pi, 100)
        camera = Intrinsics.assumed(1280, 720)
        tracks = []
        for side in SIDES:
            orient = np.stack([0.3 * np.sin(t), 0.2 * np.cos(t), t * 0], axis=-1)
            bend = 0.4 + 0.4 * np.sin(t)
            pose = np.tile([0.0, 0.0, 1.0 if side == "right" else -1.0], 15) * bend[:, None]
            transl = np.stack([0.1 * np.sin(t), 0.1 * np.cos(t), 0.6 + 0 * t], axis=-1) * (away / 0.6)
            tracks.append(track_of(side, orient, pose, transl, camera))
        take = take_of(tracks, camera, 1280, 720, source=Source("video", ("gone.mp4",)))
        return correctable(take).save(self.folder / "two.take.npz")

    def drawing(self) -> dict[str, object]:
        """A drawing of a robot's hand, and where its keypoints are."""
        path = self.folder / "robot.png"
        return {"source": path, "truth": write_robot_hand(path).tolist()}

    def _written(self, name: str, code: str, *arguments: object) -> Path:
        """A file that Python code writes, to sys.argv[2], where OpenCV is."""
        python, path = os.environ.get("HANDFIT_PYTHON", sys.executable), self.folder / name
        source, *others = map(str, arguments)
        command = [python, "-c", f"import sys, cv2, numpy as np\n{code}", source, str(path), *others]
        subprocess.run(command, check=True, timeout=120)
        return path


_WRITE_CLIP = """
import pathlib
folder, output, frames, blank = sys.argv[1:]
pictures = [cv2.imread(str(p)) for p in sorted(pathlib.Path(folder).glob("*.jpg"))]
pictures += pictures[-2:0:-1]
writer = cv2.VideoWriter(output, cv2.VideoWriter_fourcc(*"mp4v"), 25.0, (640, 480))
for i in range(int(frames)):
    shown = pictures[i % len(pictures)]
    writer.write(shown if blank == "None" or i < int(blank) else np.full_like(shown, 90))
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
