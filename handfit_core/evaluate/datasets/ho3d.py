"""HO-3D v2 and v3 (Hampali et al. 2020): right hands holding objects, as sequences."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from handfit_core.common.errors import DatasetError
from handfit_core.common.skeleton import KEYPOINT_SOURCE, NUM_KEYPOINTS
from handfit_core.evaluate.datasets import reading
from handfit_core.evaluate.labels import Dataset, Entry, Labels, Problem, Reader
from handfit_core.media.opening import pictures_in

PLACES = {"evaluation": "evaluation_xyz.json", "train": "train"}
"""The place of each split's joint labels; the evaluation's meta files hold the wrist only, as the authors
kept the rest back for their contest"""

OPENGL_TO_CAMERA = np.array([1.0, -1.0, -1.0])
"""HO-3D's points are in OpenGL's frame: y up, z backward."""


def recognises(root: Path) -> bool:
    """True if the folder has any part of this layout."""
    parts = ("{0}.txt", "{0}/*/meta", "{0}/*/rgb")
    return any(any(root.glob(part.format(split))) for split in PLACES for part in parts)


def read(root: Path, split: str | None = None) -> Dataset:
    """List `evaluation` or `train`; by default evaluation where its labels are there.

    Raises DatasetError, OptionError.
    """
    split = reading.split_of(root, split, PLACES, READER.layout)
    folder, path = root / split, root / f"{split}.txt"
    pictures = {_name(file): file for rgb in folder.glob("*/rgb") for file in pictures_in(rgb)}
    metas = {_name(file): file for file in folder.glob("*/meta/*.pkl")}
    if not metas:
        raise reading.lacks(root, f"{split}/ABF10/meta/*.pkl", READER.layout)
    rows = dict.fromkeys(sorted(pictures | metas), -1)
    hidden, problems = None, []
    if split == "evaluation" or path.is_file():
        lines = [line for line in map(str.strip, path.read_text("utf-8").splitlines()) if line]
        rows = {}
        for row, line in enumerate(lines):
            rows.setdefault(line, row)
        problems += [Problem("listed twice", f"{path}: {x}") for i, x in enumerate(lines) if rows[x] != i]
        if split == "evaluation":
            hidden = reading.read_json(root / PLACES[split])
            if len(hidden) != len(lines):
                raise DatasetError(
                    f"{root}: {len(hidden)} labels in evaluation_xyz.json, but evaluation.txt has "
                    f"{len(lines)} lines"
                )
    # Sequences as they are listed, and their frames in time.
    sequences = list(dict.fromkeys(name.partition("/")[0] for name in rows))
    first: dict[str, int] = {}
    entries = []
    for frame in sorted(rows, key=lambda name: (sequences.index(name.partition("/")[0]), _in_time(name))):
        number, sequence = _in_time(frame)[0], frame.partition("/")[0]
        start = first.setdefault(sequence, number)
        if frame not in pictures:
            problems.append(Problem(reading.NO_PICTURE, f"{folder}: {frame}"))
        elif frame not in metas:
            problems.append(Problem(reading.NO_LABEL, str(pictures[frame])))
        else:
            read = partial(_labels, metas[frame], root, rows[frame], hidden)
            time = (number - start) / 30.0
            entries.append(Entry(frame, pictures[frame], read, clip=sequence, time=time))
    return Dataset(
        name=f"HO-3D ({split})",
        kind="ho3d",
        root=root,
        entries=entries,
        problems=tuple(problems),
        notes=("HO-3D's labels are MANO's joints, inside the hand; a detector's landmarks sit on the skin.",),
    )


def _name(file: Path) -> str:
    """Return a picture's name as the set's lists have it: `sequence/frame`."""
    return f"{file.parent.parent.name}/{file.stem}"


def _in_time(name: str) -> tuple[int, str]:
    return reading.number_of(Path(name)) or 0, name


def _labels(meta: Path, root: Path, row: int, hidden: list[Any] | None) -> Labels:
    content, mesh = reading.read_pickle(meta), None
    if hidden is not None:
        joints = hidden[row]
        mesh = reading.mesh_of(root / "evaluation_verts.json", row, OPENGL_TO_CAMERA)
    else:
        joints = content["handJoints3D"]
    points = None
    if joints is not None:
        # MANO's 16 joints, then the fingertips from thumb to little finger.
        points = reading.numbers(f"{meta}: joints", joints, (NUM_KEYPOINTS, 3))
        points = (points * OPENGL_TO_CAMERA)[list(KEYPOINT_SOURCE)]
    hand = reading.hand_label("right", points, mesh=mesh)
    return Labels((hand,), reading.intrinsics_of(str(meta), content.get("camMat")))


READER = Reader(
    "HO-3D's layout: train/ABF10/rgb/0000.png (v3: .jpg), train/ABF10/meta/0000.pkl, train.txt, and the "
    "same for evaluation with evaluation.txt and evaluation_xyz.json (also evaluation_verts.json)",
    recognises,
    read,
    has_splits=True,
)
