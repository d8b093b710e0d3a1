"""MediaPipe's landmarks in the many layouts that people write, from hands that are known."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from handfit_core.__main__ import main
from handfit_core.errors import InputError, OptionError
from handfit_core.interchange.gather import share_left
from handfit_core.interchange.opening import RELATIVE, read_recording
from handfit_core.interchange.recording import Recording
from handfit_core.interchange.writers import writer_for
from handfit_core.options import CaptureOptions
from handfit_core.pipeline import capture
from handfit_core.skeleton import SIDES, Side, other_side
from tests.told import FRAMES, HEIGHT, WIDTH, told

TOLD = told()
SCALE = np.array([WIDTH, HEIGHT, WIDTH], dtype=float)
NAMES = (
    "WRIST THUMB_CMC THUMB_MCP THUMB_IP THUMB_TIP INDEX_FINGER_MCP INDEX_FINGER_PIP INDEX_FINGER_DIP "
    "INDEX_FINGER_TIP MIDDLE_FINGER_MCP MIDDLE_FINGER_PIP MIDDLE_FINGER_DIP MIDDLE_FINGER_TIP "
    "RING_FINGER_MCP RING_FINGER_PIP RING_FINGER_DIP RING_FINGER_TIP PINKY_MCP PINKY_PIP PINKY_DIP PINKY_TIP"
).split(" ")


def landmarks(side: Side, frame: int) -> np.ndarray:
    """(21, 3) in parts of the picture, as MediaPipe has them."""
    return np.column_stack([TOLD.pixels[side][frame], TOLD.depth[side][frame]]) / SCALE


def points(values: np.ndarray) -> list[dict[str, float]]:
    return [dict(zip("xyz", map(float, row), strict=True)) for row in values]


def read(path: Path, **options: Any) -> Recording:
    return read_recording(path, CaptureOptions(**options))


def worst(recording: Recording) -> float:
    """The largest error in pixels; every hand must be of its side, with its depth if there is any."""
    seen = recording.seen
    assert seen is not None
    by = np.array([WIDTH, HEIGHT]) if recording.size == RELATIVE else np.ones(2)
    errors = []
    for side in SIDES:
        mine = seen.left == (side == "left")
        assert seen.row[mine].tolist() == list(range(FRAMES))
        errors.append(np.abs(seen.keypoints[mine] * by - TOLD.pixels[side]).max())
        if seen.depth is not None:
            errors.append(np.abs(seen.depth[mine] * by[0] - TOLD.depth[side]).max())
        if seen.world is not None:
            errors.append(1000.0 * np.abs(seen.world[mine] - TOLD.world[side]).max())
    return float(max(errors))


def tasks(frame: int) -> dict[str, Any]:
    """As tasks-vision's HandLandmarkerResult in JSON."""
    return {
        "landmarks": [points(landmarks(side, frame)) for side in SIDES],
        "worldLandmarks": [points(TOLD.world[side][frame]) for side in SIDES],
        "handedness": [
            [{"score": 0.97, "index": 0, "categoryName": s.capitalize(), "displayName": s}] for s in SIDES
        ],
    }


def tasks_python(frame: int) -> dict[str, Any]:
    return {
        "hand_landmarks": [landmarks(side, frame).tolist() for side in SIDES],
        "hand_world_landmarks": [TOLD.world[side][frame].tolist() for side in SIDES],
        "handedness": [[{"score": 0.97, "category_name": side.capitalize()}] for side in SIDES],
    }


def legacy(frame: int) -> dict[str, Any]:
    """As the older solutions' messages in JSON, whose labels count for mirrored pictures."""
    return {
        "multi_hand_landmarks": [{"landmark": points(landmarks(side, frame))} for side in SIDES],
        "multi_handedness": [
            {"classification": [{"index": 0, "score": 0.9, "label": other_side(side).capitalize()}]}
            for side in SIDES
        ],
    }


def legacy_script(frame: int) -> dict[str, Any]:
    return {
        "multiHandLandmarks": [points(landmarks(side, frame)) for side in SIDES],
        "multiHandedness": [
            {"index": 0, "score": 0.9, "label": other_side(side).capitalize()} for side in SIDES
        ],
        "multiHandWorldLandmarks": [points(TOLD.world[side][frame]) for side in SIDES],
    }


def holistic(frame: int) -> dict[str, Any]:
    return {
        "pose_landmarks": points(np.full((33, 3), 0.5)),
        **{f"{side}_hand_landmarks": points(landmarks(side, frame)) for side in SIDES},
    }


