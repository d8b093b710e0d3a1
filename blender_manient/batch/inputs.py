"""From what the user names to jobs: folders, patterns and sequences taken apart, each with a name."""

from __future__ import annotations

import glob
from dataclasses import dataclass, replace
from pathlib import Path

from handfit_core.media.opening import (
    PHOTO_SUFFIXES,
    VIDEO_SUFFIXES,
    is_pattern,
    pictures_in,
    sequence_numbers,
)


@dataclass(frozen=True)
class Job:
    """One input: what to capture (or the take to use), and the name of its results."""

    shown: str
    name: str
    source: tuple[str, ...] = ()
    take: Path | None = None
    error: str = ""
    """Why it cannot even be tried"""


def expand(text: str, grouping: str | None = None) -> list[Job]:
    """The jobs of one INPUT.

    A folder or a glob pattern gives one job per video, and one per photo, unless the photos
    form one numbered sequence (`grouping` forces either: "sequence" or "separate").
    """
    path = Path(text).expanduser()
    if path.is_dir():
        videos = sorted(p for p in path.iterdir() if p.suffix.lower() in VIDEO_SUFFIXES and p.name[0] != ".")
        jobs = _group(pictures_in(path), grouping, path.resolve().name) + [_file_job(v) for v in videos]
        return jobs or [Job(text, path.resolve().name, error=f"{text}: no photos or videos in this folder")]
    if path.exists() or not is_pattern(text):
        return [_file_job(path)]
    if not any(c in path.name for c in "*?["):  # name.%04d.png and name.####.png are sequences by intent
        name = path.name.partition("%")[0].partition("#")[0].rstrip("._- ") or path.absolute().parent.name
        return [Job(text, name, (str(path),))]
    pattern = str(Path(glob.escape(str(path.parent))) / path.name)
    found = sorted(p for p in map(Path, glob.glob(pattern)) if p.is_file())
    pictures = [p for p in found if p.suffix.lower() in PHOTO_SUFFIXES]
    others = [_file_job(p) for p in found if p not in pictures]
    jobs = _group(pictures, grouping, path.absolute().parent.name) + others
    return jobs or [Job(text, "pattern", error=f"{text}: no file matches this pattern")]


def with_free_names(jobs: list[Job], output: Path, overwrite: bool) -> list[Job]:
    """Give every job a result folder of its own: a name that is taken gets -2, -3, ...

    Names are compared without case, since some file systems do.
    """
    taken: set[str] = set()
    if not overwrite and output.is_dir():
        taken = {p.name.lower() for p in output.iterdir() if p.is_dir() and any(p.iterdir())}
    named = []
    for job in jobs:
        name, number = job.name, 1
        while name.lower() in taken:
            number += 1
            name = f"{job.name}-{number}"
        taken.add(name.lower())
        named.append(replace(job, name=name))
    return named


def _file_job(path: Path) -> Job:
    if path.suffix.lower() == ".npz":
        return Job(str(path), path.stem.removesuffix(".take"), take=path)
    return Job(str(path), path.stem, (str(path),))


def _group(pictures: list[Path], grouping: str | None, name: str) -> list[Job]:
    is_sequence = grouping == "sequence" or (grouping is None and sequence_numbers(pictures) is not None)
    if len(pictures) > 1 and is_sequence:
        shown = f"{pictures[0]} ... {pictures[-1].name} ({len(pictures)} pictures)"
        return [Job(shown, name, tuple(map(str, pictures)))]
    return [_file_job(p) for p in pictures]
