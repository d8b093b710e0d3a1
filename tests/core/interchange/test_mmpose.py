"""MMPose's JSON, written in the layouts of its sources from hands that are known."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from handfit_core.errors import InputError
from handfit_core.interchange.opening import read_recording
from handfit_core.interchange.recording import Recording
from handfit_core.options import CaptureOptions
from handfit_core.skeleton import SIDES
from tests.told import FRAMES, told

TOLD = told()
FIRST = {"left": 91, "right": 112}


def instance(frame: int, count: int = 133, score: float = 0.9) -> dict[str, Any]:
    points = np.full((count, 2), 5.0)
    for side in SIDES:
        first = FIRST[side] + count - 133
        points[first : first + 21] = TOLD.pixels[side][frame]
    # split_instances puts the box into a list of its own.
    box = [[10.0, 10.0, 500.0, 500.0]]
    return {"keypoints": points.tolist(), "keypoint_scores": [score] * count, "bbox": box, "bbox_score": 0.99}


def read(path: Path, **options: Any) -> Recording:
    return read_recording(path, CaptureOptions(**options))


def worst(recording: Recording) -> float:
    assert recording.seen is not None
    seen = recording.seen
    mine = {side: seen.keypoints[seen.left == (side == "left")] for side in SIDES}
    return float(max(np.abs(mine[side] - TOLD.pixels[side]).max() for side in SIDES))


def saved(tmp_path: Path, content: Any, name: str = "clip.json") -> Path:
    path = tmp_path / name
    path.write_text(json.dumps(content))
    return path


@pytest.mark.parametrize("count", [133, 136])
def test_the_inferencers_video(tmp_path: Path, count: int) -> None:
    frames = [{"frame_id": i, "instances": [instance(i, count)]} for i in range(FRAMES)]
    recording = read(saved(tmp_path, frames))
    assert recording.format == "mmpose"
    assert recording.frame_numbers.tolist() == list(range(FRAMES))
    assert worst(recording) < 1e-6
    assert recording.seen is not None
    assert np.allclose(recording.seen.confidence, 0.9)


def test_the_demos_video_and_picture(tmp_path: Path) -> None:
    meta = {"dataset_name": "coco_wholebody", "num_keypoints": 133}
    frames = [{"frame_id": i + 1, "instances": [instance(i)]} for i in range(FRAMES)]
    recording = read(saved(tmp_path, {"meta_info": meta, "instance_info": frames}))
    assert recording.frame_numbers.tolist() == list(range(1, FRAMES + 1))
    assert worst(recording) < 1e-6
    picture = read(saved(tmp_path, {"meta_info": meta, "instance_info": [instance(2)]}))
    assert picture.seen is not None
    assert sorted(picture.seen.left.tolist()) == [False, True]
    assert picture.frame_numbers.tolist() == [1]


def test_the_inferencers_folder_of_pictures(tmp_path: Path) -> None:
    folder = tmp_path / "predictions"
    folder.mkdir()
    saved(folder, [], "frame_0009.json")
    for i in range(FRAMES):
        saved(folder, [instance(i)], f"frame_{i + 10:04d}.json")
    recording = read(folder)
    assert recording.format == "mmpose"
    assert recording.frame_numbers.tolist() == list(range(9, 10 + FRAMES))
    assert worst(recording) < 1e-6


def test_people_and_doubtful_points(tmp_path: Path) -> None:
    doubtful = instance(0)
    doubtful["keypoint_scores"][91 + 8] = 0.01
    hidden = instance(1, score=0.1)
    recording = read(saved(tmp_path, [{"frame_id": 0, "instances": [doubtful, hidden]}]))
    assert recording.seen is not None
    assert len(recording.seen) == 2
    assert recording.seen.confidence[recording.seen.left][0, 8] == pytest.approx(0.01)
    assert any("2 of 4 hands are left out" in phrase for phrase in recording.assumed)
    with pytest.raises(InputError, match="none of its frames has a hand"):
        read(saved(tmp_path, [{"frame_id": 0, "instances": [doubtful, hidden]}]), person=2)
    with pytest.raises(InputError, match="no person 3"):
        read(saved(tmp_path, [{"frame_id": 0, "instances": [doubtful, hidden]}]), person=3)


def test_hands_alone_take_the_side_that_is_asked_for(tmp_path: Path) -> None:
    hand = {"keypoints": TOLD.pixels["left"][0].tolist(), "keypoint_scores": [0.8] * 21}
    path = saved(tmp_path, [{"frame_id": 0, "instances": [hand]}])
    left, either = read(path, hands="left"), read(path)
    assert left.seen is not None
    assert either.seen is not None
    assert (left.seen.left.tolist(), either.seen.left.tolist()) == ([True], [False])
    assert any("which hand it is is not told" in phrase for phrase in either.assumed)


@pytest.mark.parametrize(
    ("points", "scores", "said"),
    [
        ([[1.0, 2.0]] * 17, [0.9] * 17, r"shape \(17, 2\).*expected 133"),
        ([[1.0, 2.0, 3.0]] * 133, [0.9] * 133, r"\(133, 3\)"),
        ([[1.0, 2.0]] * 133, [0.9] * 3, "with 3 scores"),
        ([["a", "b"]] * 133, [0.9] * 133, "expected 133"),
        ([[1e300, 1.0]] * 133, [0.9] * 133, "beyond"),
        ([[None, None]] * 133, [0.9] * 133, "none of its frames has a hand"),
    ],
)
def test_what_is_wrong_is_one_sentence(tmp_path: Path, points: Any, scores: Any, said: str) -> None:
    path = saved(tmp_path, [{"frame_id": 0, "instances": [{"keypoints": points, "keypoint_scores": scores}]}])
    with pytest.raises(InputError, match=said):
        read(path)


def test_a_frame_of_another_kind_is_named(tmp_path: Path) -> None:
    frames = [{"frame_id": 0, "instances": [instance(0)]}, {"frame_id": 1, "instances": 3}]
    with pytest.raises(InputError, match="frame 1 has no list of instances"):
        read(saved(tmp_path, frames))
    frames[1] = {"frame_id": 0, "instances": []}
    with pytest.raises(InputError, match="frame 0 is there twice"):
        read(saved(tmp_path, frames))
