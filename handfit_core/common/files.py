"""Files of the user: written whole or not at all, read with a limit, named in messages; and the cache."""

from __future__ import annotations

import contextlib
import errno
import os
import platform
import re
import stat
import sys
import tempfile
from bisect import bisect_right
from collections.abc import Callable, Iterable, Iterator, Sequence
from io import FileIO
from itertools import accumulate
from pathlib import Path
from typing import BinaryIO

from handfit_core.common.errors import HandfitError, OutputError

PART = ".part-"
"""What names of files and folders begin with that are not whole yet. Whoever made such a folder has taken it
away where it is gone, or its disk was: nothing may be written where it was"""


def part_of(process: int | str) -> str:
    """Return how the names of files begin that a process of this machine has not finished."""
    return f"{PART}{platform.node()[:40]}-{process}-"


_ADDRESS = re.compile(r"[A-Za-z][A-Za-z0-9+.-]+:[/\\]")
"""How an address such as https://... begins; a drive of Windows has one letter, so that C:/ is none"""


def output_path(path: str | os.PathLike[str], inputs: Iterable[str | os.PathLike[str]] = ()) -> Path:
    """Return the full path of a result that the user names so: ~ is the user's folder.

    Raises OutputError for an address, for what is no file (a device would be gone), for one of the `inputs`,
    and for names that no file can have.
    """
    path = path_of(path)
    if _ADDRESS.match(str(path)):
        raise OutputError(
            f"{shown(path)}: this is an address, and results are files; name one of this machine"
        )
    try:
        there = path.stat()
    except FileNotFoundError:
        return path
    except (OSError, ValueError) as error:
        raise OutputError(_cannot_write(path, error)) from error
    if stat.S_ISDIR(there.st_mode):
        raise OutputError(f"{shown(path)}: this is a folder; give the name of a file in it")
    if not stat.S_ISREG(there.st_mode):
        raise OutputError(f"{shown(path)}: this is a pipe, a device or the like; give the name of a file")
    for each in inputs:
        with contextlib.suppress(OSError, ValueError):
            if os.path.samestat(path_of(each).stat(), there):
                raise OutputError(f"{shown(path)}: this is an input, which stays; choose another name")
    return path


def check_writable(path: str | os.PathLike[str], inputs: Iterable[str | os.PathLike[str]] = ()) -> None:
    """Raise OutputError if `written_whole(path)` could not work, or would replace one of the `inputs`; leaves
    nothing behind."""
    path = output_path(path, inputs)
    folder = path.absolute().parent
    while not folder.exists():
        folder = folder.parent
    try:
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise OutputError(_cannot_write(path, error)) from error


@contextlib.contextmanager
def opened_file(path: str | os.PathLike[str], most: int) -> Iterator[BinaryIO]:
    """Open a file of at most `most` bytes for reading.

    Raises OSError, with a reason in words, also for larger ones and for what is no file: a pipe would be
    waited for, and a device has no end. Raises ValueError for names that no file can have.
    """
    # Looked at before it is opened, as opening a device can do something, and again after, as another may
    # have come in its place.
    _checked_size(Path(path).stat(), most)
    flags = os.O_RDONLY | getattr(os, "O_BINARY", 0) | getattr(os, "O_NONBLOCK", 0)
    with open(path, "rb", opener=lambda name, _flags: os.open(name, flags)) as stream:
        _checked_size(os.fstat(stream.fileno()), most)
        yield stream


def read_file(path: str | os.PathLike[str], most: int) -> bytes:
    """Return the bytes of a file of at most `most` bytes. Raises what `opened_file` raises."""
    with opened_file(path, most) as stream:
        return stream.read(os.fstat(stream.fileno()).st_size)  # no more of a file that grows


