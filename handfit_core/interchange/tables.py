"""Hands in tables: rows that hold a whole hand or both, and rows of one point each."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from handfit_core.interchange.document import Table
from handfit_core.interchange.gather import UNKNOWN, ToldHands
from handfit_core.interchange.numbered import plain
from handfit_core.interchange.point_names import PointColumn, point_columns, point_named, side_named
from handfit_core.interchange.recording import known
from handfit_core.skeleton import NUM_KEYPOINTS, SIDES

_NAMES: Final = {
    "frame": "frame frameid framenumber frameindex frameidx frameno framenum image file".split(),
    "time": "timestamp time timestampms timems timestamps times t".split(),
    "side": "handedness side hand handlabel handside label type handtype chirality which".split(),
    "hand": "handid handindex handidx handnumber handno hand id".split(),
    "point": (
        "landmark landmarkindex landmarkid landmarkname landmarkidx point pointid pointname keypoint "
        "keypointid keypointname joint jointname jointid index name id"
    ).split(),
    "score": "score handednessscore handscore".split(),
    "confidence": "confidence visibility likelihood conf presence score".split(),
}
"""Names of columns by what they hold, in lower case and without what is between words"""
_AXES: Final = "xyz"
_NUMBER: Final = re.compile(r"[+-]?\d+(\.\d*)?(e[+-]?\d+)?", re.ASCII | re.IGNORECASE)


@dataclass(frozen=True, eq=False)
class TableHands:
    """What a table of hands holds."""

    numbers: np.ndarray
    """(T,) int, increasing"""
    hands: ToldHands
    """Points that are in metres about the hand's middle are its world"""
    fps: float
    """0: not told"""
    named_sides: bool
    """Whether columns' names, rather than a column, tell the sides"""
    counted: bool
    """Whether frames are numbered by the table"""


@dataclass(frozen=True)
class _Long:
    point: str
    axes: tuple[str, ...]


def columns_of(table: Table) -> list[PointColumn] | None:
    """The columns of points where each row is a hand or two; None for other tables."""
    columns = point_columns(table.columns)
    named = {column.point for column in columns if column.axis in "xy"}
    # Points that a table's columns must name before it counts as one of hands
    return columns if len(named) >= 6 else None


def _long(table: Table) -> _Long | None:
    plain_names = {plain(name): name for name in reversed(table.columns)}
    point = next((plain_names[name] for name in _NAMES["point"] if name in plain_names), None)
    axes = []
    for axis in _AXES:
        found = next(
            (
                plain_names[n]
                for n in (axis, f"{axis}norm", f"normalized{axis}", f"{axis}px")
                if n in plain_names
            ),
            None,
        )
        if found is not None:
            axes.append(found)
    if point is None or len(axes) < 2:
        return None
    first = [text for text in table.texts(point)[:200] if text]
    fits = sum(_place(text) is not None for text in first)
    return _Long(point, tuple(axes)) if first and fits > 0 else None


def is_hand_table(table: Table) -> bool:
    """Whether a table holds points of hands."""
    return columns_of(table) is not None or _long(table) is not None


def hands_of(table: Table) -> TableHands:
    """The hands of a table that `is_hand_table`. Raises ValueError."""
    columns = columns_of(table)
    frames = _frames(table)
    if columns is not None:
        hands, row_of = _wide(table, columns)
        named_sides = any(column.side is not None for column in columns)
    else:
        long = _long(table)
        if long is None:
            raise ValueError("its columns name no points of hands")
        if frames is None:
            raise ValueError("each row is a point, and no column tells the frame")
        hands, row_of = _pointwise(table, long, frames)
        named_sides = False
    counted = frames is not None
    if frames is None:
        frames = np.arange(1, len(table.rows) + 1)
    numbers, place = np.unique(frames, return_inverse=True)
    order = np.argsort(place[row_of], kind="stable")
    hands = replace(hands, row=place[row_of]).select(order)
    return TableHands(numbers, hands, _rate(table, frames), named_sides, counted)


