"""A clip of 30 frames per second in a shot of 24, in the window."""

from __future__ import annotations

import os
import sys

import numpy as np
import pytest

from tests.window.inputs import write_clip

FIRST, CLIP = 101, 50
FRAMES = [101, 102, 103, 104, 105, 110, 118, 123, 127, 132]


def shown_number(picture: np.ndarray, bar: list[list[float]]) -> float:
    """The frame of the clip in a screenshot, by how far the white of its bar reaches."""
    (left, y), (right, _) = bar
    x = np.linspace(left, right, 1000)
    inside = (x >= 0) & (x < picture.shape[1] - 1)
    bright = picture[round(y), np.round(x[inside]).astype(int)].mean(axis=-1) > 120
    return CLIP * float(np.linspace(0, 1, 1000)[inside][bright].max())


def test_hand_and_picture_stay_in_step(blender, rendered_hand, screenshots, tmp_path):
    cv2 = pytest.importorskip("cv2")
    clip = tmp_path / "clip.mp4"
    write_clip(os.environ.get("HANDFIT_PYTHON", sys.executable), clip, CLIP, fps=30.0, bar=24)
    played = blender.play(
        "retiming.in_step", source=clip, rate=24, first=FIRST, frames=FRAMES, timeout=400
    ).value
    for look in played["looks"]:
        moment = 1 + (look["frame"] - FIRST) * 30 / 24
        picture = cv2.imread(str(screenshots / f"retiming-{look['frame']}.png"))
        number = shown_number(picture, look["bar"])
        print(look["frame"], moment, number)
        assert abs(number - moment) <= 0.75  # half a frame, and how exactly the bar can be read
        away = np.linalg.norm(np.subtract(look["hand"], look["found"]), axis=-1)
        assert np.median(away) < 12
    assert played["corrected"] == [FRAMES[-1]]
    assert played["changed"] == [127, 132]  # the spread reaches six frames
    assert played["keys"]
    # At 25 frames per second the corrected frame is the nearest one; one undo takes that back.
    assert played["again"] == [FIRST + round((FRAMES[-1] - FIRST) * 25 / 24)]
    assert played["undone"]
