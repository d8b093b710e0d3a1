"""FreiHAND (Zimmermann et al. 2019): single right hands, 224x224, MANO meshes."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np

from handfit_core.errors import DatasetError
from handfit_core.evaluate.datasets import reading
from handfit_core.evaluate.labels import Dataset, Labels, MeshLabel, Reader
from handfit_core.media.opening import pictures_in
from handfit_core.skeleton import NUM_KEYPOINTS

SPLITS = ("evaluation", "training")


_COPIES = 4


def recognises(root: Path) -> bool:
    """Whether the folder has any part of this layout."""
    return any(
        (root / split / "rgb").is_dir() or (root / f"{split}_{name}.json").is_file()
        for split in SPLITS
        for name in ("K", "xyz", "scale")
    )


def read(root: Path, split: str | None = None) -> Dataset:
    """List `evaluation` or `training`; by default evaluation where its labels are there.

    Only K is read now: it is small, and tells how many labels there are. Raises DatasetError,
    OptionError.
    """
    split = reading.split_of(root, split, SPLITS, "{0}_xyz.json", "{0}/rgb", READER.layout)
    folder = root / split / "rgb"
    if not folder.is_dir() and (root / "rgb").is_dir():
        folder = root / "rgb"
    if not folder.is_dir():
        raise reading.lacks(root, f"{split}/rgb", READER.layout)
    labels = _Labels(root, split)
    count = len(labels.cameras)

    pictures = pictures_in(folder)
    limit = _picture_limit(split, count, pictures)
    entries, problems = reading.paired(
        split,
        pictures,
        lambda number: number % count if number < limit else None,
        labels.of,
        range(count),
        root / f"{split}_xyz.json",
    )
    return Dataset(
        name=f"FreiHAND ({split})",
        kind="freihand",
        root=root,
        entries=entries,
        problems=problems,
        notes=(
            "FreiHAND's labels are MANO's joints, inside the hand; a detector's landmarks sit on the skin.",
            "Where its *_verts.json is there, meshes are MANO's (778 vertices).",
        ),
    )


def _picture_limit(split: str, count: int, pictures: Iterable[Path]) -> int:
    """The first picture number that has no label.

    Label i belongs to pictures i, i + n, i + 2n, i + 3n of the training set. With a label missing, n would
    be wrong and pair pictures with others' labels, so copies are trusted only where they are complete.
    """
    last = 1 + max((int(p.stem) for p in pictures if p.stem.isascii() and p.stem.isdigit()), default=-1)
    # The released training set shows each of them four times, before other backgrounds.
    complete = count == 32560 or (count > 0 and last % count == 0 and last <= _COPIES * count)
    return _COPIES * count if split == "training" and complete else count


class _Labels:
    """The files of one split; all but the cameras are read when first needed, and once."""

    def __init__(self, root: Path, split: str) -> None:
        self._files = {name: root / f"{split}_{name}.json" for name in ("K", "xyz", "verts")}
        self.cameras = reading.read_json_arrays(self._files["K"], READER.layout)
        self._joints = reading.once(self._read_joints)
        # In single precision, as thousands of meshes stay in memory.
        self._vertices = reading.once(
            lambda: reading.read_json_arrays(self._files["verts"], READER.layout, np.float32)
        )

    def _read_joints(self) -> list[np.ndarray | None]:
        joints = reading.read_json_arrays(self._files["xyz"], READER.layout)
        if len(joints) != len(self.cameras):
            raise DatasetError(
                f"{self._files['xyz']}: {len(joints)} labels, but {len(self.cameras)} cameras in "
                f"{self._files['K'].name}; copy both again"
            )
        return joints

    def of(self, index: int, where: str) -> Labels:
        intrinsics = reading.intrinsics_of(where, self.cameras[index])
        joints = reading.shaped(where, "xyz", self._joints()[index], (NUM_KEYPOINTS, 3))
        mesh = MeshLabel(lambda: self._mesh(index, where)) if self._files["verts"].is_file() else None
        # Its points are in MediaPipe's own order.
        hand = reading.hand_label("right", joints, intrinsics, mesh=mesh)
        return Labels((hand,), intrinsics)

    def _mesh(self, index: int, where: str) -> np.ndarray:
        meshes = self._vertices()
        return reading.vertices(where, meshes[index] if index < len(meshes) else None)


READER = Reader(
    "FreiHAND's layout: training/rgb/00000000.jpg ..., training_K.json, training_xyz.json, and likewise "
    "evaluation/rgb, evaluation_K.json, evaluation_xyz.json (also *_scale.json, *_verts.json)",
    recognises,
    read,
    has_splits=True,
)
