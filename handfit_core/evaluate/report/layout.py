"""A table before it becomes Markdown or HTML."""

from __future__ import annotations

from dataclasses import dataclass

MISSING = "–"
"""What stands where there is no number"""


@dataclass(frozen=True)
class Cell:
    """One cell's text, unescaped."""

    text: str
    is_best: bool = False
    """Shown bold"""
    is_number: bool = True
    """Aligned to the right"""
    is_code: bool = False
    """A name as on the command line"""
    remark: str = ""
    """Words behind it"""


@dataclass(frozen=True)
class Column:
    """One column's heading."""

    title: str
    note: int = 0
    """Number of its footnote, from 1; 0 for none"""
    is_number: bool = True


@dataclass(frozen=True)
class Table:
    """Headings, rows of as many cells, and footnotes."""

    columns: tuple[Column, ...]
    rows: tuple[tuple[Cell, ...], ...]
    notes: tuple[str, ...] = ()
    """Footnote 1, 2, ..."""
    names: tuple[tuple[str, str], ...] = ()
    """Names of methods and what they are, told below"""
    muted: frozenset[int] = frozenset()
    """Rows that are only there to compare with"""


def words(text: str) -> Cell:
    """A cell of words."""
    return Cell(text, is_number=False)


def name(text: str, remark: str = "") -> Cell:
    """A cell with a name as on the command line."""
    return Cell(text, is_number=False, is_code=True, remark=remark)


def markdown(table: Table) -> str:
    """The table in GitHub's Markdown, names and footnotes as lists below."""
    lines = [
        _line([_escaped(c.title) + (f" [{c.note}]" if c.note else "") for c in table.columns]),
        _line(["---:" if c.is_number else "---" for c in table.columns]),
        *(_line([_marked(cell) for cell in row]) for row in table.rows),
    ]
    if table.names:
        lines += ["", *(f"* `{who}`: {_escaped(what)}" for who, what in table.names)]
    if table.notes:
        lines += ["", *(f"{i}. {_escaped(note)}" for i, note in enumerate(table.notes, 1))]
    return "\n".join(lines) + "\n"


def _line(cells: list[str]) -> str:
    return "| " + " | ".join(cells) + " |"


def _marked(cell: Cell) -> str:
    text = f"`{cell.text.replace('|', '')}`" if cell.is_code and cell.text else _escaped(cell.text)
    text = f"**{text}**" if cell.is_best else text
    return f"{text} {_escaped(cell.remark)}" if cell.remark else text


def _escaped(text: str) -> str:
    """Names of files and tags may hold what Markdown takes for markup."""
    text = " ".join(text.split())
    for character in "\\|<*_`[":
        text = text.replace(character, "\\" + character)
    return text
