"""What the readers share: numbers out of files, and one sentence for whatever is wrong with them."""

from __future__ import annotations

import json
from collections.abc import Callable, Hashable, Iterable
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from typing import Any, Final, TypeVar

import numpy as np

from handfit_core import safe_pickle
from handfit_core.errors import DatasetError, OptionError
from handfit_core.evaluate.labels import Entry, HandLabel, Labels, MeshLabel, Problem
from handfit_core.geometry.camera import Intrinsics
from handfit_core.skeleton import NUM_KEYPOINTS, Side

T = TypeVar("T")
Label = TypeVar("Label", bound=Hashable)


@dataclass(frozen=True)
class ProblemNames:
    """What may be wrong with a picture or a label."""

    no_picture: str = "picture missing"
    no_label: str = "picture without a label"
    unpaired_label: str = "label without a picture"
    no_camera: str = "camera (K) missing"


PROBLEMS: Final = ProblemNames()


def once(read: Callable[[], T]) -> Callable[[], T]:
    """What a file holds, read when first asked for, and once: also when it turns out to be damaged."""

    @cache
    def kept() -> T | DatasetError:
        try:
            return read()
        except DatasetError as error:
            return error

    def asked() -> T:
        found = kept()
        if isinstance(found, DatasetError):
            raise DatasetError(str(found))
        return found

    return asked


def lacks(root: Path, name: str, layout: str) -> DatasetError:
    """The error for a folder that lacks `name`; `layout` tells what is expected there."""
    return DatasetError(f"{root}: {name} is missing; expected {layout}")


def choice(root: Path, word: str, value: str | None, available: Iterable[str], known: Iterable[str]) -> str:
    """`value`, or the first available one where it is None.

    Raises OptionError for a value that the kind does not know, DatasetError for one that the folder
    does not have.
    """
    available, known = tuple(available), tuple(known)
    if value is not None and value not in known:
        raise OptionError(f"{word} {value!r} does not exist here; choose from {', '.join(known)}")
    if value is not None and value not in available:
        has = ", ".join(available) or "none"
        raise DatasetError(f"{root}: there is no {word} {value!r} with its labels here; it has {has}")
    return value if value is not None else available[0]


def split_of(
    root: Path, split: str | None, splits: tuple[str, ...], labels: str, pictures: str, layout: str
) -> str:
    """The split asked for, or the first that has labels; `labels` and `pictures` are places with {0} for a
    split. Raises OptionError for an unknown split, DatasetError where its labels are missing."""
    available = [name for name in splits if (root / labels.format(name)).is_file()]
    if split is None and not available:
        shown = [name for name in splits if (root / pictures.format(name)).is_dir()] or ["training"]
        raise lacks(root, labels.format(shown[0]), layout)
    if split in splits and split not in available:
        raise lacks(root, labels.format(split), layout)
    return choice(root, "split", split, available, splits)


def read_bytes(path: Path, layout: str, limit: int | None = None) -> bytes:
    """A file's bytes. Raises DatasetError where it is missing, unreadable or larger than `limit`."""
    try:
        if limit is not None and path.stat().st_size > limit:
            size = path.stat().st_size // 1_000_000
            raise DatasetError(f"{path}: {size} MB is too large; at most {limit // 1_000_000} MB are read")
        return path.read_bytes()
    except FileNotFoundError as error:
        raise lacks(path.parent, path.name, layout) from error
    except OSError as error:
        raise DatasetError(f"{path}: cannot be read ({error.strerror or error})") from error


def read_text(path: Path, layout: str) -> str:
    """A UTF-8 file's text. Raises DatasetError."""
    try:
        return read_bytes(path, layout).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise DatasetError(f"{path}: not a text file, or a damaged one; copy it again") from error


def read_json(path: Path, layout: str) -> Any:
    """What a JSON file holds; NaN is allowed. Raises DatasetError."""
    try:
        return json.loads(read_text(path, layout))
    except (ValueError, RecursionError) as error:
        raise _no_json(path, error) from error


