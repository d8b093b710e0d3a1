"""Labelled data sets, one reader per file, which lists at once and reads labels when asked for. A line here
knows files and labels, and no solver."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Final

from handfit_core.common.errors import DatasetError, HandfitError, OptionError
from handfit_core.common.registry import Registry
from handfit_core.evaluate.labels import Dataset, Reader, said

__all__ = ["READERS", "open_dataset"]

_HERE = "handfit_core.evaluate.datasets"
READERS: Final = Registry(
    "handfit.datasets",
    "data set kind",
    Reader,
    # HO-3D before FreiHAND: both may hold an evaluation_xyz.json, and the first that recognises it reads it.
    {
        **{kind: f"{_HERE}.{kind}:READER" for kind in ("plain", "rhd", "ho3d", "freihand")},
        "egodexter": f"{_HERE}.tips:EGODEXTER_READER",
        "dexter-object": f"{_HERE}.tips:DEXTER_OBJECT_READER",
    },
)
"""The readers by their names on the command line; installed packages may add to them"""


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
        A name in READERS; None recognises it from the folder's layout.
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
    OptionError for a kind, split or labels that does not exist; PlugInError, which names a reader of another
    package that failed.
    """
    root = Path(root).expanduser()
    readers = READERS.all() if kind is None else {kind: READERS.get(kind)}
    if not root.is_dir():
        raise DatasetError(f"{root}: there is no such folder; give the folder of a labelled data set")
    kind = kind or next((kind for kind, reader in readers.items() if _recognises(kind, reader, root)), None)
    if kind is None:
        layouts = ", or ".join(reader.layout for reader in readers.values())
        raise DatasetError(f"{root}: this folder fits no layout that is known. Expected {layouts}")
    reader = readers[kind]
    if split is not None and not reader.has_splits:
        raise OptionError(f"a {kind} data set has no splits; leave the split {split!r} out")
    if labels is not None and not reader.has_label_variants:
        raise OptionError(f"a {kind} data set has one set of labels; leave the labels {labels!r} out")
    chosen = {"split": split} if reader.has_splits else {}
    variant = {"labels": labels, "published_frame": published_frame} if reader.has_label_variants else {}
    try:
        with READERS.blamed(kind):
            return reader.read(root, **chosen, **variant)
    except HandfitError:
        raise
    except Exception as error:  # a damaged file can fail in any way
        raise DatasetError(f"{root}: {said(error)}; expected {reader.layout}") from error


def _recognises(kind: str, reader: Reader, root: Path) -> bool:
    with READERS.blamed(kind):
        return reader.recognises(root)
