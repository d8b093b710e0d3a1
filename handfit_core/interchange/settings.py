"""What other programs' files may hold, and how surely hands are told in them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final


@dataclass(frozen=True)
class FileLimits:
    """The most that is read of other programs' files, or looked at."""

    file_bytes: int = 1 << 29
    """of one file"""
    text_bytes: int = 1 << 27
    """bytes of one JSON text or table"""
    parsed_bytes: int = 900_000_000
    """bytes of memory that what is in one may take, together with the text"""
    file_count: int = 1_000_000
    """of a folder"""
    memory_bytes: int = 1 << 28
    """bytes of the arrays of a small file"""
    packed: int = 50
    """times the size of a larger file that its arrays may have"""
    columns: int = 10_000
    """of a table"""
    pickle_steps: int = 2_000_000
    """instructions of a pickle, each of which may take a hundred bytes"""
    frames: int = 100_000
    """of a file whose frames may be next to empty, and take a kilobyte each; of full ones a JSON holds
    fewer"""
    looked_at: int = 200
    """Files of a folder that are looked at before it is said of what they are"""
    number_digits: int = 15
    hands: int = 1000
    """of one file"""
    bvh_bytes: int = 1 << 27
    """bytes of a .bvh"""
    bvh_bones: int = 2048
    bvh_turns: int = 1 << 23
    """bones of a .bvh times frames"""
    relative: float = 3.0
    """Beyond it, coordinates are no parts of the picture's size"""


LIMITS: Final = FileLimits()
