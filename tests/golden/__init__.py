"""What the program did when these files were written, to be compared with what it does now.

Each file is text. Words and whole numbers must be equal; numbers with a decimal point may differ by what
processors differ.

    python -m pytest tests/core/test_golden.py --write-golden

writes the files anew; with `tests/blender/test_golden.py`, it does so for the Blender that runs it.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

FOLDER = Path(__file__).parent
TAKE = FOLDER / "two_hands.take.npz"
"""Written on 2026-11-24: every later version reads it"""

_NUMBER = re.compile(r"-?\d+\.\d+")


class Golden:
    """The golden files of one run of tests."""

    def __init__(self, *, write: bool) -> None:
        self._write = write

    def check(self, name: str, text: str, steps: int = 0) -> None:
        """Compare a text with the file of that name, or write it. Fails with the first line in which a number
        with a decimal point differs by more than so many steps of its last digit."""
        path = FOLDER / name
        if self._write:
            path.write_text(text, encoding="utf-8", newline="\n")
            return
        lines, known = text.splitlines(), path.read_text(encoding="utf-8").splitlines()
        for number, (line, expected) in enumerate(zip(lines, known, strict=False), start=1):
            same_words = _NUMBER.sub("#", line) == _NUMBER.sub("#", expected)
            differs = f"{name}, line {number}:\n  expected {expected}\n  but got  {line}"
            assert same_words, differs
            assert _steps(line, expected) <= steps, differs
        assert len(lines) == len(known), f"{name} has {len(known)} lines, and now there are {len(lines)}"


def _steps(line: str, expected: str) -> int:
    """The most by which numbers of two lines differ, in steps of the last digit of each."""
    pairs = zip(_NUMBER.findall(line), _NUMBER.findall(expected), strict=True)
    return max((abs(int(a.replace(".", "")) - int(b.replace(".", ""))) for a, b in pairs), default=0)


def numbers(values: np.ndarray, digits: int) -> str:
    """An array's numbers in one line, rounded; nothing is written as -0."""
    rounded = np.round(np.asarray(values, dtype=float).ravel(), digits) + 0.0
    return " ".join(f"{value:.{digits}f}" for value in rounded)
