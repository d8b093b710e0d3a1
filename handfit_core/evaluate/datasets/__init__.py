"""Labelled data sets, one reader per file. Every reader lists at once and reads labels when asked for."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Final

from handfit_core.errors import DatasetError, OptionError
from handfit_core.evaluate.datasets import freihand, ho3d, plain, rhd
from handfit_core.evaluate.datasets.tips import DEXTER_OBJECT, EGODEXTER
from handfit_core.evaluate.labels import Dataset

__all__ = ["DATASET_KINDS", "open_dataset"]

_WITH_SPLITS: Final = {freihand.KIND: freihand, ho3d.KIND: ho3d, rhd.KIND: rhd}
_OF_TIPS: Final = {tip_set.kind: tip_set for tip_set in (EGODEXTER, DEXTER_OBJECT)}
DATASET_KINDS: Final = (plain.KIND, *_WITH_SPLITS, *_OF_TIPS)
"""The readers' names on the command line"""


def open_dataset(
    root: str | os.PathLike[str],
    kind: str | None = None,
    *,
    split: str | None = None,
    labels: str | None = None,
    published_frame: bool = False,
) -> Dataset:
    """List a data set on disk.

    kind
        One of DATASET_KINDS; None recognises it from the folder's layout.
    split
        FreiHAND and RHD: `training` or `evaluation`; HO-3D: `train` or `evaluation`. None is the
        evaluation where its labels are there, else the training set.
    labels
        EgoDexter and Dexter+Object: `original` or `cleaned` (the `my_*` files). None is the cleaned
        ones where they are there, else the original ones.
    published_frame
        EgoDexter and Dexter+Object: leave labels in the depth camera's frame, as the paper's
        evaluation does.

    Raises DatasetError where the folder or a file in it is missing or damaged, or fits no layout;
    OptionError for a kind, split or labels that does not exist.
    """
    root = Path(root).expanduser()
    if kind is not None and kind not in DATASET_KINDS:
        raise OptionError(f"there is no data set kind {kind!r}; choose from {', '.join(DATASET_KINDS)}")
    if not root.is_dir():
        raise DatasetError(f"{root}: there is no such folder; give the folder of a labelled data set")
    kind = kind or _recognised(root)
    if split is not None and kind not in _WITH_SPLITS:
        raise OptionError(f"a {kind} data set has no splits; leave the split {split!r} out")
    if labels is not None and kind not in _OF_TIPS:
        raise OptionError(f"a {kind} data set has one set of labels; leave the labels {labels!r} out")
    if kind in _WITH_SPLITS:
        return _WITH_SPLITS[kind].read(root, split)
    if kind in _OF_TIPS:
        return _OF_TIPS[kind].read(root, labels, published_frame=published_frame)
    return plain.read(root)


def _recognised(root: Path) -> str:
    # HO-3D before FreiHAND: both may hold an evaluation_xyz.json.
    tests = {module.KIND: module.recognises for module in (plain, rhd, ho3d, freihand)}
    tests |= {kind: tip_set.recognises for kind, tip_set in _OF_TIPS.items()}
    for kind, recognises in tests.items():
        if recognises(root):
            return kind
    layouts = [module.LAYOUT for module in (plain, *_WITH_SPLITS.values())]
    layouts += [tip_set.layout for tip_set in _OF_TIPS.values()]
    raise DatasetError(f"{root}: this folder fits no layout that is known. Expected {', or '.join(layouts)}")
