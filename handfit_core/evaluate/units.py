"""What is fitted in one go: a still, or a whole clip."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby

from handfit_core.evaluate.labels import Entry


@dataclass(frozen=True, eq=False)
class Unit:
    """A still, or a clip's pictures in the order of time."""

    entries: tuple[Entry, ...]
    is_clip: bool


def units_of(entries: Sequence[Entry], *, clips: bool = True, every: int = 1) -> list[Unit]:
    """Group entries into units and keep every n-th still and every n-th clip, each counted by itself.

    With `clips=False` every picture is a still of its own, as in the paper, and every n-th is kept.
    """
    if not clips:
        return [Unit((entry,), is_clip=False) for entry in entries[::every]]
    stills = [Unit((entry,), is_clip=False) for entry in entries if entry.clip is None]
    of_clips = [entry for entry in entries if entry.clip is not None]
    tracks = [Unit(tuple(group), is_clip=True) for _, group in groupby(of_clips, key=lambda e: e.clip)]
    return stills[::every] + tracks[::every]
