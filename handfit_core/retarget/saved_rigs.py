"""The user's rigs, which say once for all which bones are the hands of a studio's characters. Each is a
preset file in one folder, by its name, and is for every armature that has all bones it names."""

from __future__ import annotations

import functools
import os
import re
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from handfit_core.common.errors import HandModelError, OptionError, OutputError
from handfit_core.common.files import data_dir, shown, storable, why, written_whole
from handfit_core.common.skeleton import Side
from handfit_core.retarget.hand_map import HandMap, read_preset, to_preset

SUFFIX: Final = ".json"
_MOST: Final = 200
"""Most files of the folder that are read"""
_NAME: Final = re.compile(r"(?!(con|prn|aux|nul|com\d|lpt\d)(\.|$))\w([\w .()+-]{0,58}[\w)+-])?", re.I)
"""Names of files that every system allows"""


@dataclass(frozen=True)
class SavedRig:
    """A rig that the user has saved: its name and its tables."""

    name: str
    tables: tuple[HandMap, ...]
    """The tables of one hand or of both"""

    def of(self, side: Side) -> HandMap | None:
        """Return the table of the hand of that side; None where the rig has none."""
        return next((table for table in self.tables if table.side == side), None)

    @property
    def label(self) -> str:
        """The label that an artist reads in lists."""
        return f"{self.name}, your rig"

    @property
    def path(self) -> Path:
        """The path of the rig's file."""
        return rigs_folder() / f"{self.name}{SUFFIX}"

    @functools.cached_property
    def bones(self) -> frozenset[str]:
        """Names of all bones in the rig's tables."""
        return frozenset().union(*(table.named for table in self.tables))


def rigs_folder() -> Path:
    """Return the folder of the user's rigs."""
    return data_dir() / "rigs"


def rig_path(name: str) -> Path:
    """Return the path of a rig's file, by the rig's name. Raises OptionError for text that can be no name."""
    name = storable(name).strip()
    if not _NAME.fullmatch(name):
        raise OptionError(
            f"{shown(name)}: give the rig a name of at most 60 letters, digits, spaces, dots and dashes"
        )
    return SavedRig(name, ()).path


def saved_rigs() -> tuple[dict[str, SavedRig], tuple[str, ...]]:
    """Return the user's rigs by their names, in alphabetical order, and for every other file in the folder a
    sentence that says why it is none. Panels ask at every redraw: files are read again when one was added,
    changed or removed."""
    folder = rigs_folder()
    try:
        with os.scandir(folder) as entries:
            there = [e for e in entries if e.name.endswith(SUFFIX) and not e.name.startswith(".")]
            files = [(e.name, e.stat(follow_symlinks=False)) for e in there]
        return _read(folder, tuple(sorted((name, s.st_mtime_ns, s.st_size) for name, s in files)))
    except FileNotFoundError:
        return {}, ()
    except (OSError, ValueError) as error:
        return {}, (f"{shown(folder)}: your saved rigs cannot be read ({why(error)})",)


@functools.lru_cache(maxsize=1)
def _read(
    folder: Path, files: tuple[tuple[str, int, int], ...]
) -> tuple[dict[str, SavedRig], tuple[str, ...]]:
    """Read the rigs as `saved_rigs` returns them, from files of these names, times of change and sizes."""
    rigs, troubles = dict[str, SavedRig](), list[str]()
    if len(files) > _MOST:
        troubles.append(f"{shown(folder)}: only the first {_MOST} of {len(files)} saved rigs are read")
    for path in (folder / name for name, *_ in files[:_MOST]):
        try:
            rigs[path.stem] = SavedRig(path.stem, tuple(read_rig(path)))
        except HandModelError as error:
            troubles.append(f"this saved rig is left out, mend or remove it: {error}")
    return rigs, tuple(troubles)


def read_rig(path: Path) -> list[HandMap]:
    """Read the tables of a file, each of which names a hand. Raises HandModelError, which names the file."""
    tables = read_preset(path)
    for table in tables:
        try:
            table.check(table.named)
        except HandModelError as error:
            raise HandModelError(f"{shown(path)}: {error}") from error
    return tables


def fitting_rig(names: Collection[str], side: Side) -> SavedRig | None:
    """Find the saved rig for a hand of an armature whose bones have these names: of the rigs whose bones are
    all among them the one that names the most; None where no rig fits."""
    there = frozenset(names)
    fitting = [rig for rig in saved_rigs()[0].values() if rig.of(side) is not None and rig.bones <= there]
    return max(fitting, key=lambda rig: len(rig.bones), default=None)


def save_rig(name: str, tables: Sequence[HandMap]) -> Path:
    """Save a rig under a name, in place of an older one of that name, and return the path of its file. Raises
    OptionError, HandModelError and OutputError."""
    for table in tables:
        table.check(table.named)
    path = rig_path(name)
    write_rig(path, tables)
    _read.cache_clear()
    return path


def write_rig(path: Path, tables: Sequence[HandMap]) -> None:
    """Write a rig's file to any path. Raises OutputError."""
    with written_whole(path, read_preset) as beside:
        beside.write_text(to_preset(tables), encoding="utf-8")


def forget_rig(name: str) -> None:
    """Remove a saved rig's file. Raises OptionError and OutputError."""
    rig = saved_rigs()[0].get(name)
    if rig is None:
        raise OptionError(f"there is no saved rig {shown(name)}")
    try:
        rig.path.unlink()
    except OSError as error:
        raise OutputError(f"{shown(rig.path)}: this rig could not be removed ({why(error)})") from error
    _read.cache_clear()
