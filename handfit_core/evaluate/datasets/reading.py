"""Functions that the readers of data sets share. Exceptions that damaged files cause beside those named are
reported with the file or picture."""

from __future__ import annotations

import codecs
import json
import mmap
import re
from collections.abc import Callable, Hashable, Iterable, Mapping
from functools import lru_cache, partial
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from handfit_core.common import safe_pickle
from handfit_core.common.errors import DatasetError, OptionError
from handfit_core.common.files import read_file
from handfit_core.common.skeleton import NUM_KEYPOINTS, Side
from handfit_core.evaluate.labels import Entry, HandLabel, Labels, MeshLabel, Problem
from handfit_core.geometry.camera import Intrinsics

Label = TypeVar("Label", bound=Hashable)

NO_PICTURE = "picture missing"
NO_LABEL = "picture without a label"
UNPAIRED_LABEL = "label without a picture"
NO_CAMERA = "camera (K) missing"


def lacks(root: Path, name: str, layout: str) -> DatasetError:
    """Return the error for a folder that lacks `name`; `layout` tells what is expected there."""
    return DatasetError(f"{root}: {name} is missing; expected {layout}")


def choice(word: str, value: str | None, known: Iterable[str]) -> None:
    """Raise OptionError for a value that is not among the known ones; None, which chooses nothing, passes.
    `word` names the option."""
    if value is not None and value not in known:
        raise OptionError(f"{word} {value!r} does not exist here; choose from {', '.join(known)}")


def split_of(root: Path, split: str | None, places: Mapping[str, str], layout: str) -> str:
    """Return the split asked for, or the first that has labels, which stand at `places`. Raises OptionError
    for an unknown split, DatasetError where its labels are missing."""
    choice("split", split, places)
    asked = [split] if split else list(places)
    available = [name for name in asked if (root / places[name]).exists()]
    if not available:
        raise lacks(root, places[asked[0]], layout)
    return available[0]


def read_json(path: Path) -> Any:
    """Return the content of a JSON file; NaN is allowed. Raises DatasetError, OSError."""
    return _parsed(path, path.read_bytes().removeprefix(codecs.BOM_UTF8))


def _parsed(path: Path, text: bytes) -> Any:
    try:
        return json.loads(text)
    except (ValueError, RecursionError) as error:
        reason = str(error).splitlines()[0][:100]
        raise DatasetError(f"{path}: damaged, not readable as JSON ({reason}); copy it again") from error


def read_pickle(path: Path) -> dict[Any, Any]:
    """Return the dictionary that a pickle holds, read without running anything in it (see `safe_pickle`).

    Raises DatasetError where it is damaged, or asks for more than arrays; OSError where it is too large.
    """
    # RHD's training labels have 94 MB, and about 3 million instructions for 41 000 pictures.
    data = read_file(path, 500_000_000)
    try:
        content = safe_pickle.load(data, most_steps=10_000_000)
    except safe_pickle.Refused as error:
        raise DatasetError(f"{path}: refused: the file {error}; labels never do, do not trust it") from error
    except Exception as error:  # a damaged pickle can fail in any way
        raise DatasetError(f"{path}: not a pickle, or a damaged or truncated one; copy it again") from error
    if not isinstance(content, dict):
        raise DatasetError(f"{path}: this pickle holds no labels")
    return content


def numbers(where: str, value: Any, shape: tuple[int, ...]) -> np.ndarray:
    """Return nested lists, or a pickle's array, as float64 of that shape, NaN for a null. Raises
    DatasetError."""
    try:
        array = np.array(safe_pickle.plain(value), dtype=np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise DatasetError(f"{where}: {error}") from error
    if array.shape != shape:
        raise DatasetError(f"{where} has shape {array.shape}, expected {shape}")
    return array


def intrinsics_of(where: str, matrix: Any) -> Intrinsics | None:
    """Return the camera of a (3, 3) matrix in pixels; None where there is none. Raises DatasetError,
    OptionError."""
    if matrix is None:
        return None
    k = numbers(f"{where}: K", matrix, (3, 3))
    return Intrinsics(*map(float, (k[0, 0], k[1, 1], k[0, 2], k[1, 2])))


def hand_label(
    side: Side | None,
    joints_3d: np.ndarray | None,
    keypoints_2d: np.ndarray | None = None,
    mesh: MeshLabel | None = None,
) -> HandLabel:
    """Make a label of joints (21, 3) in metres and keypoints (21, 2) in pixels, both in MediaPipe's order;
    None stands for all missing.

    Points with a missing coordinate are missing as a whole.
    """

    def whole(points: np.ndarray | None, dimensions: int) -> np.ndarray:
        if points is None:
            return np.full((NUM_KEYPOINTS, dimensions), np.nan)
        return np.where(np.isfinite(points).all(axis=1, keepdims=True), points, np.nan)

    return HandLabel(side, whole(joints_3d, 3), whole(keypoints_2d, 2), mesh)


def mesh_of(path: Path, index: int, axes: np.ndarray | float = 1.0) -> MeshLabel | None:
    """Return the mesh of that number in a JSON list of meshes, its vertices times `axes`; None where there is
    no such file. A file can have gigabytes, so no more than one mesh is in memory."""

    def vertices() -> np.ndarray:
        places = _mesh_places(path)
        if index >= len(places):
            raise DatasetError(f"{path}: damaged or cut off before mesh {index}; copy it again")
        place = places[index]
        if place is None:
            raise DatasetError(f"{path}: mesh {index} is null")
        with path.open("rb") as stream:
            stream.seek(place[0])
            mesh = _parsed(path, stream.read(place[1] - place[0]))
        return numbers(f"{path}: mesh {index}", mesh, (len(mesh), 3)) * axes

    return MeshLabel(vertices) if path.is_file() else None


@lru_cache(maxsize=1)
def _mesh_places(path: Path) -> list[tuple[int, int] | None]:
    """Return the positions of the first byte of each mesh in the file and of the one behind its last, up to
    where the file is cut off; None for a null."""
    places: list[tuple[int, int] | None] = []
    if not path.stat().st_size:
        return places
    end = 1  # behind the bracket of the whole list
    with path.open("rb") as stream, mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ) as text:
        for last in re.finditer(rb"\]\s*+\]", text):
            first = text.find(b"[", end)
            places += [None] * text[end:first].count(b"null")
            places.append((first, end := last.end()))
        places += [None] * text[end:].count(b"null")
    return places


def number_of(picture: Path) -> int | None:
    """Return the number that a picture's name is, or None where it is none."""
    return int(picture.stem) if picture.stem.isascii() and picture.stem.isdigit() else None


def paired(
    split: str,
    pictures: Iterable[Path],
    label_of: Callable[[int], Label | None],
    read: Callable[[Label, str], Labels],
    every: Iterable[Label],
    file: Path,
) -> tuple[list[Entry], tuple[Problem, ...]]:
    """Pair pictures with the label that `label_of` gives for their numbers, which `read` reads for the
    picture; a problem is added for each picture without a label, and for each of `every` label of the `file`
    without a picture."""
    entries: list[Entry] = []
    problems: list[Problem] = []
    unused = set(every)
    for picture in pictures:
        number = number_of(picture)
        label = None if number is None else label_of(number)
        if label is None:
            problems.append(Problem(NO_LABEL, str(picture)))
            continue
        unused.discard(label)
        entries.append(Entry(f"{split}/{picture.stem}", picture, partial(read, label, str(picture))))
    lonely = sorted(map(str, unused), key=lambda name: (len(name), name))
    return entries, (*problems, *(Problem(UNPAIRED_LABEL, f"{file}: label {name}") for name in lonely))