def listed(frame: int) -> dict[str, Any]:
    return {
        "hands": [
            {"handedness": s.capitalize(), "score": 0.8, "landmarks": points(landmarks(s, frame))}
            for s in SIDES
        ]
    }


def by_side(frame: int) -> dict[str, Any]:
    return {
        side: {n.lower(): row.tolist() for n, row in zip(NAMES, landmarks(side, frame), strict=True)}
        for side in SIDES
    }


def flat(frame: int) -> dict[str, Any]:
    return {
        "hands": [{"label": side, "landmarks": landmarks(side, frame).ravel().tolist()} for side in SIDES]
    }


LAYOUTS = [tasks, tasks_python, legacy, legacy_script, holistic, listed, by_side, flat]


@pytest.mark.parametrize("layout", LAYOUTS)
def test_a_list_of_frames(tmp_path: Path, layout: Callable[[int], dict[str, Any]]) -> None:
    path = tmp_path / "hands.json"
    path.write_text(json.dumps([layout(i) for i in range(FRAMES)]))
    recording = read(path)
    assert recording.format == "mediapipe"
    assert recording.size == RELATIVE
    assert recording.frame_numbers.tolist() == list(range(1, FRAMES + 1))
    assert worst(recording) < 0.01


@pytest.mark.parametrize("layout", LAYOUTS)
def test_frames_with_numbers_beside_a_header(tmp_path: Path, layout: Callable[[int], dict[str, Any]]) -> None:
    frames = [{"frame": 3 + 2 * i, "timestamp": 80.0 * i, **layout(i)} for i in range(FRAMES)]
    path = tmp_path / "hands.json"
    path.write_text(json.dumps({"width": WIDTH, "height": HEIGHT, "frames": frames}))
    recording = read(path)
    assert recording.frame_numbers.tolist() == list(range(3, 3 + 2 * FRAMES, 2))
    assert (recording.size, recording.fps) == ((WIDTH, HEIGHT), 25.0)
    assert worst(recording) < 0.01


def test_frames_by_their_numbers_lines_and_a_folder(tmp_path: Path) -> None:
    by_number = tmp_path / "hands.json"
    by_number.write_text(json.dumps({str(i): tasks(i) for i in range(FRAMES)}))
    lines = tmp_path / "hands.jsonl"
    lines.write_text("\n".join(json.dumps({"frame_id": i, **tasks(i)}) for i in range(FRAMES)))
    folder = tmp_path / "hands"
    folder.mkdir()
    for i in range(FRAMES):
        (folder / f"frame_{i:05d}.json").write_text(json.dumps(tasks(i)))
    for path in (by_number, lines, folder):
        recording = read(path)
        assert recording.frame_numbers.tolist() == list(range(FRAMES))
        assert worst(recording) < 0.01


def test_a_folder_that_begins_without_hands(tmp_path: Path) -> None:
    folder = tmp_path / "hands"
    folder.mkdir()
    for i in range(3):
        empty = {"landmarks": [], "handedness": []}
        (folder / f"{i}.json").write_text(json.dumps(empty if i < 2 else tasks(i)))
    seen = read(folder).seen
    assert seen is not None
    assert seen.row.tolist() == [2, 2]


def test_one_frame_and_one_hand(tmp_path: Path) -> None:
    path = tmp_path / "photo.json"
    path.write_text(json.dumps(tasks(0)))
    seen = read(path).seen
    assert seen is not None
    assert seen.left.tolist() == [True, False]
    path.write_text(json.dumps(points(landmarks("left", 3))))
    recording = read(path)
    assert recording.seen is not None
    assert recording.seen.left.tolist() == [True]
    assert any("a left hand, as its fingers bend" in phrase for phrase in recording.assumed)


def test_frames_without_hands_stay(tmp_path: Path) -> None:
    empty = {"landmarks": [], "worldLandmarks": [], "handedness": []}
    path = tmp_path / "hands.json"
    path.write_text(json.dumps([empty, None, tasks(0)]))
    recording = read(path)
    assert recording.frame_numbers.tolist() == [1, 2, 3]
    assert recording.seen is not None
    assert recording.seen.row.tolist() == [2, 2]


def wrong(frame: int) -> dict[str, Any]:
    """As somebody writes who keeps the older solutions' labels in a layout of his own."""
    named = {"left": "Right", "right": "Left"}
    return {"hands": [{"label": named[s], "landmarks": points(landmarks(s, frame))} for s in SIDES]}


