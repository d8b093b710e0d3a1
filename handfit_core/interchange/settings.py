"""Limits on other programs' files, and bounds by which hands are told in them."""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import Final

from handfit_core.common.errors import InputError
from handfit_core.common.files import shown


@dataclass(frozen=True)
class FileLimits:
    """The most that is read of other programs' files; every reader keeps to it."""

    file_bytes: int = 1 << 29
    """Bytes of one file"""
    text_bytes: int = 1 << 27
    """Bytes of one JSON text, table or .bvh"""
    parsed_bytes: int = 900_000_000
    """Bytes of memory that the content of one text may take, together with the text"""
    array_bytes: int = 1 << 28
    """Bytes of all arrays of one file, with 8 bytes for each float"""
    pickle_steps: int = 2_000_000
    """Instructions of a pickle, each of which may take a hundred bytes"""
    file_count: int = 1_000_000
    """Files of a folder"""
    frames: int = 100_000
    points: int = 4_200_000
    """Frames times hands times points of a recording: two whole hands in each frame"""
    depth: int = 64
    """Levels of JSON's lists and objects within one another"""
    entries: int = 200_000
    """Lists and objects in one list of JSON, and keys of one of its objects"""
    columns: int = 10_000
    """Columns of a table"""
    letters: int = 1000
    """Letters of a table's cell or of a JSON key"""
    digits: int = 400
    """Digits of a number in JSON or a table; floats have 309 before their point"""
    coordinate: float = 1e6
    """Pixels of a point's coordinate, in either direction"""
    away: float = 1000.0
    """Metres of a hand from the origin"""
    looked_at: int = 200
    """Files of a folder that are looked at before it is said whose format they are"""
    number_digits: int = 15
    """Digits of a frame's number"""
    hands: int = 1000
    """Hands of one list in JSON; those after them are not read"""
    bvh_bones: int = 2048
    relative: float = 3.0
    """The magnitude beyond which coordinates are no parts of the picture's size"""

    def check(self, path: str | os.PathLike[str], frames: int, hands: int = 1, points: int = 21) -> None:
        """Raise InputError for more frames, or more points of hands in frames, than are read. It is called
        before an array of them is made."""
        if frames > self.frames:
            raise InputError(
                f"{shown(path)}: it has {frames} frames, and at most {self.frames} are read; cut it into "
                "parts"
            )
        if frames * hands * points > self.points:
            raise InputError(
                f"{shown(path)}: it has {frames} frames with {hands} hands of {points} points, and at most "
                f"{self.points} points are read; cut it into parts"
            )


LIMITS: Final = FileLimits()
