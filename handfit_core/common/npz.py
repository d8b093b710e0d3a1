"""NumPy's `.npz` and `.npy` files from anywhere, looked through before anything is read.

What a zip and the arrays in it declare costs nothing to write: a terabyte of zeros, objects that are code.
Members are read by name, and each only where its size in the zip, its own description and what the caller
allows agree.
"""

from __future__ import annotations

import contextlib
import io
import json
import math
import re
import zipfile
from collections.abc import Iterator
from typing import Any, BinaryIO, Final

import numpy as np

LONGEST_HEADER: Final = 1 << 26
"""The most characters of a file's JSON header, which names each picture of a sequence: 300 000 of them with
long names fit"""
_MOST_SYNTAX: Final = 1 << 22
"""The most characters of a JSON header outside its strings, each of which may become an object of a hundred
bytes"""
_STRING: Final = re.compile(r'"[^"\\]*(?:\\.[^"\\]*)*"?', re.DOTALL)
"""A JSON string; one without an end reaches to the header's end, as looking for its end would begin anew at
every quote"""
_LONGEST_TABLE: Final = 1 << 21
"""The most bytes of a zip's table of contents"""
_LONGEST_DESCRIPTION: Final = 1024
"""The most bytes with which a member describes its array; plain arrays take 128"""


class NotNpz(Exception):
    """A file is no `.npz` that can be trusted; the message says why, to be put after the file's name."""


@contextlib.contextmanager
def _or_not_npz(what: str) -> Iterator[None]:
    """Within, any exception but MemoryError becomes NotNpz with this text and its own, as a damaged file can
    fail in any way."""
    try:
        yield
    except (NotNpz, MemoryError):
        raise
    except Exception as error:
        raise NotNpz(f"{what} ({str(error)[:200]})") from error


class NpzArchive:
    """The arrays of an `.npz`, each read when it is asked for."""

    def __init__(self, data: bytes, most_bytes: int) -> None:
        """`most_bytes`: what all arrays together may take once they are read, with 8 bytes for each float,
        besides the header.

        Raises NotNpz.
        """
        self._left = most_bytes
        self._archive = _opened(io.BytesIO(data))
        self._members = {info.filename.removesuffix(".npy"): info for info in self._archive.infolist()}

    def __contains__(self, name: str) -> bool:
        return name in self._members

    @property
    def names(self) -> list[str]:
        """Return the names of the archive's members, without .npy."""
        return list(self._members)

    @contextlib.contextmanager
    def _member(self, name: str) -> Iterator[tuple[Any, int]]:
        """Open a member; yields its contents, and how many bytes the zip says that they are. Raises KeyError
        and NotNpz."""
        info = self._members[name]
        if info.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):  # others take what they like
            raise NotNpz(f"holds {name}, which is compressed in a way that NumPy never uses")
        with _or_not_npz(f"holds {name}, which is damaged"), self._archive.open(info) as stream:
            yield stream, info.file_size

    def _pay(self, name: str, size: int) -> None:
        self._left -= size
        if self._left < 0:
            raise NotNpz(f"would take more memory than such a file ever needs, with its {name}")

    def array(self, name: str, kinds: str) -> np.ndarray:
        """Return one member's array, writable and in native byte order; floats as float64.

        `kinds`: which of NumPy's kinds of numbers it may hold, as in "f" or "iu". Raises KeyError where there
        is no such member, and NotNpz.
        """
        with self._member(name) as (stream, size):
            self._pay(name, _checked(stream, size, name, kinds))
            return _array(stream)

    def pickle(self, name: str) -> bytes:
        """Return the pickle that a member with Python's objects holds, for `safe_pickle`. Raises KeyError
        where there is no such member, and NotNpz, also for a member of numbers."""
        with self._member(name) as (stream, size):
            self._pay(name, size)
            return _pickle(stream, name)

    def contents(self, name: str) -> bytes:
        """Return the bytes of a member that is no array. Raises KeyError where there is none, and NotNpz."""
        with self._member(name) as (stream, size):
            self._pay(name, size)
            return stream.read()

    def header(self, name: str = "header") -> dict[str, Any]:
        """Return the JSON object that a member holds as its only text. Raises KeyError and NotNpz."""
        with self._member(name) as (stream, size):
            if _checked(stream, size, name, "U") > 4 * LONGEST_HEADER:
                raise NotNpz(f"has a {name} of more than {LONGEST_HEADER} characters")
            array = _array(stream)
        if array.shape != ():
            raise NotNpz(f"has a {name} that is no single text")
        text = array.item()
        del array  # four times as large
        if len(_STRING.sub("", text)) > _MOST_SYNTAX:
            raise NotNpz(f"has a {name} of very many parts")
        try:
            content = json.loads(text)
        except (ValueError, RecursionError) as error:
            raise NotNpz(f"has a {name} that is no JSON") from error
        if not isinstance(content, dict):
            raise NotNpz(f"has a {name} that is no JSON object")
        return content


