"""HO-3D's layout: OpenGL's axes, MANO's order, pickled labels, the evaluation's held-back ones."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from handfit_core.common.errors import DatasetError
from handfit_core.evaluate.datasets import open_dataset
from tests.core.evaluate.dataset_files import (
    K,
    hand,
    labels_of,
    pixels,
    touch,
    write_json,
    write_pickle,
)

MANO_TO_MEDIAPIPE = [0, 13, 14, 15, 16, 1, 2, 3, 17, 4, 5, 6, 18, 10, 11, 12, 19, 7, 8, 9, 20]
"""The authors' own list."""


def opengl(points: np.ndarray) -> np.ndarray:
    """From the camera frame to OpenGL's: half a turn about x."""
    half_turn = np.array([[1, 0, 0], [0, np.cos(np.pi), -np.sin(np.pi)], [0, np.sin(np.pi), np.cos(np.pi)]])
    return points @ half_turn.T


def meta(points: np.ndarray | None, **changes: Any) -> dict[str, Any]:
    return {
        "handJoints3D": None if points is None else opengl(points),
        "camMat": np.array(K),
        "handPose": np.zeros(48, dtype=np.float32),
        "objName": "004_sugar_box",
        "objLabel": np.int64(3),
        "objRot": np.zeros((3, 1)),
        "handVertContact": np.zeros(778, dtype=bool),
    } | changes


def write_frame(root: Path, split: str, name: str, content: dict[str, Any], suffix: str = ".png") -> None:
    sequence, frame = name.split("/")
    touch(root / split / sequence / "rgb" / f"{frame}{suffix}")
    write_pickle(root / split / sequence / "meta" / f"{frame}.pkl", content)


@pytest.mark.parametrize("suffix", [".png", ".jpg"], ids=["v2", "v3"])
def test_train(tmp_path: Path, suffix: str) -> None:
    for i, name in enumerate(["SM1/0010", "SM1/0002", "ABF10/0007"]):
        write_frame(tmp_path, "train", name, meta(hand(i)), suffix)
    dataset = open_dataset(tmp_path)
    assert (dataset.kind, dataset.name, dataset.problems) == ("ho3d", "HO-3D (train)", ())
    assert [e.name for e in dataset.entries] == ["ABF10/0007", "SM1/0002", "SM1/0010"]
    assert [e.clip for e in dataset.entries] == ["ABF10", "SM1", "SM1"]
    assert [e.time for e in dataset.entries] == [0.0, 0.0, 8 / 30]
    label, points = labels_of(dataset.entries[1])
    expected = hand(1)[MANO_TO_MEDIAPIPE]
    assert label.side == "right"
    np.testing.assert_allclose(label.joints_3d, expected, atol=1e-12)
    np.testing.assert_allclose(points, pixels(expected), atol=1e-9)
    assert label.mesh is None


def test_the_list_decides_and_what_it_misses_is_reported(tmp_path: Path) -> None:
    for name in ("SM1/0000", "SM1/0001", "SM1/0002"):
        write_frame(tmp_path, "train", name, meta(hand()))
    (tmp_path / "train" / "SM1" / "meta" / "0002.pkl").unlink()
    lines = ["SM1/0002", "SM1/0000", "SM1/0005", "SM9/0000", "SM1/0000", "../secret/0001", "nonsense"]
    (tmp_path / "train.txt").write_text("\n".join(lines) + "\n\n")
    dataset = open_dataset(tmp_path)
    assert [e.name for e in dataset.entries] == ["SM1/0000"]
    assert sorted((p.kind, p.where.rsplit("/", 1)[-1]) for p in dataset.problems) == [
        ("listed twice", "0000"),
        ("picture missing", "0000"),
        ("picture missing", "0001"),
        ("picture missing", "0005"),
        ("picture missing", "train: nonsense"),
        ("picture without a label", "0002.png"),
    ]


def test_evaluation_takes_its_labels_by_line(tmp_path: Path) -> None:
    names = ["SM1/0003", "AP10/0000", "SM1/0001"]
    for name in names:
        write_frame(tmp_path, "evaluation", name, meta(None, handJoints3D=np.zeros(3)))
    with pytest.raises(DatasetError, match=r"evaluation_xyz\.json is missing; expected HO-3D's layout"):
        open_dataset(tmp_path)
    (tmp_path / "evaluation.txt").write_text("\n".join(names))
    write_json(tmp_path / "evaluation_xyz.json", [opengl(hand(i)).tolist() for i in range(3)])
    write_json(tmp_path / "evaluation_verts.json", [opengl(hand(50 + i, 778)).tolist() for i in range(3)])
    dataset = open_dataset(tmp_path)
    assert (dataset.kind, dataset.name) == ("ho3d", "HO-3D (evaluation)")
    assert [e.name for e in dataset.entries] == ["SM1/0001", "SM1/0003", "AP10/0000"]
    for entry in dataset.entries:
        row = names.index(entry.name)
        (label,) = entry.read_labels().hands
        np.testing.assert_allclose(label.joints_3d, hand(row)[MANO_TO_MEDIAPIPE], atol=1e-7)
        assert label.mesh is not None
        np.testing.assert_allclose(label.mesh.vertices(), hand(50 + row, 778), atol=1e-7)
