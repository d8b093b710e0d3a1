"""FreeMoCap's hands in space, in the layouts of its sources."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from handfit_core.errors import InputError, OptionError
from handfit_core.interchange.opening import is_recording, read_recording
from handfit_core.interchange.recording import Recording
from handfit_core.options import CaptureOptions
from handfit_core.pipeline import capture
from handfit_core.skeleton import SIDES, Side
from tests.core.interchange.test_mediapipe import NAMES
from tests.told import FRAMES, told

TOLD = told()
FLOOR = np.array([200.0, -900.0, 1100.0])
"""Where the camera would stand in FreeMoCap's room, millimetres"""


def in_room(side: Side) -> np.ndarray:
    """(6, 21, 3) millimetres with Z up: what is below for the camera is below, what is away lies along Y."""
    x, y, z = np.moveaxis(TOLD.points[side], -1, 0)
    return 1000.0 * np.stack([x, z, -y], axis=-1) + FLOOR


def read(path: Path, **options: Any) -> Recording:
    return read_recording(path, CaptureOptions(**options))


def worst(recording: Recording) -> float:
    """The largest error in metres, in place, of both hands."""
    assert [hand.side for hand in recording.points] == list(SIDES)
    away = np.array([0.2, -1.1, -0.9])
    return float(max(np.abs(hand.points - away - TOLD.points[hand.side]).max() for hand in recording.points))


@pytest.fixture
def output(tmp_path: Path) -> Path:
    folder = tmp_path / "recording" / "output_data"
    folder.mkdir(parents=True)
    for side in SIDES:
        np.save(folder / f"mediapipe_{side}_hand_3d_xyz.npy", in_room(side))
    np.save(folder / "mediapipe_body_3d_xyz.npy", np.zeros((FRAMES, 33, 3)))
    return folder


def test_a_folder_and_a_file(output: Path) -> None:
    assert is_recording(output)
    recording = read(output)
    assert recording.format == "freemocap"
    assert worst(recording) < 1e-9
    assert not any(hand.on_joints for hand in recording.points)
    assert recording.frame_numbers.tolist() == list(range(FRAMES))
    (hand,) = read(output / "mediapipe_left_hand_3d_xyz.npy").points
    assert hand.side == "left"
    assert worst(read(output.parent)) < 1e-9


def rows_of(names: list[str], points: np.ndarray, path: Path) -> Path:
    header = ",".join(f"{name}_{axis}" for name in names for axis in "xyz")
    np.savetxt(path, points.reshape(len(points), -1), delimiter=",", header=header, comments="")
    return path


def test_tables_of_trajectories(tmp_path: Path) -> None:
    names = [f"{side}_hand_{name.lower()}" for side in SIDES for name in NAMES]
    names = ["body_nose", "body_left_wrist", *names]
    both = np.concatenate([np.full((FRAMES, 2, 3), 500.0), in_room("left"), in_room("right")], axis=1)
    recording = read(rows_of(names, both, tmp_path / "session_by_trajectory.csv"))
    assert recording.format == "freemocap"
    assert worst(recording) < 1e-9
    old = [f"right_hand_{i:04d}" for i in range(21)]
    (hand,) = read(rows_of(old, in_room("right"), tmp_path / "mediapipe_right_hand_3d_xyz.csv")).points
    assert hand.side == "right"


def test_hands_come_before_a_virtual_camera_and_are_fitted(output: Path) -> None:
    """The test's points are a skeleton's joints, and FreeMoCap's are where MediaPipe sees them: millimetres
    apart."""
    take = capture(output, fps=30)
    assert sorted(hand.side for hand in take.hands) == list(SIDES)
    assert take.fps == 30.0
    for hand in take.hands:
        truth = TOLD.points[hand.side]
        fitted = hand.joints_3d - hand.joints_3d[:, :1]
        assert np.linalg.norm(fitted - (truth - truth[:, :1]), axis=-1).mean() < 0.01


def test_missing_frames_and_points(output: Path) -> None:
    points = in_room("left")
    points[2] = np.nan
    points[3, 8] = np.nan
    np.save(output / "mediapipe_left_hand_3d_xyz.npy", points)
    left = read(output).points[0]
    assert left.present.tolist() == [True, True, False, True, True, True]
    assert np.isnan(left.points[3, 8]).all()


@pytest.mark.parametrize(("unit", "said"), [(1.0, None), (0.1, "centimetres"), (0.001, "metres")])
def test_other_units_are_noticed(output: Path, unit: float, said: str | None) -> None:
    for side in SIDES:
        np.save(output / f"mediapipe_{side}_hand_3d_xyz.npy", unit * in_room(side))
    recording = read(output)
    assert worst(recording) < 1e-9
    assert any("its unit is" in phrase for phrase in recording.assumed) == (said is not None)


def test_swapped_files_are_noticed(output: Path) -> None:
    shutil.move(output / "mediapipe_left_hand_3d_xyz.npy", output / "x.npy")
    shutil.move(output / "mediapipe_right_hand_3d_xyz.npy", output / "mediapipe_left_hand_3d_xyz.npy")
    shutil.move(output / "x.npy", output / "mediapipe_right_hand_3d_xyz.npy")
    assert any("its left hand bends like a right one" in phrase for phrase in read(output).assumed)


@pytest.mark.parametrize(
    ("array", "said"),
    [
        (np.zeros((FRAMES, 33, 3)), r"\(6, 33, 3\); expected \(frames, 21, 3\)"),
        (np.zeros((FRAMES, 63)), r"expected \(frames, 21, 3\)"),
        (np.full((FRAMES, 21, 3), np.nan), "none of its frames has a hand"),
        (np.full((FRAMES, 21, 3), 7.0), "its palms are 0 long"),
        (np.array([{}], dtype=object), "no array"),
        (np.full((FRAMES, 21, 3), 1e300), "beyond"),
    ],
)
def test_what_is_wrong_is_one_sentence(tmp_path: Path, array: np.ndarray, said: str) -> None:
    path = tmp_path / "mediapipe_left_hand_3d_xyz.npy"
    np.save(path, array)
    with pytest.raises(InputError, match=said):
        read(path)


def test_lengths_that_differ_cut_files_and_persons(output: Path) -> None:
    with pytest.raises(OptionError, match="one person"):
        read(output, person=1)
    path = output / "mediapipe_left_hand_3d_xyz.npy"
    path.write_bytes(path.read_bytes()[:500])
    with pytest.raises(InputError, match="no array"):
        read(output)
    np.save(path, in_room("left")[:4])
    with pytest.raises(InputError, match="different numbers of frames"):
        read(output)
