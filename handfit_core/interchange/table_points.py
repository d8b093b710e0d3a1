"""Hands in tables: rows that hold a whole hand or both, and rows of one point each."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Final

import numpy as np

from handfit_core.common.skeleton import NUM_KEYPOINTS, SIDES
from handfit_core.interchange.document import Table
from handfit_core.interchange.json_points import rate_of
from handfit_core.interchange.point_hands import UNKNOWN, ParsedHands, ParsedPoints
from handfit_core.interchange.point_names import PointColumn, plain, point_columns, point_named, side_named
from handfit_core.interchange.settings import LIMITS

_NAMES: Final = {
    "frame": "frame frameid framenumber frameindex frameidx frameno framenum image file".split(),
    "time": "timestamp time timestampms timems timestamps times t trackingtimestampus timestampus".split(),
    "side": (
        "handedness side hand handlabel handside handhandedness handhandness label type handtype chirality "
        "which model"
    ).split(),
    "hand": "handid handindex handidx handnumber handno hand id".split(),
    "point": (
        "landmark landmarkindex landmarkid landmarkname landmarkidx point pointid pointname keypoint "
        "keypointid keypointname joint jointname jointid index name id"
    ).split(),
    "score": "score handednessscore handscore".split(),
    "confidence": "confidence visibility likelihood conf presence score".split(),
    "type": ["type", "model"],
}
"""Names of columns by what they hold, plain"""
_AXES: Final = "xyz"
_SLOTS: Final = {"x": 0, "y": 1, "z": 2, "c": 3}
_NUMBER: Final = re.compile(r"[+-]?\d+(\.\d*)?(e[+-]?\d+)?", re.ASCII | re.IGNORECASE)


def columns_of(table: Table) -> list[PointColumn] | None:
    """The columns of points where each row is a hand or two; None for other tables."""
    columns = point_columns(table.columns)
    named = {column.point for column in columns if column.axis in "xy"}
    # Points that a table's columns must name before it counts as one of hands
    return columns if len(named) >= 6 else None


class HandTable:
    """A table with what its columns hold."""

    def __init__(self, table: Table, path: Path) -> None:
        if "trajectory" in table.columns:  # FreeMoCap's, of which the filtered ones come after
            kinds = table.texts("trajectory")
            first = "3d_xyz" if "3d_xyz" in kinds else kinds[0]
            rows = [row for row, kind in zip(table.rows, kinds, strict=True) if kind == first]
            table = Table(table.columns, rows)
        self.table, self.path = table, path
        self._named = {plain(name): name for name in reversed(table.columns)}
        self._count = len(table.rows)

    def _column(self, *names: str) -> str | None:
        """The first of these columns, by plain names, that there is."""
        return next((self._named[name] for name in names if name in self._named), None)

    def _numbers(self, kind: str) -> np.ndarray:
        """(R,) the numbers of the first column of a kind; NaN without one."""
        name = self._column(*_NAMES[kind])
        return np.full(self._count, np.nan) if name is None else self.table.numbers([name])[:, 0]

    def axes(self, *endings: str) -> list[str]:
        """The columns of x, y and z where each row is a point, by what may stand about the letters."""
        found = (self._column(*(ending.format(axis) for ending in endings)) for axis in _AXES)
        return [name for name in found if name is not None]

    @property
    def is_long(self) -> bool:
        """Whether each row is a point of a hand."""
        point = self._column(*_NAMES["point"])
        if point is None or len(self.axes(*_IN_PLANE)) < 2:
            return False
        return any(_place(text) is not None for text in self.table.texts(point)[:200])

    def hands(self, *, first: int = 1, in_space: bool = False, ours: bool = False) -> ParsedPoints:
        """The hands. `first`: from what frames without numbers count; `ours`: whether it is a table of this
        project, in which everything is named. Raises ValueError for what is no table of hands."""
        columns, frames = columns_of(self.table), self._frames()
        if columns is None and self.table.is_trc:
            markers = [name.removesuffix("_x") for name in self.table.columns[2::3]]
            raise ValueError(
                f"none of its {len(markers)} markers ({', '.join(markers)[:200]}) is a point of a hand"
            )
        assumed: tuple[str, ...] = ()
        if columns is not None:
            hands, row_of = self._wide(columns)
            named = all(column.named for column in columns)
            if frames is None:
                frames = np.arange(first, first + self._count)
                assumed = (f"its rows have no frame numbers: they are counted from {first}",)
        elif frames is None:
            raise ValueError("each row is a point, and no column tells the frame")
        else:
            axes, metres = self.axes(*_IN_PLANE), self.axes("{}m") if ours else []
            if len(metres) == 3 and np.isfinite(self.table.numbers(metres)).all(axis=1).any():
                axes, in_space = metres, True
            hands, row_of = self._pointwise(frames, axes, ours)
            point = self._column(*_NAMES["point"]) or ""
            named = ours or not any(_digits(text) for text in self.table.texts(point)[:200])
        numbers, place = np.unique(frames, return_inverse=True)
        named_sides = columns is not None and any(column.side is not None for column in columns)
        return ParsedPoints(
            numbers,
            ParsedHands.of(place[row_of], *hands),
            rate_of(frames, self._numbers("time")),
            self._size(),
            order="mediapipe" if named else "",
            in_space=in_space,
            mirrored=False if named_sides else None,
            assumed=assumed,
        )

    def _frames(self) -> np.ndarray | None:
        """(R,) the frame of each row; of a text such as a file's name, its last number. Raises ValueError."""
        name = self._column(*_NAMES["frame"])
        if name is None:
            return None
        numbers = []
        for text in self.table.texts(name):
            found = [text] if _NUMBER.fullmatch(text) else re.findall(r"\d+", text[:300])
            value = float(found[-1][:300]) if found else np.nan
            if not (value == np.round(value) and abs(value) < 2**53):
                raise ValueError(f"the column {name} holds {text[:40]!r}, which is no frame's number")
            numbers.append(int(value))
        return np.array(numbers)

    def _size(self) -> tuple[int, int] | None:
        if not {"width", "height"} <= set(self._named):
            return None
        width, height = self.table.numbers([self._named["width"], self._named["height"]])[0]
        return (int(width), int(height)) if np.isfinite(width + height) else None

    def _sides(self) -> np.ndarray:
        """(R,) which of SIDES each row is of, or UNKNOWN."""
        for key in _NAMES["side"]:
            if key in self._named:
                texts = self.table.texts(self._named[key])
                told = {text: side_named(text) for text in set(texts)}
                if any(told.values()):
                    codes = {t: UNKNOWN if side is None else SIDES.index(side) for t, side in told.items()}
                    return np.array([codes[text] for text in texts])
        point = self._column(*_NAMES["point"])
        if point is not None:
            told = {text: side_named(text) for text in set(self.table.texts(point))}
            codes = {t: UNKNOWN if side is None else SIDES.index(side) for t, side in told.items()}
            return np.array([codes[text] for text in self.table.texts(point)])
        return np.full(self._count, UNKNOWN)

    def _counted(self) -> np.ndarray:
        """(R,) which of a frame's hands each row is of."""
        return np.nan_to_num(self._numbers("hand")).clip(-1e6, 1e6).astype(int)

    def _wide(self, columns: list[PointColumn]) -> tuple[tuple[np.ndarray, ...], np.ndarray]:
        """What `ParsedHands.of` takes beside the rows, and which row of the table each hand is."""
        groups = sorted({(column.side or "", column.hand) for column in columns})
        LIMITS.check(self.path, self._count, len(groups))
        told = np.full((self._count, len(groups), NUM_KEYPOINTS, 7), np.nan)
        numbers = self.table.numbers([self.table.columns[column.index] for column in columns])
        for i, column in enumerate(columns):
            slot = _SLOTS[column.axis] + (4 if column.world and column.axis != "c" else 0)
            told[:, groups.index((column.side or "", column.hand)), column.point, slot] = numbers[:, i]
        # MediaPipe fills the visibility of hands' points with zeros.
        told[:, ~np.any(told[..., 3] > 0.0, axis=(0, 2)), :, 3] = np.nan
        told = told.reshape(-1, NUM_KEYPOINTS, 7)
        row_of, group_of = np.divmod(np.arange(len(told)), len(groups))
        sides = np.array([SIDES.index(side) if side in SIDES else UNKNOWN for side, _ in groups])[group_of]
        sides = np.where(sides == UNKNOWN, self._sides()[row_of], sides)
        counted = self._counted()[row_of] + np.array([hand for _, hand in groups])[group_of]
        score = self._numbers("score")[row_of]
        return (sides, counted, score, told[..., :4], told[..., 4:]), row_of

    def _pointwise(
        self, frames: np.ndarray, axes: list[str], ours: bool
    ) -> tuple[tuple[np.ndarray, ...], np.ndarray]:
        """What `ParsedHands.of` takes of a table with a point a row, and one row of each hand."""
        column = self._column(*_NAMES["point"])
        if column is None or len(axes) < 2:
            raise ValueError(f"none of its {len(self.table.columns)} columns is a point of a hand")
        texts = self.table.texts(column)
        places = {text: _place(text) for text in set(texts)}
        if ours and (
            wrong := [text for text, place in places.items() if place is None or place == NUM_KEYPOINTS]
        ):
            raise ValueError(
                f"there is no point {wrong[0][:40]!r}; expected 0 to 20, or wrist, thumb_1 to little_4"
            )
        counts = {text for text in places if text.removesuffix(".0").isdigit()}
        first = 1 if any(places[t] == NUM_KEYPOINTS for t in counts) and not {"0", "0.0"} & counts else 0
        codes = {t: -1 if p is None else p - first * (t in counts) for t, p in places.items()}
        place = np.array([codes[text] for text in texts])
        sides, hand = self._sides(), self._counted()
        if ours:
            which = self._column("hand", "side")
            _, hand = np.unique(self.table.texts(which or column), return_inverse=True)
        elif self._column(*_NAMES["hand"]) == column:
            hand = np.zeros(self._count, dtype=int)
        used = (place >= 0) & (place < NUM_KEYPOINTS)
        # Of tables with a body and a face, too, rows that name neither hand are none.
        if self._column(*_NAMES["type"]) is not None and (sides != UNKNOWN).any():
            used &= sides != UNKNOWN
        used = np.flatnonzero(used)
        if not len(used):
            raise ValueError("none of its rows is a hand's point")
        _, start, group = np.unique(
            np.column_stack([frames, sides, hand])[used], axis=0, return_index=True, return_inverse=True
        )
        LIMITS.check(self.path, 1, len(start))
        group, place = group.reshape(-1), place[used]
        where = np.bincount(group * NUM_KEYPOINTS + place)
        if where.max() > 1:
            at = used[np.flatnonzero(where[group * NUM_KEYPOINTS + place] > 1)[0]]
            raise ValueError(f"frame {frames[at]} has the point {texts[at]} of one hand twice")
        told = np.full((len(start), NUM_KEYPOINTS, 4), np.nan)
        told[group, place, : len(axes)] = self.table.numbers(axes)[used]
        told[group, place, 3] = self._numbers("confidence")[used]
        if not np.any(told[..., 3] > 0.0):
            told[..., 3] = np.nan
        rows = used[start]
        return (sides[rows], hand[rows], np.full(len(rows), np.nan), told), rows


_IN_PLANE: Final = ("{}", "{}norm", "normalized{}", "{}px")


def _digits(text: str) -> bool:
    number = text.removesuffix(".0")
    return number.isascii() and number.isdigit()


def _place(text: str) -> int | None:
    """Which point a cell names or counts, from 0 or 1; None: none."""
    number = text.removesuffix(".0")
    if _digits(text):
        return int(number) if len(number) < 4 and int(number) <= NUM_KEYPOINTS else None
    return point_named(text)