def _checked_size(found: os.stat_result, most: int) -> None:
    if stat.S_ISDIR(found.st_mode):
        raise IsADirectoryError(errno.EISDIR, "it is a folder")
    if not stat.S_ISREG(found.st_mode):
        raise OSError(errno.EINVAL, "it is no file, but a pipe, a device or the like")
    if found.st_size > most:
        size, largest = found.st_size // 1_000_000, most // 1_000_000
        raise OSError(errno.EFBIG, f"it is too large: {size} MB, and at most {largest} MB are read")


_SAMPLES = 16
_SAMPLE = 1 << 16
"""Bytes that are read at each sampled place of a file, as it takes minutes to read all of a long video"""


def samples(files: Sequence[Path], sizes: Sequence[int]) -> Iterator[bytes]:
    """Yield the bytes at some places of files of these sizes in bytes, which are taken as lying one behind
    the other. Raises OSError."""
    ends = list(accumulate(sizes))
    for i in range(_SAMPLES if ends else 0):
        at = i * max(ends[-1] - _SAMPLE, 0) // (_SAMPLES - 1)
        index = min(bisect_right(ends, at), len(files) - 1)
        with files[index].open("rb") as stream:
            stream.seek(at - ends[index] + sizes[index])
            yield stream.read(_SAMPLE)


_NO_NAME = (errno.ENAMETOOLONG, errno.EINVAL, errno.EILSEQ)


def _cannot_write(path: Path, error: OSError | ValueError) -> str:
    if isinstance(error, ValueError) or error.errno in _NO_NAME:
        return f"{shown(path)}: cannot write to a file of this name ({why(error)}); choose another name"
    return f"{shown(path)}: cannot write here ({why(error)}); choose a folder that you may write to"


def shown(path: str | os.PathLike[str]) -> str:
    """Return a path as messages show it: quoted where it could not be seen otherwise, and of bounded
    length."""
    text = os.fspath(path)
    text = text if len(text) <= _LONGEST_SHOWN else f"{text[:_LONGEST_SHOWN]}..."
    return text if text.isprintable() and text == text.strip() and text else repr(text)


_LONGEST_SHOWN = 300


def printable(text: str) -> str:
    """Return a text that a terminal can show: control characters, which it would obey, are escaped."""
    return "".join(sign if sign.isprintable() else repr(sign)[1:-1] for sign in text)


def storable(text: str) -> str:
    """Return a text that UTF-8 can hold: a question mark stands for all else, such as in the names of some
    files on Linux."""
    return text.encode("utf-8", "replace").decode("utf-8")


def is_file(path: str | os.PathLike[str]) -> bool:
    """Return whether the path is a regular file that exists; also False for names that no file can have."""
    try:
        return Path(path).is_file()
    except (OSError, ValueError):
        return False


def is_folder(path: str | os.PathLike[str]) -> bool:
    """Return whether the path is a folder that exists; also False for names that no folder can have."""
    try:
        return Path(path).is_dir()
    except (OSError, ValueError):
        return False


def why(error: OSError | ValueError) -> str:
    """Return the system's own words for what is wrong with a path."""
    if isinstance(error, OSError):
        return error.strerror or str(error)
    return "it holds a character that no name can" if isinstance(error, UnicodeError) else str(error)