def _column(table: Table, names: Iterable[str]) -> str | None:
    plain_names = {plain(name): name for name in reversed(table.columns)}
    return next((plain_names[name] for name in names if name in plain_names), None)


def _frames(table: Table) -> np.ndarray | None:
    """(R,) the frame of each row; of a text such as a file's name, its last number. Raises ValueError."""
    name = _column(table, _NAMES["frame"])
    if name is None:
        return None
    numbers = []
    for text in table.texts(name):
        found = [text] if _NUMBER.fullmatch(text) else re.findall(r"\d+", text[:300])
        value = float(found[-1][:300]) if found else np.nan
        if not (value == np.round(value) and abs(value) < 2**53):
            raise ValueError(f"the column {name} holds {text[:40]!r}, which is no frame's number")
        numbers.append(int(value))
    return np.array(numbers)


def _rate(table: Table, frames: np.ndarray) -> float:
    """Frames per second, by a column of times; 0 without one."""
    name = _column(table, _NAMES["time"])
    if name is None or len(np.unique(frames)) < 2:
        return 0.0
    return rate_of(frames, table.numbers([name])[:, 0], milliseconds=plain(name).endswith("ms"))


def rate_of(frames: np.ndarray, times: np.ndarray, *, milliseconds: bool = False) -> float:
    """Frames per second of frames at times in seconds, or in milliseconds, which steps of more than a second
    are taken for; 0 where they tell none."""
    there = np.isfinite(times)
    frames, times = frames[there], times[there]
    if len(frames) < 2:
        return 0.0
    order = np.argsort(frames, kind="stable")
    steps, spent = np.diff(frames[order]), np.diff(times[order])
    moved = (steps > 0) & (spent > 0.0)
    if not moved.any():
        return 0.0
    step = float(np.median(spent[moved] / steps[moved]))
    rate = 1.0 / step * (1000.0 if milliseconds or step > 1.0 else 1.0)
    nearest = round(rate)
    rate = float(nearest) if nearest and abs(rate - nearest) < 0.02 * nearest and step > 1.0 else rate
    return rate if 0.1 <= rate <= 10_000.0 else 0.0


def _sides(table: Table) -> np.ndarray:
    """(R,) which of SIDES each row is of, or UNKNOWN."""
    for names in _NAMES["side"]:
        name = _column(table, (names,))
        if name is not None:
            texts = table.texts(name)
            told = {text: side_named(text) for text in set(texts)}
            if any(told.values()):
                return np.array(
                    [UNKNOWN if told[t] is None else SIDES.index(told[t] or "left") for t in texts]
                )
    return np.full(len(table.rows), UNKNOWN)


def _counted_hands(table: Table) -> np.ndarray:
    """(R,) which of a frame's hands each row is of."""
    name = _column(table, _NAMES["hand"])
    if name is None:
        return np.zeros(len(table.rows), dtype=int)
    values = table.numbers([name])[:, 0]
    return np.nan_to_num(values).clip(-1e6, 1e6).astype(int)


def _score(table: Table) -> np.ndarray:
    name = _column(table, _NAMES["score"])
    return np.full(len(table.rows), np.nan) if name is None else table.numbers([name])[:, 0]


def _made(
    side: np.ndarray,
    hand: np.ndarray,
    score: np.ndarray,
    points: np.ndarray,
    sure: np.ndarray,
    world: np.ndarray,
) -> tuple[ToldHands, np.ndarray]:
    if not np.any(sure > 0.0):
        # MediaPipe fills the visibility of hands' points with zeros.
        sure = np.full_like(sure, np.nan)
    there = known(points[..., :2]) & ~np.all(points[..., :2] == 0.0, axis=-1)
    trusted = np.where(there, np.where(np.isfinite(sure), sure, 1.0).clip(0.0, 1.0), 0.0)
    kept = np.flatnonzero(trusted.any(axis=1) | known(world).any(axis=1))
    certain = np.where(np.isfinite(score), score, trusted.mean(axis=1)).clip(0.0, 1.0)
    hands = ToldHands(kept, side[kept], hand[kept], certain[kept], points[kept], trusted[kept], world[kept])
    return hands, kept


