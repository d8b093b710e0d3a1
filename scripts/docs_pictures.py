#!/usr/bin/env python3
"""Make the pictures of the docs: the running program in Blender's own window, and overview.html of a batch.

    sudo HANDFIT_BLENDER_CHROOT=DIR HANDFIT_PYTHON=PYTHON python scripts/docs_pictures.py [NAME ...]

NAME is a scene of the window's, such as `acting`, or `overview`; without one, all are made. DIR is from
make_blender_chroot.sh; PYTHON has the core's requirements. This script itself needs bpy, OpenCV and pytest,
and Chromium for the overview. It writes docs/images/window-*.png and docs/images/overview.png.
"""

from __future__ import annotations

import contextlib
import math
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

import bpy  # noqa: F401  (mathutils is in it)
import cv2
import numpy as np
from mathutils import Matrix, Vector

from handfit_core.hand_model import axes
from scripts import batch_fit
from tests.window.blender_window import BlenderWindow
from tests.window.inputs import Inputs, write_robot_hand

SIZE = (1600, 1000)
SHOWN = (1120, 700)
"""pixels; enough to read the panel's text"""
SIDEBAR = (1035, 80, 1325, 760)
"""x, y, right and bottom of the sidebar in the window, pixels"""
RESULT = (1035, 80, 1325, 285)
"""of its section Result"""
PLATE, BESIDE = (215, 150, 875, 895), (1035, 80, 1300, 825)
"""of the picture that the viewport shows, and of the sidebar"""


def window_pictures(folder: Path, scenes: list[str]) -> None:
    """Play scenes in Blender's window, under Xvfb."""
    chroot = os.environ.get("HANDFIT_BLENDER_CHROOT")
    if not chroot:
        sys.exit("docs_pictures.py: HANDFIT_BLENDER_CHROOT must name a Blender chroot")
    shots = folder / "shots"
    window = BlenderWindow(chroot, folder / "run", shots, SIZE, reachable=folder)
    try:
        for scene in scenes:
            settings = SCENES[scene](folder)
            window.play(f"pictures.{scene}", folder=str(folder), timeout=600, **settings)
    finally:
        window.stop()
    for name, (compose, *used) in PICTURES.items():
        files = [shots / f"{each}.png" for each in used or [name]]
        if all(file.is_file() for file in files):
            write(f"window-{name}", compose(*(cv2.imread(str(file)) for file in files)))


def placed(folder: Path) -> dict[str, Any]:
    """A drawn hand, and the points by which it is posed."""
    points = write_robot_hand(folder / "robot.png").tolist()
    return {"source": "robot.png", "points": [(k, points[k]) for k in (0, 9, 8, 4, 20, 12)]}


def filmed_twice(folder: Path) -> dict[str, Any]:
    """A moving hand of the benchmark, rendered from two cameras that stand 60 degrees apart; the second one
    began seven frames later."""
    from scripts.benchmark.clips import clip_shot
    from scripts.benchmark.drawing import draw
    from scripts.benchmark.scene import build_scene

    shot = clip_shot(0, 9, 70, 400)
    camera = build_scene(shot, 2).camera
    middle = Vector(axes.points_to_world(shot.hands[0].keypoints()[36].mean(axis=0)).tolist())
    around = Matrix.Translation(middle) @ Matrix.Rotation(math.radians(60), 4, "Z")
    for view, first in (("front", 0), ("side", 7)):
        for number in range(60):
            draw(shot, first + number, folder / view / f"{view}.{number + 1:04d}.jpg")
        camera.matrix_world = around @ Matrix.Translation(-middle) @ camera.matrix_world
    return {"source": "front", "second": "side", "other": Inputs(folder).clip(60).name}


def filmed_in_part(folder: Path) -> dict[str, Any]:
    """A moving hand of the benchmark, of whose movement frames 19 to 52 are filmed."""
    from blender_manient.scene.onto_character import motion_of
    from scripts.benchmark.clips import clip_shot
    from scripts.benchmark.drawing import draw
    from scripts.benchmark.scene import build_scene

    shot = clip_shot(0, 9, 110, 400)
    build_scene(shot, 2)
    for number in range(34):
        draw(shot, 18 + number, folder / "film" / f"film.{number + 1:04d}.jpg")
    motion = motion_of(take := shot.take(), take.hands[0])
    numbers = slice(1, 63)  # the first key frame is before the first picture
    movement = {"turns": motion.turns[numbers, 0].tolist(), "places": motion.places[numbers].tolist()}
    return {"source": "film", "side": shot.hands[0].side, **movement}


SCENES: dict[str, Callable[[Path], dict[str, Any]]] = {
    "tour": lambda _: {"source": "wave"},
    "choosing": lambda _: {"source": "mona_lisa.jpg"},
    "onto_a_character": lambda _: {"source": "wave"},
    "onto_a_body": filmed_in_part,
    "several": lambda _: {"sources": ["mona_lisa.jpg", "wave"]},
    "posing": lambda _: {"source": "wave"},
    "gripping": lambda _: {"source": "wave"},
    "placing": placed,
    "acting": lambda folder: {"source": Inputs(folder).clip(600).name},
    "two_cameras": filmed_twice,
}


def whole(window: np.ndarray) -> np.ndarray:
    """The window, smaller."""
    return cv2.resize(window, SHOWN, interpolation=cv2.INTER_AREA)


def cut(window: np.ndarray, box: tuple[int, int, int, int] = SIDEBAR) -> np.ndarray:
    """A part of the window, as large as it is."""
    left, top, right, bottom = box
    return window[top:bottom, left:right]


def through_both(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """The pictures of both cameras beside the sidebar."""
    parts = np.hstack([cut(first, PLATE), cut(second, PLATE), cut(second, BESIDE)])
    return cv2.resize(parts, None, fx=0.6, fy=0.6, interpolation=cv2.INTER_AREA)


PICTURES: dict[str, tuple[Any, ...]] = {
    "empty": (cut,),
    **dict.fromkeys(
        ("capturing", "captured", "keypoints", "touch", "grip", "gripped", "find", "box"), (whole,)
    ),
    **dict.fromkeys(
        ("add-laid", "add-point-12", "character", "body", "captures", "pose-range", "live"), (whole,)
    ),
    "views": (through_both, "views-first", "views-second"),
    "views-wrong": (lambda window: cut(window, RESULT),),
}
"""Name of a picture -> the function that makes it, and its screenshots if they have other names"""


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
    wanted = sys.argv[1:] or [*SCENES, "overview"]
    with tempfile.TemporaryDirectory() as temporary:
        inputs = Path(temporary)
        shutil.copytree(ROOT / "samples" / "rendered_hand", inputs / "wave")
        shutil.copy(ROOT / "samples" / "mona_lisa" / "mona_lisa.jpg", inputs)
        if scenes := [name for name in wanted if name in SCENES]:
            window_pictures(inputs, scenes)
        if "overview" in wanted:
            overview_picture(inputs)
