"""The fingertip files of EgoDexter and Dexter+Object: a line per picture, `x, y, z;` five times.

Both sets were filmed with a depth camera and labelled in its pictures. The pictures that are evaluated
are the colour camera's, so labels are taken over to its frame with the sets' own calibration, as in
`TipSet.rotation` and `translation`, which are published with each set.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from handfit_core.common.skeleton import NUM_KEYPOINTS, TIP_KEYPOINTS
from handfit_core.evaluate.datasets import reading
from handfit_core.evaluate.labels import Dataset, Entry, Labels, Problem, Reader
from handfit_core.geometry.camera import Intrinsics
from handfit_core.media.opening import pictures_in, sequence_numbers

LABELS = ("cleaned", "original")

_MM = 1000.0


@dataclass(frozen=True, eq=False)
class TipSet:
    """One of the two sets: its files, how its numbers are read, and its cameras."""

    kind: str
    title: str
    layout: str
    sequences: tuple[str, ...]
    files: Mapping[str, tuple[str, ...]]
    """The file names of a sequence's `cleaned` and `original` labels; {0} stands for the sequence"""
    clean: Callable[[np.ndarray], np.ndarray]
    """Turns the (5, 3) numbers of a line into (5, 3) millimetres in the depth camera's frame, NaN where
    missing"""
    color: Intrinsics
    """The intrinsics of the colour camera, pixels"""
    rotation: np.ndarray
    """(3, 3) rotation from the depth camera's frame to the colour camera's"""
    translation: np.ndarray
    """(3,) millimetres: the translation from the depth camera's frame to the colour camera's"""
    notes: tuple[str, ...] = ()

    def _folders(self, root: Path) -> dict[str, Path]:
        """Return the folder of pictures of each sequence that is there, in `data` or in the root itself."""
        data = root / "data" if (root / "data").is_dir() else root
        folders = {sequence: data / sequence / "color" for sequence in self.sequences}
        return {sequence: folder for sequence, folder in folders.items() if folder.is_dir()}

    def recognises(self, root: Path) -> bool:
        """True if any of the set's sequences is there."""
        return bool(self._folders(root))

    def read(self, root: Path, labels: str | None = None, *, published_frame: bool = False) -> Dataset:
        """List the colour pictures with `cleaned` or `original` labels; by default cleaned if complete.

        `published_frame` takes the depth camera's frame for the colour camera's, as the published
        evaluation does.

        The label files' lines are counted now and understood when asked for. Raises DatasetError,
        OptionError.
        """
        reading.choice("labels", labels, LABELS)
        folders = self._folders(root)
        if not folders:
            raise reading.lacks(root, f"data/{self.sequences[0]}/color", self.layout)
        found = {
            name: {sequence: self._file(root, sequence, name) for sequence in folders}
            for name in ([labels] if labels else LABELS)
        }
        complete = (name for name, files in found.items() if None not in files.values())
        labels = next(complete, labels or "original")
        files = found[labels]

        entries: list[Entry] = []
        missing = (sequence for sequence in self.sequences if sequence not in folders)
        problems = [Problem("sequence missing", f"{root}: {sequence}") for sequence in missing]
        for sequence, path in files.items():
            if path is None:
                lost = self.files[labels][0].format(sequence)
                raise reading.lacks(root, f"{lost} ({labels} labels)", self.layout)
            lines = path.read_text(encoding="utf-8-sig").rstrip().split("\n")
            pictures = pictures_in(folders[sequence])
            rows = _rows_of(pictures, len(lines))
            if rows is None:
                rows = list(range(len(pictures)))
                counts = f"{path}: {len(lines)} lines for {len(pictures)} pictures"
                problems.append(Problem("pictures and labels differ in number, paired in order", counts))
            for picture, row in zip(pictures, rows, strict=True):
                if row >= len(lines):
                    problems.append(Problem(reading.NO_LABEL, str(picture)))
                    continue
                read = partial(self._labels, lines[row], published_frame)
                name = f"{sequence}/{picture.stem}"
                entries.append(Entry(name, picture, read, clip=sequence, time=row / 30.0))
            lonely = sorted(set(range(len(lines))) - set(rows))
            problems += [Problem(reading.UNPAIRED_LABEL, f"{path}: line {row + 1}") for row in lonely]
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

    def _file(self, root: Path, sequence: str, labels: str) -> Path | None:
        """Return the sequence's label file, None where it is missing; files of pixel pairs, which hold places
        in the depth picture, do not count."""
        for place in self.files[labels]:
            for path in (root / place.format(sequence), root / place.format(sequence).removeprefix("data/")):
                if path.is_file():
                    with path.open("rb") as stream:
                        if stream.readline(1000).split(b";")[0].count(b",") != 1:
                            return path
        return None

    def _labels(self, line: str, published_frame: bool) -> Labels:
        # `x, y, z; x, y, z; ...`, where an empty coordinate is missing.
        fields = (field.split(",") for field in line.strip().rstrip("; ").split(";"))
        numbers = [float(number) if number.strip() else np.nan for field in fields for number in field]
        tips = self.clean(np.reshape(numbers, (5, 3)))
        if not published_frame:
            tips = tips @ self.rotation.T + self.translation
        # Both sets name the tips from thumb to little finger, as MediaPipe does.
        joints = np.full((NUM_KEYPOINTS, 3), np.nan)
        joints[list(TIP_KEYPOINTS)] = tips / _MM
        return Labels((reading.hand_label("left", joints),), self.color)


