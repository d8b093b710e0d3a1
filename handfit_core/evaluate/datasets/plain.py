"""The plain folder form: pictures and one `index.json`. How users bring their own; see docs/data-sets.md."""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from handfit_core.common.errors import DatasetError
from handfit_core.common.files import is_file, written_whole
from handfit_core.common.skeleton import NUM_BETAS, NUM_KEYPOINTS, SIDES
from handfit_core.evaluate.datasets import reading
from handfit_core.evaluate.labels import Dataset, Entry, HandLabel, Labels, MeshLabel, Problem, Reader
from handfit_core.hand_model import OPEN_HAND, load_model

INDEX = "index.json"
DEFAULT_FPS = 25.0

_MANO_SIZES = {"betas": NUM_BETAS, "global_orient": 3, "hand_pose": 45, "transl": 3}
_POINTS = {"joints_3d_mm": 3, "keypoints_2d_px": 2}
_HAND_KEYS = ("hand", *_POINTS, "mano")


def recognises(root: Path) -> bool:
    """True if the folder has an index."""
    return (root / INDEX).is_file()


def read(root: Path) -> Dataset:
    """List the pictures of `index.json`; their labels are understood when asked for.

    Raises DatasetError where the index is missing, damaged, or of another form.
    """
    path = root / INDEX
    if not path.is_file():
        raise reading.lacks(root, INDEX, READER.layout)
    index = reading.read_json(path)
    whole: dict[str, Any] = index if isinstance(index, dict) else {"pictures": index}
    if not isinstance(whole.get("pictures"), list):
        raise DatasetError(f"{path}: it holds no list of pictures; expected {READER.layout}")
    step = 1.0 / float(whole.get("fps", DEFAULT_FPS))
    problems: list[Problem] = []
    units: dict[tuple[str, int | str], list[Entry]] = {}
    frames: Counter[str] = Counter()
    seen: set[str] = set()
    for number, item in enumerate(whole["pictures"]):
        try:
            file, clip, time = Path(item["file"]).as_posix(), item.get("clip"), item.get("time")
            # Counted before anything can be left out: a frame's time does not depend on its neighbours.
            time = frames[clip] * step if time is None else float(time)
            frames[clip] += clip is not None
            entry = Entry(
                name=file,
                picture=root / file,
                read_labels=partial(_labels, item, file),
                clip=clip,
                time=time,
                tags={str(key): str(value) for key, value in item.get("tags", {}).items()},
            )
            unusable = _problem_of(root, item, file, seen)
            doubts = _doubts(item, file)
        except (AttributeError, KeyError, TypeError, ValueError) as error:
            where = f"{path}: picture {number + 1} ({type(error).__name__}: {error})"
            problems.append(Problem("index entry that cannot be read", where))
            continue
        problems += [Problem(unusable, file)] if unusable else doubts
        if not unusable:
            seen.add(file)
            units.setdefault(("still", number) if clip is None else ("clip", clip), []).append(entry)
    return Dataset(
        name=str(whole.get("name") or root.resolve().name),
        kind="plain",
        root=root,
        entries=[e for unit in units.values() for e in sorted(unit, key=lambda entry: entry.time)],
        problems=tuple(problems),
        notes=tuple(map(str, whole.get("notes", ()))),
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
    """Return a value in JSON's types, NaN as null."""
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if isinstance(value, Mapping):
        return {str(key): _plain(part) for key, part in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(part) for part in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def _problem_of(root: Path, item: dict[str, Any], file: str, seen: set[str]) -> str | None:
    """Return the reason why a picture cannot be an entry, or None."""
    if Path(file).is_absolute() or ".." in Path(file).parts:
        return "file outside the folder"
    if file in seen:
        return "listed twice"
    if not is_file(root / file):
        return reading.NO_PICTURE
    return None if any(key in item for key in ("hands", *_HAND_KEYS)) else reading.NO_LABEL


def _doubts(item: dict[str, Any], file: str) -> list[Problem]:
    """Return problems of a picture that can be used all the same. Only parameters of the bundled hand, in its
    present version, become a mesh."""
    meshes = [hand for hand in _hands_of(item) if isinstance(hand, dict) and hand.get("mano") is not None]
    others = ["mesh of another hand model: not scored" for hand in meshes if not _is_ours(hand)]
    return [Problem(kind, file) for kind in [reading.NO_CAMERA] * (item.get("K") is None) + others]


def _is_ours(hand: dict[str, Any]) -> bool:
    mano, side = hand["mano"], hand.get("hand")
    return (
        side in SIDES
        and mano.get("model", OPEN_HAND) == OPEN_HAND
        and mano.get("digest") == load_model(OPEN_HAND, side).digest
    )


def _hands_of(item: dict[str, Any]) -> list[Any]:
    if "hands" in item:
        return item["hands"]
    return [{key: item[key] for key in _HAND_KEYS if key in item}]


def _labels(item: dict[str, Any], file: str) -> Labels:
    hands = tuple(_hand(hand, file) for hand in _hands_of(item))
    return Labels(hands, reading.intrinsics_of(file, item.get("K")))


def _hand(hand: dict[str, Any], file: str) -> HandLabel:
    side = hand.get("hand")
    if side is not None and side not in SIDES:
        raise DatasetError(f"{file}: hand is {side!r}; expected left, right or null")
    joints, pixels = (_points(hand, key, size, file) for key, size in _POINTS.items())
    joints = None if joints is None else joints / 1000.0
    mesh = None
    if hand.get("mano") is not None and _is_ours(hand):
        pose = {
            key: reading.numbers(f"{file}: mano {key}", hand["mano"].get(key), (size,))
            for key, size in _MANO_SIZES.items()
        }
        # The left hand is the right one's mirror image, vertex by vertex.
        models = {each: load_model(OPEN_HAND, each) for each in SIDES}
        digests = frozenset(model.digest for model in models.values())
        mesh = MeshLabel(lambda: models[hand["hand"]].posed(**pose).vertices, digests)
    return reading.hand_label(side, joints, pixels, mesh)


def _points(hand: dict[str, Any], key: str, size: int, file: str) -> np.ndarray | None:
    """Return (21, size) numbers; a point or number that is null becomes NaN. None where the key is not
    there."""
    points = hand.get(key)
    if points is None:
        return None
    whole = [[None] * size if point is None else point for point in points]
    return reading.numbers(f"{file}: {key}", whole, (NUM_KEYPOINTS, size))


READER = Reader(
    "the plain layout: pictures, and index.json with a list of "
    '{"file", "hand", "joints_3d_mm", "keypoints_2d_px", "K"}; see docs/data-sets.md',
    recognises,
    read,
)
