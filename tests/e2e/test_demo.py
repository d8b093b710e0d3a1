"""scripts/demo.py as `nox -s demo` runs it: the first picture that anybody sees."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

bpy = pytest.importorskip("bpy", reason="needs one of the bpy wheels")

from tests.capturing import can_capture  # noqa: E402

ROOT = Path(__file__).resolve().parents[2]
TIMEOUT = 1200


@pytest.mark.slow
@pytest.mark.skipif(not can_capture(), reason="needs torch, OpenCV and MediaPipe in HANDFIT_PYTHON")
def test_the_mona_lisa_s_hands_are_captured_and_drawn_over_hers(tmp_path):
    done = subprocess.run(
        [sys.executable, str(ROOT / "scripts" / "demo.py"), "--output", str(tmp_path), "--format", "glb"],
        capture_output=True,
        text=True,
        env={**os.environ, "HANDFIT_PYTHON": os.environ.get("HANDFIT_PYTHON", sys.executable)},
        timeout=TIMEOUT,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    painting, clip = json.loads((tmp_path / "report.json").read_text(encoding="utf-8"))["inputs"]
    assert [(h["side"], h["detected"]) for h in painting["hands"]] == [("right", 1), ("left", 1)]
    assert [(h["side"], h["detected"]) for h in clip["hands"]] == [("right", 24)]
    endings = ("glb", "preview.png", "sheet.jpg", "take.npz")
    assert sorted(painting["files"]) == [f"mona_lisa.{ending}" for ending in endings]
    assert sorted(clip["files"]) == [f"hand.{ending}" for ending in endings]
    overview = (tmp_path / "overview.html").read_text(encoding="utf-8")
    for name in (*painting["files"], *clip["files"]):
        assert f'"./{name}"' in overview

    halves = np.split(pixels(tmp_path / "mona_lisa.preview.png"), 2, axis=1)
    off = np.abs(halves[0] - halves[1]).max(axis=-1) > 0.05
    rows, columns = np.nonzero(off)
    # Her hands, and nothing else.
    assert 0.03 < off.mean() < 0.08
    assert rows.min() > 0.68 * len(off)
    assert 0.15 * off.shape[1] < columns.min() < columns.max() < 0.75 * off.shape[1]


def pixels(path: Path) -> np.ndarray:
    """Rows (H, W, 3) of sRGB values 0..1, the first row on top."""
    image = bpy.data.images.load(str(path), check_existing=False)
    image.colorspace_settings.name = "Non-Color"
    values = np.empty(len(image.pixels), dtype=np.float32)
    image.pixels.foreach_get(values)
    return values.reshape(image.size[1], image.size[0], 4)[::-1, :, :3]
