#!/usr/bin/env python3
"""Make the pictures of the pages for artists: Blender's own window with the running program, under Xvfb.

    sudo HANDFIT_BLENDER_CHROOT=DIR HANDFIT_PYTHON=PYTHON python scripts/window_pictures.py

DIR is from make_blender_chroot.sh; PYTHON has the core's requirements. This script needs OpenCV itself.
"""

from __future__ import annotations

import os
import shutil
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
if str(ROOT) not in sys.path:
    sys.path.insert(0, str(ROOT))

import cv2

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


def main() -> int:
    """Play the tour and write docs/images/window-*.png; returns the exit code."""
    chroot = os.environ.get("HANDFIT_BLENDER_CHROOT")
    if not chroot:
        print("window_pictures.py: HANDFIT_BLENDER_CHROOT must name a Blender chroot", file=sys.stderr)
        return 2
    with tempfile.TemporaryDirectory() as folder:
        shots = Path(folder) / "shots"
        shutil.copytree(ROOT / "samples" / "rendered_hand", Path(folder) / "wave")
        shutil.copy(ROOT / "samples" / "mona_lisa" / "mona_lisa.jpg", folder)
        window = BlenderWindow(chroot, Path(folder) / "run", shots, SIZE, reachable=Path(folder))
        try:
            window.play("pictures.tour", folder=folder, source="wave", timeout=300)
            window.play("pictures.choosing", folder=folder, source="mona_lisa.jpg", timeout=300)
            window.play("pictures.onto_a_character", folder=folder, source="wave", timeout=300)
            window.play("pictures.several", folder=folder, sources=["mona_lisa.jpg", "wave"], timeout=300)
            window.play("pictures.posing", folder=folder, source="wave", timeout=300)
            points = write_robot_hand(Path(folder) / "robot.png").tolist()
            order = [(k, points[k]) for k in (0, 9, 8, 4, 20, 12)]
            window.play("pictures.placing", folder=folder, source="robot.png", points=order, timeout=300)
        finally:
            window.stop()
        for name in PICTURES:
            picture = cv2.imread(str(shots / f"{name}.png"))
            if picture is None:
                print(f"window_pictures.py: the tour left no picture of {name}", file=sys.stderr)
                return 1
            left, top, right, bottom = SIDEBAR
            if name == "empty":
                picture = picture[top:bottom, left:right]
            else:
                picture = cv2.resize(picture, SHOWN, interpolation=cv2.INTER_AREA)
            path = ROOT / "docs" / "images" / f"window-{name}.png"
            cv2.imwrite(str(path), picture, [cv2.IMWRITE_PNG_COMPRESSION, 9])
            print(f"{path.relative_to(ROOT)}: {path.stat().st_size // 1024} kB")
    return 0


if __name__ == "__main__":
    sys.exit(main())
