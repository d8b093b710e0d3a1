"""The plain folder form: pictures and one `index.json`. How users bring their own; see docs/data-sets.md."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from handfit_core.errors import DatasetError
from handfit_core.evaluate.datasets import reading
from handfit_core.evaluate.labels import Dataset, Entry, HandLabel, Labels, MeshLabel, Problem, Reader
from handfit_core.files import written_whole
from handfit_core.geometry.camera import Intrinsics
from handfit_core.hand_model import OPEN_HAND, load_model
from handfit_core.skeleton import NUM_BETAS, NUM_KEYPOINTS, SIDES, Side

INDEX = "index.json"
DEFAULT_FPS = 25.0

_MANO_SHAPES = {"betas": NUM_BETAS, "global_orient": 3, "hand_pose": 45, "transl": 3}
_HAND_KEYS = ("hand", "joints_3d_mm", "keypoints_2d_px", "mano")


def recognises(root: Path) -> bool:
    """Whether the folder has an index."""
    return (root / INDEX).is_file()


def read(root: Path) -> Dataset:
    """List the pictures of `index.json`; their labels are understood when asked for.

    Raises DatasetError where the index is missing, damaged, or of another form.
    """
    path = root / INDEX
    index = reading.read_json(path, READER.layout)
    whole: dict[str, Any] = index if isinstance(index, dict) else {"pictures": index}
    items, fps, notes = whole.get("pictures"), whole.get("fps", DEFAULT_FPS), whole.get("notes", [])
    if not isinstance(items, list):
        raise DatasetError(f"{path}: it holds no list of pictures; expected {READER.layout}")
    if not _is_number(fps) or fps <= 0:
        raise DatasetError(f"{path}: fps is {fps!r}, expected pictures per second, as in 25")
    if not (isinstance(notes, list) and all(isinstance(note, str) for note in notes)):
        raise DatasetError(f"{path}: notes is no list of sentences")

    problems: list[Problem] = []
    stills: dict[str, list[Entry]] = {}
    seen: set[str] = set()
    frames: dict[str, int] = {}
    for number, item in enumerate(items):
        where = f"{path}: picture {number + 1}"
        file = item.get("file") if isinstance(item, dict) else None
        if not isinstance(item, dict) or not isinstance(file, str) or not file:
            problems.append(Problem("index entry without a file name", where))
            continue
        file = Path(file).as_posix()
        clip = item.get("clip")
        if clip is not None and not isinstance(clip, str):
            problems.append(Problem("clip is no name", f"{where}: {file}"))
            clip = None
        # Counted before anything can be left out: a frame's time does not depend on its neighbours.
        frame = 0
        if clip is not None:
            frame = frames[clip] = frames.get(clip, -1) + 1
        problem = _problem_of(root, file, item, seen)
        if problem is not None:
            problems.append(Problem(problem, file))
            continue
        seen.add(file)
        if item.get("K") is None:
            problems.append(Problem(reading.PROBLEMS.no_camera, file))
        time = item.get("time")
        if time is not None and not _is_number(time):
            problems.append(Problem("time is no number", file))
            time = None
        problems += _mesh_problems(item, file)
        entry = Entry(
            name=file,
            picture=root / file,
            read_labels=lambda item=item, file=file: _labels(item, file),
            clip=clip,
            time=frame / fps if time is None else float(time),
            tags=_tags(item),
        )
        stills.setdefault(f"clip {clip}" if clip is not None else f"still {number}", []).append(entry)
    return Dataset(
        name=str(whole.get("name") or root.resolve().name),
        kind="plain",
        root=root,
        entries=[e for group in stills.values() for e in sorted(group, key=lambda entry: entry.time)],
        problems=tuple(problems),
        notes=tuple(notes),
    )


def save_index(
    root: Path,
    pictures: Sequence[Mapping[str, Any]],
    *,
    name: str,
    notes: Sequence[str] = (),
    fps: float = DEFAULT_FPS,
) -> Path:
    """Write `root/index.json`, whole or not at all; returns its path.

    `pictures` are dictionaries as docs/data-sets.md describes them; arrays may be NumPy's, and NaN is
    written as null. Raises OutputError where the folder cannot be written.
    """
    content = {"name": name, "notes": list(notes), "fps": fps, "pictures": list(pictures)}
    path = root / INDEX
    with written_whole(path) as beside:
        beside.write_text(json.dumps(_plain(content), allow_nan=False) + "\n", encoding="utf-8")
    return path


def _plain(value: Any) -> Any:
    """The same in JSON's types."""
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if isinstance(value, Mapping):
        return {str(key): _plain(part) for key, part in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(part) for part in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def _is_number(value: Any) -> bool:
    try:
        return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
    except OverflowError:  # JSON's integers have no end
        return False


def _problem_of(root: Path, file: str, item: dict[str, Any], seen: set[str]) -> str | None:
    """Why a picture cannot be an entry."""
    if Path(file).is_absolute() or ".." in Path(file).parts:
        return "file outside the folder"
    if file in seen:
        return "listed twice"
    with suppress(OSError):  # a name that no file system takes
        if (root / file).is_file():
            return None if any(key in item for key in ("hands", *_HAND_KEYS)) else reading.PROBLEMS.no_label
    return reading.PROBLEMS.no_picture


def _tags(item: dict[str, Any]) -> dict[str, str]:
    tags = item.get("tags")
    return {str(key): str(value) for key, value in tags.items()} if isinstance(tags, dict) else {}


def _hands_of(item: dict[str, Any]) -> list[Any]:
    if "hands" in item:
        return item["hands"] if isinstance(item["hands"], list) else [item["hands"]]
    return [{key: item[key] for key in _HAND_KEYS if key in item}]


def _labels(item: dict[str, Any], file: str) -> Labels:
    camera = item.get("K")
    if camera is not None:
        camera = reading.shaped(file, "K", reading.numbers_or_none(camera), (3, 3))
    intrinsics = reading.intrinsics_of(file, camera)
    return Labels(tuple(_hand(hand, intrinsics, file) for hand in _hands_of(item)), intrinsics)


def _hand(hand: Any, intrinsics: Intrinsics | None, file: str) -> HandLabel:
    if not isinstance(hand, dict):
        raise DatasetError(f"{file}: a hand's label is no object with {', '.join(_HAND_KEYS)}")
    side = hand.get("hand")
    if side is not None and side not in SIDES:
        raise DatasetError(f"{file}: hand is {side!r}; expected left, right or null")
    joints = _points(hand, "joints_3d_mm", 3, file)
    return reading.hand_label(
        side,
        None if joints is None else joints / 1000.0,
        intrinsics,
        _points(hand, "keypoints_2d_px", 2, file),
        _mesh(hand, side, file),
    )


def _points(hand: dict[str, Any], key: str, dimensions: int, file: str) -> np.ndarray | None:
    """(21, dimensions); a point or number that is null becomes NaN. None where the key is not there."""
    points = hand.get(key)
    if isinstance(points, list):
        points = [[None] * dimensions if point is None else point for point in points]
    elif points is None:
        return None
    return reading.shaped(file, key, reading.numbers_or_none(points), (NUM_KEYPOINTS, dimensions))


def _mesh_problems(item: dict[str, Any], file: str) -> list[Problem]:
    """Meshes that cannot be had: only the bundled hand's parameters become one, and only this version's."""
    hands = [hand for hand in _hands_of(item) if isinstance(hand, dict)]
    meshes = [(hand["mano"], hand.get("hand")) for hand in hands if isinstance(hand.get("mano"), dict)]
    return [Problem("mesh of another hand model: not scored", file) for m in meshes if not _is_ours(*m)]


def _is_ours(mano: dict[str, Any], side: Any) -> bool:
    return (
        side in SIDES
        and mano.get("model", OPEN_HAND) == OPEN_HAND
        and mano.get("digest") == load_model(OPEN_HAND, side).digest
    )


def _mesh(hand: dict[str, Any], side: Side | None, file: str) -> MeshLabel | None:
    mano = hand.get("mano")
    if mano is None:
        return None
    if not isinstance(mano, dict):
        raise DatasetError(f"{file}: mano is no object with {', '.join(_MANO_SHAPES)}")
    if side is None or not _is_ours(mano, side):
        return None
    found = {
        key: reading.shaped(file, f"mano {key}", reading.numbers_or_none(mano.get(key)), (size,))
        for key, size in _MANO_SHAPES.items()
    }
    model = load_model(OPEN_HAND, side)
    # The left hand is the right one's mirror image, vertex by vertex.
    digests = frozenset(load_model(OPEN_HAND, each).digest for each in SIDES)
    return MeshLabel(lambda: model.posed(**found).vertices, digests)


READER = Reader(
    "the plain layout: pictures, and index.json with a list of "
    '{"file", "hand", "joints_3d_mm", "keypoints_2d_px", "K"}; see docs/data-sets.md',
    recognises,
    read,
)
