"""The table of programs that write points: hands that are known come back out of each layout."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from handfit_core.capturing.pipeline import capture
from handfit_core.common.errors import InputError, OptionError, PictureSizeError
from handfit_core.common.skeleton import KEYPOINT_NAMES, SIDES, Side, other_side
from handfit_core.interchange.opening import RELATIVE, is_recording
from handfit_core.interchange.point_hands import share_left
from handfit_core.interchange.recording import Recording, SeenHands
from handfit_core.interchange.settings import LIMITS
from handfit_core.interchange.writers import writer_for
from tests.core.interchange import point_files as files
from tests.core.interchange.known_hands import read, says
from tests.core.interchange.point_files import ALL, MADE, SIZE, TOLD, landmarks, saved, table, wide
from tests.told import FRAMES, HEIGHT, WIDTH


def seen_in(recording: Recording) -> SeenHands:
    assert recording.seen is not None
    return recording.seen


def sides_in(recording: Recording) -> str:
    """L and R of each hand."""
    return "".join("LR"[side] for side in seen_in(recording).side)


def worst(recording: Recording, rows: list[int] = ALL, sides: tuple[Side, ...] = SIDES) -> float:
    """The largest error of the hands in those rows of the known ones: pixels, or millimetres in space and of
    the world."""
    if recording.seen is None:
        assert {hand.side for hand in recording.points} == set(sides)
        off = [np.abs(hand.points - TOLD.points[hand.side][rows]) for hand in recording.points]
        assert all(np.isfinite(each).any(axis=(1, 2)).sum() >= len(rows) - 1 for each in off)
        return 1000.0 * float(np.nanmax(off))
    seen, errors = recording.seen, []
    by = SIZE if recording.size == RELATIVE else np.ones(2)
    assert set(seen.side) == {SIDES.index(side) for side in sides}
    for side in sides:
        mine = seen.select(seen.side == SIDES.index(side))
        assert mine.row.tolist() == list(range(len(rows)))
        errors.append(np.abs(mine.keypoints * by - TOLD.pixels[side][rows]).max())
        errors.append(np.nanmax(np.abs(mine.points[..., 2] * by[0] - TOLD.depth[side][rows]), initial=0.0))
        errors.append(1000.0 * np.nanmax(np.abs(mine.world - TOLD.world[side][rows]), initial=0.0))
    return float(max(errors))


# Every layout


@pytest.mark.parametrize("name", MADE)
def test_hands_come_back(tmp_path: Path, name: str) -> None:
    made, path = MADE[name], files.written(tmp_path, name)
    assert is_recording(path)
    recording = read(path)
    assert recording.format == made.reader
    assert len(recording.frame_numbers) == len(made.rows)
    assert worst(recording, made.rows, made.sides) < 0.01
    fps = {"aria": 10.0, "trc": 50.0, "leap": 100.0}.get(made.reader, 24.0)
    assert recording.fps == pytest.approx(fps)
    if made.reader in ("leap", "freemocap"):
        assert all(hand.on_joints == (made.reader == "leap") for hand in recording.points)
    unsided = name in ("both_numbered.csv", "deeplabcut.csv", "points.csv", "metres.json") or (
        made.reader == "arrays" and name != "sides.npz"
    )
    assert says(recording, "which hand it is is not told") == unsided
    annotations = made.reader == "coco-wholebody"
    if annotations or name in ("right_hand.csv", "trajectories.csv", "freemocap2.csv"):
        first = 100 if annotations else 0
        assert recording.frame_numbers.tolist() == [first + i for i in ALL]
    assert (recording.size == (WIDTH, HEIGHT)) == (annotations or name == "a.pose")


def test_pose_files_of_other_versions_and_broken_ones(tmp_path: Path) -> None:
    files.pose_format(path := tmp_path / "a.pose", 0.2)
    assert worst(read(path)) < 0.01
    path.write_bytes(path.read_bytes()[:-100])
    with pytest.raises(InputError, match="breaks off"):
        read(path)
    files.pose_format(path, 0.0)
    with pytest.raises(InputError, match=r"version 0\.0"):
        read(path)


def test_the_landmark_that_a_layout_lacks_is_missing(tmp_path: Path) -> None:
    """Aria has no root of the thumb; in row 2 the glasses saw no right hand."""
    left, right = read(files.aria(tmp_path / "a.csv")).points
    assert np.flatnonzero(np.isnan(left.points).all(axis=(0, 2))).tolist() == [1]
    assert np.flatnonzero(~right.present).tolist() == [2]


# Frames of JSON


@pytest.mark.parametrize("layout", [files.tasks, files.openpose, files.halpe, files.apple])
def test_frames(tmp_path: Path, layout: Callable[[int], Any]) -> None:
    """In a list, with numbers and times beside a size, by their numbers, in lines, and in a folder."""
    frames, odd = [layout(i) for i in ALL], list(range(3, 3 + 2 * FRAMES, 2))
    told = [{**f, "frame": n, "frame_id": n, "timestamp": 40.0 * n} for n, f in zip(odd, frames, strict=True)]
    lines = tmp_path / "lines.jsonl"
    lines.write_text("\n".join(json.dumps({"frame_id": i, **frames[i]}) for i in ALL))
    twice = list(range(2 * FRAMES))
    for path, numbers in (
        (saved(tmp_path / "list.json", frames), [i + (layout is not files.halpe) for i in ALL]),
        (saved(tmp_path / "more.json", {str(i): frames[i % FRAMES] for i in twice}), twice),
        (saved(tmp_path / "told.json", {"width": WIDTH, "height": HEIGHT, "frames": told}), odd),
        (saved(tmp_path / "by_number.json", {str(i): frames[i] for i in ALL}), ALL),
        (lines, ALL),
        (files.folder_of(tmp_path / "hands", frames, "frame_{:05d}.json"), ALL),
    ):
        assert is_recording(path)
        recording = read(path)
        assert recording.frame_numbers.tolist() == numbers
        assert worst(recording, [*ALL, *ALL][: len(numbers)]) < 0.01
        if numbers is odd:
            assert (recording.size, recording.fps) == ((WIDTH, HEIGHT), 25.0)


@pytest.mark.parametrize("empty", [None, {"landmarks": [], "worldLandmarks": [], "handedness": []}])
def test_frames_without_hands_stay(tmp_path: Path, empty: Any) -> None:
    assert seen_in(read(saved(tmp_path / "a.json", [empty, empty, files.tasks(0)]))).row.tolist() == [2, 2]
    folder = files.folder_of(tmp_path / "hands", [empty or {}, empty or {}, files.tasks(0)])
    assert seen_in(read(folder)).row.tolist() == [2, 2]
    predictions = [[], *([files.instance(i)] for i in ALL)]
    inferencer = files.folder_of(tmp_path / "predictions", predictions, "f_{:04d}.json")
    assert seen_in(read(inferencer)).row.tolist() == [i + 1 for i in ALL for _ in SIDES]


def test_files_of_a_folder_by_their_names(tmp_path: Path) -> None:
    path = files.folder_of(
        tmp_path / "op", [files.openpose(i) for i in range(3)], "shot{:04d}_keypoints.json"
    )
    (path / "shot0001_keypoints.json").unlink()
    assert read(path).frame_numbers.tolist() == [0, 2]
    assert read(path / "shot0002_keypoints.json").frame_numbers.tolist() == [2]
    for content in ({"people": []}, {"intrinsics": [1.0]}):
        saved(path / "camera.json", content)
        recording = read(path)
        assert worst(recording, [0, 2]) < 0.01
        assert "camera.json has no number in its name: left out" in recording.assumed
    other = tmp_path / "other"
    other.mkdir()
    for name in "ba":
        saved(other / f"{name}.json", files.openpose("ab".index(name)))
    recording = read(other)
    assert recording.frame_numbers.tolist() == [1, 2]
    assert worst(recording, [0, 1]) < 0.01
    assert says(recording, "a.json and 1 more have no number")
    saved(path / "clip_7_keypoints.json", files.openpose(0))
    with pytest.raises(InputError, match="several clips"):
        read(path)


# Left and right


@pytest.mark.parametrize(
    ("layout", "labels", "swapped"),
    [
        (files.tasks, {}, False),
        (files.legacy, {}, True),
        (files.tasks, {"handedness": ["Right", "Left"]}, True),
        (files.legacy, {"multi_handedness": ["left", "right"]}, False),
    ],
)
def test_fingers_tell_whose_sides_are_of_mirrored_pictures(
    tmp_path: Path, layout: Callable[[int], Any], labels: dict[str, Any], swapped: bool
) -> None:
    frames = [layout(i) | labels for i in ALL]
    recording = read(saved(tmp_path / "hands.json", frames))
    assert says(recording, "left and right are swapped") == swapped
    assert worst(recording) < 0.01
    # Without a depth, the layout tells.
    plane = [{name: each for name, each in frame.items() if name != "worldLandmarks"} for frame in frames]
    plane = json.loads(json.dumps(plane).replace('"z":', '"depth":'))
    recording = read(saved(tmp_path / "plane.json", plane))
    assert says(recording, "left and right are swapped") == (layout is files.legacy)


@pytest.mark.parametrize("key", ["hand", "type", "label", "handedness"])
def test_counts_are_no_sides(tmp_path: Path, key: str) -> None:
    """But for Apple's chirality. A side that is asked for is that of hands of unknown side."""
    hands = [{key: i, "landmarks": landmarks("right", 0).tolist()} for i in (-1, 0, 1)]
    path = saved(tmp_path / "hands.json", [{"hands": hands}])
    assert sides_in(read(path, hands="left")) == "LLL"
    hands = [hand | {"chirality": side} for hand, side in zip(hands, (-1, 1, 1), strict=True)]
    saved(path, [{"hands": hands}])
    assert sides_in(read(path, reader="apple-vision")) == "LRR"