def _rows_of(pictures: list[Path], lines: int) -> list[int] | None:
    """Return the index of each picture's line: by order, if there are as many of both, else by the number in
    the pictures' names, so that a missing picture does not shift all that follow. None where neither
    works."""
    if len(pictures) == lines:
        return list(range(lines))
    numbers = sequence_numbers(pictures)
    # Without a picture 0 or one as high as the number of lines, nothing tells where numbers start.
    if not numbers or (0 not in numbers and max(numbers) != lines):
        return None
    first = 0 if 0 in numbers else 1
    return [number - first for number in numbers]


def _egodexter_tips(tips: np.ndarray) -> np.ndarray:
    """Return EgoDexter's tips (5, 3) with NaN for missing ones, which are written as zeros."""
    given = np.isfinite(tips) & (np.abs(tips) >= 1e-6)
    return np.where(np.all(given, axis=1, keepdims=True), tips, np.nan)


EGODEXTER = TipSet(
    kind="egodexter",
    title="EgoDexter",
    layout="EgoDexter's layout: data/Desk/color/*.png and data/Desk/annotation.txt_3D.txt (original labels) "
    "or data/Desk/my_annotation.txt_3D.txt (cleaned), likewise Fruits, Kitchen, Rotunda",
    sequences=("Desk", "Fruits", "Kitchen", "Rotunda"),
    files={
        "cleaned": ("data/{0}/my_annotation.txt_3D.txt",),
        # annotation.txt itself holds pixels of the depth picture in the released set.
        "original": tuple(
            f"data/{{0}}/{name}.txt" for name in ("annotation.txt_3D", "annotation_3D", "annotation")
        ),
    },
    clean=_egodexter_tips,
    color=Intrinsics(617.173, 617.173, 315.453, 242.259),
    rotation=np.array([[1.0, 0.00090442, -0.0074], [-0.00071933, 0.9997, 0.0248], [0.0075, -0.0248, 0.9997]]),
    translation=np.array([20.2365, 1.2846, 5.7360]),
)
"""Mueller et al. 2017: left hands with objects, seen from the wearer's shoulder, 640x480"""


def _dexter_tips(tips: np.ndarray) -> np.ndarray:
    """Return Dexter+Object's tips (5, 3) with x and y negated, as they are written with the opposite sign."""
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
    files={
        labels: tuple(f"{place}/{name}" for place in ("data/{0}/annotations", "annotations", "data/{0}"))
        for labels, name in (("cleaned", "my_{0}3D.txt"), ("original", "{0}3D.txt"))
    },
    clean=_dexter_tips,
    color=Intrinsics(587.45209, 600.67456, 325.0, 249.0),
    rotation=np.array([[0.9999, 0.0034, 0.0161], [-0.0033, 1.0, -0.0079], [-0.0162, 0.0079, 0.9998]]),
    translation=np.array([19.0473, -1.8514, -4.7501]),
    notes=("Its *2D.txt files hold pixels of the depth picture and are not used.",),
)
"""Sridhar et al. 2016: a left hand with a box, seen from the front, 640x480"""

EGODEXTER_READER, DEXTER_OBJECT_READER = (
    Reader(tip_set.layout, tip_set.recognises, tip_set.read, has_label_variants=True)
    for tip_set in (EGODEXTER, DEXTER_OBJECT)
)