def right(frame: int) -> dict[str, Any]:
    """As somebody writes who has put the older solutions' labels right."""
    return legacy(frame) | {"multi_handedness": [{"label": side} for side in SIDES]}


@pytest.mark.parametrize(
    ("layout", "swapped"), [(wrong, True), (right, False), (tasks, False), (legacy, True)]
)
def test_the_fingers_tell_whose_labels_are_of_mirrored_pictures(
    tmp_path: Path, layout: Callable[[int], dict[str, Any]], swapped: bool
) -> None:
    path = tmp_path / "hands.json"
    path.write_text(json.dumps([layout(i) for i in range(FRAMES)]))
    recording = read(path)
    assert worst(recording) < 0.01
    assert any("left and right are swapped" in phrase for phrase in recording.assumed) == swapped


@pytest.mark.parametrize(("layout", "swapped"), [(legacy, True), (listed, False)])
def test_without_depth_the_layout_tells(
    tmp_path: Path, layout: Callable[[int], dict[str, Any]], swapped: bool
) -> None:
    text = json.dumps([layout(i) for i in range(FRAMES)])
    flat_hands = json.loads(text, object_hook=lambda of: {k: v for k, v in of.items() if k != "z"})
    path = tmp_path / "hands.json"
    path.write_text(json.dumps(flat_hands))
    recording = read(path)
    assert recording.seen is not None
    assert recording.seen.depth is None
    assert worst(recording) < 0.01
    assert any("multi_handedness" in phrase for phrase in recording.assumed) == swapped


@pytest.mark.parametrize("key", ["hand", "type", "label", "handedness"])
def test_hands_that_are_counted_are_no_sides(tmp_path: Path, key: str) -> None:
    """A side that is asked for is that of hands of unknown side; chirality tells it by -1 and 1."""
    hands = [{key: i, "landmarks": landmarks("right", 0).tolist()} for i in (-1, 0, 1)]
    path = tmp_path / "hands.json"
    path.write_text(json.dumps([{"hands": hands}]))
    recording = read(path, hands="left")
    assert recording.seen is not None
    assert recording.seen.left.tolist() == [True] * 3
    for hand, side in zip(hands, (-1, 1, 1), strict=True):
        hand["chirality"] = side
    path.write_text(json.dumps([{"hands": hands}]))
    recording = read(path, reader="apple-vision")
    assert recording.seen is not None
    assert recording.seen.left.tolist() == [True, False, False]


def test_world_landmarks_alone_are_hands_in_space(tmp_path: Path) -> None:
    frames = [
        {"handedness": list(SIDES), "world_landmarks": [TOLD.world[s][i].tolist() for s in SIDES]}
        for i in range(FRAMES)
    ]
    path = tmp_path / "hands.json"
    path.write_text(json.dumps(frames))
    recording = read(path)
    assert recording.seen is None
    assert [hand.side for hand in recording.points] == list(SIDES)
    for hand in recording.points:
        assert not hand.on_joints
        assert np.abs(hand.points - TOLD.world[hand.side]).max() < 1e-4


def table(path: Path, header: list[str], rows: Iterator[list[Any]] | list[list[Any]]) -> Path:
    lines = [header, *rows]
    path.write_text("\n".join(",".join(map(str, line)) for line in lines))
    return path


def wide(first: int) -> list[str]:
    return [f"{axis}{i}" for i in range(first, first + 21) for axis in "xyz"]


def each() -> Iterator[tuple[int, Side]]:
    return ((i, side) for i in range(FRAMES) for side in SIDES)


@pytest.mark.parametrize("first", [0, 1])
def test_a_row_for_each_hand(tmp_path: Path, first: int) -> None:
    rows = [[i, side.capitalize(), *landmarks(side, i).ravel()] for i, side in each()]
    recording = read(table(tmp_path / "a.csv", ["frame", "handedness", *wide(first)], rows))
    assert recording.frame_numbers.tolist() == list(range(FRAMES))
    assert worst(recording) < 0.01


@pytest.mark.parametrize("written", ["{:.6f}", "{:.18e}", "{}.0", "frame_2.1_{:05d}.png", "{:04d}"])
def test_frames_numbers_as_they_are_written(tmp_path: Path, written: str) -> None:
    rows = [[written.format(i + 9), side, *landmarks(side, i).ravel()] for i, side in each()]
    recording = read(table(tmp_path / "a.csv", ["frame", "hand", *wide(0)], rows))
    assert recording.frame_numbers.tolist() == list(range(9, 9 + FRAMES))
    assert worst(recording) < 0.01