# People and points that are missing


def test_one_of_several_people(tmp_path: Path) -> None:
    """Of programs that tell persons apart."""
    alone = {"hand_left_keypoints_2d": files.triples(TOLD.pixels["left"][1])}
    for frame in (
        {"people": [files.person(0), alone]},
        {"frame_id": 0, "instances": [files.instance(0), files.instance(1)]},
    ):
        path = saved(tmp_path / "a_0.json", [frame])
        assert len(seen_in(read(path))) in (3, 4)
        second = seen_in(read(path, person=2))
        assert np.abs(second.keypoints[second.side == 0] - TOLD.pixels["left"][1]).max() < 0.01
        with pytest.raises(InputError, match="no person 3; its frames have at most 2"):
            read(path, person=3)
    with pytest.raises(OptionError, match="belong to no persons"):
        read(saved(path, [files.tasks(0)]), person=1)


def test_zeros_are_missing_and_hidden_hands_are_left_out(tmp_path: Path) -> None:
    human = files.person(0)
    left = np.array(human["hand_left_keypoints_2d"]).reshape(21, 3)
    left[[4, 8]], left[12, 0] = 0.0, np.nan
    human["hand_left_keypoints_2d"] = left.ravel().tolist()
    human["hand_right_keypoints_2d"] = files.triples(TOLD.pixels["right"][0], 0.04)
    recording = read(files.folder_of(tmp_path / "op", [{"people": [human]}, {"people": []}]))
    seen = seen_in(recording)
    assert sides_in(recording) == "L"
    assert np.flatnonzero(np.isnan(seen.keypoints[0, :, 0])).tolist() == [4, 8, 12]
    assert seen.confidence[0, [4, 8, 12]].tolist() == [0.0] * 3
    assert says(recording, "1 of 2 hands are left out")
    doubtful = files.instance(0)
    doubtful["keypoint_scores"][91 + 8] = 0.01
    people = [doubtful, files.instance(1, score=0.1)]
    mmpose = read(saved(tmp_path / "b.json", [{"instances": people, "frame_id": 0}]))
    assert seen_in(mmpose).confidence[0, 8] == pytest.approx(0.01)
    assert says(mmpose, "2 of 4 hands are left out")
    below = files.from_below("left", 0).tolist()
    points = {name: [x, y, 0.6] for name, (x, y) in zip(files.APPLE_CODES, below, strict=True)}
    points["VNHLKITIP"][2] = 0.0
    del points["VNHLKPTIP"]
    seen = seen_in(read(saved(tmp_path / "c.json", {"chirality": "left", **points})))
    assert np.flatnonzero(np.isnan(seen.keypoints[0, :, 0])).tolist() == [8, 20]
    assert seen.confidence[0, 0] == pytest.approx(0.6)