def _wide(table: Table, columns: list[PointColumn]) -> tuple[ToldHands, np.ndarray]:
    """The hands, and which row each is of."""
    rows = len(table.rows)
    numbers = table.numbers([table.columns[column.index] for column in columns])
    sides, counted, score = _sides(table), _counted_hands(table), _score(table)
    groups = sorted({(column.side or "", column.hand) for column in columns})
    parts = []
    for side, hand in groups:
        points = np.full((rows, NUM_KEYPOINTS, 3), np.nan)
        world, sure = points.copy(), np.full((rows, NUM_KEYPOINTS), np.nan)
        for i, column in enumerate(columns):
            if (column.side or "", column.hand) != (side, hand):
                continue
            if column.axis == "c":
                sure[:, column.point] = numbers[:, i]
            else:
                (world if column.world else points)[:, column.point, _AXES.index(column.axis)] = numbers[:, i]
        of_side = np.full(rows, SIDES.index(side)) if side in SIDES else sides
        parts.append(_made(of_side, counted + hand, score, points, sure, world))
    return _joined(parts)


def _joined(parts: list[tuple[ToldHands, np.ndarray]]) -> tuple[ToldHands, np.ndarray]:
    fields = {name: np.concatenate([vars(hands)[name] for hands, _ in parts]) for name in vars(parts[0][0])}
    return ToldHands(**fields), np.concatenate([rows for _, rows in parts])


def _place(text: str) -> int | None:
    if text.isascii() and text.removesuffix(".0").isdigit():
        number = int(text.removesuffix(".0")) if len(text) < 6 else NUM_KEYPOINTS + 1
        return number if number <= NUM_KEYPOINTS else None
    return point_named(text)


def _pointwise(table: Table, long: _Long, frames: np.ndarray) -> tuple[ToldHands, np.ndarray]:
    """The hands of a table with a point a row, and one row of each."""
    texts = table.texts(long.point)
    places = {text: _place(text) for text in set(texts)}
    numbered = any(text.removesuffix(".0") == str(NUM_KEYPOINTS) for text in places)
    first = 1 if numbered and "0" not in places and "0.0" not in places else 0
    place = np.array([-1 if places[text] is None else places[text] for text in texts])
    place = np.where([text.removesuffix(".0").isdigit() for text in texts], place - first, place)
    sides = _sides(table)
    # Of tables with a body and a face, too, rows that name neither hand are none.
    types = _column(table, ("type",))
    of_hands = (
        sides != UNKNOWN
        if types is not None and (sides != UNKNOWN).any()
        else np.ones(len(sides), dtype=bool)
    )
    used = np.flatnonzero((place >= 0) & (place < NUM_KEYPOINTS) & of_hands)
    if not len(used):
        raise ValueError("none of its rows is a hand's point")
    hand = (
        _counted_hands(table)
        if _column(table, _NAMES["hand"]) != long.point
        else np.zeros(len(sides), dtype=int)
    )
    keys = np.column_stack([frames, sides, hand])[used]
    _, start, group = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    group = group.reshape(-1)
    where = np.bincount(group * NUM_KEYPOINTS + place[used])
    if where.max() > 1:
        at = used[np.flatnonzero(where[group * NUM_KEYPOINTS + place[used]] > 1)[0]]
        raise ValueError(f"frame {frames[at]} has the point {texts[at]} of one hand twice")
    points = np.full((len(start), NUM_KEYPOINTS, 3), np.nan)
    numbers = table.numbers(list(long.axes))
    points[group, place[used], : len(long.axes)] = numbers[used]
    sure = np.full(points.shape[:2], np.nan)
    name = _column(table, _NAMES["confidence"])
    if name is not None:
        sure[group, place[used]] = table.numbers([name])[used, 0]
    rows = used[start]
    nothing = np.full_like(points, np.nan)
    hands, kept = _made(sides[rows], hand[rows], np.full(len(rows), np.nan), points, sure, nothing)
    return hands, rows[kept]