def read_json_arrays(path: Path, layout: str, dtype: type = np.float64) -> list[np.ndarray | None]:
    """A JSON list of arrays of numbers, one by one: a list of meshes would not fit in memory as lists.

    Items that are no arrays of numbers are None. Raises DatasetError where it is no JSON list.
    """
    text = read_text(path, layout)
    decoder = json.JSONDecoder()
    arrays: list[np.ndarray | None] = []
    try:
        at = _after_space(text, 0)
        if text[at] != "[":
            raise ValueError("it holds no list")
        at = _after_space(text, at + 1)
        while text[at] != "]":
            if arrays:
                if text[at] != ",":
                    raise ValueError(f"a comma is missing at character {at}")
                at = _after_space(text, at + 1)
            item, at = decoder.raw_decode(text, at)
            array = numbers_or_none(item)
            arrays.append(None if array is None else array.astype(dtype))
            at = _after_space(text, at)
    except IndexError as error:
        raise _no_json(path, ValueError("it ends too early")) from error
    except (ValueError, RecursionError) as error:
        raise _no_json(path, error) from error
    return arrays


def _after_space(text: str, at: int) -> int:
    while text[at] in " \t\r\n":
        at += 1
    return at


def _no_json(path: Path, error: Exception) -> DatasetError:
    reason = str(error).splitlines()[0][:100]
    return DatasetError(f"{path}: damaged, not readable as JSON ({reason}); copy it again")


def read_pickle(path: Path, layout: str) -> dict[Any, Any]:
    """The dictionary that a pickle holds, read without running anything in it (see `safe_pickle`).

    Raises DatasetError where it is missing, damaged, too large, or asks for more than arrays.
    """
    # RHD's training labels have 94 MB.
    data = read_bytes(path, layout, 500_000_000)
    try:
        # RHD's 41 000 training labels have about 3 million instructions.
        content = safe_pickle.load(data, most_steps=10_000_000)
    except safe_pickle.Refused as error:
        raise DatasetError(f"{path}: refused: the file {error}; labels never do, do not trust it") from error
    except Exception as error:  # a damaged pickle can fail in any way
        raise DatasetError(f"{path}: not a pickle, or a damaged or truncated one; copy it again") from error
    if not isinstance(content, dict):
        raise DatasetError(f"{path}: this pickle holds no labels; expected {layout}")
    return content


def pickled_array(where: str, content: Any, key: str, shape: tuple[int, ...]) -> np.ndarray:
    """The float64 array under `key` of a pickle's dictionary. Raises DatasetError."""
    if not isinstance(content, dict) or key not in content:
        raise DatasetError(f"{where}: there is no {key} in its labels")
    array = safe_pickle.plain(content[key])
    if not isinstance(array, np.ndarray):
        raise DatasetError(f"{where}: {key} is not an array of numbers")
    return shaped(where, key, array.astype(np.float64), shape)


def numbers_or_none(value: Any) -> np.ndarray | None:
    """Nested lists of numbers as float64, NaN for a number that is null; None for anything else."""
    if not isinstance(value, list):
        return None
    try:
        array = np.asarray(value)
        if array.dtype.kind == "O":
            array = np.array(value, dtype=np.float64)  # null becomes NaN
        return array.astype(np.float64) if array.dtype.kind in "fiu" else None
    except (TypeError, ValueError, OverflowError):
        return None


def shaped(where: str, key: str, array: np.ndarray | None, shape: tuple[int, ...]) -> np.ndarray:
    """`array` in float64 if it has that shape. Raises DatasetError."""
    expected = "x".join(map(str, shape))
    if array is None:
        raise DatasetError(f"{where}: {key} is not an array of {expected} numbers")
    if array.shape != shape:
        got = "x".join(map(str, array.shape)) or "one number"
        raise DatasetError(f"{where}: {key} has shape {got}, expected {expected}")
    return array.astype(np.float64)


