"""HO-3D v2 and v3 (Hampali et al. 2020): right hands holding objects, as sequences."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from handfit_core.errors import DatasetError
from handfit_core.evaluate.datasets import reading
from handfit_core.evaluate.labels import Dataset, Entry, Labels, MeshLabel, Problem, Reader
from handfit_core.media.opening import pictures_in
from handfit_core.skeleton import KEYPOINT_SOURCE, NUM_KEYPOINTS

SPLITS = ("evaluation", "train")

OPENGL_TO_CAMERA = np.array([1.0, -1.0, -1.0])
"""HO-3D's points are in OpenGL's frame: y up, z backward."""


def recognises(root: Path) -> bool:
    """Whether the folder has any part of this layout."""
    parts = ("{0}.txt", "{0}/*/meta", "{0}/*/rgb")
    return any(any(root.glob(part.format(split))) for split in SPLITS for part in parts)


def read(root: Path, split: str | None = None) -> Dataset:
    """List `evaluation` or `train`; by default evaluation where its labels are there.

    Raises DatasetError, OptionError.
    """
    available = [
        name
        for name in SPLITS
        if (root / name).is_dir() and (name == "train" or (root / "evaluation_xyz.json").is_file())
    ]
    if split in SPLITS and not (root / split).is_dir():
        raise reading.lacks(root, split, READER.layout)
    if "evaluation" not in available and (split == "evaluation" or (split is None and not available)):
        # Its meta files hold the wrist only: the authors kept the rest back for their contest.
        raise reading.lacks(root, "evaluation_xyz.json", READER.layout)
    split = reading.choice(root, "split", split, available, SPLITS)
    folder = root / split
    path = root / f"{split}.txt"
    lines = (
        [line.strip() for line in reading.read_text(path, READER.layout).split("\n") if line.strip()]
        if split == "evaluation" or path.is_file()
        else None
    )
    hidden = _Hidden(root, len(lines or [])) if split == "evaluation" else None

    found = {seq.name: _sequence(seq) for seq in sorted(folder.iterdir()) if seq.is_dir()}
    if not any(sequence.metas for sequence in found.values()):
        raise reading.lacks(root, f"{split}/{next(iter(found), 'ABF10')}/meta/*.pkl", READER.layout)
    listed = {name: sequence.frames() for name, sequence in found.items()}
    rows: dict[str, int] = {}
    problems: list[Problem] = []
    if lines is not None:
        listed, rows, problems = _listed(path, lines)
    entries: list[Entry] = []
    for name, frames in listed.items():
        sequence = found.get(name, _Sequence(folder / name, {}, set()))
        for frame in frames:
            picture = sequence.pictures.get(frame)
            if picture is None:
                problems.append(Problem(reading.PROBLEMS.no_picture, f"{sequence.folder / 'rgb' / frame}.*"))
            elif frame not in sequence.metas:
                problems.append(Problem(reading.PROBLEMS.no_label, str(picture)))
            else:
                meta = sequence.folder / "meta" / f"{frame}.pkl"
                read = partial(_labels, meta, rows.get(f"{name}/{frame}"), hidden)
                time = (_number(frame) - _number(frames[0])) / 30.0
                entries.append(Entry(f"{name}/{frame}", picture, read, clip=name, time=time))
    return Dataset(
        name=f"HO-3D ({split})",
        kind="ho3d",
        root=root,
        entries=entries,
        problems=tuple(problems),
        notes=("HO-3D's labels are MANO's joints, inside the hand; a detector's landmarks sit on the skin.",),
    )


@dataclass(frozen=True)
class _Sequence:
    """The files of one sequence; frames are the names of files without their suffixes."""

    folder: Path
    pictures: dict[str, Path]
    metas: set[str]

    def frames(self) -> list[str]:
        return sorted(self.metas | set(self.pictures), key=_in_time)


def _sequence(folder: Path) -> _Sequence:
    pictures = pictures_in(folder / "rgb") if (folder / "rgb").is_dir() else []
    metas = (folder / "meta").iterdir() if (folder / "meta").is_dir() else []
    return _Sequence(folder, {p.stem: p for p in pictures}, {p.stem for p in metas if p.suffix == ".pkl"})


def _number(frame: str) -> int:
    return int(frame) if frame.isascii() and frame.isdigit() else 0


def _in_time(frame: str) -> tuple[int, str]:
    return _number(frame), frame


def _listed(path: Path, lines: list[str]) -> tuple[dict[str, list[str]], dict[str, int], list[Problem]]:
    """sequence -> frames in time; `sequence/frame` -> line of the list; lines that are neither."""
    listed: dict[str, list[str]] = {}
    rows: dict[str, int] = {}
    problems: list[Problem] = []
    for row, line in enumerate(lines):
        sequence, _, frame = line.partition("/")
        if not sequence or not frame or "/" in frame or "\\" in line or ".." in (sequence, frame):
            problems.append(Problem("line is not sequence/frame", f"{path}: {line}"))
        elif line in rows:
            problems.append(Problem("listed twice", f"{path}: {line}"))
        else:
            rows[line] = row
            listed.setdefault(sequence, []).append(frame)
    for frames in listed.values():
        frames.sort(key=_in_time)
    return listed, rows, problems


class _Hidden:
    """The evaluation's labels, one per line of evaluation.txt, read when first needed, and once."""

    def __init__(self, root: Path, lines: int) -> None:
        self._lines = lines
        self._verts = root / "evaluation_verts.json"
        self.joints = reading.once(lambda: self._rows(root / "evaluation_xyz.json"))
        # In single precision, as thousands of meshes stay in memory.
        self._vertices = reading.once(lambda: self._rows(self._verts, np.float32))

    def _rows(self, path: Path, dtype: type = np.float64) -> list[np.ndarray | None]:
        rows = reading.read_json_arrays(path, READER.layout, dtype)
        if len(rows) != self._lines:
            raise DatasetError(
                f"{path}: {len(rows)} labels, but evaluation.txt has {self._lines} lines; copy both again"
            )
        return rows

    def mesh(self, row: int, where: str) -> MeshLabel | None:
        if not self._verts.is_file():
            return None
        return MeshLabel(lambda: reading.vertices(where, self._vertices()[row]) * OPENGL_TO_CAMERA)


