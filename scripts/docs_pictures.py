#!/usr/bin/env python3
"""Make the pictures of the docs: the running program in Blender's own window, and overview.html of a batch.

    sudo HANDFIT_BLENDER_CHROOT=DIR HANDFIT_PYTHON=PYTHON python scripts/docs_pictures.py [window | overview]

DIR is from make_blender_chroot.sh; PYTHON has the core's requirements. This script itself needs bpy, OpenCV
and Chromium. It writes docs/images/window-*.png and docs/images/overview.png.
"""

from __future__ import annotations

import contextlib
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

import cv2
import numpy as np

from scripts import batch_fit
from tests.window.blender_window import BlenderWindow
from tests.window.inputs import write_robot_hand

SIZE = (1600, 1000)
SHOWN = (1120, 700)
"""pixels; enough to read the panel's text"""
SIDEBAR = (1035, 80, 1325, 740)
"""x, y, right and bottom of the sidebar in the window, pixels"""
PICTURES = (
    *("empty", "capturing", "captured", "keypoints", "touch", "find", "box"),
    *("add-laid", "add-point-12", "character", "captures", "pose-range"),
)


def window_pictures(folder: Path) -> None:
    """Play the tour in Blender's window, under Xvfb."""
    chroot = os.environ.get("HANDFIT_BLENDER_CHROOT")
    if not chroot:
        sys.exit("docs_pictures.py: HANDFIT_BLENDER_CHROOT must name a Blender chroot")
    shots = folder / "shots"
    window = BlenderWindow(chroot, folder / "run", shots, SIZE, reachable=folder)
    points = write_robot_hand(folder / "robot.png").tolist()
    order = [(k, points[k]) for k in (0, 9, 8, 4, 20, 12)]
    try:
        for scene, settings in (
            ("tour", {"source": "wave"}),
            ("choosing", {"source": "mona_lisa.jpg"}),
            ("onto_a_character", {"source": "wave"}),
            ("several", {"sources": ["mona_lisa.jpg", "wave"]}),
            ("posing", {"source": "wave"}),
            ("placing", {"source": "robot.png", "points": order}),
        ):
            window.play(f"pictures.{scene}", folder=str(folder), timeout=300, **settings)
    finally:
        window.stop()
    left, top, right, bottom = SIDEBAR
    for name in PICTURES:
        picture = cv2.imread(str(shots / f"{name}.png"))
        if picture is None:
            sys.exit(f"docs_pictures.py: the tour left no picture of {name}")
        if name == "empty":
            picture = picture[top:bottom, left:right]
        else:
            picture = cv2.resize(picture, SHOWN, interpolation=cv2.INTER_AREA)
        write(f"window-{name}", picture)


def overview_picture(folder: Path) -> None:
    """Capture the bundled samples and a wall, and have Chromium show the overview."""
    browser = next(filter(None, map(shutil.which, ("chromium", "google-chrome", "chrome"))), None)
    if browser is None:
        sys.exit("docs_pictures.py: there is no Chromium on the path")
    (folder / "wave").rename(folder / "day 1")
    cv2.imwrite(f"{folder}/wall.png", np.full((240, 320, 3), 120, dtype=np.uint8))
    with contextlib.chdir(folder):  # so that no folder of this machine is in the picture
        inputs = ["mona_lisa.jpg", "wall.png", "day 1"]
        batch_fit.main([*inputs, "--output", "results", "--format", "blend,glb"])
    shot = folder / "shot.png"
    options = ["--headless", "--no-sandbox", "--hide-scrollbars", f"--user-data-dir={folder}/profile"]
    options += ["--window-size=1160,1160", f"--screenshot={shot}"]
    page = (folder / "results" / "overview.html").as_uri()
    subprocess.run([browser, *options, page], check=True, capture_output=True)
    picture = cv2.imread(str(shot))
    rows = (picture != picture[-1, -1]).any(axis=(1, 2)).nonzero()[0]  # down to the last card
    write("overview", picture[: rows[-1] + 12])


def write(name: str, picture: np.ndarray) -> None:
    """A picture of the docs."""
    path = ROOT / "docs" / "images" / f"{name}.png"
    cv2.imwrite(str(path), picture, [cv2.IMWRITE_PNG_COMPRESSION, 9])
    print(f"{path.relative_to(ROOT)}: {path.stat().st_size // 1024} kB")


if __name__ == "__main__":
    kinds = {"window": window_pictures, "overview": overview_picture}
    for kind in sys.argv[1:] or kinds:
        with tempfile.TemporaryDirectory() as temporary:
            shutil.copytree(ROOT / "samples" / "rendered_hand", Path(temporary) / "wave")
            shutil.copy(ROOT / "samples" / "mona_lisa" / "mona_lisa.jpg", temporary)
            kinds[kind](Path(temporary))
