"""Points as a table: written, read back, and what people write by hand."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from handfit_core.errors import InputError
from handfit_core.interchange.document import Document
from handfit_core.interchange.opening import read_recording
from handfit_core.interchange.recording import Recording
from handfit_core.interchange.writers import writer_for
from handfit_core.options import CaptureOptions
from handfit_core.skeleton import KEYPOINT_NAMES, SIDES
from tests.told import FRAMES, HEIGHT, WIDTH, told

TOLD = told()


def read(path: Path, **options: Any) -> Recording:
    return read_recording(path, CaptureOptions(**options))


@pytest.fixture
def written(tmp_path: Path) -> Path:
    path = tmp_path / "hands.points.csv"
    writer_for(path).write(TOLD.take, path)
    return path


def without(path: Path, *columns: str) -> Path:
    """The same table with fewer columns."""
    table = Document(path).table
    assert table is not None
    kept = [i for i, name in enumerate(table.columns) if name not in columns]
    rows = [table.columns, *table.rows]
    path.write_text("\n".join(",".join(row[i] for i in kept) for row in rows))
    return path


def test_what_is_written_is_read_back(written: Path) -> None:
    recording = read(written)
    assert (recording.format, recording.size) == ("points-table", (WIDTH, HEIGHT))
    assert recording.fps == pytest.approx(TOLD.take.fps)
    assert recording.frame_numbers.tolist() == TOLD.take.frame_numbers.tolist()
    assert [hand.side for hand in recording.points] == list(SIDES)
    for hand in recording.points:
        assert hand.on_joints
        assert np.abs(hand.points - TOLD.points[hand.side]).max() < 1e-6


def test_points_in_the_plane(written: Path) -> None:
    recording = read(without(written, "x_m", "y_m", "z_m"))
    seen = recording.seen
    assert seen is not None
    for side in SIDES:
        mine = seen.left == (side == "left")
        assert seen.row[mine].tolist() == list(range(FRAMES))
        assert np.abs(seen.keypoints[mine] - TOLD.pixels[side]).max() < 1e-3
    assert np.allclose(seen.confidence, 0.9)


def test_the_least_that_a_table_needs(tmp_path: Path) -> None:
    pixels = TOLD.pixels["left"][0]
    rows = [f"12,left,{i},{x},{y}" for i, (x, y) in enumerate(pixels.tolist()) if i != 8]
    path = tmp_path / "least.csv"
    path.write_text("\n".join(["frame,side,point,x_px,y_px", *rows]))
    recording = read(path, picture_size=(WIDTH, HEIGHT))
    seen = recording.seen
    assert seen is not None
    assert (recording.size, recording.frame_numbers.tolist()) == ((WIDTH, HEIGHT), [12])
    assert np.isnan(seen.keypoints[0, 8]).all()
    assert np.nanmax(np.abs(seen.keypoints[0] - pixels)) < 1e-9


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("1,left,wrist,1,2", "is there twice"),
        ("1.5,left,wrist,1,2", "something else than whole numbers"),
        ("2,both,wrist,1,2", "expected left or right"),
        ("2,left,elbow,1,2", "no point 'elbow'"),
        ("2,left,21,1,2", "no point '21'"),
        ("2,left,wrist,1e300,2", "beyond"),
    ],
)
def test_what_is_wrong_is_one_sentence(tmp_path: Path, line: str, said: str) -> None:
    rows = [f"1,left,{name},{i},{i * i}" for i, name in enumerate(KEYPOINT_NAMES)]
    path = tmp_path / "points.csv"
    path.write_text("\n".join(["frame,side,point,x_px,y_px", *rows, line]))
    with pytest.raises(InputError, match=said):
        read(path)