def vertices(where: str, array: np.ndarray | None) -> np.ndarray:
    """`array` in float64 if it is (V, 3). Raises DatasetError."""
    if array is None or array.ndim != 2 or array.shape[1] != 3 or not np.isfinite(array).all():
        raise DatasetError(f"{where}: its mesh is missing or damaged; expected Vx3 numbers")
    return array.astype(np.float64)


def intrinsics_of(where: str, matrix: np.ndarray | None) -> Intrinsics | None:
    """A (3, 3) camera matrix in pixels; None where there is none. Raises DatasetError if it is none."""
    if matrix is None:
        return None
    matrix = shaped(where, "K", matrix, (3, 3))
    try:
        return Intrinsics(*(float(matrix[i]) for i in ((0, 0), (1, 1), (0, 2), (1, 2))))
    except OptionError as error:
        raise DatasetError(f"{where}: K is no camera matrix: {error}") from error


def hand_label(
    side: Side | None,
    joints_3d: np.ndarray | None,
    intrinsics: Intrinsics | None,
    keypoints_2d: np.ndarray | None = None,
    mesh: MeshLabel | None = None,
) -> HandLabel:
    """A label from (21, 3) metres and (21, 2) pixels, both in MediaPipe's order; None is all missing.

    Points with a missing coordinate are missing as a whole. Without keypoints_2d, the joints are
    projected where there is a camera.
    """
    joints = _whole_points(joints_3d, 3)
    if keypoints_2d is None and intrinsics is not None:
        keypoints_2d = projected(joints, intrinsics)
    return HandLabel(side, joints, _whole_points(keypoints_2d, 2), mesh)


def projected(points: np.ndarray, intrinsics: Intrinsics) -> np.ndarray:
    """(N, 3) metres, camera frame -> (N, 2) pixels; NaN for points that are missing or behind the camera."""
    pixels = np.full((len(points), 2), np.nan)
    seen = points[:, 2] > 0.0
    pixels[seen] = intrinsics.project(points[seen])
    return pixels


def _whole_points(points: np.ndarray | None, dimensions: int) -> np.ndarray:
    if points is None:
        return np.full((NUM_KEYPOINTS, dimensions), np.nan)
    return np.where(np.all(np.isfinite(points), axis=1, keepdims=True), points, np.nan)


def paired(
    split: str,
    pictures: Iterable[Path],
    label_of: Callable[[int], Label | None],
    read: Callable[[Label, str], Labels],
    every: Iterable[Label],
    file: Path,
) -> tuple[list[Entry], tuple[Problem, ...]]:
    """Pictures with the label that `label_of` gives for their numbers, which `read` reads for the picture; a
    problem for each picture without one, and for each of `every` label of the `file` without a picture."""
    entries: list[Entry] = []
    lonely: list[Path] = []
    unused = set(every)
    for picture in pictures:
        number = int(picture.stem) if picture.stem.isascii() and picture.stem.isdigit() else None
        label = None if number is None else label_of(number)
        if label is None:
            lonely.append(picture)
            continue
        unused.discard(label)
        entries.append(Entry(f"{split}/{picture.stem}", picture, partial(read, label, str(picture))))
    return entries, unpaired(lonely, file, unused)


def unpaired(pictures: Iterable[Path], file: Path, labels: Iterable[object]) -> tuple[Problem, ...]:
    """A problem for each of these pictures, which have no label, and of a file's labels without a picture."""
    return (
        *(Problem(PROBLEMS.no_label, str(picture)) for picture in pictures),
        *(
            Problem(PROBLEMS.unpaired_label, f"{file}: label {name}")
            for name in sorted(labels, key=_in_order)
        ),
    )


def _in_order(name: object) -> tuple[bool, int, str]:
    return (False, name, "") if isinstance(name, int) else (True, 0, str(name))