def npy_array(data: bytes, kinds: str, most_bytes: int) -> np.ndarray:
    """Return the array of a .npy file, as `NpzArchive.array` returns a member's. Raises NotNpz."""
    stream = io.BytesIO(data)
    with _or_not_npz("is no .npy, or a damaged one"):
        if _checked(stream, len(data), "array", kinds) > most_bytes:
            raise NotNpz("would take more memory than such a file ever needs")
        return _array(stream)


def npy_pickle(data: bytes) -> bytes:
    """Return the pickle that a .npy file with Python's objects holds, for `safe_pickle`. Raises NotNpz."""
    with _or_not_npz("is no .npy, or a damaged one"):
        return _pickle(io.BytesIO(data), "array")


def names_of(stream: BinaryIO) -> set[str]:
    """Return the names of an `.npz`'s members, without .npy; nothing else of them is read. Raises NotNpz."""
    return {name.removesuffix(".npy") for name in _opened(stream).namelist()}


def _opened(stream: BinaryIO) -> zipfile.ZipFile:
    """Open a zip whose table of contents is short enough to be read at all."""
    with _or_not_npz("is no zip, or a damaged one"):
        length = stream.seek(0, io.SEEK_END)
        stream.seek(max(0, length - 98))
        end = stream.read()
        # Without a comment, the last 22 bytes are what zipfile takes for the end. NumPy writes none.
        # PyTorch writes none either, and a longer record before it, which counts, always in one place.
        longer = end[-42:].startswith(b"PK\6\7")
        record = b"PK\6\6" + (44).to_bytes(8, "little")
        placed = end.startswith(record) and int.from_bytes(end[64:72], "little") == length - 98
        if not end[-22:].startswith(b"PK\5\6") or (longer and not placed):
            raise NotNpz("is no zip, or does not end where it should")
        table = end[40:48] if longer else end[-10:-6]
        if int.from_bytes(table, "little") > _LONGEST_TABLE:
            raise NotNpz("has very many members, or members with very long names")
        return zipfile.ZipFile(stream)


def _description(stream: BinaryIO) -> tuple[int, tuple[int, ...], np.dtype[Any]]:
    """Read an array's description; returns the position at which its contents begin, its shape and its
    type."""
    start = io.BytesIO(stream.read(_LONGEST_DESCRIPTION))  # whatever length it claims
    version = np.lib.format.read_magic(start)
    if version == (1, 0):
        shape, _, dtype = np.lib.format.read_array_header_1_0(start)
    else:
        shape, _, dtype = np.lib.format.read_array_header_2_0(start)
    return start.tell(), shape, dtype


def _checked(stream: BinaryIO, size: int, name: str, kinds: str) -> int:
    """Return how many bytes an array will take in memory that is described at the beginning of `size` bytes.
    Raises NotNpz unless it is of the wanted kinds of numbers and fills these bytes."""
    start, shape, dtype = _description(stream)
    if dtype.kind not in kinds:
        raise NotNpz(f"holds {dtype} as {name}, which is none of its kinds")
    count = math.prod(shape)
    if not 0 <= count <= size or count * dtype.itemsize + start != size:
        raise NotNpz(f"holds {name} with another size than it declares")
    return count * (8 if dtype.kind == "f" else dtype.itemsize)


def _pickle(stream: BinaryIO, name: str) -> bytes:
    start, _, dtype = _description(stream)
    if not dtype.hasobject:
        raise NotNpz(f"holds numbers as {name}, and no objects")
    stream.seek(start)
    return stream.read()


def _array(stream: BinaryIO) -> np.ndarray:
    """Read the array of a stream that `_checked` has accepted."""
    stream.seek(0)
    found = np.lib.format.read_array(stream, allow_pickle=False)
    stream.read(1)  # at the end a zip's sum is compared
    return found.astype(np.float64 if found.dtype.kind == "f" else found.dtype.newbyteorder("="), copy=False)