# Scales


@pytest.mark.parametrize(("low", "said"), [(0.0, "parts of the picture's size"), (-1.0, "between -1 and 1")])
@pytest.mark.parametrize("corner", [False, True])
def test_scales_of_openpose_are_noticed(tmp_path: Path, low: float, said: str, corner: bool) -> None:
    """Where all that is seen lies in the right lower quarter, nothing is negative from -1 to 1, and a missing
    point tells."""
    pixels = TOLD.pixels["left"][0] / 2.0 + SIZE / 2.0 if corner else TOLD.pixels["left"][0]
    hand = np.column_stack([low + pixels / SIZE * (1.0 - low), np.full(21, 0.7)])
    hand[7] = [low, low, 0.0]
    human = {"hand_left_keypoints_2d": hand.ravel().tolist(), "hand_right_keypoints_2d": []}
    if not corner:
        human["pose_keypoints_2d"] = files.triples(np.array([[low + 0.1, low + 0.1]]))
    recording = read(files.folder_of(tmp_path / "op", [{"people": [human]}]))
    assert recording.size == RELATIVE
    assert says(recording, said)
    assert np.nanmax(np.abs(seen_in(recording).keypoints[0] * SIZE - pixels)) < 0.01
    sized = {"people": [human], "canvas_width": WIDTH, "canvas_height": HEIGHT}  # ControlNet's
    recording = read(saved(tmp_path / "poses.json", [sized]))
    assert recording.size == (WIDTH, HEIGHT)
    assert np.nanmax(np.abs(seen_in(recording).keypoints[0] - pixels)) < 0.01


