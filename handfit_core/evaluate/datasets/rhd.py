"""The Rendered Hand Pose set (Zimmermann & Brox 2017): rendered people, up to two hands, 320x320."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from handfit_core.evaluate.datasets import orders, reading
from handfit_core.evaluate.labels import Dataset, Entry, HandLabel, Labels
from handfit_core.media.opening import pictures_in
from handfit_core.skeleton import NUM_KEYPOINTS, SIDES

KIND = "rhd"
LAYOUT = (
    "RHD's layout (RHD_published_v2): training/color/00000.png ..., training/anno_training.pickle, and "
    "the same for evaluation"
)
SPLITS = ("evaluation", "training")


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
    available = [name for name in SPLITS if (root / name / f"anno_{name}.pickle").is_file()]
    if split is None and not available:
        shown = [name for name in SPLITS if (root / name).is_dir()] or ["training"]
        raise reading.lacks(root, f"{shown[0]}/anno_{shown[0]}.pickle", LAYOUT)
    if split in SPLITS and split not in available:
        raise reading.lacks(root, f"{split}/anno_{split}.pickle", LAYOUT)
    split = reading.choice(root, "split", split, available, SPLITS)
    folder = root / split / "color"
    if not folder.is_dir():
        raise reading.lacks(root, f"{split}/color", LAYOUT)
    annotations = reading.read_pickle(root / split / f"anno_{split}.pickle", LAYOUT)

    entries: list[Entry] = []
    lonely: list[Path] = []
    unused = set(annotations)
    for picture in pictures_in(folder):
        number = reading.number_of(picture)
        if number is None or number not in unused:
            lonely.append(picture)
            continue
        unused.discard(number)
        annotation, where = annotations[number], str(picture)
        entries.append(
            Entry(
                f"{split}/{picture.stem}",
                picture,
                lambda annotation=annotation, where=where: _labels(annotation, where),
            )
        )
    path = root / split / f"anno_{split}.pickle"
    return Dataset(
        name=f"RHD ({split})",
        kind=KIND,
        root=root,
        entries=entries,
        problems=(
            *reading.unpaired(reading.NO_LABEL, lonely),
            *reading.unpaired(
                reading.UNPAIRED_LABEL, (f"{path}: label {key}" for key in sorted(unused, key=str))
            ),
        ),
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
        own, order = orders.RHD_HANDS[side], list(orders.RHD)
        if np.any(pixels[own, 2] > 0.5):
            hands.append(reading.hand_label(side, joints[own][order], intrinsics, pixels[own, :2][order]))
    return Labels(tuple(hands), intrinsics)
