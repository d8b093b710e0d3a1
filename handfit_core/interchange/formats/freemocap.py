"""FreeMoCap's hands in space: (frames, 21, 3) arrays and tables, in millimetres with Z up.

Names after freemocap/system/paths_and_filenames/file_and_folder_names.py and split_and_save.py:
`*left_hand_3d_xyz.npy` and .csv in `output_data`, `*_by_trajectory.csv` beside it; the columns are
`left_hand_wrist_x` and so on, the points MediaPipe's.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Final

import numpy as np

from handfit_core.arrays import LARGEST
from handfit_core.errors import InputError, OptionError
from handfit_core.files import shown
from handfit_core.interchange.document import Document, Table
from handfit_core.interchange.gather import LEAST_SURE, UNKNOWN, hands_in_space, share_left
from handfit_core.interchange.readers import Reader
from handfit_core.interchange.recording import Asked, PointsHand, Recording, known
from handfit_core.interchange.skeletons import UP_AXES
from handfit_core.interchange.tables import columns_of, hands_of
from handfit_core.skeleton import NUM_KEYPOINTS, SIDES, Side, other_side

_HAND_FILE: Final = re.compile(r"(?:^|.*_)(left|right)_hand_(?:3d_xyz|frame_name_xyz)\.npy")
_SIGMA: Final = 0.005
"""Metres that triangulated points are expected to be off"""
_PALM: Final = 0.09
"""Metres from the wrist to the middle finger's knuckle, about"""


def _side_of(path: Path) -> Side | None:
    match = _HAND_FILE.fullmatch(path.name.lower())
    return None if match is None else (SIDES[0] if match[1] == "left" else SIDES[1])


def _arrays(document: Document) -> list[Path]:
    """The files of hands in a folder, or in its output_data; the file itself."""
    if not document.is_folder:
        return [document.path] if _side_of(document.path) else []
    for folder in (document, Document(document.path / "output_data")):
        found = [file for file in folder.files(".npy") if _side_of(file)]
        if found:
            return found
    return []


def _in_space(table: Table) -> bool:
    """Whether columns name both points and sides, and hold lengths rather than parts of a picture."""
    columns = columns_of(table)
    if columns is None or any(column.side is None for column in columns):
        return False
    if not {"x", "y", "z"} <= {column.axis for column in columns} or any(column.world for column in columns):
        return False
    by_axis = {
        axis: [table.columns[c.index] for c in columns if c.axis == axis and c.point == 0] for axis in "xyz"
    }
    if not all(by_axis.values()):
        return False
    depth = table.numbers(by_axis["z"])
    across = table.numbers(by_axis["x"])
    if not np.isfinite(depth).any() or not np.isfinite(across).any():
        return False
    # The depth of MediaPipe's wrist is zero, as the others' count from it.
    return bool(np.nanmedian(np.abs(depth)) > 0.01 and np.nanmax(np.abs(across)) > 3.0)


def _recognises(document: Document) -> bool:
    if _arrays(document):
        return True
    return not document.is_folder and document.table is not None and _in_space(document.table)


def _read(document: Document, asked: Asked) -> Recording:
    path = shown(document.path)
    if asked.person is not None:
        raise OptionError(f"{path}: FreeMoCap's files are of one person; leave --person out")
    files, fps = _arrays(document), 0.0
    if files:
        hands = [_of_array(file) for file in files]
        count = max(len(hand.points) for hand in hands)
        if any(len(hand.points) != count for hand in hands):
            raise InputError(f"{path}: its left and right hand have different numbers of frames")
        numbers = np.arange(count)
    else:
        if document.table is None:
            raise InputError(f"{path}: no array or table of FreeMoCap's hands ({document.found})")
        table = hands_of(document.table)
        if np.any(table.hands.side == UNKNOWN):
            raise InputError(f"{path}: some of its columns name no side, as left_hand_wrist_x does")
        count, fps = len(table.numbers), table.fps
        numbers = table.numbers if table.counted else np.arange(count)
        hands = list(hands_in_space(table.hands, count, table.hands.points, on_joints=False, sigma=_SIGMA))
    if not any(hand.present.any() for hand in hands):
        raise InputError(f"{path}: FreeMoCap's hands, but none of its frames has a hand")
    if any(np.nanmax(np.abs(hand.points)) > LARGEST for hand in hands if hand.present.any()):
        raise InputError(f"{path}: FreeMoCap's hands, but some of its points lie beyond {LARGEST:g}")
    unit, said = _unit(hands, path)
    points = tuple(
        PointsHand(hand.side, hand.points * unit @ UP_AXES["z"].T, on_joints=False, sigma=_SIGMA)
        for hand in hands
    )
    return Recording(
        "freemocap",
        tuple(str(file.absolute()) for file in files or [document.path]),
        asked.fps or fps,
        numbers,
        points=points,
        assumed=("Z is up, and Y leads away from who looks", *said, *_odd_sides(points)),
    )


def _of_array(file: Path) -> PointsHand:
    side = _side_of(file)
    points = Document(file).npy
    assert side is not None
    if points is None or points.ndim != 3 or points.shape[1:] != (NUM_KEYPOINTS, 3):
        found = "no array" if points is None else f"an array of the shape {points.shape}"
        raise InputError(f"{shown(file)}: {found}; expected (frames, 21, 3) as FreeMoCap writes its hands")
    values = np.asarray(points, dtype=np.float64)
    return PointsHand(side, np.where(known(values)[..., None], values, np.nan), on_joints=False, sigma=_SIGMA)


def _unit(hands: list[PointsHand], path: str) -> tuple[float, tuple[str, ...]]:
    """Metres of one of the file's units, by the palm's length, and what is said where it is no millimetre."""
    palms = np.concatenate([np.linalg.norm(h.points[:, 9] - h.points[:, 0], axis=-1) for h in hands])
    palm = float(np.nanmedian(palms)) if np.isfinite(palms).any() else np.nan
    for unit, name in ((1e-3, "millimetres"), (1e-2, "centimetres"), (1.0, "metres")):
        if 0.4 * _PALM < palm * unit < 2.5 * _PALM:
            return unit, () if unit == 1e-3 else (f"its unit is {name}, by the palm's length",)
    raise InputError(
        f"{path}: its palms are {palm:.3g} long from the wrist to the middle finger's knuckle; expected "
        "about 90, in millimetres"
    )


def _odd_sides(hands: tuple[PointsHand, ...]) -> tuple[str, ...]:
    """What is said of hands that look like the other side's."""
    odd = []
    for hand in hands:
        looks = share_left(hand.points) * (1.0 if hand.side == "left" else -1.0)
        if looks < -LEAST_SURE:
            other = other_side(hand.side)
            odd.append(f"its {hand.side} hand bends like a {other} one: its files may be swapped or mirrored")
    return tuple(odd)


READER = Reader(
    "FreeMoCap",
    "output_data with *left_hand_3d_xyz.npy, one such file, or a table of trajectories",
    _recognises,
    _read,
)