def test_pixels_with_a_depth_in_parts_of_the_width(tmp_path: Path) -> None:
    made = files.rows_of_hands(lambda s, i: np.column_stack([TOLD.pixels[s][i], landmarks(s, i)[:, 2]]))
    rows = [[i, i / 50.0, *rest] for i, *rest in made]
    path = table(tmp_path / "a.csv", ["frame", "time", "hand", *wide()], rows)
    recording = read(path, picture_size=(WIDTH, HEIGHT))
    assert (recording.size, recording.fps) == ((WIDTH, HEIGHT), 50.0)
    assert worst(recording) < 0.01
    assert np.isnan(seen_in(read(path)).points[..., 2]).all()


# Tables


@pytest.mark.parametrize("written", ["{:.6f}", "{:.18e}", "{}.0", "frame_2.1_{:05d}.png", "{:04d}"])
def test_frames_numbers_as_they_are_written(tmp_path: Path, written: str) -> None:
    rows = [[written.format(i + 9), *rest] for i, *rest in files.rows_of_hands()]
    recording = read(table(tmp_path / "a.csv", ["frame", "hand", *wide()], rows))
    assert recording.frame_numbers.tolist() == list(range(9, 9 + FRAMES))
    assert worst(recording) < 0.01


def test_rows_without_numbers_and_missing_cells(tmp_path: Path) -> None:
    header = ["hand", *(f"{axis}{i}" for i in range(21) for axis in ("x", "y", "z", "v"))]
    rows = [["Right", *np.column_stack([landmarks("right", i), np.zeros(21)]).ravel()] for i in range(2)]
    rows[1][1 + 4 * 8 : 1 + 4 * 8 + 2] = ["", ""]
    recording = read(table(tmp_path / "a.csv", header, [*rows, ["", *[""] * 84]]))
    seen = seen_in(recording)
    assert seen.row.tolist() == [0, 1]
    assert np.flatnonzero(seen.confidence[1] == 0.0).tolist() == [8]
    assert seen.confidence[0].min() == 1.0
    assert says(recording, "no frame numbers")


