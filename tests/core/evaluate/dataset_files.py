"""Tiny data sets for tests, in the layouts of the released ones."""

from __future__ import annotations

import json
import pickle
from pathlib import Path
from typing import Any

import numpy as np

from handfit_core.evaluate.labels import Entry, HandLabel, said
from handfit_core.evaluate.rows import label_pixels

K = [[500.0, 0.0, 160.0], [0.0, 510.0, 120.0], [0.0, 0.0, 1.0]]


def touch(*files: Path) -> None:
    """Pictures that no reader may open: listing and labels need none of their pixels."""
    for file in files:
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_bytes(b"no picture")


def write_json(path: Path, content: Any) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(content), encoding="utf-8")
    return path


def write_pickle(path: Path, content: Any) -> Path:
    """As Python 2 and NumPy 1 name things."""
    path.parent.mkdir(parents=True, exist_ok=True)
    data = pickle.dumps(content, protocol=2)
    path.write_bytes(data.replace(b"cnumpy._core.multiarray\n", b"cnumpy.core.multiarray\n"))
    return path


def hand(seed: int = 0, points: int = 21) -> np.ndarray:
    """(points, 3) metres, half a metre before the camera."""
    rng = np.random.default_rng(seed)
    return rng.uniform(-0.1, 0.1, (points, 3)) + [0.0, 0.0, 0.5]


def pixels(points: np.ndarray, matrix: Any = K) -> np.ndarray:
    """Projection by a matrix (3, 3 or 4) itself, not by our camera."""
    turn, shift = np.array(matrix)[:, :3], np.array(matrix)[:, 3:].sum(axis=1)
    homogeneous = points @ turn.T + shift
    return homogeneous[:, :2] / homogeneous[:, 2:]


def labels_of(entry: Entry) -> tuple[HandLabel, np.ndarray]:
    """An entry's only hand, and its (21, 2) labelled pixels."""
    labels = entry.read_labels()
    (hand,) = labels.hands
    return hand, label_pixels(hand, labels.intrinsics)


def reason(entry: Entry) -> str:
    """What an evaluation says of an entry whose labels cannot be read."""
    try:
        entry.read_labels()
    except Exception as error:
        return said(error)
    raise AssertionError(f"{entry.name} can be read")


def write_tips(path: Path, frames: np.ndarray) -> None:
    """(N, 5, 3) numbers -> the `x, y, z;` lines of EgoDexter and Dexter+Object; NaN is left empty."""
    path.parent.mkdir(parents=True, exist_ok=True)
    texts = np.where(np.isnan(frames), "", np.char.mod("%.6f", frames)).tolist()
    path.write_text("\n".join("".join(", ".join(tip) + "; " for tip in frame) for frame in texts) + "\n")
