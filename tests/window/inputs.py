"""What the scenarios are given to capture and to build."""

from __future__ import annotations

import shutil
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import pytest

from handfit_core.common.skeleton import KEYPOINT_PARENTS, SIDES
from handfit_core.edit import landmark_points
from handfit_core.geometry.camera import Intrinsics
from handfit_core.geometry.lens import Lens
from handfit_core.geometry.rotations import rotmat_to_rotvec, rotvec_to_rotmat
from handfit_core.hand_model import load_model
from handfit_core.media.source import Source
from handfit_core.take import Take
from scripts.benchmark.kinematics import RightHand, hand_pose_from_angles
from scripts.benchmark.poses import random_pose
from tests.conftest import samples_dir
from tests.films import all_around, film
from tests.takes import correctable, take_of, track_of, with_arms

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
        return _written(self.folder / "portrait.jpg", _rendered(1)[:, 160:460])

    @property
    def four_hands(self) -> Path:
        """A picture of two right hands and two left ones."""
        row = np.hstack([_rendered(7), _rendered(7)[:, ::-1]])
        return _written(self.folder / "four.jpg", np.vstack([row, row]))

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
    def film_of_the_board(self) -> Path:
        """A film that tells its lens."""
        lens = Lens(Intrinsics(430.0, 430.0, 320.0, 240.0), (0.0,) * 5, 640, 480)
        return film(self.folder / "board.mp4", lens, all_around(lens, 20))

    @property
    def two_cameras(self) -> dict[str, Path]:
        """Two clips of one hand, seen by cameras that stand 76 degrees apart."""
        folder = samples_dir() / "two_cameras" / "apart75"
        if not folder.is_dir():
            pytest.skip(f"the clips of two cameras are not here ({folder}); set HANDFIT_SAMPLES")
        given = {"source": "clip1_a.mp4", "second": "clip1_b.mp4"}
        return {name: Path(shutil.copy(folder / file, self.folder)) for name, file in given.items()}

    @property
    def rig(self) -> Path:
        """A calibration of one camera."""
        path = self.folder / "rig.toml"
        path.write_text("[cam_0]\nmatrix = [[1, 0, 0], [0, 1, 0], [0, 0, 1]]\n", encoding="utf-8")
        return path

    def clip(self, frames: int, blank_from: int | None = None) -> Path:
        """A video of the bundled hand, to and fro; from `blank_from` on it shows nothing."""
        shown = _to_and_fro([_rendered(number) for number in range(1, 25)])
        blank, end = np.full_like(shown[0], 90), frames if blank_from is None else blank_from
        pictures = (shown[i % len(shown)] if i < end else blank for i in range(frames))
        return _filmed(self.folder / "clip.mp4", 25.0, pictures)

    @property
    def two_arms(self) -> Path:
        """A take of two moving hands, with the arms that they hang on."""
        path = self.folder / "arms.take.npz"
        return with_arms(Take.load(self.two_hands())).save(path)

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

    @property
    def two_hands_acting(self) -> Path:
        """Three minutes of the bundled hand and its mirror image, which are held open and still at first,
        then move to and fro."""
        small = [cv2.resize(_rendered(number), None, fx=0.5, fy=0.5) for number in range(1, 25)]
        shown = []
        for one in small:
            shown.append(np.full((480, 640, 3), one[0, 0], np.uint8))
            shown[-1][120 : 120 + len(one)] = np.hstack([one, one[:, ::-1]])
        shown = _to_and_fro(shown)
        pictures = (shown[0 if i < 480 else i // 2 % len(shown)] for i in range(2400))
        return _filmed(self.folder / "acting.mp4", 12.0, pictures)


def _rendered(number: int) -> np.ndarray:
    """(480, 640, 3) uint8 BGR: a picture of the bundled hand."""
    return cv2.imread(str(RENDERED_HAND / f"hand.{number:04}.jpg"))


def _to_and_fro(pictures: list[np.ndarray]) -> list[np.ndarray]:
    return pictures + pictures[-2:0:-1]


def _written(path: Path, picture: np.ndarray) -> Path:
    cv2.imwrite(str(path), picture)
    return path


def _filmed(path: Path, rate: float, pictures: Iterable[np.ndarray]) -> Path:
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"mp4v"), rate, (640, 480))
    for picture in pictures:
        writer.write(picture)
    writer.release()
    return path


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
    at = pixels.round().astype(int)
    paper = np.full((700, 900, 3), (214, 232, 238), np.uint8)
    palm = cv2.convexHull(at[[0, 1, 5, 9, 13, 17]].astype(np.int32))
    cv2.fillConvexPoly(paper, palm, (150, 130, 110), cv2.LINE_AA)
    cv2.polylines(paper, [palm], True, (60, 50, 40), 5, cv2.LINE_AA)
    for k in range(20, 0, -1):
        if k % 4 != 1:
            ends = [at[i].tolist() for i in (KEYPOINT_PARENTS[k], k)]
            cv2.line(paper, *ends, (60, 50, 40), 36, cv2.LINE_AA)
            cv2.line(paper, *ends, (190, 165, 140), 26, cv2.LINE_AA)
    for place in at.tolist():
        cv2.circle(paper, place, 11, (60, 50, 40), -1, cv2.LINE_AA)
        cv2.circle(paper, place, 5, (120, 200, 255), -1, cv2.LINE_AA)
    _written(path, paper)
    return pixels
