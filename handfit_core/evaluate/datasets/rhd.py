"""The Rendered Hand Pose set (Zimmermann & Brox 2017): rendered people, up to two hands, 320x320."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from handfit_core.evaluate.datasets import reading
from handfit_core.evaluate.labels import Dataset, HandLabel, Labels, Reader
from handfit_core.media.opening import pictures_in
from handfit_core.skeleton import NUM_KEYPOINTS, SIDES

SPLITS = ("evaluation", "training")

_ORDER = [0, *(1 + 4 * finger + 3 - joint for finger in range(5) for joint in range(4))]
"""keypoints[k] = points[_ORDER[k]]: the wrist, then thumb to little finger, each from the tip to the palm"""


def recognises(root: Path) -> bool:
    """Whether the folder has any part of this layout."""
    return any(
        (root / split / f"anno_{split}.pickle").is_file() or (root / split / "color").is_dir()
        for split in SPLITS
    )


def read(root: Path, split: str | None = None) -> Dataset:
    """List `evaluation` or `training`; by default evaluation where it is there.

    The split's pickle is read now, as it alone says which labels there are; the arrays in it only when
    asked for. Raises DatasetError, OptionError.
    """
    split = reading.split_of(root, split, SPLITS, "{0}/anno_{0}.pickle", "{0}", READER.layout)
    folder = root / split / "color"
    if not folder.is_dir():
        raise reading.lacks(root, f"{split}/color", READER.layout)
    path = root / split / f"anno_{split}.pickle"
    annotations = reading.read_pickle(path, READER.layout)

    entries, problems = reading.paired(
        split,
        pictures_in(folder),
        lambda number: number if number in annotations else None,
        lambda number, where: _labels(annotations[number], where),
        annotations,
        path,
    )
    return Dataset(
        name=f"RHD ({split})",
        kind="rhd",
        root=root,
        entries=entries,
        problems=problems,
        notes=(
            "RHD is rendered: labels are exact, those of hidden points too, and are all scored.",
            "A hand of which RHD marks no point as visible is no labelled hand.",
        ),
    )


def _labels(annotation: Any, where: str) -> Labels:
    points = 2 * NUM_KEYPOINTS
    joints = reading.pickled_array(where, annotation, "xyz", (points, 3))
    pixels = reading.pickled_array(where, annotation, "uv_vis", (points, 3))
    camera = reading.pickled_array(where, annotation, "K", (3, 3)) if "K" in annotation else None
    intrinsics = reading.intrinsics_of(where, camera)
    hands: list[HandLabel] = []
    for side in SIDES:
        # Which of RHD's 42 points belong to which hand
        own = {"left": slice(0, 21), "right": slice(21, 42)}[side]
        if np.any(pixels[own, 2] > 0.5):
            hands.append(reading.hand_label(side, joints[own][_ORDER], intrinsics, pixels[own, :2][_ORDER]))
    return Labels(tuple(hands), intrinsics)


READER = Reader(
    "RHD's layout (RHD_published_v2): training/color/00000.png ..., training/anno_training.pickle, and "
    "the same for evaluation",
    recognises,
    read,
    has_splits=True,
)
