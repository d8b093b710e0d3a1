"""Points of this project as a table with a point a row (docs/interchange.md)."""

from __future__ import annotations

import csv
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np

from handfit_core.doors.values import Unfit
from handfit_core.interchange.document import Document, Table
from handfit_core.interchange.gather import Gathering, check_some, seen_hands
from handfit_core.interchange.point_names import point_named, side_named
from handfit_core.interchange.readers import Reader
from handfit_core.interchange.recording import Asked, PointsHand, Recording, known
from handfit_core.interchange.tables import rate_of
from handfit_core.interchange.writers import Writer
from handfit_core.skeleton import KEYPOINT_NAMES, NUM_KEYPOINTS, Side
from handfit_core.take import Take

_IN_PLANE: Final = ("x_px", "y_px")
_IN_SPACE: Final = ("x_m", "y_m", "z_m")
COLUMNS: Final = (
    *("frame", "time", "hand", "side", "point"),
    *(*_IN_PLANE, "confidence", *_IN_SPACE, "width", "height"),
)


def _recognises(document: Document) -> bool:
    table = None if document.is_folder else document.table
    if table is None or not set(table.columns) >= {"frame", "side", "point"}:
        return False
    return set(_IN_PLANE) <= set(table.columns) or set(_IN_SPACE) <= set(table.columns)


def _read(document: Document, asked: Asked) -> Recording:
    table = document.table
    if table is None:
        raise Unfit("it is no table: its lines differ in length, or its name ends in neither .csv nor .txt")
    frames, hands, points = _whole(table, "frame"), _hands(table), _points(table)
    numbers, row = np.unique(frames, return_inverse=True)
    sides = table.texts("side")
    told: dict[int, Side] = {}
    for hand, text in dict.fromkeys(zip(hands.tolist(), sides, strict=True)):
        side = side_named(text)
        if side is None or told.setdefault(hand, side) != side:
            raise ValueError(
                f"the side of hand {hand} is {text[:40]!r}; expected left or right, always the same"
            )
    keys = (row * (hands.max() + 1) + hands) * NUM_KEYPOINTS + points
    if len(np.unique(keys)) != len(keys):
        raise ValueError("a point of one hand and frame is there twice")
    fps = rate_of(frames, table.numbers(["time"])[:, 0]) if "time" in table.columns else 0.0
    made = Recording(
        "points-table", (str(document.path.absolute()),), asked.fps or fps, numbers, size=_size(table)
    )
    space = (
        table.numbers(_IN_SPACE) if set(_IN_SPACE) <= set(table.columns) else np.full((len(row), 3), np.nan)
    )
    if known(space).any():
        found = []
        for hand, side in told.items():
            mine = hands == hand
            track = np.full((len(numbers), NUM_KEYPOINTS, 3), np.nan)
            track[row[mine], points[mine]] = space[mine]
            found.append(PointsHand(side, track))
        return replace(made, points=tuple(found))
    if not set(_IN_PLANE) <= set(table.columns):
        raise ValueError("no point has all of x_m, y_m and z_m")
    pixels = table.numbers(_IN_PLANE)
    sure = table.numbers(["confidence"])[:, 0] if "confidence" in table.columns else np.ones(len(row))
    sure = np.where(np.isfinite(sure), sure, 1.0)
    gathered = Gathering()
    order = np.lexsort((hands, row))
    starts = np.flatnonzero(np.diff(row[order] * (hands.max() + 1) + hands[order], prepend=-1))
    for mine in np.split(order, starts[1:]):
        plane, certain = np.full((NUM_KEYPOINTS, 2), np.nan), np.zeros(NUM_KEYPOINTS)
        plane[points[mine]], certain[points[mine]] = pixels[mine], sure[mine]
        gathered.add(int(row[mine[0]]), plane, told[int(hands[mine[0]])], certain)
    seen = gathered.hands()
    check_some(seen, f"{document.path.name}: a table of points")
    return replace(made, seen=seen_hands(seen))


def _whole(table: Table, column: str) -> np.ndarray:
    """(R,) whole numbers. Raises ValueError."""
    values = table.numbers([column])[:, 0]
    if not np.all(np.isfinite(values) & (np.abs(values) < 2**53) & (values == np.round(values))):
        raise ValueError(f"the column {column} holds something else than whole numbers")
    return values.astype(np.int64)


def _hands(table: Table) -> np.ndarray:
    """(R,) which hand each row is of, from 0: by the column hand, or by the side."""
    column = "hand" if "hand" in table.columns else "side"
    _, hands = np.unique(np.array(table.texts(column)), return_inverse=True)
    return hands


def _points(table: Table) -> np.ndarray:
    """(R,) which of the 21 points each row is. Raises ValueError."""
    texts = table.texts("point")
    places: dict[str, int] = {}
    for text in set(texts):
        place = int(text) if text.isascii() and text.isdigit() and len(text) < 3 else point_named(text)
        if place is None or place >= NUM_KEYPOINTS:
            raise ValueError(
                f"there is no point {text[:40]!r}; expected 0 to 20, or wrist, thumb_1 to little_4"
            )
        places[text] = place
    return np.array([places[text] for text in texts])


def _size(table: Table) -> tuple[int, int] | None:
    if not {"width", "height"} <= set(table.columns):
        return None
    width, height = table.numbers(["width", "height"])[0]
    if not (np.isfinite(width) and np.isfinite(height)):
        return None
    return int(width), int(height)


def _write(take: Take, path: Path) -> None:
    first = int(take.frame_numbers[0])
    with path.open("w", encoding="utf-8", newline="") as stream:
        writer = csv.writer(stream)
        writer.writerow(COLUMNS)
        for row, number in enumerate(take.frame_numbers.tolist()):
            time = f"{(number - first) / take.fps:.6f}"
            for count, hand in enumerate(take.hands):
                pixels, joints = hand.keypoints_2d[row], hand.joints_3d[row]
                if not known(pixels).any() and not known(joints).any():
                    continue
                score = _text(hand.score[row], 4)
                for point, name in enumerate(KEYPOINT_NAMES):
                    plane = [_text(value, 3) for value in pixels[point]]
                    space = [_text(value, 6) for value in joints[point]]
                    writer.writerow(
                        [number, time, count, hand.side, name, *plane, score, *space, take.width, take.height]
                    )


def _text(value: float, digits: int) -> str:
    return "" if np.isnan(value) else f"{value:.{digits}f}"


READER = Reader("Points as a table", "the CSV of docs/interchange.md", _recognises, _read)
WRITER = Writer("Points as a table", (".points.csv", ".csv"), _write)
