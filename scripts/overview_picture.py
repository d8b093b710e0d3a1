#!/usr/bin/env python3
"""Make the picture of docs/batch.md: overview.html of a batch of the bundled samples, as a browser shows it.

    python scripts/overview_picture.py

Needs bpy, what a capture needs, and Chromium.
"""

from __future__ import annotations

import contextlib
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
if str(ROOT) not in sys.path:
    sys.path.insert(0, str(ROOT))

import cv2
import numpy as np

from scripts import batch_fit

SIZE = (1160, 1160)
"""pixels of the window"""
PICTURE = ROOT / "docs" / "images" / "overview.png"


def main() -> int:
    """Capture, and write docs/images/overview.png; returns the exit code."""
    browser = next(filter(None, map(shutil.which, ("chromium", "google-chrome", "chrome"))), None)
    if browser is None:
        print("overview_picture.py: there is no Chromium on the path", file=sys.stderr)
        return 2
    with tempfile.TemporaryDirectory() as folder:
        footage, results = Path(folder) / "day 1", Path(folder) / "results"
        shutil.copytree(ROOT / "samples" / "rendered_hand", footage)
        shutil.copy(ROOT / "samples" / "mona_lisa" / "mona_lisa.jpg", folder)
        cv2.imwrite(f"{folder}/wall.png", np.full((240, 320, 3), 120, dtype=np.uint8))
        inputs = ["mona_lisa.jpg", "wall.png", footage.name]
        with contextlib.chdir(folder):  # so that no folder of this machine is in the picture
            batch_fit.main([*inputs, "--output", results.name, "--format", "blend,glb"])
        shot = Path(folder) / "shot.png"
        options = ["--headless", "--no-sandbox", "--hide-scrollbars", f"--user-data-dir={folder}/profile"]
        options += [f"--window-size={SIZE[0]},{SIZE[1]}", f"--screenshot={shot}"]
        page = (results / "overview.html").as_uri()
        subprocess.run([browser, *options, page], check=True, capture_output=True)
        picture = cv2.imread(str(shot))
        rows = (picture != picture[-1, -1]).any(axis=(1, 2)).nonzero()[0]  # down to the last card
        cv2.imwrite(str(PICTURE), picture[: rows[-1] + 12], [cv2.IMWRITE_PNG_COMPRESSION, 9])
    print(f"{PICTURE.relative_to(ROOT)}: {PICTURE.stat().st_size // 1024} kB")
    return 0


if __name__ == "__main__":
    sys.exit(main())