# Hands in space


def test_arrays_of_freemocap(tmp_path: Path) -> None:
    """The folder above them is read, too; the palm's length tells the unit, and fingers whose they are."""
    points = files.in_room("left")
    points[2], points[3, 8] = np.nan, np.nan
    files.output(tmp_path / "output_data", left=points)
    left = read(tmp_path).points[0]
    assert left.present.tolist() == [True, True, False, True, True, True]
    assert np.isnan(left.points[3, 8]).all()
    for unit, said in ((1.0, ""), (0.1, "centimetres"), (0.001, "metres")):
        hands = {side: unit * files.in_room(side) for side in SIDES}
        recording = read(files.output(tmp_path / "output_data", **hands))
        assert worst(recording) < 1e-6
        assert says(recording, "its unit is") == says(recording, f"its unit is {said}, by") == bool(said)
    swapped = {side: files.in_room(other_side(side)) for side in SIDES}
    swapped = read(files.output(tmp_path / "output_data", **swapped))
    assert says(swapped, "its left hand bends like a right one")


def test_several_hands_of_a_side(tmp_path: Path) -> None:
    """The first is taken; a frame may have none."""
    frames = files.websocket()
    frames[1]["hands"] += [{**frames[1]["hands"][1], "type": "left"}] * 2
    twice = read(saved(tmp_path / "leap.json", frames))
    assert "1 frame has several left hands: the first was taken" in twice.assumed
    assert worst(twice) < 1e-3
    frames[1]["hands"] = []
    assert read(saved(tmp_path / "leap.json", frames)).points[0].present.tolist() == [
        True,
        False,
        *[True] * 4,
    ]


def test_a_trc_without_hands_is_named(tmp_path: Path) -> None:
    with pytest.raises(
        InputError, match=r"OpenSim's markers, none of its 3 markers \(Hip, LWrist, Nose\) is a point"
    ):
        read(files.trc(tmp_path / "a.trc", "Hip", "LWrist", "Nose"))


# Orders

SHUFFLED = {
    "interhand": [*(4 * f + j for f in range(5) for j in (4, 3, 2, 1)), 0],
    "rhd": [0, *(4 * f + j for f in range(5) for j in (4, 3, 2, 1))],
    "mano": [0, 5, 6, 7, 9, 10, 11, 17, 18, 19, 13, 14, 15, 1, 2, 3, 4, 8, 12, 16, 20],
    "aria": [4, 8, 12, 16, 20, 0, 2, 3, 5, 6, 7, 9, 10, 11, 13, 14, 15, 17, 18, 19, 9],
    "umetrack": files.ARIA,
    "bighand": [0, 1, 5, 9, 13, 17, 2, 3, 4, 6, 7, 8, 10, 11, 12, 14, 15, 16, 18, 19, 20],
    "mediapipe": list(range(21)),
}


@pytest.mark.parametrize("order", SHUFFLED)
@pytest.mark.parametrize("kind", ["picture", "pixels", "space"])
def test_bones_tell_the_order(tmp_path: Path, order: str, kind: str) -> None:
    def hand(side: Side, i: int) -> list[list[float]]:
        values = {"picture": landmarks(side, i), "pixels": TOLD.pixels[side][i], "space": TOLD.world[side][i]}
        return values[kind][SHUFFLED[order]].tolist()

    path = saved(tmp_path / "a.json", [{side: hand(side, i) for side in SIDES} for i in ALL])
    for recording, told in ((read(path), True), (read(path, order=order), False)):
        assert says(recording, f"as the bones tell: {order} ") == told
        if kind == "space":
            off = [np.abs(hand.points - TOLD.world[hand.side]) for hand in recording.points]
        else:
            by = SIZE if kind == "picture" else np.ones(2)
            seen = seen_in(recording)
            off = [
                np.abs(seen.keypoints[seen.side == SIDES.index(side)] * by - TOLD.pixels[side])
                for side in SIDES
            ]
        assert np.nanmax(off) < 0.01


