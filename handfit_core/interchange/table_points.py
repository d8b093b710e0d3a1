"""Tables as frames of JSON: rows that hold a whole hand or both, and rows of one point each."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from handfit_core.common.skeleton import NUM_KEYPOINTS
from handfit_core.interchange.document import Document, Table
from handfit_core.interchange.frames import Frames, in_order, rate_of
from handfit_core.interchange.point_names import KEYS, PointColumn, place_of, plain, point_columns, side_named
from handfit_core.interchange.settings import LIMITS

_SLOTS: Final = {"x": 0, "y": 1, "z": 2, "c": 3}
_NUMBER: Final = re.compile(r"[+-]?\d+(\.\d*)?(e[+-]?\d+)?", re.ASCII | re.IGNORECASE)
_IN_PLANE: Final = ("{}", "{}norm", "normalized{}", "{}px")
"""The forms that the names of x, y and z may have in the columns of a table whose rows are points"""


def columns_of(table: Table) -> list[PointColumn] | None:
    """Return the columns of points where each row holds a hand or two; None for other tables."""
    columns = point_columns(table.columns)
    named = {column.point for column in columns if column.axis in "xy"}
    # Points that a table's columns must name before it counts as one of hands
    return columns if len(named) >= 6 else None


def is_hand_table(table: Table) -> bool:
    """Return whether a table holds points of hands."""
    return columns_of(table) is not None or HandTable(table).is_long


def frames_of_table(document: Document, *, first: int = 1, ours: bool = False) -> Frames | None:
    """Return the frames of a table; None without one. `first`: the number of the first of frames without
    numbers; `ours`: it is a table of this project, in which everything is named. Raises ValueError for what
    is no table of hands."""
    return None if document.table is None else HandTable(document.table).frames(document, first, ours=ours)


class HandTable:
    """A table of R rows with points of hands, and the meaning of its columns."""

    def __init__(self, table: Table) -> None:
        if "trajectory" in table.columns:  # FreeMoCap's, of which the filtered ones come after
            kinds = table.texts("trajectory")
            first = "3d_xyz" if "3d_xyz" in kinds else kinds[0]
            rows = [row for row, kind in zip(table.rows, kinds, strict=True) if kind == first]
            table = Table(table.columns, rows)
        self.table = table
        self._named = {plain(name): name for name in reversed(table.columns)}
        self._count = len(table.rows)

    def _column(self, names: Iterable[str]) -> str:
        """Return the first of these columns, by plain names, that there is; empty where there is none."""
        return next((self._named[name] for name in names if name in self._named), "")

    def _texts(self, kind: str) -> list[str]:
        """Return the R cells of the first column of a kind; empty texts where there is none."""
        name = self._column(KEYS[kind])
        return self.table.texts(name) if name else [""] * self._count

    def _numbers(self, *names: str) -> np.ndarray:
        """Return (R,) numbers of the first of these columns that there is; NaN where there is none."""
        name = self._column(names)
        return self.table.numbers([name])[:, 0] if name else np.full(self._count, np.nan)

    def _axes(self, *endings: str) -> list[str]:
        """Return the columns of x, y and z where each row is a point; `endings`: the forms that a column's
        name may have, with {} for the letter."""
        return [name for axis in "xyz" if (name := self._column(e.format(axis) for e in endings))]

    @property
    def is_long(self) -> bool:
        """True if each row is one point of a hand."""
        points = self._texts("point")[:200]
        return len(self._axes(*_IN_PLANE)) > 1 and any(place_of(text) is not None for text in points)

    def frames(self, document: Document, first: int, *, ours: bool) -> Frames:
        """Return the frames of the table, as `frames_of_table` does."""
        columns, numbers, assumed, in_space = columns_of(self.table), self._frames(), "", False
        if columns is not None:
            named = all(column.named for column in columns)
            if numbers is None:
                numbers = np.arange(first, first + self._count)
                assumed = f"its rows have no frame numbers: they are counted from {first}"
            contents = self._hands_of_rows(columns, document.path)
        elif self.table.is_trc:
            markers = [name.removesuffix("_x") for name in self.table.columns[2::3]]
            raise ValueError(
                f"none of its {len(markers)} markers ({', '.join(markers)[:200]}) is a point of a hand"
            )
        elif numbers is None:
            raise ValueError("each row is a point, and no column tells the frame")
        else:
            axes = self._axes("{}m") if ours else []
            in_space = bool(len(axes) == 3 and np.isfinite(self.table.numbers(axes)).all(axis=1).any())
            axes = axes if in_space else self._axes(*_IN_PLANE)
            named = ours or not any(map(_counts, self._texts("point")[:200]))
            contents = self._hands_of_points(numbers, axes, document.path, ours=ours)
        header: dict[str, Any] = {"fps": rate_of(numbers, self._numbers(*KEYS["time"]))}
        size = [self._numbers(name)[0] for name in ("width", "height")]
        if np.isfinite(size).all():
            header |= {"width": int(size[0]), "height": int(size[1])}
        together: dict[int, list[Any]] = {number: [] for number in numbers.tolist()}
        for number, hands in zip(numbers.tolist(), contents, strict=True):
            together[number] += hands
        frames = in_order(document, together, list(together.values()), header, (assumed,) if assumed else ())
        return replace(frames, order="mediapipe" if named else "", in_space=in_space)

    def _frames(self) -> np.ndarray | None:
        """Return (R,) the frame number of each row, which of a text such as a file's name is its last number;
        None where no column tells. Raises ValueError."""
        name = self._column(KEYS["frame"])
        if not name:
            return None
        numbers = []
        for text in self.table.texts(name):
            found = [text] if _NUMBER.fullmatch(text) else re.findall(r"\d+", text[:300])
            value = float(found[-1][:300]) if found else np.nan
            if not (value == np.round(value) and abs(value) < 2**53):
                raise ValueError(f"the column {name} holds {text[:40]!r}, which is no frame's number")
            numbers.append(int(value))
        return np.array(numbers)

    def _sides(self) -> list[str]:
        """Return R texts that tell the side of each row: a column, or the names of points."""
        named = (self.table.texts(self._named[key]) for key in KEYS["side"] if key in self._named)
        told = next((texts for texts in named if any(map(side_named, set(texts)))), None)
        return self._texts("point") if told is None else told

    def _hand(self) -> np.ndarray:
        """Return (R,) the number of the hand within its frame that each row is of."""
        return np.nan_to_num(self._numbers(*KEYS["hand"])).clip(-1e6, 1e6).astype(int)

    def _hands_of_rows(self, columns: list[PointColumn], path: Path) -> list[Any]:
        """Return for each of the R rows its hands, where rows hold whole ones."""
        groups = sorted({(column.side or "", column.hand) for column in columns})
        LIMITS.check(path, self._count, len(groups))
        told = np.full((self._count, len(groups), NUM_KEYPOINTS, 7), np.nan)
        numbers = self.table.numbers([self.table.columns[column.index] for column in columns])
        for i, column in enumerate(columns):
            slot = _SLOTS[column.axis] + (4 if column.world and column.axis != "c" else 0)
            told[:, groups.index((column.side or "", column.hand)), column.point, slot] = numbers[:, i]
        # MediaPipe fills the visibility of hands' points with zeros.
        told[:, ~np.any(told[..., 3] > 0.0, axis=(0, 2)), :, 3] = np.nan
        sides, hands, scores = self._sides(), self._hand(), self._numbers(*KEYS["score"])
        return [
            [
                {
                    "side": side or sides[row],
                    "handnumber": hands[row] + hand,
                    "score": scores[row],
                    "points": told[row, i, :, :4],
                    "worldlandmarks": told[row, i, :, 4:],
                }
                for i, (side, hand) in enumerate(groups)
            ]
            for row in range(self._count)
        ]

    def _hands_of_points(self, frames: np.ndarray, axes: list[str], path: Path, *, ours: bool) -> list[Any]:
        """Return for each of the R rows the hand that begins there, where rows hold a point each."""
        texts, sides, hands = self._texts("point"), self._sides(), self._hand()
        if len(axes) < 2 or not self._column(KEYS["point"]):
            raise ValueError(f"none of its {len(self.table.columns)} columns is a point of a hand")
        places = {text: place_of(text) for text in set(texts)}
        wrong = [text for text, place in places.items() if place is None or place == NUM_KEYPOINTS]
        if ours and wrong:
            raise ValueError(
                f"there is no point {wrong[0][:40]!r}; expected 0 to 20, or wrist, thumb_1 to little_4"
            )
        counts = {text for text in places if _counts(text)}
        first = 1 if any(places[t] == NUM_KEYPOINTS for t in counts) and not {"0", "0.0"} & counts else 0
        codes = {t: -1 if p is None else p - first * (t in counts) for t, p in places.items()}
        if ours:
            which = self._column(("hand", "side"))
            hands = np.unique(self.table.texts(which) if which else texts, return_inverse=True)[1]
        elif self._column(KEYS["hand"]) == self._column(KEYS["point"]):
            hands = np.zeros(self._count, dtype=int)
        known = {text: side_named(text) for text in set(sides)}
        # Of tables with a body and a face, too, rows that name neither hand are none.
        sided = bool(self._column(("type", "model"))) and any(known.values())
        numbers, sure = self.table.numbers(axes), self._numbers(*KEYS["confidence"])
        if not np.any(sure > 0.0):
            sure = np.full(self._count, np.nan)
        found: dict[Any, np.ndarray] = {}
        contents: list[Any] = [[] for _ in texts]
        for row, text in enumerate(texts):
            place, side = codes[text], known[sides[row]]
            if not 0 <= place < NUM_KEYPOINTS or (sided and side is None):
                continue
            key = frames[row], side, hands[row]
            if key not in found:
                found[key] = np.full((NUM_KEYPOINTS, 4), np.nan)
                LIMITS.check(path, 1, len(found))
                contents[row] = [{"side": side, "handnumber": hands[row], "points": found[key]}]
            if np.isfinite(found[key][place]).any():
                raise ValueError(f"frame {frames[row]} has the point {text} of one hand twice")
            found[key][place, : len(axes)], found[key][place, 3] = numbers[row], sure[row]
        if not found:
            raise ValueError("none of its rows is a hand's point")
        return contents


def _counts(text: str) -> bool:
    """Return whether a cell counts points rather than names one."""
    number = text.removesuffix(".0")
    return number.isascii() and number.isdigit()
