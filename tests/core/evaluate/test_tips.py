"""EgoDexter and Dexter+Object: their lines of fingertips, markers of missing tips, axes and cameras."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from handfit_core.common.errors import DatasetError
from handfit_core.evaluate.datasets import open_dataset
from tests.core.evaluate.dataset_files import labels_of, pixels, touch, write_tips

TIPS = [4, 8, 12, 16, 20]
EGO = ("Desk", "Fruits", "Kitchen", "Rotunda")
DEXTER = ("Grasp1", "Grasp2", "Occlusion", "Rigid", "Pinch", "Rotate")

# The calibrations, as the sets' other readers have them: pixel = M (x, y, z, 1) with points in mm.
EGO_M = np.array([[617.173, 0, 315.453], [0, 617.173, 242.259], [0, 0, 1]]) @ np.array(
    [
        [1.0, 0.00090442, -0.0074, 20.2365],
        [-0.00071933, 0.9997, 0.0248, 1.2846],
        [0.0075, -0.0248, 0.9997, 5.736],
    ]
)
DEXTER_M = np.array([[587.45209, 0, 325], [0, 600.67456, 249], [0, 0, 1]]) @ np.array(
    [[0.9999, 0.0034, 0.0161, 19.0473], [-0.0033, 1.0, -0.0079, -1.8514], [-0.0162, 0.0079, 0.9998, -4.7501]]
)


def frames(count: int, seed: int = 0) -> np.ndarray:
    """(count, 5, 3) mm in the depth camera's frame."""
    return np.random.default_rng(seed).uniform(-80, 80, (count, 5, 3)).round(4) + [0, 0, 450]


def pictures(root: Path, sequence: str, numbers: range | list[int]) -> None:
    touch(*(root / "data" / sequence / "color" / f"image_{n:05d}_color.png" for n in numbers))


def write_ego(root: Path, truth: np.ndarray, name: str = "annotation.txt_3D.txt") -> Path:
    for sequence in EGO:
        pictures(root, sequence, range(len(truth)))
        write_tips(root / "data" / sequence / name, truth)
    return root


def write_dexter(root: Path, truth: np.ndarray, *, cleaned: bool = False, inside: bool = True) -> Path:
    for sequence in DEXTER:
        pictures(root, sequence, range(len(truth)))
        folder = root / "data" / sequence if inside else root
        name = f"{'my_' if cleaned else ''}{sequence}3D.txt"
        write_tips(folder / "annotations" / name, truth * [-1, -1, 1])
    return root


def test_egodexter(tmp_path: Path) -> None:
    truth = frames(3)
    dataset = open_dataset(write_ego(tmp_path, truth))
    assert (dataset.kind, dataset.name, dataset.problems) == ("egodexter", "EgoDexter (original labels)", ())
    assert len(dataset.entries) == 12
    assert [e.clip for e in dataset.entries[::3]] == list(EGO)
    entry = dataset.entries[5]
    assert (entry.name, entry.time) == ("Fruits/image_00002_color", 2 / 30)
    label, points = labels_of(entry)
    assert label.side == "left"
    np.testing.assert_allclose(points[TIPS], pixels(truth[2], EGO_M), atol=1e-6)
    assert np.isnan(np.delete(label.joints_3d, TIPS, axis=0)).all()


def test_dexter_object_is_written_with_the_opposite_sign(tmp_path: Path) -> None:
    truth = frames(2)
    dataset = open_dataset(write_dexter(tmp_path, truth))
    assert (dataset.kind, dataset.problems) == ("dexter-object", ())
    assert [e.clip for e in dataset.entries[::2]] == list(DEXTER)
    label, points = labels_of(dataset.entries[1])
    assert label.side == "left"
    np.testing.assert_allclose(points[TIPS], pixels(truth[1], DEXTER_M), atol=1e-6)
    # The calibration's turn and shift, in metres.
    shift = label.joints_3d[TIPS] * 1000 - truth[1]
    np.testing.assert_allclose(shift, np.tile([19 + 7.2, -1.9 - 3.6, -4.8], (5, 1)), atol=3)


