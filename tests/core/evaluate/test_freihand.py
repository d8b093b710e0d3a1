"""FreiHAND's layout: training shown four times, lazily read JSON, meshes only when asked for."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from handfit_core.common.errors import DatasetError
from handfit_core.evaluate.datasets import open_dataset
from tests.core.evaluate.dataset_files import K, hand, labels_of, pixels, touch, write_json


def write_split(root: Path, split: str, labels: int, pictures: list[int], **replaced: Any) -> Path:
    files = {
        "K": [K] * labels,
        "xyz": [hand(i).tolist() for i in range(labels)],
        "scale": [0.028] * labels,
        "verts": [hand(100 + i, 778).tolist() for i in range(labels)],
    } | replaced
    for name, content in files.items():
        if content is not None:
            write_json(root / f"{split}_{name}.json", content)
    touch(*(root / split / "rgb" / f"{n:08d}.jpg" for n in pictures))
    return root


def test_evaluation_comes_first_where_it_has_labels(tmp_path: Path) -> None:
    write_split(tmp_path, "training", 3, list(range(12)))
    assert open_dataset(tmp_path).name == "FreiHAND (training)"
    write_split(tmp_path, "evaluation", 2, [0, 1])
    dataset = open_dataset(tmp_path)
    assert (dataset.kind, dataset.name, len(dataset.entries)) == ("freihand", "FreiHAND (evaluation)", 2)
    assert [e.name for e in dataset.entries] == ["evaluation/00000000", "evaluation/00000001"]
    assert dataset.problems == ()
    assert len(open_dataset(tmp_path, split="training").entries) == 12


def test_numbers(tmp_path: Path) -> None:
    dataset = open_dataset(write_split(tmp_path, "evaluation", 2, [0, 1]), "freihand")
    label, points = labels_of(dataset.entries[1])
    assert label.side == "right"
    np.testing.assert_allclose(label.joints_3d, hand(1), atol=1e-12)
    np.testing.assert_allclose(points, pixels(hand(1)), atol=1e-9)
    assert label.mesh is not None
    np.testing.assert_allclose(label.mesh.vertices(), hand(101, 778), atol=1e-7)
    assert label.mesh.digests == frozenset()
    assert label.joints_3d.dtype == label.mesh.vertices().dtype == np.float64


def test_training_labels_serve_four_pictures_each(tmp_path: Path) -> None:
    dataset = open_dataset(write_split(tmp_path, "training", 3, list(range(12)), verts=None))
    assert dataset.problems == ()
    for number, entry in enumerate(dataset.entries):
        label = entry.read_labels().hands[0]
        np.testing.assert_allclose(label.joints_3d, hand(number % 3), atol=1e-7)
        assert label.mesh is None


def test_counts_that_do_not_fit_pair_no_picture_with_anothers_label(tmp_path: Path) -> None:
    dataset = open_dataset(write_split(tmp_path, "training", 3, [0, 2, 3, 4, 5, 6, 7]))
    assert [int(e.picture.stem) for e in dataset.entries] == [0, 2]
    kinds = [p.kind for p in dataset.problems]
    assert kinds.count("picture without a label") == 5
    assert kinds.count("label without a picture") == 1
    assert "label 1" in dataset.problems[-1].where


def test_damaged_meshes_harm_no_joints(tmp_path: Path) -> None:
    root = write_split(tmp_path, "evaluation", 2, [0, 1], verts=[hand(100, 778).tolist(), None])
    first, second = (labels_of(entry)[0].mesh for entry in open_dataset(root).entries)
    assert first is not None
    assert second is not None
    assert first.vertices().shape == (778, 3)
    with pytest.raises(DatasetError, match="mesh 1 is null"):
        second.vertices()