@pytest.mark.parametrize("cell", ["1.5", "1e-3", "1e400", "1e17", "first", ""])
def test_frames_that_are_no_whole_numbers(tmp_path: Path, cell: str) -> None:
    rows = [[cell, "left", *landmarks("left", 0).ravel()]]
    with pytest.raises(InputError, match="no frame's number"):
        read(table(tmp_path / "a.csv", ["frame", "hand", *wide(0)], rows))


def test_columns_by_names_with_and_without_a_side(tmp_path: Path) -> None:
    header = ["frame_number", "hand", *(f"{name}_{axis}" for name in NAMES for axis in "xyz")]
    rows = [[i, side[0].upper(), *landmarks(side, i).ravel()] for i, side in each()]
    assert worst(read(table(tmp_path / "a.csv", header, rows))) < 0.01
    header = [f"{side}_hand_{name.lower()}_{axis}" for side in SIDES for name in NAMES for axis in "xyz"]
    rows = [[*landmarks("left", i).ravel(), *landmarks("right", i).ravel()] for i in range(FRAMES)]
    recording = read(table(tmp_path / "b.csv", header, rows))
    assert worst(recording) < 0.01
    assert any("no frame numbers" in phrase for phrase in recording.assumed)


def test_columns_of_two_numbered_hands_without_sides(tmp_path: Path) -> None:
    header = [f"hand{h}_landmark{i}_{axis}" for h in (0, 1) for i in range(21) for axis in "xyz"]
    rows = [[*landmarks("left", i).ravel(), *landmarks("right", i).ravel()] for i in range(FRAMES)]
    assert worst(read(table(tmp_path / "a.csv", header, rows))) < 0.01


def test_a_row_for_each_point(tmp_path: Path) -> None:
    rows = [[i, side == "right", k, *landmarks(side, i)[k]] for i, side in each() for k in range(21)]
    rows = [[i, int(h), *rest] for i, h, *rest in rows]
    recording = read(table(tmp_path / "a.csv", ["Frame", "Hand", "Landmark", "X", "Y", "Z"], rows))
    assert worst(recording) < 0.01
    assert any("as its fingers bend" in phrase for phrase in recording.assumed)


def test_a_row_for_each_point_beside_a_body_and_a_face(tmp_path: Path) -> None:
    """As in the data of Google's sign language competition."""
    rows: list[list[Any]] = []
    for i in range(FRAMES):
        for kind, values in (
            ("face", np.full((30, 3), 0.4)),
            ("left_hand", landmarks("left", i)),
            ("pose", np.full((33, 3), 0.5)),
            ("right_hand", landmarks("right", i)),
        ):
            rows += [[20 + i, f"{20 + i}-{kind}-{k}", kind, k, *row] for k, row in enumerate(values)]
    header = ["frame", "row_id", "type", "landmark_index", "x", "y", "z"]
    recording = read(table(tmp_path / "a.csv", header, rows))
    assert recording.frame_numbers.tolist() == list(range(20, 20 + FRAMES))
    assert worst(recording) < 0.01


def test_pixels_with_a_depth_in_parts_of_the_width(tmp_path: Path) -> None:
    rows = [
        [i, i / 50.0, side, *np.column_stack([TOLD.pixels[side][i], landmarks(side, i)[:, 2]]).ravel()]
        for i, side in each()
    ]
    path = table(tmp_path / "a.csv", ["frame", "time", "hand", *wide(0)], rows)
    recording = read(path, picture_size=(WIDTH, HEIGHT))
    assert (recording.size, recording.fps) == ((WIDTH, HEIGHT), 50.0)
    assert worst(recording) < 0.01
    plain = read(path).seen
    assert plain is not None
    assert plain.depth is None