@pytest.mark.parametrize("write", [write_ego, write_dexter])
def test_the_published_frame_is_the_depth_cameras(tmp_path: Path, write) -> None:
    truth = frames(1)
    dataset = open_dataset(write(tmp_path, truth), published_frame=True)
    (label,) = dataset.entries[0].read_labels().hands
    np.testing.assert_allclose(label.joints_3d[TIPS] * 1000, truth[0])


def missing_of(dataset_root: Path) -> list[list[int]]:
    labels = [entry.read_labels().hands[0] for entry in open_dataset(dataset_root).entries]
    return [[i for i, k in enumerate(TIPS) if np.isnan(label.joints_3d[k]).all()] for label in labels]


def test_missing_tips(tmp_path: Path) -> None:
    truth = frames(3)
    truth[0, 2] = 0.0
    truth[1, 4] = np.nan
    truth[2] = 1e-7
    assert missing_of(write_ego(tmp_path / "ego", truth))[:3] == [[2], [4], [0, 1, 2, 3, 4]]
    truth = frames(3)
    truth[0, 1, 2] = 32001
    truth[1, 3] = np.nan
    truth[2, 0, 0] = 0.0  # on the optical axis, and there
    assert missing_of(write_dexter(tmp_path / "dexter", truth))[:3] == [[1], [3], []]


@pytest.mark.parametrize("inside", [True, False], ids=["in the sequences", "in one folder"])
def test_both_variants_of_dexter_object(tmp_path: Path, inside: bool) -> None:
    original, cleaned = frames(2, seed=1), frames(2, seed=2)
    write_dexter(tmp_path, original, inside=inside)
    assert open_dataset(tmp_path).name == "Dexter+Object (original labels)"
    with pytest.raises(DatasetError, match=r"my_Grasp13D\.txt \(cleaned labels\) is missing"):
        open_dataset(tmp_path, labels="cleaned")
    write_dexter(tmp_path, cleaned, cleaned=True, inside=inside)
    for labels, truth in ((None, cleaned), ("cleaned", cleaned), ("original", original)):
        _, points = labels_of(open_dataset(tmp_path, labels=labels).entries[0])
        np.testing.assert_allclose(points[TIPS], pixels(truth[0], DEXTER_M), atol=1e-6)
    (tmp_path / ("data/Rigid" if inside else "") / "annotations" / "my_Rigid3D.txt").unlink()
    # Labels are not mixed: one sequence without cleaned labels, and the original ones are taken.
    assert open_dataset(tmp_path).name == "Dexter+Object (original labels)"


def test_pixels_of_the_depth_picture_are_not_taken_for_points(tmp_path: Path) -> None:
    for sequence in EGO:
        pictures(tmp_path, sequence, range(1))
        (tmp_path / "data" / sequence / "annotation.txt").write_text("1, 2; 3, 4; 5, 6; 7, 8; -1, -1;\n")
    with pytest.raises(DatasetError, match=r"annotation\.txt_3D\.txt \(original labels\) is missing"):
        open_dataset(tmp_path)
    # Where it does hold points, it is the label file.
    truth = frames(1)
    _, points = labels_of(open_dataset(write_ego(tmp_path, truth, "annotation.txt")).entries[0])
    np.testing.assert_allclose(points[TIPS], pixels(truth[0], EGO_M), atol=1e-6)


def test_a_missing_picture_shifts_no_label(tmp_path: Path) -> None:
    truth = frames(4)
    for first in (0, 1):
        root = tmp_path / str(first)
        write_ego(root, truth)
        for file in (root / "data" / "Desk" / "color").iterdir():
            file.unlink()
        pictures(root, "Desk", [first, first + 2, first + 3])
        dataset = open_dataset(root)
        desk = [e for e in dataset.entries if e.clip == "Desk"]
        assert [e.time for e in desk] == pytest.approx([0, 2 / 30, 3 / 30])
        for entry, row in zip(desk, (0, 2, 3), strict=True):
            np.testing.assert_allclose(labels_of(entry)[1][TIPS], pixels(truth[row], EGO_M), atol=1e-6)
        assert [(p.kind, p.where.split(": ")[-1]) for p in dataset.problems] == [
            ("label without a picture", "line 2")
        ]
