"""Files that the add-on can make again, in its own folder and the core's of copies: where they lie, how large
they are, clearing them."""

from __future__ import annotations

import contextlib
import itertools
import os
import shutil
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import bpy

from handfit_core.common.errors import OutputError
from handfit_core.common.files import cache_dir
from handfit_core.media.copies import copies_folder

from ..common import preferences

_NEEDED = 20_000_000
"""Bytes that must be free on the disk for a take"""
_TAKES = "takes-"
"""The beginning of the names of the folders with the takes of one Blender each"""
_ABANDONED = 24 * 3600.0
"""Seconds without a change after which a folder of takes belongs to a Blender that has crashed"""
_STALE = 10.0
"""Seconds for which a measured size is shown without measuring again"""

_takes_folder: Path | None = None
_numbers = itertools.count(1)
_measured, _measured_at = 0, -_STALE


def folder_path() -> Path:
    """Return the path of the cache folder, whether or not it exists.

    It is a folder of our own in the one that the preferences name; else in the user's folder of the
    extension; else, where the add-on is no extension, in handfit_core's cache folder."""
    chosen = preferences.full_path(preferences.get().cache_folder)
    if chosen:
        return Path(chosen) / "manient"  # never the chosen folder itself: it may hold anything
    if preferences.ADDON.startswith("bl_ext."):
        return Path(bpy.utils.extension_path_user(preferences.ADDON, path="cache"))
    return cache_dir() / "manient"


def cache_folder() -> Path:
    """Return the cache folder, made if need be. Raises OutputError."""
    path = folder_path()
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise _unusable(path, error) from error
    return path


def temporary_take(name: str = "hands", needed: int = _NEEDED) -> Path:
    """Return a path for the take of one capture, in a folder that goes when Blender ends.

    `needed`: bytes that must be free there. Raises OutputError when the disk is full or cannot be written."""
    global _takes_folder
    folder = cache_folder()
    try:
        if _takes_folder is None or _takes_folder.parent != folder or not _takes_folder.is_dir():
            _remove_abandoned(folder)
            _takes_folder = Path(tempfile.mkdtemp(prefix=_TAKES, dir=folder))
        free = shutil.disk_usage(folder).free
    except OSError as error:
        raise _unusable(folder, error) from error
    if free < needed:
        raise OutputError(
            f"the disk of {folder} is full ({free / 1e6:.0f} MB free, {needed / 1e6:.0f} MB needed); free "
            "some, or choose another cache folder in the add-on's preferences"
        )
    stem = bpy.path.clean_name(name)[:60] or "hands"
    return _takes_folder / f"{stem}-{next(_numbers)}.take.npz"


def remove_temporary_takes() -> None:
    """Remove the temporary takes of this Blender."""
    global _takes_folder
    if _takes_folder is not None:
        shutil.rmtree(_takes_folder, ignore_errors=True)
    _takes_folder = None


def clear() -> tuple[int, int]:
    """Remove everything from the cache folder but pictures that the open file shows; return (bytes freed,
    files left)."""
    global _measured_at
    shown = (*bpy.data.images, *bpy.data.movieclips)
    kept = {Path(bpy.path.abspath(each.filepath)) for each in shown if each.filepath}
    freed = left = 0
    for path in _files():
        try:
            if path in kept:
                left += 1
                continue
            size = path.stat().st_size
            path.unlink()
            freed += size
        except OSError:  # open elsewhere, on Windows
            left += 1
    for folder in _folders():
        for parent, _, _ in os.walk(folder, topdown=False):
            with contextlib.suppress(OSError):  # not empty
                Path(parent).rmdir()
    _measured_at = -_STALE
    return freed, left


def shown_size() -> int:
    """Return the size of all files of the cache in bytes, measured anew every few seconds; for drawing: they
    are few."""
    global _measured, _measured_at
    if time.monotonic() - _measured_at > _STALE:
        _measured, _measured_at = 0, time.monotonic()
        for path in _files():
            with contextlib.suppress(OSError):
                _measured += path.stat().st_size
    return _measured


def _folders() -> tuple[Path, Path]:
    return folder_path(), copies_folder()


def _files() -> Iterator[Path]:
    for folder in _folders():
        yield from (Path(parent, name) for parent, _, names in os.walk(folder) for name in names)


def _remove_abandoned(folder: Path) -> None:
    for path in folder.glob(f"{_TAKES}*"):
        with contextlib.suppress(OSError):
            if time.time() - path.stat().st_mtime > _ABANDONED:
                shutil.rmtree(path, ignore_errors=True)


def _unusable(path: Path, error: OSError) -> OutputError:
    return OutputError(
        f"{path}: cannot write here ({error.strerror or error}); choose another cache folder in the add-on's "
        "preferences"
    )


def unregister() -> None:
    """Remove this Blender's takes, and the cache folder if nothing else is in it."""
    remove_temporary_takes()
    with contextlib.suppress(OSError):
        folder_path().rmdir()
