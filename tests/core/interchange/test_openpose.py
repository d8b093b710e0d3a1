"""OpenPose's folders of JSON, written in its layout from hands that are known."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from handfit_core.errors import InputError, PictureSizeError
from handfit_core.interchange.opening import RELATIVE, read_recording
from handfit_core.interchange.recording import Recording
from handfit_core.options import CaptureOptions
from handfit_core.pipeline import capture
from handfit_core.skeleton import SIDES
from tests.told import FRAMES, HEIGHT, WIDTH, told

TOLD = told()
BODY = np.column_stack([np.linspace(100, 800, 25), np.linspace(50, 500, 25), np.full(25, 0.8)])
SIZE = np.array([WIDTH, HEIGHT], dtype=float)


def flat(points: np.ndarray, sure: float | np.ndarray = 0.7) -> list[float]:
    return np.column_stack([points, np.broadcast_to(sure, len(points))]).round(3).ravel().tolist()


def person(frame: int, scale: Callable[[np.ndarray], np.ndarray] = np.copy) -> dict[str, Any]:
    hands = {f"hand_{side}_keypoints_2d": flat(scale(TOLD.pixels[side][frame])) for side in SIDES}
    body = np.column_stack([scale(BODY[:, :2]), BODY[:, 2]])
    return {"person_id": [-1], "pose_keypoints_2d": body.ravel().tolist(), "face_keypoints_2d": [], **hands}


def folder(path: Path, frames: list[list[Any]], name: str = "clip_{:012d}_keypoints.json") -> Path:
    path.mkdir(exist_ok=True)
    for number, people in enumerate(frames):
        (path / name.format(number)).write_text(json.dumps({"version": 1.3, "people": people}))
    return path


def read(path: Path, **options: Any) -> Recording:
    return read_recording(path, CaptureOptions(**options))


def worst(recording: Recording, by: np.ndarray | float = 1.0, rows: range = range(FRAMES)) -> float:
    """The largest error in pixels of hands that are there in all rows."""
    assert recording.seen is not None
    seen = recording.seen
    errors = []
    for side in SIDES:
        mine = seen.keypoints[seen.left == (side == "left")] * by
        errors.append(np.abs(mine - TOLD.pixels[side][list(rows)]).max())
    return float(max(errors))


def test_a_folder_has_both_hands_of_every_frame(tmp_path: Path) -> None:
    recording = read(folder(tmp_path / "op", [[person(i)] for i in range(FRAMES)]))
    assert recording.format == "openpose"
    assert recording.frame_numbers.tolist() == list(range(FRAMES))
    assert recording.seen is not None
    assert worst(recording) < 0.01
    assert np.allclose(recording.seen.confidence, 0.7)
    assert recording.seen.depth is None


def to_unit(points: np.ndarray) -> np.ndarray:
    return points / (SIZE - 1.0)


def to_minus(points: np.ndarray) -> np.ndarray:
    return 2.0 * points / (SIZE - 1.0) - 1.0


@pytest.mark.parametrize(("scale", "said"), [(to_unit, "scale 3"), (to_minus, "scale 4")])
def test_keypoint_scales_are_noticed(
    tmp_path: Path, scale: Callable[[np.ndarray], np.ndarray], said: str
) -> None:
    people = [[person(i, lambda p: scale(p))] for i in range(FRAMES)]
    for frame in people:
        for side in SIDES:
            values = np.column_stack([scale(TOLD.pixels[side][0]), np.full(21, 0.7)])
            frame[0][f"hand_{side}_keypoints_2d"] = values.ravel().tolist()
    recording = read(folder(tmp_path / "op", people))
    assert recording.size == RELATIVE
    assert any(said in phrase for phrase in recording.assumed)
    assert recording.seen is not None
    left = recording.seen.keypoints[recording.seen.left] * (SIZE - 1.0)
    assert np.abs(left - TOLD.pixels["left"][0]).max() < 0.1


def test_a_missing_point_tells_the_scale_of_hands_in_one_corner(tmp_path: Path) -> None:
    """All that is seen lies in the right lower quarter: from -1 to 1, nothing of it is negative."""
    corner = to_minus(TOLD.pixels["left"][0] / 2.0 + SIZE / 2.0)
    hand = np.column_stack([corner, np.full(21, 0.7)])
    hand[7] = [-1.0, -1.0, 0.0]
    human = {"hand_left_keypoints_2d": hand.ravel().tolist(), "hand_right_keypoints_2d": [0.0] * 63}
    recording = read(folder(tmp_path / "op", [[human]]))
    assert recording.seen is not None
    pixels = recording.seen.keypoints[0] * (SIZE - 1.0)
    expected = TOLD.pixels["left"][0] / 2.0 + SIZE / 2.0
    assert np.isnan(pixels[7]).all()
    assert np.nanmax(np.abs(pixels - expected)) < 0.1


def test_a_folder_alone_is_fitted_by_the_size_that_is_told(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = folder(tmp_path / "op", [[person(i)] for i in range(FRAMES)])
    take = capture(path, picture_size=(WIDTH, HEIGHT), fps=25)
    assert (take.width, take.height, take.source.kind) == (WIDTH, HEIGHT, "data")
    assert take.frame_numbers.tolist() == list(range(FRAMES))
    assert take.program == "OpenPose"
    assert sorted(hand.side for hand in take.hands) == list(SIDES)
    for hand in take.hands:
        # The hand's size in the picture is about 190 pixels.
        assert (
            np.linalg.norm(take.intrinsics.project(hand.joints_3d) - TOLD.pixels[hand.side], axis=-1).mean()
            < 12
        )
    assert not caplog.messages
    with pytest.raises(PictureSizeError, match="--picture-size"):
        capture(path)


def test_zeros_are_missing_points_and_hidden_hands_are_left_out(tmp_path: Path) -> None:
    people = person(0)
    left = np.array(people["hand_left_keypoints_2d"]).reshape(21, 3)
    left[[4, 8]] = 0.0
    people["hand_left_keypoints_2d"] = left.ravel().tolist()
    people["hand_right_keypoints_2d"] = flat(TOLD.pixels["right"][0], 0.04)
    recording = read(folder(tmp_path / "op", [[people], []]))
    assert recording.seen is not None
    assert recording.seen.left.tolist() == [True]
    assert np.flatnonzero(np.isnan(recording.seen.keypoints[0, :, 0])).tolist() == [4, 8]
    assert recording.seen.confidence[0, [4, 8]].tolist() == [0.0, 0.0]
    assert any("1 of 2 hands are left out" in phrase for phrase in recording.assumed)


def test_one_of_several_people_is_chosen(tmp_path: Path) -> None:
    other = {"hand_left_keypoints_2d": flat(TOLD.pixels["left"][0] + 40.0), "hand_right_keypoints_2d": []}
    path = folder(tmp_path / "op", [[person(0), other], [person(1)]])
    assert len(read(path).seen or ()) == 5
    second = read(path, person=2).seen
    assert second is not None
    assert second.row.tolist() == [0]
    assert np.abs(second.keypoints[0] - TOLD.pixels["left"][0] - 40.0).max() < 0.01
    with pytest.raises(InputError, match="no person 3; its frames have at most 2"):
        read(path, person=3)


def test_names_of_pictures_keep_their_numbers(tmp_path: Path) -> None:
    path = folder(tmp_path / "op", [[person(i)] for i in range(3)], "shot{:04d}_keypoints.json")
    (path / "shot0001_keypoints.json").unlink()
    assert read(path).frame_numbers.tolist() == [0, 2]
    alone = read(path / "shot0002_keypoints.json")
    assert alone.frame_numbers.tolist() == [2]


def test_files_without_numbers_are_counted(tmp_path: Path) -> None:
    path = tmp_path / "op"
    path.mkdir()
    for name in ("b", "a"):
        (path / f"{name}.json").write_text(json.dumps({"people": [person(int(name == "b"))]}))
    recording = read(path)
    assert recording.frame_numbers.tolist() == [1, 2]
    assert recording.seen is not None
    left = recording.seen.keypoints[recording.seen.left]
    assert np.abs(left - TOLD.pixels["left"][:2]).max() < 0.01
    assert any("a.json and 1 more have no number" in phrase for phrase in recording.assumed)


def test_files_that_are_no_frames_are_left_out_by_name(tmp_path: Path) -> None:
    """A camera's parameters lie in OpenPose's folders, too."""
    path = folder(tmp_path / "op", [[person(i)] for i in range(FRAMES)])
    for content in ({"people": []}, {"intrinsics": [1.0]}):
        (path / "camera.json").write_text(json.dumps(content))
        recording = read(path)
        assert recording.frame_numbers.tolist() == list(range(FRAMES))
        assert worst(recording) < 0.01
        assert "camera.json has no number in its name: left out" in recording.assumed


def test_a_point_that_is_no_number_leaves_the_others_their_scale(tmp_path: Path) -> None:
    for scale, size in ((SIZE, RELATIVE), (1.0, None)):
        hand = np.column_stack([TOLD.pixels["left"][0] / scale, np.full(21, 0.7)])
        hand[8, 0] = np.nan
        people = [{"hand_left_keypoints_2d": hand.ravel().tolist()}]
        recording = read(folder(tmp_path / "op", [people]))
        assert recording.size == size
        assert recording.seen is not None
        assert np.flatnonzero(np.isnan(recording.seen.keypoints[0, :, 0])).tolist() == [8]


def test_parts_of_a_canvas_become_its_pixels(tmp_path: Path) -> None:
    points = [[TOLD.pixels[side][0] / SIZE, np.full((21, 1), 0.7)] for side in SIDES]
    hands = {
        f"hand_{s}_keypoints_2d": np.hstack(p).ravel().tolist() for s, p in zip(SIDES, points, strict=True)
    }
    path = tmp_path / "poses.json"
    path.write_text(json.dumps([{"people": [hands], "canvas_width": WIDTH, "canvas_height": HEIGHT}]))
    recording = read(path)
    assert recording.size == (WIDTH, HEIGHT)
    assert worst(recording, rows=range(1)) < 1e-6


def test_controlnets_list_with_the_size_of_its_canvas(tmp_path: Path) -> None:
    frames = [{"people": [person(i)], "canvas_width": WIDTH, "canvas_height": HEIGHT} for i in range(FRAMES)]
    path = tmp_path / "poses.json"
    path.write_text(json.dumps(frames))
    recording = read(path)
    assert recording.size == (WIDTH, HEIGHT)
    assert worst(recording) < 0.01
    assert recording.frame_numbers.tolist() == list(range(1, FRAMES + 1))


@pytest.mark.parametrize(
    ("frame", "said"),
    [
        (
            {"people": [{"pose_keypoints_2d": [1.0, 2.0, 0.5] * 25, "hand_left_keypoints_2d": []}]},
            "with --hand",
        ),
        ({"people": [{"hand_left_keypoints_2d": [1.0, 2.0, 0.5] * 20}]}, "of 20 points; expected 21"),
        ({"people": [{"hand_left_keypoints_2d": [1.0] * 62}]}, "x, y and confidence"),
        ({"people": [{"hand_left_keypoints_2d": ["a"] * 63}]}, "not as OpenPose writes it"),
        ({"people": [{"hand_left_keypoints_2d": [0.0] * 63}]}, "at least 6 points"),
        ({"people": [{"hand_left_keypoints_2d": [1e300] * 63}]}, "beyond"),
        ({"people": [7]}, "with --hand"),
        ({"people": []}, "with --hand"),
    ],
)
def test_what_is_wrong_is_one_sentence(tmp_path: Path, frame: Any, said: str) -> None:
    path = tmp_path / "op"
    path.mkdir()
    (path / "a_000_keypoints.json").write_text(json.dumps(frame))
    with pytest.raises(InputError, match=said) as error:
        read(path)
    assert "\n" not in str(error.value)


def test_a_truncated_file_and_two_clips_are_named(tmp_path: Path) -> None:
    path = folder(tmp_path / "op", [[person(i)] for i in range(3)])
    cut = path / "clip_000000000001_keypoints.json"
    cut.write_text(cut.read_text()[:300])
    with pytest.raises(InputError, match=r"000001_keypoints\.json: .*damaged"):
        read(path)
    cut.unlink()
    folder(path, [[person(0)]], "other_{:012d}_keypoints.json")
    with pytest.raises(InputError, match="several clips"):
        read(path)