@contextlib.contextmanager
def written_whole(
    path: str | os.PathLike[str], read: Callable[[Path], object] | None = None
) -> Iterator[Path]:
    """Yield a path beside `path` to write to; rename it over `path` once the block succeeds.

    Makes the folder if need be, but none of `PART`. A crash, a full disk or an error leaves whatever stood
    at `path` before; the new file is on the disk before it takes the old one's place. So does a file that
    `read`, which opens it as whoever needs it will, refuses with a HandfitError. Raises OutputError with the
    remedy when the folder cannot be written, and what `output_path` raises.
    """
    path = output_path(path)
    try:
        if not path.parent.name.startswith(PART):
            path.parent.mkdir(parents=True, exist_ok=True)
        # The suffix stays last: some exporters append it themselves when they miss it.
        handle, name = tempfile.mkstemp(dir=path.parent, prefix=part_of(os.getpid()), suffix=path.suffix)
        os.close(handle)
    except (OSError, ValueError) as error:
        raise OutputError(_cannot_write(path, error)) from error
    beside = Path(name)
    try:
        yield beside
        if read is not None:
            _check_readable(path, beside, read)
        flush(beside)
        # mkstemp makes files that only their owner may read; results are ordinary files.
        mask = os.umask(0)
        os.umask(mask)
        beside.chmod(0o666 & ~mask)
        beside.replace(path)
    except OSError as error:
        if error.errno in _NO_NAME:
            raise OutputError(_cannot_write(path, error)) from error
        remedy = "; free some space or choose another folder" if error.errno in _NO_ROOM else ""
        raise OutputError(f"{shown(path)}: could not be written ({why(error)}){remedy}") from error
    finally:
        with contextlib.suppress(OSError):
            beside.unlink(missing_ok=True)


def _check_readable(path: Path, beside: Path, read: Callable[[Path], object]) -> None:
    try:
        read(beside)
    except HandfitError as error:
        reason = str(error).removeprefix(f"{beside}: ")
        raise OutputError(
            f"{shown(path)}: nothing was written, as nobody could read it again ({reason})"
        ) from error


_NO_ROOM = {errno.ENOSPC, errno.EFBIG, getattr(errno, "EDQUOT", errno.ENOSPC)}


def flush(path: Path) -> None:
    """Have the system write a file out: network disks and quotas report only then what did not fit. Raises
    OSError."""
    with path.open("rb+") as stream:
        try:
            os.fsync(stream.fileno())
        except OSError as error:
            if error.errno not in (errno.EINVAL, errno.ENOTSUP):  # a file system without it
                raise


def check_room(path: Path, size: int) -> None:
    """Raise OSError unless `size` bytes fit into the file now, which is empty afterwards.

    The room is really taken for a moment, so that quotas and limits of a process count too; nothing holds
    it afterwards.
    """
    with path.open("wb", buffering=0) as stream:
        try:
            _take_room(stream, size)
        finally:
            stream.truncate(0)


def _take_room(stream: FileIO, size: int) -> None:
    if hasattr(os, "posix_fallocate"):
        try:
            return os.posix_fallocate(stream.fileno(), 0, size)
        except OSError as error:
            if error.errno in _NO_ROOM:
                raise  # other errors: this file system cannot do it
    block = bytes(1 << 20)
    while (left := size - stream.tell()) > 0:
        stream.write(block[:left])


def path_of(name: str | os.PathLike[str]) -> Path:
    """Return the path of that name, with ~ as the user's folder; ~nobody, where there is no such user, is a
    name like others."""
    try:
        return Path(name).expanduser()
    except RuntimeError:
        return Path(name)


def cache_dir() -> Path:
    """Return the folder of files that are kept between runs: `$HANDFIT_CACHE`, or the platform's cache
    folder."""
    if override := os.environ.get("HANDFIT_CACHE"):
        return Path(override).expanduser()
    if sys.platform == "win32":
        base = os.environ.get("LOCALAPPDATA") or Path.home() / "AppData" / "Local"
    elif sys.platform == "darwin":
        base = Path.home() / "Library" / "Caches"
    else:
        base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(base) / "handfit"


def data_dir() -> Path:
    """Return the folder in which what the user has made is kept for good: `$HANDFIT_DATA`, or the platform's
    folder of programs' data."""
    if override := os.environ.get("HANDFIT_DATA"):
        return Path(override).expanduser()
    if sys.platform == "win32":
        base = os.environ.get("APPDATA") or Path.home() / "AppData" / "Roaming"
    elif sys.platform == "darwin":
        base = Path.home() / "Library" / "Application Support"
    else:
        base = os.environ.get("XDG_DATA_HOME") or Path.home() / ".local" / "share"
    return Path(base) / "handfit"
