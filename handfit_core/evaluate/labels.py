"""The content of a labelled data set, as every reader gives it: metres, camera frame, MediaPipe's order.

Readers list their entries at once and read labels one by one, when asked: some sets hold a hundred
thousand pictures. A label that the set does not have, or marks as invalid, is NaN, never a guess.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import groupby
from pathlib import Path

import numpy as np

from handfit_core.common.errors import HandfitError
from handfit_core.common.skeleton import Side
from handfit_core.geometry.camera import Intrinsics


@dataclass(frozen=True, eq=False)
class MeshLabel:
    """A hand's true surface, read when asked for."""

    vertices: Callable[[], np.ndarray]
    """Reads the surface's vertices: (V, 3) metres in the camera frame"""
    digests: frozenset[str] = frozenset()
    """`HandModel.digest` of every model that has these vertices in this order, as a hand's mirror image
    does; empty where unknown (a MANO of someone's)"""


@dataclass(frozen=True, eq=False)
class HandLabel:
    """The truth about one hand in one picture."""

    side: Side | None
    """The side of the hand; None where the set does not say"""
    joints_3d: np.ndarray
    """(21, 3) metres in the camera frame, MediaPipe's order; NaN where there is no label"""
    keypoints_2d: np.ndarray
    """(21, 2) pixels of the picture as stored; NaN where there is no label"""
    mesh: MeshLabel | None = None


@dataclass(frozen=True, eq=False)
class Labels:
    """The truth about one picture."""

    hands: tuple[HandLabel, ...]
    intrinsics: Intrinsics | None
    """The true camera, with lengths in pixels; None where the set does not give it"""


@dataclass(frozen=True, eq=False)
class Entry:
    """One picture of a data set."""

    name: str
    """The entry's name, unique within the set, as in `Desk/00012`"""
    picture: Path
    read_labels: Callable[[], Labels]
    """Reads the picture's labels; an error that it raises is a problem of this entry alone"""
    clip: str | None = None
    """The name of the clip that the picture belongs to; None for a still. Entries of a clip stand together,
    in the order of time"""
    time: float = 0.0
    """Seconds since the clip's start"""
    tags: Mapping[str, str] = field(default_factory=dict)
    """Properties of the picture by which results are grouped, as in {"pose": "fist", "occluder": "none"}"""


@dataclass(frozen=True, eq=False)
class Unit:
    """A still, or a clip's pictures in the order of time, which are fitted together."""

    entries: tuple[Entry, ...]
    is_clip: bool


def units_of(entries: Sequence[Entry], *, clips: bool = True, every: int = 1) -> list[Unit]:
    """Group entries into units and keep every n-th still and every n-th clip, stills and clips counted apart.

    With `clips=False` every picture is a still of its own, as in the paper, and every n-th is kept.
    """
    if not clips:
        return [Unit((entry,), is_clip=False) for entry in entries[::every]]
    stills = [Unit((entry,), is_clip=False) for entry in entries if entry.clip is None]
    of_clips = [entry for entry in entries if entry.clip is not None]
    tracks = [Unit(tuple(group), is_clip=True) for _, group in groupby(of_clips, key=lambda e: e.clip)]
    return stills[::every] + tracks[::every]


def said(error: Exception) -> str:
    """Return the text of an error in one line, for a `Problem`."""
    if isinstance(error, HandfitError):
        return str(error)
    if isinstance(error, OSError):
        return f"{error.filename or 'a file'} cannot be read ({error.strerror})"
    lines = str(error).splitlines() or [""]
    return f"damaged ({type(error).__name__}: {lines[0][:100]})"


@dataclass(frozen=True)
class Problem:
    """A fault of some entries, which are counted and reported, never silently dropped."""

    kind: str
    """The kind of fault in a few words, as in `picture missing`; problems of one kind are counted together"""
    where: str
    """The name of the file or entry that has the fault"""


@dataclass(frozen=True, eq=False)
class Dataset:
    """A labelled data set on disk."""

    name: str
    """The set's name for people, as in `FreiHAND (evaluation)`"""
    kind: str
    """The reader's name on the command line, as in `freihand`"""
    root: Path
    entries: Sequence[Entry]
    problems: tuple[Problem, ...] = ()
    """The problems found while listing: pictures without labels, labels without pictures, ..."""
    notes: tuple[str, ...] = ()
    """Sentences about the labels, for the report"""


@dataclass(frozen=True, eq=False)
class Reader:
    """One layout of data sets on disk, and what can be chosen about it."""

    layout: str
    """The layout's description for messages, as in `RHD's layout: training/color/00000.png ..., ...`"""
    recognises: Callable[[Path], bool]
    """True if a folder has any part of this layout, even if other parts are missing"""
    read: Callable[..., Dataset]
    """Lists everything in a folder, (root, **choices) -> Dataset, with labels that are read when asked for.
    Raises DatasetError, OptionError"""
    has_splits: bool = False
    """True if `read` takes `split`: a name, or None for the part that is evaluated by default"""
    has_label_variants: bool = False
    """True if `read` takes `labels` and `published_frame`, which `open_dataset` explains"""
