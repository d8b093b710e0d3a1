"""Writers of other programs' files, found by name or by a file's ending.

Those of other packages are found by their entry points of the group `handfit.writers` (see `registry`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from handfit_core.common.errors import OptionError
from handfit_core.common.files import shown
from handfit_core.common.registry import Registry
from handfit_core.take import Take


@dataclass(frozen=True)
class Writer:
    """One format that takes are written in."""

    title: str
    """The format's own name, for people"""
    endings: tuple[str, ...]
    """Endings of the format's file names, the usual one first, as in (".smplx.npz",)"""
    write: Callable[[Take, Path], None]
    """Writes a take into a file that need not exist yet, and is moved to its place afterwards. Raises
    OutputError, and OptionError for a take that the format cannot hold"""
    write_wrist: Callable[[Take, Path], None] | None = None
    """Writes the file with how hands turn to their forearms, as far as that can be said; None for a format
    without this choice"""


_HERE: Final = "handfit_core.interchange.formats"
WRITERS: Final = Registry(
    "handfit.writers",
    "format",
    Writer,
    {
        "take": f"{_HERE}.written:TAKE",
        "points": f"{_HERE}.written:POINTS",
        "vrma": f"{_HERE}.vrma:WRITER",
        "bvh": f"{_HERE}.bvh:WRITER",
        "points-table": f"{_HERE}.written:POINTS_TABLE",
        "mediapipe": f"{_HERE}.written:MEDIAPIPE",
        "smplx": f"{_HERE}.written:SMPLX",
        "smplx-keywords": f"{_HERE}.written:SMPLX_KEYWORDS",
    },
)
"""The writers by their names on the command line"""


def writer_for(path: Path, name: str | None = None) -> Writer:
    """Return the writer of that name, or the one whose ending the path has: the longest that fits. Raises
    OptionError."""
    if name is not None:
        return WRITERS.get(name)
    fits = [
        (len(ending), writer)
        for writer in WRITERS.all().values()
        for ending in writer.endings
        if path.name.lower().endswith(ending)
    ]
    if not fits:
        known = ", ".join(ending for writer in WRITERS.all().values() for ending in writer.endings)
        raise OptionError(
            f"{shown(path)}: no format is known by this ending; end the name with one of {known}, or name "
            "the format with --to"
        )
    return max(fits, key=lambda fit: fit[0])[1]
