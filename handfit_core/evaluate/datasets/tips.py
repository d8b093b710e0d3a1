"""The fingertip files of EgoDexter and Dexter+Object: a line per picture, `x, y, z;` five times.

Both sets were filmed with a depth camera and labelled in its pictures. The pictures that are evaluated
are the colour camera's, so labels are taken over to its frame with the sets' own calibration, as in
`DepthToColor`, which is published with each set.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from handfit_core.errors import DatasetError
from handfit_core.evaluate.datasets import reading
from handfit_core.evaluate.labels import Dataset, Entry, Labels, Problem, Reader
from handfit_core.geometry.camera import Intrinsics
from handfit_core.media.opening import pictures_in, sequence_numbers
from handfit_core.skeleton import NUM_KEYPOINTS, TIP_KEYPOINTS

LABELS = ("cleaned", "original")

_MM = 1000.0


@dataclass(frozen=True, eq=False)
class DepthToColor:
    """The colour camera, and where the depth camera's points are in its frame."""

    color: Intrinsics
    rotation: np.ndarray
    """(3, 3)"""
    translation: np.ndarray
    """(3,) millimetres"""

    def __call__(self, points: np.ndarray) -> np.ndarray:
        """(N, 3) mm in the depth camera's frame -> (N, 3) metres in the colour camera's."""
        return (points @ self.rotation.T + self.translation) / _MM


@dataclass(frozen=True, eq=False)
class TipSet:
    """What differs between the two sets."""

    kind: str
    title: str
    layout: str
    sequences: tuple[str, ...]
    candidates: Callable[[Path, str, str], tuple[Path, ...]]
    """(folder of the sequences, sequence, "cleaned" or "original") -> where its label file may be"""
    clean: Callable[[np.ndarray], np.ndarray]
    """(5, 3) numbers of a line -> (5, 3) mm in the depth camera's frame, NaN where missing"""
    calibration: DepthToColor
    notes: tuple[str, ...]

    def folder(self, root: Path) -> Path:
        """The folder of the sequences: `data` in the root, or the root itself."""
        return root / "data" if (root / "data").is_dir() else root

    def recognises(self, root: Path) -> bool:
        """Whether any of the set's sequences is there."""
        return any((self.folder(root) / sequence / "color").is_dir() for sequence in self.sequences)

    def read(self, root: Path, labels: str | None = None, *, published_frame: bool = False) -> Dataset:
        """List the colour pictures with `cleaned` or `original` labels; by default cleaned if complete.

        `published_frame` takes the depth camera's frame for the colour camera's, as the published
        evaluation does.

        The label files' lines are counted now and understood when asked for. Raises DatasetError,
        OptionError.
        """
        folder = self.folder(root)
        present = [sequence for sequence in self.sequences if (folder / sequence / "color").is_dir()]
        if not present:
            raise reading.lacks(root, f"data/{self.sequences[0]}/color", self.layout)
        files = {
            name: {
                sequence: next(filter(_holds_points, self.candidates(folder, sequence, name)), None)
                for sequence in present
            }
            for name in LABELS
        }
        available = [name for name in LABELS if None not in files[name].values()]
        if labels not in available and (labels in LABELS or not available):
            wanted = labels or "original"
            lost = next(sequence for sequence, path in files[wanted].items() if path is None)
            expected = self.candidates(folder, lost, wanted)[0]
            raise reading.lacks(root, f"{expected.relative_to(root)} ({wanted} labels)", self.layout)
        labels = reading.choice(root, "labels", labels, available, LABELS)

        entries: list[Entry] = []
        missing = (sequence for sequence in self.sequences if sequence not in present)
        problems = [Problem("sequence missing", str(folder / sequence)) for sequence in missing]
        for sequence, path in files[labels].items():
            assert path is not None, "only complete labels are available"
            self._list(folder / sequence, path, published_frame, entries, problems)
        return Dataset(
            name=f"{self.title} ({labels} labels)",
            kind=self.kind,
            root=root,
            entries=entries,
            problems=tuple(problems),
            notes=(
                "Only fingertips are labelled, of left hands.",
                "Labels were made in the depth camera's pictures. The strict protocol takes them over to the "
                "colour camera's frame by the set's own calibration; the published evaluation, and so the "
                "paper's protocol, leaves that step out, which turns the tips by 1 to 1.5 degrees.",
                *self.notes,
            ),
        )

    def _list(
        self, sequence: Path, path: Path, published_frame: bool, entries: list[Entry], problems: list[Problem]
    ) -> None:
        lines = reading.read_text(path, self.layout).rstrip().split("\n")
        pictures = pictures_in(sequence / "color")
        rows = _rows_of(pictures, len(lines))
        if rows is None:
            rows = list(range(len(pictures)))
            counts = f"{path}: {len(lines)} lines for {len(pictures)} pictures"
            problems.append(Problem("pictures and labels differ in number, paired in order", counts))
        for picture, row in zip(pictures, rows, strict=True):
            if row >= len(lines):
                problems.append(Problem(reading.PROBLEMS.no_label, str(picture)))
                continue
            read = partial(self._labels, lines[row], f"{path}: line {row + 1}", published_frame)
            name = f"{sequence.name}/{picture.stem}"
            entries.append(Entry(name, picture, read, clip=sequence.name, time=row / 30.0))
        lonely = sorted(set(range(len(lines))) - set(rows))
        problems += [Problem(reading.PROBLEMS.unpaired_label, f"{path}: line {row + 1}") for row in lonely]

    def _labels(self, line: str, where: str, published_frame: bool) -> Labels:
        tips = self.clean(parse_line(line, where))
        # Both sets name the tips from thumb to little finger, as MediaPipe does.
        joints = np.full((NUM_KEYPOINTS, 3), np.nan)
        joints[list(TIP_KEYPOINTS)] = tips / _MM if published_frame else self.calibration(tips)
        intrinsics = self.calibration.color
        return Labels((reading.hand_label("left", joints, intrinsics),), intrinsics)


