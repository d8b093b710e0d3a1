"""The table of what a zip holds and what each part costs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

HEADINGS = ("part", "version", "licence", "Python", "in the zip", "unpacked")
_NUMBERS = (4, 5)


@dataclass(frozen=True)
class Part:
    """One wheel, or the add-on itself (its `file` is then None). Sizes in bytes: `size` in the zip,
    `unpacked_size` on the user's disk."""

    name: str
    version: str
    file: str | None
    size: int
    unpacked_size: int
    licence: str
    pythons: tuple[str, ...]


def table(parts: Sequence[Part], zip_size: int, markdown: bool = False) -> str:
    """One line a part, and the total, whose size is that of the zip (bytes); as plain text or Markdown."""
    rows = [
        (p.name, p.version, p.licence, " ".join(p.pythons), megabytes(p.size), megabytes(p.unpacked_size))
        for p in parts
    ]
    unpacked = sum(p.unpacked_size for p in parts)
    rows.append(("total", "", "", "", megabytes(zip_size), megabytes(unpacked)))
    if markdown:
        rule = ("---",) * len(_NUMBERS) * 2 + ("---:",) * len(_NUMBERS)
        return "\n".join(f"| {' | '.join(row)} |" for row in (HEADINGS, rule, *rows))
    widths = [max(len(row[i]) for row in (HEADINGS, *rows)) for i in range(len(HEADINGS))]
    return "\n".join(
        "  ".join(
            cell.rjust(width) if i in _NUMBERS else cell.ljust(width)
            for i, (cell, width) in enumerate(zip(row, widths, strict=True))
        ).rstrip()
        for row in (HEADINGS, *rows)
    )


def megabytes(size: int) -> str:
    """Bytes as millions of them, such as "191.8 MB"."""
    return f"{size / 1e6:.1f} MB"
