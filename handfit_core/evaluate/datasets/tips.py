"""The fingertip files of EgoDexter and Dexter+Object: a line per picture, `x, y, z;` five times.

Both sets were filmed with a depth camera and labelled in its pictures. The pictures that are evaluated
are the colour camera's, so labels are taken over to its frame with the sets' own calibration, as in
`DepthToColor`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from handfit_core.errors import DatasetError
from handfit_core.evaluate.datasets import orders, reading
from handfit_core.evaluate.labels import Dataset, Entry, Labels, Problem
from handfit_core.geometry.camera import Intrinsics
from handfit_core.media.opening import pictures_in, sequence_numbers

FPS = 30.0
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
        available = {
            name: files for name in LABELS if (files := self._label_files(folder, present, name)) is not None
        }
        if labels not in available and (labels in LABELS or not available):
            wanted = labels or "original"
            lost = next(s for s in present if self._label_file(folder, s, wanted) is None)
            expected = self.candidates(folder, lost, wanted)[0]
            raise reading.lacks(root, f"{expected.relative_to(root)} ({wanted} labels)", self.layout)
        labels = reading.choice(root, "labels", labels, available, LABELS)

        entries: list[Entry] = []
        problems = [
            Problem("sequence missing", str(folder / sequence))
            for sequence in self.sequences
            if sequence not in present
        ]
        for sequence in present:
            self._list(folder / sequence, available[labels][sequence], published_frame, entries, problems)
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

    def _label_file(self, folder: Path, sequence: str, labels: str) -> Path | None:
        return next((path for path in self.candidates(folder, sequence, labels) if _holds_points(path)), None)

    def _label_files(self, folder: Path, present: list[str], labels: str) -> Mapping[str, Path] | None:
        files = {sequence: self._label_file(folder, sequence, labels) for sequence in present}
        whole = {sequence: path for sequence, path in files.items() if path is not None}
        return whole if len(whole) == len(files) else None

    def _list(
        self,
        sequence: Path,
        path: Path,
        published_frame: bool,
        entries: list[Entry],
        problems: list[Problem],
    ) -> None:
        lines = reading.read_text(path, self.layout).rstrip().split("\n")
        pictures = pictures_in(sequence / "color")
        rows = _rows_of(pictures, len(lines))
        if rows is None:
            rows = list(range(len(pictures)))
            problems.append(
                Problem(
                    "pictures and labels differ in number, paired in order",
                    f"{path}: {len(lines)} lines for {len(pictures)} pictures",
                )
            )
        for picture, row in zip(pictures, rows, strict=True):
            if row >= len(lines):
                problems.append(Problem(reading.NO_LABEL, str(picture)))
                continue
            line, where = lines[row], f"{path}: line {row + 1}"
            entries.append(
                Entry(
                    f"{sequence.name}/{picture.stem}",
                    picture,
                    lambda line=line, where=where: self._labels(line, where, published_frame),
                    clip=sequence.name,
                    time=row / FPS,
                )
            )
        lonely = sorted(set(range(len(lines))) - set(rows))
        problems += reading.unpaired(reading.UNPAIRED_LABEL, (f"{path}: line {row + 1}" for row in lonely))

    def _labels(self, line: str, where: str, published_frame: bool) -> Labels:
        tips = self.clean(parse_line(line, where))
        joints = orders.keypoints_of_tips(tips / _MM if published_frame else self.calibration(tips))
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
