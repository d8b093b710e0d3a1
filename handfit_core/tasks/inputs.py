"""From what the user names to inputs: folders, patterns and sequences taken apart, each with a name."""

from __future__ import annotations

import glob
import logging
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from handfit_core.interchange.opening import is_recording
from handfit_core.media.opening import (
    PHOTO_SUFFIXES,
    VIDEO_SUFFIXES,
    is_pattern,
    pictures_and_others,
    to_read,
)
from handfit_core.take import is_take
from handfit_core.take.sheet import SUFFIX
from handfit_core.tasks.record import Record

log = logging.getLogger("handfit")

PREVIEW_SUFFIX: Final = ".preview.png"
_OURS: Final = (SUFFIX, PREVIEW_SUFFIX, ".export.json")
"""The endings of results' names that may lie among the inputs, and are none"""
PAIRS: Final = "*_b"
"""The input that stands for a batch in which NAME_a and NAME_b are two views of one capture"""
_VIEW_NAME: Final = re.compile(r"(.+)_([a-z])", re.IGNORECASE)


@dataclass(frozen=True)
class Input:
    """One thing to capture, or a take to use, and the name that its results would like to have."""

    shown: str
    name: str
    source: tuple[str, ...] = ()
    view: str = ""
    """The clip of a second camera that filmed the same hands; empty where there is none"""
    take: Path | None = None
    error: str = ""
    """The reason why it cannot even be tried; else empty"""


def expand(text: str, grouping: str | None = None) -> list[Input]:
    """Return the inputs that one INPUT of the command line names.

    A folder or a glob pattern gives one per video, and one for the numbered pictures that a capture of it
    reads, or one per photo where there are none (`grouping` forces either: "sequence" or "separate"). Contact
    sheets and previews that a batch has put there are left out.
    """
    path = Path(text).expanduser()
    if path.is_dir():
        pictures, others = pictures_and_others(path)
        pictures, others = ([p for p in files if not p.name.endswith(_OURS)] for files in (pictures, others))
        videos = sorted(p for p in others if p.suffix.lower() in VIDEO_SUFFIXES)
        left = [p for p in others if p.suffix.lower() not in VIDEO_SUFFIXES] if pictures or videos else []
        jobs = _group(pictures, grouping, path, left) + [_one_file(v) for v in videos]
        if not jobs and is_recording(path):
            return [Input(text, path.resolve().name, (str(path),))]
        return jobs or [Input(text, path.resolve().name, error=f"{text}: no photos or videos in this folder")]
    if path.exists() or not is_pattern(text):
        return [_one_file(path)]
    if not any(c in path.name for c in "*?["):  # name.%04d.png and name.####.png are sequences by intent
        name = path.name.partition("%")[0].partition("#")[0].rstrip("._- ") or path.absolute().parent.name
        return [Input(text, name, (str(path),))]
    pattern = str(Path(glob.escape(str(path.parent))) / path.name)
    found = sorted(p for p in map(Path, glob.glob(pattern)) if p.is_file() and not p.name.endswith(_OURS))
    found = [p for p in found if p.suffix.lower() != ".json" or Record.read(p) is None]
    pictures = [p for p in found if p.suffix.lower() in PHOTO_SUFFIXES]
    others = [_one_file(p) for p in found if p.suffix.lower() not in PHOTO_SUFFIXES]
    jobs = _group(pictures, grouping, path.absolute().parent) + others
    return jobs or [Input(text, "pattern", error=f"{text}: no file matches this pattern")]


def _one_file(path: Path) -> Input:
    if path.suffix.lower() == ".npz" and (is_take(path) or not path.exists()):
        return Input(str(path), path.stem.removesuffix(".take"), take=path)
    return Input(str(path), path.stem, (str(path),))


def _group(
    pictures: list[Path], grouping: str | None, folder: Path, others: Sequence[Path] = ()
) -> list[Input]:
    chosen, numbers, said = to_read(folder, [] if grouping else pictures, others)
    pictures = chosen or pictures
    if said:
        log.warning("%s", said)
    if len(pictures) > 1 and (numbers or grouping == "sequence"):
        shown = f"{pictures[0]} ... {pictures[-1].name} ({len(pictures)} pictures)"
        return [Input(shown, folder.resolve().name, tuple(map(str, pictures)))]
    return [_one_file(p) for p in pictures]


def paired(inputs: Iterable[Input]) -> list[Input]:
    """Return the inputs, with clips NAME_a and NAME_b that lie side by side made one input, NAME, of two
    views. One of them may be named for both; what has no other view stays as it is."""
    found: dict[object, Input] = {}
    for each in inputs:
        path = Path(each.source[0]) if len(each.source) == 1 else Path(each.shown)
        match = _VIEW_NAME.fullmatch(path.stem)
        views = _views(path, match[1]) if match and path.suffix.lower() in VIDEO_SUFFIXES else []
        if match is None or len(views) < 2:
            found[len(found)] = each
            continue
        shown, error = " + ".join([str(views[0]), *(view.name for view in views[1:])]), ""
        if [view.stem[-1].lower() for view in views] != ["a", "b"]:
            error = f"{shown}: a capture has two views, {match[1]}_a and {match[1]}_b: leave others out"
        found[views[0]] = Input(shown, match[1], (str(views[0]),), str(views[1]), error=error)
    return list(found.values())


def _views(clip: Path, name: str) -> list[Path]:
    """Return the clips NAME_a, NAME_b, ... in the folder of one of them, in this order."""
    named = re.compile(re.escape(name) + "_[a-z]", re.IGNORECASE)
    there = clip.parent.iterdir() if clip.parent.is_dir() else ()
    found = (path for path in there if path.suffix.lower() in VIDEO_SUFFIXES)
    return sorted((path for path in found if named.fullmatch(path.stem)), key=lambda path: path.stem.lower())