def test_missing_cells_and_zeros_of_visibility(tmp_path: Path) -> None:
    header = ["frame", "hand", *(f"{axis}{i}" for i in range(21) for axis in ("x", "y", "z", "v"))]
    rows: list[list[Any]] = []
    for i in range(2):
        cells = [[*row, 0.0] for row in landmarks("right", i).tolist()]
        rows.append([i, "Right", *(cell for row in cells for cell in row)])
    rows[1][2 + 4 * 8 : 2 + 4 * 8 + 2] = ["", ""]
    rows.append([2, "", *[""] * 84])
    seen = read(table(tmp_path / "a.csv", header, rows)).seen
    assert seen is not None
    assert seen.row.tolist() == [0, 1]
    assert np.flatnonzero(seen.confidence[1] == 0.0).tolist() == [8]
    assert seen.confidence[0].min() == 1.0


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ([{"landmarks": [points(np.ones((20, 3)))], "handedness": ["Left"]}], "20 points; expected 21"),
        (
            [{"landmarks": [[{"x": "a", "y": 1, "z": 1}] * 21], "handedness": ["Left"]}],
            "not as MediaPipe|no hands",
        ),
        ([{"landmarks": [[[1e300, 1, 1]] * 21], "handedness": ["Left"]}], "beyond"),
        ([{"frame": 1, **tasks(0)}, {"frame": 1, **tasks(1)}], "frame 1 is there twice"),
        ([tasks(0), {"landmarks": [[[0.1, 0.2]] * 22]}], "22 points; expected 21"),
        (
            [{"multi_hand_landmarks": [[[None, None, None]] * 21], "multi_handedness": ["Left"]}],
            "at least 6|no hands",
        ),
        ([{"landmarks": [], "handedness": []}], "no hands or keypoints"),
    ],
)
def test_what_is_wrong_is_one_sentence(tmp_path: Path, content: Any, said: str) -> None:
    path = tmp_path / "hands.json"
    path.write_text(json.dumps(content))
    with pytest.raises(InputError, match=said) as error:
        read(path, reader="mediapipe") if "no hands" not in said else read(path)
    assert "\n" not in str(error.value)


def test_tables_that_cannot_be_read(tmp_path: Path) -> None:
    rows = [[0, "Left", 0, 0.1, 0.2, 0.0], [0, "Left", 0, 0.1, 0.2, 0.0]]
    header = ["frame", "hand", "landmark", "x", "y", "z"]
    with pytest.raises(InputError, match="frame 0 has the point 0 of one hand twice"):
        read(table(tmp_path / "a.csv", header, rows))
    with pytest.raises(InputError, match="no column tells the frame"):
        read(table(tmp_path / "b.csv", header[1:], [row[1:] for row in rows]))
    rows[0][0] = "first"
    with pytest.raises(InputError, match="'first', which is no frame's number"):
        read(table(tmp_path / "c.csv", header, rows))
    path = tmp_path / "d.json"
    path.write_text(json.dumps([tasks(0)]))
    with pytest.raises(OptionError, match="no persons"):
        read(path, person=1)


def test_what_is_written_is_read_back(tmp_path: Path) -> None:
    path = tmp_path / "hands.mediapipe.json"
    writer_for(path).write(TOLD.take, path)
    recording = read(path)
    assert (recording.format, recording.size, recording.fps) == ("mediapipe", (WIDTH, HEIGHT), TOLD.take.fps)
    assert recording.frame_numbers.tolist() == TOLD.take.frame_numbers.tolist()
    assert worst(recording) < 0.01
    assert not recording.assumed


def test_the_command_line_converts_landmarks(tmp_path: Path) -> None:
    path, out = tmp_path / "hands.json", tmp_path / "hands.points.json"
    path.write_text(
        json.dumps({"width": WIDTH, "height": HEIGHT, "frames": [tasks(i) for i in range(FRAMES)]})
    )
    assert main(["convert", str(path), "-o", str(out), "--progress", "none"]) == 0
    written = json.loads(out.read_text())
    assert sorted(hand["side"] for hand in written["hands"]) == list(SIDES)
    for hand in written["hands"]:
        off = np.abs(np.array(hand["keypoints_2d"]) - TOLD.pixels[hand["side"]]).max()
        assert off < 0.01


def test_parts_of_an_unknown_size_are_asked_for(tmp_path: Path) -> None:
    path = tmp_path / "hands.json"
    path.write_text(json.dumps([tasks(0)]))
    with pytest.raises(OptionError, match="--picture-size"):
        capture(path)


def test_a_real_clips_landmarks(samples: Path) -> None:
    """A bare list of a hand's points a frame, in pixels, of whoever detected it."""
    path = samples / "videos" / "asl_hand.mediapipe_2d.json"
    recording = read(path)
    assert recording.seen is not None
    assert len(recording.frame_numbers) == 325
    assert any("a right hand, as its fingers bend" in phrase for phrase in recording.assumed)
    assert share_left(np.array(json.loads(path.read_text()))) < -0.99
    world = read(samples / "videos" / "asl_hand.mediapipe_world.json")
    assert [hand.side for hand in world.points] == ["right"]