def test_which_of_both_hands_comes_first(tmp_path: Path) -> None:
    """InterHand2.6M's right hand does."""
    order = SHUFFLED["interhand"]
    both = [TOLD.points[side][:, order] for side in ("right", "left")]
    np.save(tmp_path / "a.npy", np.concatenate(both, axis=1))
    recording = read(tmp_path / "a.npy")
    assert says(recording, "left and right are swapped, as its fingers bend")
    for hand in recording.points:
        assert np.abs(hand.points - TOLD.points[hand.side]).max() < 1e-6


def test_several_arrays_are_not_mixed(tmp_path: Path) -> None:
    arrays = {"keypoints_2d": TOLD.pixels["left"], "keypoints_3d": TOLD.points["left"], "betas": np.zeros(10)}
    np.savez(tmp_path / "a.npz", **arrays)
    assert np.abs(read(tmp_path / "a.npz").points[0].points - TOLD.points["left"]).max() < 1e-6
    np.savez(tmp_path / "a.npz", first=TOLD.points["left"], second=TOLD.points["right"])
    with pytest.raises(InputError, match=r"several arrays of points \(first, second\)"):
        read(tmp_path / "a.npz")


@pytest.mark.parametrize("count", [20, 21])
def test_points_in_no_order_are_refused(tmp_path: Path, count: int) -> None:
    shuffled = np.random.default_rng(0).permutation(21)[:count]
    frames = [{side: TOLD.world[side][i][shuffled].tolist() for side in SIDES} for i in ALL]
    with pytest.raises(InputError, match=r"no order that is known, of which \S+ fits best; --order decides"):
        read(saved(tmp_path / "a.json", frames))


# Files that are worse


def test_lines_whose_last_one_breaks_off(tmp_path: Path) -> None:
    text = "\n".join(json.dumps({"frame_id": i, **files.tasks(i)}) for i in ALL)
    path = tmp_path / "a.jsonl"
    path.write_text(text[:-40])
    recording = read(path)
    assert recording.frame_numbers.tolist() == ALL[:-1]
    assert says(recording, "its last line breaks off")
    path.write_text(text.replace("}\n{", "}\n{,", 1))
    with pytest.raises(InputError, match="lines of JSON, of which line 2 is damaged"):
        read(path)


def test_percents_nulls_and_frames_out_of_order(tmp_path: Path) -> None:
    frames = [{"frame": i, **files.openpose(i)} for i in reversed(ALL)]
    for frame in frames:
        hand = frame["people"][0]["hand_left_keypoints_2d"]
        hand[2::3] = [90.0] * 21
        hand[:3] = [None, float("nan"), 0.0]
    recording = read(saved(tmp_path / "a.json", frames))
    assert recording.frame_numbers.tolist() == ALL
    left = seen_in(recording).select(seen_in(recording).side == 0)
    assert left.confidence[:, 1:].max() == pytest.approx(0.9)
    assert np.isnan(left.keypoints[:, 0]).all()


def test_world_landmarks_alone_are_hands_in_space(tmp_path: Path) -> None:
    world = [[TOLD.world[side][i].tolist() for side in SIDES] for i in ALL]
    frames = [{"handedness": list(SIDES), "world_landmarks": hands} for hands in world]
    rows = files.rows_of_hands(lambda s, i: TOLD.world[s][i])
    for path in (
        saved(tmp_path / "a.json", frames),
        table(tmp_path / "a.csv", ["frame", "side", *wide()], rows),
    ):
        recording = read(path)
        assert recording.seen is None
        assert [hand.side for hand in recording.points] == list(SIDES)
        for hand in recording.points:
            assert not hand.on_joints
            assert np.abs(hand.points - TOLD.world[hand.side]).max() < 1e-4


# This project's own


