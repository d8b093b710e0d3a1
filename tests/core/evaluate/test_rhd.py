"""RHD's layout: two hands in one array, fingers from the tip to the palm, pickled labels."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from handfit_core.evaluate.datasets import open_dataset
from tests.core.evaluate.dataset_files import K, hand, pixels, touch, write_pickle

SEEN = np.ones(42)


def annotation(seed: int = 0, visible: np.ndarray = SEEN) -> dict[str, Any]:
    points = hand(seed, 42)
    uv_vis = np.concatenate([pixels(points), visible[:, None]], axis=1)
    return {"xyz": points.astype(np.float32), "uv_vis": uv_vis, "K": np.array(K)}


def write(root: Path, split: str, annotations: dict[Any, Any], pictures: list[str] | None = None) -> Path:
    names = pictures if pictures is not None else [f"{key:05d}.png" for key in annotations]
    touch(*(root / split / "color" / name for name in names))
    write_pickle(root / split / f"anno_{split}.pickle", annotations)
    return root


def in_mediapipes_order(one_hand: np.ndarray) -> np.ndarray:
    """Fingers turned round one by one."""
    return np.concatenate([one_hand[:1], *(one_hand[1 + 4 * f : 5 + 4 * f][::-1] for f in range(5))])


def test_both_hands(tmp_path: Path) -> None:
    write(tmp_path, "training", {0: annotation()})
    assert open_dataset(tmp_path).name == "RHD (training)"
    write(tmp_path, "evaluation", {0: annotation(), 1: annotation(1)})
    dataset = open_dataset(tmp_path)
    assert (dataset.kind, dataset.name, dataset.problems) == ("rhd", "RHD (evaluation)", ())
    labels = dataset.entries[1].read_labels()
    assert [h.side for h in labels.hands] == ["left", "right"]
    points = hand(1, 42).astype(np.float32)
    for label, own in zip(labels.hands, (points[:21], points[21:]), strict=True):
        np.testing.assert_allclose(label.joints_3d, in_mediapipes_order(own), atol=1e-9)
        np.testing.assert_allclose(label.keypoints_2d, in_mediapipes_order(pixels(own)), atol=1e-2)
    assert labels.intrinsics is not None
    assert labels.intrinsics.fy == 510.0


def test_a_hand_that_nobody_sees_is_no_labelled_hand(tmp_path: Path) -> None:
    only_right = np.r_[np.zeros(21), np.ones(1), np.zeros(20)]
    annotations = {0: annotation(visible=only_right), 1: annotation(visible=np.zeros(42))}
    del annotations[1]["K"]
    entries = open_dataset(write(tmp_path, "evaluation", annotations)).entries
    first, second = (entry.read_labels() for entry in entries)
    assert [h.side for h in first.hands] == ["right"]
    # Hidden points of a hand that is seen have exact labels.
    assert np.isfinite(first.hands[0].joints_3d).all()
    assert second.hands == ()
    assert second.intrinsics is None
