"""DexYCB: a camera's folder of labels_*.npz.

Their pose_m are 3 numbers of the root, 45 coefficients of MANO's directions with its mean, and 3 of the
place, in the camera's frame; all are 0 where there is no hand.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Final

import numpy as np

from handfit_core.doors.values import Unfit
from handfit_core.errors import InputError
from handfit_core.files import read_file
from handfit_core.geometry.camera import Intrinsics
from handfit_core.interchange import mano
from handfit_core.interchange.document import Document
from handfit_core.interchange.readers import Reader
from handfit_core.interchange.recording import Asked, Recording
from handfit_core.skeleton import SIDES, Side

_LABELS: Final = re.compile(r"labels_(\d+)\.npz")
_SIZE: Final = (640, 480)


def _labels(document: Document) -> list[Path]:
    return [path for path in document.files(".npz") if _LABELS.fullmatch(path.name)]


def _recognises(document: Document) -> bool:
    labels = _labels(document)
    return bool(labels) and "pose_m" in Document(labels[0]).names


def _read(document: Document, asked: Asked) -> Recording:
    assumed: list[str] = []
    meta = _text(document.path.absolute().parent / "meta.yml")
    sides = re.findall(r"mano_sides:\s*\n?\s*(?:-|\[)\s*['\"]?(\w+)", meta)
    side: Side | None = next((side for side in SIDES if sides[:1] == [side]), None)
    if side is None:
        raise InputError(
            f"{document.path}: its labels do not tell which hand they are of; put the sequence's meta.yml, "
            "which has mano_sides, into the folder above"
        )
    frames, rows = [], []
    for path in _labels(document):
        match = _LABELS.fullmatch(path.name)
        assert match is not None
        frames.append(int(match[1]))
        rows.append(mano.numbers("pose_m", Document(path).value("pose_m"), 51)[0])
    found = []
    betas = _betas(document.path, meta)
    for frame, row in zip(frames, rows, strict=True):
        if not np.any(row):
            continue
        pose = mano.from_directions(row[None, 3:48], side, asked)
        flat = mano.from_flat(pose, side, asked, "mean")
        found.append(mano.FoundHand(side, betas, row[None, :3], flat, row[None, 48:], frame))
    if not found:
        raise Unfit("there is no hand in any of its frames")
    numbers = np.array(sorted(frames))
    posed = mano.followed(found, numbers, asked, assumed)
    camera = _camera(document.path)
    if camera is None:
        assumed.append("its camera is not told: calibration/intrinsics is not where DexYCB has it")
    fps = asked.rate
    return mano.recording_of(
        "dex-ycb",
        document,
        fps,
        numbers,
        posed,
        asked,
        assumed,
        chosen=True,
        size=None if camera is None else _SIZE,
        intrinsics=camera,
    )


def _text(path: Path) -> str:
    """A small file beside the labels; nothing where there is none."""
    try:
        return read_file(path, 1 << 20).decode("utf-8", "replace")
    except (OSError, ValueError):
        return ""


def _betas(labels: Path, meta: str) -> np.ndarray:
    """(10,) of calibration/mano_NAME/mano.yml, beside the folders of the subjects; NaN where it is not."""
    name = re.search(r"mano_calib:\s*\n?\s*(?:-|\[)\s*['\"]?([\w-]+)", meta)
    if name is None:
        return mano.NO_SHAPE
    text = _text(_calibration(labels) / f"mano_{name[1]}" / "mano.yml")
    numbers = re.findall(r"-?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?", text.partition("betas:")[2])[:10]
    return np.array(numbers, dtype=np.float64) if len(numbers) == 10 else mano.NO_SHAPE


def _camera(labels: Path) -> Intrinsics | None:
    """The colour camera of the folder's serial number."""
    file = _calibration(labels) / "intrinsics" / f"{labels.absolute().name}_{_SIZE[0]}x{_SIZE[1]}.yml"
    colour = _text(file).partition("color:")[2].partition("depth:")[0]
    values = {k: float(v) for k, v in re.findall(r"(fx|fy|ppx|ppy):\s*([\d.]+)", colour)}
    names = ("fx", "fy", "ppx", "ppy")
    return Intrinsics(*(values[name] for name in names)) if set(values) == set(names) else None


def _calibration(labels: Path) -> Path:
    return labels.absolute().parents[2] / "calibration"


READER = Reader(
    "DexYCB", "a camera's folder with labels_*.npz that hold pose_m, under a meta.yml", _recognises, _read
)