def _labels(meta: Path, row: int | None, hidden: _Hidden | None) -> Labels:
    where = str(meta)
    content = reading.read_pickle(meta, READER.layout)
    camera = None
    if content.get("camMat") is not None:
        camera = reading.pickled_array(where, content, "camMat", (3, 3))
    intrinsics = reading.intrinsics_of(where, camera)
    mesh: MeshLabel | None = None
    if hidden is not None and row is not None:
        joints = reading.shaped(where, "evaluation_xyz.json", hidden.joints()[row], (NUM_KEYPOINTS, 3))
        mesh = hidden.mesh(row, where)
    elif "handJoints3D" in content and content["handJoints3D"] is None:
        joints = np.full((NUM_KEYPOINTS, 3), np.nan)
    else:
        joints = reading.pickled_array(where, content, "handJoints3D", (NUM_KEYPOINTS, 3))
    # MANO's 16 joints, then the fingertips from thumb to little finger.
    joints = (joints * OPENGL_TO_CAMERA)[list(KEYPOINT_SOURCE)]
    return Labels((reading.hand_label("right", joints, intrinsics, mesh=mesh),), intrinsics)


READER = Reader(
    "HO-3D's layout: train/ABF10/rgb/0000.png (v3: .jpg), train/ABF10/meta/0000.pkl, train.txt, and the "
    "same for evaluation with evaluation.txt and evaluation_xyz.json (also evaluation_verts.json)",
    recognises,
    read,
    has_splits=True,
)