def _holds_points(path: Path) -> bool:
    """Whether it is a file, and not one of pairs, which are pixels of the depth picture."""
    if not path.is_file():
        return False
    with path.open("rb") as stream:
        first = stream.readline(1000).split(b";")[0]
    return first.count(b",") != 1


def parse_line(line: str, where: str) -> np.ndarray:
    """`x, y, z; x, y, z; ...` -> (5, 3) numbers; an empty coordinate is NaN. Raises DatasetError."""
    fields = [field for field in line.strip().split(";") if field.strip()]
    try:
        rows = [[float(c) if c.strip() else np.nan for c in field.split(",")] for field in fields]
    except ValueError as error:
        raise DatasetError(f"{where}: {error}; expected 'x, y, z;' for five fingertips") from error
    if [len(row) for row in rows] != [3] * 5:
        raise DatasetError(
            f"{where}: {len(rows)} fingertips of {'/'.join(sorted({str(len(row)) for row in rows}))} "
            "numbers; expected 'x, y, z;' for five fingertips"
        )
    return np.array(rows)


def _rows_of(pictures: list[Path], lines: int) -> list[int] | None:
    """Which line belongs to each picture: by order, where their numbers agree, else by the number in
    the names, so that a missing picture does not shift all that follow. None where neither works."""
    if len(pictures) == lines:
        return list(range(lines))
    numbers = sequence_numbers(pictures)
    # Without a picture 0 or one as high as the number of lines, nothing tells where numbers start.
    if not numbers or (0 not in numbers and max(numbers) != lines):
        return None
    first = 0 if 0 in numbers else 1
    return [number - first for number in numbers]


def _egodexter_files(folder: Path, sequence: str, labels: str) -> tuple[Path, ...]:
    names = {
        "cleaned": ("my_annotation.txt_3D.txt",),
        # annotation.txt itself holds pixels of the depth picture in the released set.
        "original": ("annotation.txt_3D.txt", "annotation_3D.txt", "annotation.txt"),
    }[labels]
    return tuple(folder / sequence / name for name in names)


def _egodexter_tips(tips: np.ndarray) -> np.ndarray:
    """Missing tips are written as zeros."""
    given = np.isfinite(tips) & (np.abs(tips) >= 1e-6)
    return np.where(np.all(given, axis=1, keepdims=True), tips, np.nan)


EGODEXTER = TipSet(
    kind="egodexter",
    title="EgoDexter",
    layout="EgoDexter's layout: data/Desk/color/*.png and data/Desk/annotation.txt_3D.txt (original labels) "
    "or data/Desk/my_annotation.txt_3D.txt (cleaned), likewise Fruits, Kitchen, Rotunda",
    sequences=("Desk", "Fruits", "Kitchen", "Rotunda"),
    candidates=_egodexter_files,
    clean=_egodexter_tips,
    calibration=DepthToColor(
        Intrinsics(617.173, 617.173, 315.453, 242.259),
        np.array([[1.0, 0.00090442, -0.0074], [-0.00071933, 0.9997, 0.0248], [0.0075, -0.0248, 0.9997]]),
        np.array([20.2365, 1.2846, 5.7360]),
    ),
    notes=(),
)
"""Mueller et al. 2017: left hands with objects, seen from the wearer's shoulder, 640x480"""


def _dexter_files(folder: Path, sequence: str, labels: str) -> tuple[Path, ...]:
    name = f"{sequence}3D.txt" if labels == "original" else f"my_{sequence}3D.txt"
    root = folder.parent if folder.name == "data" else folder
    places = folder / sequence / "annotations", root / "annotations", folder / sequence
    return tuple(place / name for place in places)


def _dexter_tips(tips: np.ndarray) -> np.ndarray:
    """x and y are written with the opposite sign."""
    depth = tips[:, 2:]
    # What Dexter+Object's depth camera gives where it sees nothing
    given = np.all(np.isfinite(tips), axis=1, keepdims=True) & (depth >= 1e-6) & (depth < 32001.0)
    return np.where(given, tips * np.array([-1.0, -1.0, 1.0]), np.nan)


DEXTER_OBJECT = TipSet(
    kind="dexter-object",
    title="Dexter+Object",
    layout="Dexter+Object's layout: data/Grasp1/color/*.png and data/Grasp1/annotations/Grasp13D.txt "
    "(original labels) or my_Grasp13D.txt (cleaned), or all of them in annotations/, likewise Grasp2, "
    "Occlusion, Rigid, Pinch, Rotate",
    sequences=("Grasp1", "Grasp2", "Occlusion", "Rigid", "Pinch", "Rotate"),
    candidates=_dexter_files,
    clean=_dexter_tips,
    calibration=DepthToColor(
        Intrinsics(587.45209, 600.67456, 325.0, 249.0),
        np.array([[0.9999, 0.0034, 0.0161], [-0.0033, 1.0, -0.0079], [-0.0162, 0.0079, 0.9998]]),
        np.array([19.0473, -1.8514, -4.7501]),
    ),
    notes=("Its *2D.txt files hold pixels of the depth picture and are not used.",),
)
"""Sridhar et al. 2016: a left hand with a box, seen from the front, 640x480"""

EGODEXTER_READER, DEXTER_OBJECT_READER = (
    Reader(tip_set.layout, tip_set.recognises, tip_set.read, has_label_variants=True)
    for tip_set in (EGODEXTER, DEXTER_OBJECT)
)