def own(path: Path, *left_out: str) -> Path:
    """What this program writes of the known hands, without some columns or values."""
    writer_for(path).write(TOLD.take, path)
    if path.suffix == ".json":
        content = json.loads(path.read_text())
        hands = [{k: v for k, v in hand.items() if k not in left_out} for hand in content.get("hands", [])]
        return saved(path, content | ({"hands": hands} if hands else {}))
    lines = [line.split(",") for line in path.read_text().splitlines()]
    kept = [i for i, name in enumerate(lines[0]) if name not in left_out]
    return table(path, [lines[0][i] for i in kept], [[line[i] for i in kept] for line in lines[1:]])


@pytest.mark.parametrize(
    ("name", "reader", "left_out"),
    [
        ("a.points.json", "points", []),
        ("a.points.json", "points", ["keypoints_3d"]),
        ("a.points.csv", "points-table", []),
        ("a.points.csv", "points-table", ["x_m", "y_m", "z_m"]),
        ("a.mediapipe.json", "mediapipe", []),
    ],
)
def test_our_own_comes_back(tmp_path: Path, name: str, reader: str, left_out: list[str]) -> None:
    recording = read(own(tmp_path / name, *left_out))
    assert (recording.format, recording.size) == (reader, (WIDTH, HEIGHT))
    assert recording.fps == pytest.approx(TOLD.take.fps)
    assert recording.frame_numbers.tolist() == TOLD.take.frame_numbers.tolist()
    assert recording.intrinsics == (TOLD.take.intrinsics if reader == "points" else None)
    if left_out or reader == "mediapipe":
        assert worst(recording) < (0.01 if reader == "mediapipe" else 1e-3)
        assert np.allclose(seen_in(recording).confidence, 0.9 if reader == "points-table" else 1.0)
    else:
        assert worst(recording) < 1e-3
        assert all(hand.on_joints for hand in recording.points)
    assert [phrase for phrase in recording.assumed if "as the bones tell: mediapipe" not in phrase] == []


# Beside the table


