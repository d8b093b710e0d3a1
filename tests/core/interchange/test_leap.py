"""Leap's frames, written by the tests from our open hand, of its websocket and of LeapC."""

from __future__ import annotations

import json
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from handfit_core.errors import InputError
from handfit_core.hand_model import load_model
from handfit_core.interchange.opening import read_recording
from handfit_core.interchange.recording import Recording
from handfit_core.interchange.settings import LIMITS
from handfit_core.options import CaptureOptions
from handfit_core.skeleton import SIDES, Side

FRAMES = 3


def keypoints(side: Side) -> np.ndarray:
    """(T, 21, 3) metres, camera frame, before a camera that looks along -z of the device."""
    rng = np.random.default_rng(SIDES.index(side))
    place = rng.uniform(-0.05, 0.05, (FRAMES, 3)) + [0.1 if side == "left" else -0.1, -0.2, 0.1]
    model = load_model(None, side)
    return model.keypoints(
        None, rng.uniform(-1.0, 1.0, (FRAMES, 3)), rng.uniform(-0.4, 0.4, (FRAMES, 45)), place
    )


def millimetres(side: Side) -> np.ndarray:
    """The same as the device has them, y up and z towards the user."""
    return keypoints(side) * [1000.0, -1000.0, -1000.0]


def websocket() -> list[dict[str, Any]]:
    frames = []
    for row in range(FRAMES):
        frame: dict[str, Any] = {
            "id": row,
            "timestamp": 10_000_000 + 10_000 * row,
            "hands": [],
            "pointables": [],
        }
        for number, side in enumerate(SIDES):
            p = millimetres(side)[row].tolist()
            frame["hands"].append({"id": 30 + number, "type": side, "wrist": p[0], "palmPosition": p[9]})
            for f in range(5):
                mcp, pip, dip, tip = p[1 + 4 * f : 5 + 4 * f]
                frame["pointables"].append(
                    {
                        "handId": 30 + number,
                        "type": f,
                        "carpPosition": mcp if f == 0 else p[0],
                        "mcpPosition": mcp,
                        "pipPosition": pip,
                        "dipPosition": dip,
                        "btipPosition": tip,
                    }
                )
        frames.append(frame)
    return frames


def leapc() -> list[dict[str, Any]]:
    frames = []
    for row in range(FRAMES):
        hands = []
        for side in SIDES:
            p = [dict(zip("xyz", x, strict=True)) for x in millimetres(side)[row].tolist()]
            digits = []
            for f in range(5):
                ends = [p[1] if f == 0 else p[0], *p[1 + 4 * f : 5 + 4 * f]]
                digits.append({"bones": [{"prev_joint": a, "next_joint": b} for a, b in pairwise(ends)]})
            hands.append({"type": side, "digits": digits, "arm": {"prev_joint": p[0], "next_joint": p[0]}})
        frames.append({"timestamp": 10_000 * row, "hands": hands})
    return frames


def read(tmp_path: Path, content: Any) -> Recording:
    path = tmp_path / "leap.json"
    path.write_text(json.dumps(content), encoding="utf-8")
    return read_recording(path, CaptureOptions())


@pytest.mark.parametrize("made", [websocket, leapc])
def test_points_come_back(tmp_path: Path, made: Any) -> None:
    recording = read(tmp_path, made())
    assert recording.format == "leap"
    assert recording.fps == pytest.approx(100.0)
    for hand in recording.points:
        np.testing.assert_allclose(hand.points, keypoints(hand.side), atol=1e-6)


def test_lines_of_json_and_frames_without_hands(tmp_path: Path) -> None:
    frames = websocket()
    frames[1]["hands"] = []
    (tmp_path / "leap.jsonl").write_text("\n".join(map(json.dumps, frames)), encoding="utf-8")
    recording = read_recording(tmp_path / "leap.jsonl", CaptureOptions())
    assert recording.points[0].present.tolist() == [True, False, True]


def edited(change: Any) -> list[dict[str, Any]]:
    frames = websocket()
    for frame in frames:
        change(frame)
    return frames


def in_metres(frame: dict[str, Any]) -> None:
    for thing in (*frame["hands"], *frame["pointables"]):
        for name, value in thing.items():
            if isinstance(value, list):
                thing[name] = [x / 1000.0 for x in value]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (in_metres, "expected millimetres"),
        (lambda frame: frame["hands"][0].update(type="both"), "expected left or right"),
        (lambda frame: frame["hands"][0].pop("wrist"), "wrist is None"),
        (lambda frame: frame["pointables"][3].update(dipPosition=[1.0]), "dipPosition"),
        (lambda frame: frame["pointables"][3].update(type=7), "type"),
        (lambda frame: frame["pointables"][3].update(btipPosition=[1e300] * 3), "btipPosition"),
    ],
)
def test_bad_files_are_named_in_a_sentence(tmp_path: Path, change: Any, words: str) -> None:
    with pytest.raises(InputError, match=words):
        read(tmp_path, edited(change))


def test_frames_without_hands_are_bounded(tmp_path: Path) -> None:
    """Each takes a kilobyte, and three bytes of the file."""
    with pytest.raises(InputError, match=f"100003 frames, and at most {LIMITS.frames} are read; cut it"):
        read(tmp_path, [*websocket(), *({} for _ in range(LIMITS.frames))])


@pytest.mark.parametrize("made", [websocket, leapc])
def test_a_second_hand_of_a_side_is_left_out_and_said(tmp_path: Path, made: Any) -> None:
    frames = made()
    assert not any("several" in phrase for phrase in read(tmp_path, frames).assumed)
    frames[1]["hands"] += [{**frames[1]["hands"][1], "type": "left"}] * 2
    recording = read(tmp_path, frames)
    assert "1 frame has several left hands: the first was taken" in recording.assumed
    for hand in recording.points:
        np.testing.assert_allclose(hand.points, keypoints(hand.side), atol=1e-6)
