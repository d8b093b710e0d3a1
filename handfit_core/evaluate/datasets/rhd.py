"""The Rendered Hand Pose set (Zimmermann & Brox 2017): rendered people, up to two hands, 320x320."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from handfit_core.common.skeleton import NUM_KEYPOINTS, Side
from handfit_core.evaluate.datasets import reading
from handfit_core.evaluate.labels import Dataset, Labels, Reader
from handfit_core.media.opening import pictures_in

PLACES = {split: f"{split}/anno_{split}.pickle" for split in ("evaluation", "training")}

_ORDER = [0, *(1 + 4 * finger + 3 - joint for finger in range(5) for joint in range(4))]
"""keypoints[k] = points[_ORDER[k]]: the wrist, then thumb to little finger, each from the tip to the palm"""

_POINTS: dict[Side, slice] = {"left": slice(0, 21), "right": slice(21, 42)}


def recognises(root: Path) -> bool:
    """True if the folder has any part of this layout."""
    return any((root / path).is_file() or (root / split / "color").is_dir() for split, path in PLACES.items())


def read(root: Path, split: str | None = None) -> Dataset:
    """List `evaluation` or `training`; by default evaluation where it is there.

    The split's pickle is read now, as it alone says which labels there are; the arrays in it only when
    asked for. Raises DatasetError, OptionError.
    """
    split = reading.split_of(root, split, PLACES, READER.layout)
    folder, path = root / split / "color", root / PLACES[split]
    if not folder.is_dir():
        raise reading.lacks(root, f"{split}/color", READER.layout)
    annotations = reading.read_pickle(path)
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
    joints, pixels = (
        reading.numbers(f"{where}: {key}", annotation[key], (2 * NUM_KEYPOINTS, 3))
        for key in ("xyz", "uv_vis")
    )
    labels = (
        reading.hand_label(side, joints[own][_ORDER], pixels[own, :2][_ORDER])
        for side, own in _POINTS.items()
        if np.any(pixels[own, 2] > 0.5)
    )
    return Labels(tuple(labels), reading.intrinsics_of(where, annotation.get("K")))


READER = Reader(
    "RHD's layout (RHD_published_v2): training/color/00000.png ..., training/anno_training.pickle, and "
    "the same for evaluation",
    recognises,
    read,
    has_splits=True,
)