def test_keypoints_alone_are_fitted_by_the_size_that_is_told(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = files.folder_of(tmp_path / "op", [files.openpose(i) for i in ALL])
    take = capture(path, picture_size=(WIDTH, HEIGHT), fps=25)
    assert (take.width, take.height, take.source.kind) == (WIDTH, HEIGHT, "data")
    assert take.frame_numbers.tolist() == ALL
    assert take.program == "OpenPose"
    assert sorted(hand.side for hand in take.hands) == list(SIDES)
    for hand in take.hands:
        # The hand's size in the picture is about 190 pixels.
        off = take.intrinsics.project(hand.joints_3d) - TOLD.pixels[hand.side]
        assert np.linalg.norm(off, axis=-1).mean() < 12
    assert not caplog.messages
    for unsized in (path, saved(tmp_path / "parts.json", [files.tasks(0)])):
        with pytest.raises(PictureSizeError, match="--picture-size"):
            capture(unsized)


def test_a_real_clips_landmarks(samples: Path) -> None:
    """A bare list of a hand's points a frame, in pixels, of whoever detected it."""
    path = samples / "videos" / "asl_hand.mediapipe_2d.json"
    recording = read(path)
    assert len(recording.frame_numbers) == 325
    assert says(recording, "a right hand, as its fingers bend")
    assert share_left(np.array(json.loads(path.read_text()))) < -0.99
    world = read(samples / "videos" / "asl_hand.mediapipe_world.json")
    assert [hand.side for hand in world.points] == ["right"]


# What is wrong


def leap(change: Callable[[Any], Any]) -> list[Any]:
    frames = files.websocket()
    for frame in frames:
        change(frame)
    return frames


def in_metres(frame: dict[str, Any]) -> None:
    for thing in (*frame["hands"], *frame["pointables"]):
        thing.update({k: [x / 1000.0 for x in v] for k, v in thing.items() if isinstance(v, list)})


def of_left_hand(numbers: list[Any]) -> dict[str, Any]:
    return {"people": [{"hand_left_keypoints_2d": numbers}]}


def of_side(points: Any) -> list[Any]:
    return [{"landmarks": [points], "handedness": ["Left"]}]


def of_apple(value: Any) -> list[Any]:
    return [{"chirality": "left", "joints": dict.fromkeys(files.APPLE_CODES, value)}]


def ours(**changes: Any) -> dict[str, Any]:
    hands = [{"side": side, "keypoints_3d": TOLD.points[side].tolist()} for side in SIDES]
    return {"format": "handfit-points", "version": 1, "frames": ALL, "hands": hands, **changes}


WRONG: list[tuple[str, Any, str]] = [
    ("openpose", {"people": [{"pose_keypoints_2d": [1.0, 2.0, 0.5] * 25}]}, "--hand"),
    ("openpose", of_left_hand([1.0, 2.0, 0.5] * 20), "hands have 20 points, and the order mediapipe has 21"),
    ("openpose", of_left_hand([0.0] * 63), "at least 6 points"),
    ("openpose", of_left_hand([1e7, 1.0, 0.5] * 21), "a point lies beyond"),
    ("mmpose", [{"keypoints": [[1.0, 2.0]] * 17, "keypoint_scores": [0.9] * 17}], "a hand model writes some"),
    ("mmpose", [files.mmpose(0), {"frame_id": 0, "instances": []}], "frame 0 is there twice"),
    ("mediapipe", of_side(files.points(np.ones((20, 3)))), "its 20 are cannot be told; --order"),
    ("mediapipe", [{"landmarks": [], "handedness": []}], "none of its frames has a hand"),
    ("apple-vision", of_apple("x"), "none of its frames has a hand"),
    ("leap", leap(in_metres), "expected about 90, in millimetres"),
    ("leap", leap(lambda frame: frame["pointables"][3].update(type=7)), "it lacks 3"),
    ("leap", [*files.websocket(), *([{}] * LIMITS.frames)], f"at most {LIMITS.frames} are read; cut it"),
    ("points", ours(version=2), "newer version"),
    ("points", ours(frames=[1] * FRAMES), "frame 1 is there twice"),
    ("points", ours(hands=[{"side": "Left", "keypoints_2d": []}]), "must be left or right"),
]  # fmt: skip


@pytest.mark.parametrize(("reader", "content", "said"), WRONG)
def test_json_that_is_wrong(tmp_path: Path, reader: str, content: Any, said: str) -> None:
    with pytest.raises(InputError, match=said) as error:
        read(saved(tmp_path / "hands.json", content), reader=reader)
    assert "\n" not in str(error.value)


POINT = ["frame", "hand", "landmark", "x", "y", "z"]
TWICE = [[0, "Left", 0, 0.1, 0.2, 0.0]] * 2
HAND = landmarks("left", 0).ravel().tolist()
OURS = ["frame", "side", "point", "x_px", "y_px"]
OWN = [[1, "left", name, i, i * i] for i, name in enumerate(KEYPOINT_NAMES)]


@pytest.mark.parametrize(
    ("header", "rows", "said"),
    [
        (POINT, TWICE, "frame 0 has the point 0 of one hand twice"),
        *(
            (["frame", "hand", *wide()], [[cell, "left", *HAND]], "no frame's number")
            for cell in ("1.5", "1e400", "first", "")
        ),
        (OURS, [*OWN, [2, "both", "wrist", 1, 2]], "expected left or right"),
    ],
)
def test_tables_that_are_wrong(tmp_path: Path, header: list[str], rows: list[Any], said: str) -> None:
    with pytest.raises(InputError, match=said):
        read(table(tmp_path / "points.csv", header, rows))


@pytest.mark.parametrize(
    ("array", "said"),
    [
        (np.zeros((FRAMES, 33, 3)), "no frame in it .an .npy of the shape 6x33x3"),
        (np.full((FRAMES, 21, 3), np.nan), "none of its frames has a hand"),
        (files.in_room("left")[:4], "different numbers of frames"),
    ],
)
def test_arrays_that_are_wrong(tmp_path: Path, array: np.ndarray, said: str) -> None:
    folder = files.output(tmp_path / "output_data", left=array)
    with pytest.raises(InputError, match=said):
        read(folder if len(array) == 4 else folder / "mediapipe_left_hand_3d_xyz.npy")
