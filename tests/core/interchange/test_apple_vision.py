"""Apple Vision's hand points, by its keys and by its API's names, from hands that are known."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from handfit_core.errors import InputError, OptionError
from handfit_core.interchange.opening import RELATIVE, read_recording
from handfit_core.interchange.recording import Recording
from handfit_core.options import CaptureOptions
from handfit_core.skeleton import SIDES, Side
from tests.told import FRAMES, HEIGHT, WIDTH, told

TOLD = told()
CODES = ["VNHLKWRI", *(f"VNHLKT{j}" for j in ("CMC", "MP", "IP", "TIP"))]
CODES += [f"VNHLK{f}{j}" for f in "IMRP" for j in ("MCP", "PIP", "DIP", "TIP")]
NAMES = ["wrist", "thumbCMC", "thumbMP", "thumbIP", "thumbTip"]
NAMES += [f"{f}{j}" for f in ("index", "middle", "ring", "little") for j in ("MCP", "PIP", "DIP", "Tip")]
WRAPPED = [f"VNHumanHandPoseObservationJointName(_rawValue: {code})" for code in CODES]


def normalised(side: Side, frame: int) -> np.ndarray:
    """(21, 2) from the lower left corner."""
    x, y = TOLD.pixels[side][frame].T
    return np.column_stack([x / WIDTH, 1.0 - y / HEIGHT])


def read(path: Path, **options: Any) -> Recording:
    return read_recording(path, CaptureOptions(**options))


def saved(path: Path, content: Any) -> Path:
    path.write_text(json.dumps(content))
    return path


def worst(recording: Recording) -> float:
    seen = recording.seen
    assert seen is not None
    assert recording.size == RELATIVE
    errors = []
    for side in SIDES:
        mine = seen.left == (side == "left")
        assert seen.row[mine].tolist() == list(range(FRAMES))
        errors.append(np.abs(seen.keypoints[mine] * [WIDTH, HEIGHT] - TOLD.pixels[side]).max())
    return float(max(errors))


@pytest.mark.parametrize("names", [CODES, NAMES, WRAPPED])
@pytest.mark.parametrize("chirality", [{"left": "left", "right": "right"}, {"left": -1, "right": 1}])
def test_dictionaries_of_points(tmp_path: Path, names: list[str], chirality: dict[str, Any]) -> None:
    def hand(side: Side, frame: int) -> dict[str, Any]:
        table = normalised(side, frame).tolist()
        return {
            "chirality": chirality[side],
            "joints": {
                n: {"x": x, "y": y, "confidence": 0.8} for n, (x, y) in zip(names, table, strict=True)
            },
        }

    frames = [{"frame": i, "hands": [hand(side, i) for side in SIDES]} for i in range(FRAMES)]
    recording = read(saved(tmp_path / "hands.json", {"frames": frames}))
    assert recording.format == "apple-vision"
    assert worst(recording) < 1e-6
    assert recording.seen is not None
    assert np.allclose(recording.seen.confidence, 0.8)


def test_parts_of_a_size_that_is_told_become_pixels(tmp_path: Path) -> None:
    points = {n: [x, y, 0.6] for n, (x, y) in zip(CODES, normalised("left", 0).tolist(), strict=True)}
    content = {"width": WIDTH, "height": HEIGHT, "frames": [{"frame": 1, "chirality": "left", **points}]}
    recording = read(saved(tmp_path / "hands.json", content))
    assert recording.seen is not None
    assert recording.size == (WIDTH, HEIGHT)
    assert np.abs(recording.seen.keypoints[0] - TOLD.pixels["left"][0]).max() < 1e-6


def test_lists_end_with_the_confidence_and_missing_points_have_none(tmp_path: Path) -> None:
    points = {n: [x, y, 0.6] for n, (x, y) in zip(CODES, normalised("left", 0).tolist(), strict=True)}
    points["VNHLKITIP"] = [0.0, 1.0, 0.0]
    del points["VNHLKPTIP"]
    recording = read(saved(tmp_path / "hand.json", {"chirality": "left", **points}))
    assert recording.seen is not None
    assert recording.seen.left.tolist() == [True]
    assert np.flatnonzero(np.isnan(recording.seen.keypoints[0, :, 0])).tolist() == [8, 20]
    assert recording.seen.confidence[0, 0] == pytest.approx(0.6)


def test_tables(tmp_path: Path) -> None:
    wide = ["frame", "chirality", *(f"{n}_{c}" for n in NAMES for c in ("x", "y", "confidence"))]
    rows: list[list[Any]] = []
    for i in range(FRAMES):
        for side in SIDES:
            rows.append([i, side, *(c for row in normalised(side, i) for c in (*row, 0.9))])
    path = tmp_path / "wide.csv"
    path.write_text("\n".join(",".join(map(str, line)) for line in [wide, *rows]))
    assert worst(read(path)) < 1e-6
    rows = []
    for i in range(FRAMES):
        for side in SIDES:
            rows += [[i, side, n, *row, 0.9] for n, row in zip(CODES, normalised(side, i), strict=True)]
    path = tmp_path / "long.csv"
    path.write_text(
        "\n".join(
            ",".join(map(str, line)) for line in [["frame", "hand", "joint", "x", "y", "confidence"], *rows]
        )
    )
    recording = read(path)
    assert recording.format == "apple-vision"
    assert worst(recording) < 1e-6


def test_an_unknown_side_and_persons(tmp_path: Path) -> None:
    points = {n: [x, y, 0.6] for n, (x, y) in zip(CODES, normalised("left", 0).tolist(), strict=True)}
    path = saved(tmp_path / "hand.json", {"chirality": 0, **points})
    asked, assumed = read(path, hands="left"), read(path)
    assert asked.seen is not None
    assert assumed.seen is not None
    assert (asked.seen.left.tolist(), assumed.seen.left.tolist()) == ([True], [False])
    assert any("--hands left" in phrase for phrase in assumed.assumed)
    with pytest.raises(OptionError, match="no persons"):
        read(path, person=1)


@pytest.mark.parametrize("value", ["x", [1], {"x": "a", "y": 1}, [1e300, 1, 1], True])
def test_what_is_wrong_is_one_sentence(tmp_path: Path, value: Any) -> None:
    path = saved(tmp_path / "hand.json", [{"chirality": "left", "joints": dict.fromkeys(CODES, value)}])
    with pytest.raises(InputError) as error:
        read(path)
    assert "\n" not in str(error.value)
