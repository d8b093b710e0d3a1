"""Dataclasses of arrays that have a row for each of a batch's hands or frames."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import Any, Final, Self

import numpy as np

SLICE: Final = 512
"""How many rows of a long batch are computed at once where rows are independent, which bounds the memory"""

Index = np.ndarray | slice
"""Rows of a batch: their numbers, booleans or a slice"""


class Batch:
    """A frozen dataclass of arrays (B, ...), of other batches, and of what belongs to all rows alike."""

    __dataclass_fields__: dict[str, Any]

    def __len__(self) -> int:
        values = (getattr(self, name) for name in self.__dataclass_fields__)
        return len(next(value for value in values if isinstance(value, np.ndarray | Batch)))

    def _rows(self) -> list[tuple[str, Any]]:
        """Return name and value of the fields that have a row for each hand or frame."""
        values = ((name, getattr(self, name)) for name in self.__dataclass_fields__)
        return [(name, value) for name, value in values if isinstance(value, np.ndarray | Batch)]

    def _with(self, **rows: Any) -> Self:
        # dataclasses.replace takes as long as the arithmetic of a small batch.
        fields = {name: getattr(self, name) for name in self.__dataclass_fields__}
        return type(self)(**fields | rows)

    def select(self, index: Index) -> Self:
        """Return the rows at `index` as a new batch."""
        return self._with(
            **{
                name: value.select(index) if isinstance(value, Batch) else value[index]
                for name, value in self._rows()
            }
        )

    def where(self, chosen: np.ndarray, other: Self) -> Self:
        """Return this batch's rows where `chosen`, (B,) bool, is true, else the rows of `other`, which has
        the same fields."""

        def pick(mine: Any, theirs: Any) -> Any:
            if isinstance(mine, Batch):
                return mine.where(chosen, theirs)
            return np.where(chosen.reshape(-1, *[1] * (mine.ndim - 1)), mine, theirs)

        return self._with(**{name: pick(value, getattr(other, name)) for name, value in self._rows()})

    def replaced(self, index: np.ndarray, rows: Self) -> Self:
        """Return a copy in which the rows numbered by `index` are replaced by `rows`."""
        whole = self._empty(len(self))
        whole.overwrite(slice(None), self)
        whole.overwrite(index, rows)
        return whole

    def overwrite(self, index: Index, rows: Self) -> None:
        """Replace the rows at `index` with `rows`, in place."""
        for name, value in self._rows():
            if isinstance(value, Batch):
                value.overwrite(index, getattr(rows, name))
            else:
                value[index] = getattr(rows, name)

    @classmethod
    def collect(cls, count: int, parts: Iterable[Self]) -> Self:
        """Concatenate an iterable of parts that have `count` rows together, or fewer where it ends early.

        Each part is released once its rows are copied, so that a long batch is in memory only once.
        """
        whole, first = None, 0
        for part in parts:
            if whole is None:
                whole = part._empty(count)
            last = first + len(part)
            whole.overwrite(slice(first, last), part)
            first = last
        assert whole is not None
        return whole if first == count else whole.select(slice(first))

    def _empty(self, count: int) -> Self:
        """Return a copy with `count` uninitialised rows."""
        return self._with(
            **{
                name: value._empty(count)
                if isinstance(value, Batch)
                else np.empty((count, *value.shape[1:]), value.dtype)
                for name, value in self._rows()
            }
        )

    @classmethod
    def concatenate(cls, parts: Sequence[Self]) -> Self:
        """Join the rows of all parts, one after the other; fields that belong to all rows are the first
        part's."""

        def join(name: str, first: Any) -> Any:
            rows = [getattr(part, name) for part in parts]
            return first.concatenate(rows) if isinstance(first, Batch) else np.concatenate(rows)

        return parts[0]._with(**{name: join(name, value) for name, value in parts[0]._rows()})


def slices(count: int, most: int = SLICE) -> Iterator[slice]:
    """Yield slices of at most `most` rows each that cover `count` rows; one empty slice where there are
    none."""
    return (slice(first, first + most) for first in range(0, max(count, 1), most))


def scatter(rows: Any, at: Any, count: int, nothing: Any = np.nan) -> np.ndarray:
    """Return an array (count, ...) that has `rows` at the indices `at` along its first axis, and `nothing`
    elsewhere."""
    whole = np.full((count, *np.shape(rows)[1:]), nothing)
    whole[at] = rows
    return whole
