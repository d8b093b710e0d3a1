"""FreiHAND (Zimmermann et al. 2019): single right hands, 224x224, MANO meshes."""

from __future__ import annotations

from pathlib import Path

from handfit_core.common.errors import DatasetError
from handfit_core.common.skeleton import NUM_KEYPOINTS
from handfit_core.evaluate.datasets import reading
from handfit_core.evaluate.labels import Dataset, Labels, Reader
from handfit_core.media.opening import pictures_in

PLACES = {split: f"{split}_xyz.json" for split in ("evaluation", "training")}
COPIES = 4
"""How many pictures the training set has of each label: the same hand before several backgrounds"""


def recognises(root: Path) -> bool:
    """True if the folder has any part of this layout."""
    parts = ("{}/rgb", "{}_K.json", "{}_xyz.json", "{}_scale.json")
    return any((root / part.format(split)).exists() for split in PLACES for part in parts)


def read(root: Path, split: str | None = None) -> Dataset:
    """List `evaluation` or `training`; by default evaluation where its labels are there.

    Cameras and joints are read now, meshes when asked for. Raises DatasetError, OptionError.
    """
    split = reading.split_of(root, split, PLACES, READER.layout)
    folder = next((f for f in (root / split / "rgb", root / "rgb") if f.is_dir()), None)
    if folder is None:
        raise reading.lacks(root, f"{split}/rgb", READER.layout)
    cameras, joints = (reading.read_json(root / f"{split}_{name}.json") for name in ("K", "xyz"))
    count, pictures = len(cameras), pictures_in(folder)
    if len(joints) != count:
        raise DatasetError(f"{root}: {len(joints)} labels, but {count} cameras in {split}_K.json")

    def labels(index: int, where: str) -> Labels:
        points = reading.numbers(f"{where}: xyz", joints[index], (NUM_KEYPOINTS, 3))
        mesh = reading.mesh_of(root / f"{split}_verts.json", index)
        # Its points are in MediaPipe's own order.
        hand = reading.hand_label("right", points, mesh=mesh)
        return Labels((hand,), reading.intrinsics_of(where, cameras[index]))

    # Label i belongs to pictures i, i + n, i + 2n, i + 3n of the training set. With a label missing, n would
    # be wrong and pair pictures with others' labels, so copies are trusted only where they are complete.
    last = 1 + max((reading.number_of(picture) or 0 for picture in pictures), default=-1)
    complete = count == 32560 or (count > 0 and last % count == 0 and last <= COPIES * count)
    limit = COPIES * count if split == "training" and complete else count
    entries, problems = reading.paired(
        split,
        pictures,
        lambda number: number % count if number < limit else None,
        labels,
        range(count),
        root / PLACES[split],
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


READER = Reader(
    "FreiHAND's layout: training/rgb/00000000.jpg ..., training_K.json, training_xyz.json, and likewise "
    "evaluation/rgb, evaluation_K.json, evaluation_xyz.json (also *_scale.json, *_verts.json)",
    recognises,
    read,
    has_splits=True,
)
