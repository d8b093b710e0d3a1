"""One real Blender with a window for all tests of a run; see blender_window.py."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from handfit_core.camera import Intrinsics
from handfit_core.hand_model import load_model
from handfit_core.skeleton import SIDES
from handfit_core.take import HandTrack, Source, Take
from tests.window.blender_window import ROOT, BlenderWindow

CHROOT = os.environ.get("HANDFIT_BLENDER_CHROOT")


@pytest.fixture(scope="session")
def screenshots(tmp_path_factory) -> Path:
    """Where pictures of the screen are kept: out/window/ where HANDFIT_KEEP_SCREENSHOTS is set."""
    if os.environ.get("HANDFIT_KEEP_SCREENSHOTS"):
        return ROOT / "out" / "window"
    return tmp_path_factory.mktemp("screenshots")


@pytest.fixture(scope="session")
def blender(tmp_path_factory, screenshots) -> Iterator[BlenderWindow]:
    """Blender at an artist's window size; every scenario gets a new file in it."""
    yield from _window(tmp_path_factory, screenshots, (1600, 1000))


@pytest.fixture(scope="session")
def small_blender(tmp_path_factory, screenshots) -> Iterator[BlenderWindow]:
    """One with a small window, which is drawn more quickly where there is no graphics card."""
    yield from _window(tmp_path_factory, screenshots, (640, 480))


@pytest.fixture
def own_blender(tmp_path_factory, screenshots) -> Iterator[BlenderWindow]:
    """A Blender for one test alone."""
    yield from _window(tmp_path_factory, screenshots, (640, 480))


def _window(tmp_path_factory, screenshots: Path, size: tuple[int, int]) -> Iterator[BlenderWindow]:
    if not CHROOT:
        pytest.skip("HANDFIT_BLENDER_CHROOT does not name a chroot with Blender in it")
    folder = tmp_path_factory.mktemp("blender")
    window = BlenderWindow(CHROOT, folder, screenshots, size, reachable=tmp_path_factory.getbasetemp())
    yield window
    window.stop()


@pytest.fixture(scope="session")
def rendered_hand() -> Path:
    """The bundled image sequence, for tests that capture."""
    python = os.environ.get("HANDFIT_PYTHON", sys.executable)
    code = "import torch, cv2, mediapipe, scipy"
    if subprocess.run([python, "-c", code], capture_output=True, check=False).returncode != 0:
        pytest.skip("needs a Python with torch, OpenCV and MediaPipe in HANDFIT_PYTHON")
    return ROOT / "samples" / "rendered_hand"


@pytest.fixture
def photo(rendered_hand, tmp_path) -> Path:
    """One picture with a right hand, in a folder of its own."""
    return Path(shutil.copy(rendered_hand / "hand.0001.jpg", tmp_path / "hand.jpg"))


@pytest.fixture(scope="session")
def make_clip(rendered_hand, tmp_path_factory):
    """make_clip(frames, blank_from=None) -> a video of the bundled hand, to and fro; its frames from
    `blank_from` on show nothing."""
    python = os.environ.get("HANDFIT_PYTHON", sys.executable)
    made: dict[tuple, Path] = {}

    def make(frames: int, blank_from: int | None = None) -> Path:
        key = (frames, blank_from)
        if key not in made:
            made[key] = tmp_path_factory.mktemp("clip") / f"clip-{frames}.mp4"
            blank = frames if blank_from is None else blank_from
            arguments = [str(rendered_hand), str(made[key]), str(frames), str(blank)]
            subprocess.run([python, "-c", _WRITE_CLIP, *arguments], check=True, timeout=120)
        return made[key]

    return make


_WRITE_CLIP = """
import pathlib, sys
import cv2, numpy as np
folder, output, frames, blank = sys.argv[1], sys.argv[2], int(sys.argv[3]), int(sys.argv[4])
pictures = [cv2.imread(str(p)) for p in sorted(pathlib.Path(folder).glob("*.jpg"))]
pictures += pictures[-2:0:-1]
height, width = pictures[0].shape[:2]
writer = cv2.VideoWriter(output, cv2.VideoWriter_fourcc(*"mp4v"), 25.0, (width, height))
for i in range(frames):
    writer.write(pictures[i % len(pictures)] if i < blank else np.full_like(pictures[0], 90))
writer.release()
"""


@pytest.fixture(scope="session")
def long_take(tmp_path_factory) -> Path:
    """10 000 frames of two hands, as a take file: a hundred times the same hundred."""
    frames, t = 10_000, np.linspace(0.0, 2 * np.pi, 100)
    camera = Intrinsics.assumed(1280, 720)
    tracks, digests = [], {}

    def again(values: np.ndarray) -> np.ndarray:
        return np.concatenate([values] * (frames // len(t)))

    for side in SIDES:
        hand = load_model("open-hand", side)
        orient = np.stack([0.3 * np.sin(t), 0.2 * np.cos(t), t * 0], axis=-1)
        bend = 0.4 + 0.4 * np.sin(t)
        pose = np.tile([0.0, 0.0, 1.0 if side == "right" else -1.0], 15) * bend[:, None]
        transl = np.stack([0.1 * np.sin(t), 0.1 * np.cos(t), 0.6 + 0 * t], axis=-1)
        posed = hand.posed(None, orient, pose, transl)
        digests[side] = hand.digest
        track = HandTrack(
            side=side,
            betas=np.zeros(10),
            global_orient=again(orient),
            hand_pose=again(pose),
            transl=again(transl),
            joints_3d=again(posed.keypoints),
            keypoints_2d=again(camera.project(posed.keypoints)),
            reprojection_error=np.full(frames, 2.0),
            detected=np.ones(frames, dtype=bool),
            score=np.ones(frames),
        )
        tracks.append(track)
    take = Take(
        source=Source("video", ("gone.mp4",)),
        fps=25.0,
        frame_numbers=np.arange(1, frames + 1),
        width=1280,
        height=720,
        intrinsics=camera,
        solver="test",
        model="open-hand",
        model_digests=digests,
        hands=tuple(tracks),
    )
    return take.save(tmp_path_factory.mktemp("long") / "long.take.npz")
