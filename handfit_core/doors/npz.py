"""NumPy's `.npz` and `.npy` files from anywhere: looked through before anything is read.

What a zip and the arrays in it declare costs nothing to write: a thousand members, a terabyte of zeros,
objects that are code. Here only the members that are asked for are read, by name, and each only after what
the zip says of its size, what its own header says, and what the caller allows are in agreement.
"""

from __future__ import annotations

import io
import json
import math
import re
import struct
import zipfile
from collections.abc import Callable
from typing import Any, BinaryIO, Final

import numpy as np

LONGEST_HEADER: Final = 1 << 26
"""characters of a file's JSON header: it names each picture of a sequence, so 300 000 of long names"""
_MOST_SYNTAX: Final = 1 << 22
"""characters of them outside strings, each of which may become an object of a hundred bytes"""
_STRING: Final = re.compile(r'"[^"\\]*(?:\\.[^"\\]*)*"?', re.DOTALL)
"""A text; one without an end goes to the header's, or looking for it would begin anew at every quote"""

_MOST_MEMBERS: Final = 4096
_LONGEST_ENTRY: Final = 512
"""bytes of a member in the zip's table of contents, on average"""
_LONGEST_DESCRIPTION: Final = 1024
"""characters with which a member describes its array; those of plain arrays have 128"""
_END: Final = struct.Struct("<4s4H2LH")
"""A zip's last record: mark, four counts of which the last is of members, the table's size and place, and the
length of a comment"""
_LOCATOR: Final = 20
"""bytes of the record that stands before it where a longer one is used"""


class NotNpz(Exception):
    """Why a file is no `.npz` that can be trusted, to be put after its name."""


class NpzArchive:
    """The arrays of an `.npz`, each read when it is asked for."""

    def __init__(self, data: bytes, most_bytes: int) -> None:
        """`most_bytes`: what all arrays together may take once they are read, with 8 bytes for each float,
        besides the header.

        Raises NotNpz.
        """
        self._left = most_bytes
        try:
            self._archive, table = _opened(io.BytesIO(data))
            self._members = _members(self._archive, table)
        except NotNpz:
            raise
        except Exception as error:  # a damaged zip can fail in any way
            raise NotNpz(f"is no zip, or a damaged one ({error})") from error

    def __contains__(self, name: str) -> bool:
        return name in self._members

    @property
    def names(self) -> list[str]:
        """What its members are called, without .npy."""
        return list(self._members)

    def array(self, name: str, kinds: str) -> np.ndarray:
        """One member, writable and in native byte order; floats as float64.

        `kinds`: which of NumPy's kinds of numbers it may hold, as in "f" or "iu". Raises KeyError where there
        is no such member, and NotNpz.
        """
        info = self._members[name]
        try:
            with self._archive.open(info) as stream:
                return _array_of(stream, info.file_size, name, kinds, self._pay)
        except (NotNpz, MemoryError):
            raise
        except Exception as error:
            raise NotNpz(f"holds {name}, which is damaged ({str(error)[:200]})") from error

    def pickle(self, name: str) -> bytes:
        """The pickle that a member with Python's objects holds, for `safe_pickle`. Raises KeyError where
        there is no such member, and NotNpz, also for a member of numbers."""
        info = self._members[name]
        try:
            with self._archive.open(info) as stream:
                _object_array(stream, name)
                self._pay(name, info.file_size)
                return stream.read(info.file_size)
        except (NotNpz, MemoryError):
            raise
        except Exception as error:
            raise NotNpz(f"holds {name}, which is damaged ({str(error)[:200]})") from error

    def header(self, name: str = "header") -> dict[str, Any]:
        """The JSON object that a member holds as its only text. Raises KeyError and NotNpz."""
        if self._members[name].file_size > 4 * LONGEST_HEADER + _LONGEST_DESCRIPTION:
            raise NotNpz(f"has a {name} of more than {LONGEST_HEADER} characters")
        try:
            array = self.array(name, "U")
            if array.shape != ():
                raise NotNpz(f"has a {name} that is no single text")
            text = array.item()
            del array  # four times as large
            if len(_STRING.sub("", text)) > _MOST_SYNTAX:
                raise NotNpz(f"has a {name} of very many parts")
            content = json.loads(text)
        except (ValueError, RecursionError) as error:
            raise NotNpz(f"has a {name} that is no JSON") from error
        if not isinstance(content, dict):
            raise NotNpz(f"has a {name} that is no JSON object")
        return content

    def _pay(self, name: str, size: int) -> None:
        self._left -= size
        if self._left < 0:
            raise NotNpz(f"would take more memory than such a file ever needs, with its {name}")


_SIZES: Final[dict[str, range | tuple[int, ...]]] = {
    "b": (1,),
    "i": (1, 2, 4, 8),
    "u": (1, 2, 4, 8),
    "f": (2, 4, 8),
    "U": range(4, 4 * LONGEST_HEADER + 1, 4),
}
"""Bytes of an item, by NumPy's kind"""


def npy_array(data: bytes, kinds: str, most_bytes: int) -> np.ndarray:
    """The array of a .npy file, as `NpzArchive.array` has one. Raises NotNpz."""

    def pay(name: str, size: int) -> None:
        if size > most_bytes:
            raise NotNpz(f"would take more memory than such a file ever needs, with its {name}")

    try:
        return _array_of(io.BytesIO(data), len(data), "array", kinds, pay)
    except (NotNpz, MemoryError):
        raise
    except Exception as error:
        raise NotNpz(f"is no .npy, or a damaged one ({str(error)[:200]})") from error


def npy_pickle(data: bytes) -> bytes:
    """The pickle that a .npy file with Python's objects holds, for `safe_pickle`. Raises NotNpz."""
    stream = io.BytesIO(data)
    try:
        _object_array(stream, "array")
    except NotNpz:
        raise
    except Exception as error:
        raise NotNpz(f"is no .npy, or a damaged one ({str(error)[:200]})") from error
    return stream.read()


def _object_array(stream: Any, name: str) -> None:
    """Go to where the pickle of an array of objects begins."""
    if not _description(stream)[2].hasobject:
        raise NotNpz(f"holds numbers as {name}, and no objects")


def _array_of(stream: Any, size: int, name: str, kinds: str, pay: Callable[[str, int], None]) -> np.ndarray:
    """The array that `size` bytes hold; `pay` is told of the bytes that it will take, and may refuse."""
    shape, fortran, dtype = _description(stream)
    # Before anything is computed from it: no number of the shape is beyond what is declared.
    if dtype.kind not in kinds or dtype.hasobject or dtype.shape or dtype.itemsize not in _SIZES[dtype.kind]:
        raise NotNpz(f"holds {dtype} as {name}, which is none of its kinds")
    if not all(type(n) is int and 0 <= n <= size for n in shape):
        raise NotNpz(f"holds {name} with an impossible shape")
    count = math.prod(shape)
    if count * dtype.itemsize + stream.tell() != size:
        raise NotNpz(f"holds {name} with another size than it declares")
    if dtype.kind != "U":
        pay(name, count * (8 if dtype.kind == "f" else dtype.itemsize))
    raw = stream.read(count * dtype.itemsize)
    if stream.read(1) or len(raw) != count * dtype.itemsize:  # the end is where a zip's sum is compared
        raise NotNpz(f"holds {name} with another size than it declares")
    flat = np.frombuffer(bytearray(raw), dtype=dtype)
    del raw
    wanted = np.dtype(np.float64) if dtype.kind == "f" else dtype.newbyteorder("=")
    return flat.astype(wanted, copy=False).reshape(shape, order="F" if fortran else "C")


def names_of(stream: BinaryIO) -> set[str]:
    """What the members of an `.npz` are called, without .npy; nothing else of them is read. Raises NotNpz."""
    try:
        archive, _ = _opened(stream)
        return {name.removesuffix(".npy") for name in archive.namelist()}
    except NotNpz:
        raise
    except Exception as error:  # a damaged zip can fail in any way
        raise NotNpz(f"is no zip, or a damaged one ({error})") from error


def _opened(stream: BinaryIO) -> tuple[zipfile.ZipFile, int]:
    """The zip, once its table of contents is known to be short enough to be read at all, and where this
    begins."""
    length = stream.seek(0, io.SEEK_END)
    if length < _END.size:
        raise NotNpz("is no zip")
    stream.seek(max(0, length - _END.size - _LOCATOR))
    data = stream.read()
    mark, _, _, _, count, size, _, comment = _END.unpack(data[-_END.size :])
    # Without a comment, the record that zipfile finds is this one. NumPy writes none, and uses the longer
    # records before it only for more than 4 GB.
    if mark != b"PK\5\6" or comment or data[: -_END.size].startswith(b"PK\6\7"):
        raise NotNpz("is no zip, or does not end where it should")
    if count > _MOST_MEMBERS or size > count * _LONGEST_ENTRY:
        raise NotNpz(f"has more than {_MOST_MEMBERS} members, or members with very long names")
    return zipfile.ZipFile(stream), length - _END.size - size


def _members(archive: zipfile.ZipFile, table: int) -> dict[str, zipfile.ZipInfo]:
    """The members by their arrays' names, none of which overlaps another or is packed as NumPy never does."""
    infos = sorted(archive.infolist(), key=lambda info: info.header_offset)
    ends = [*(info.header_offset for info in infos[1:]), table]
    for info, end in zip(infos, ends, strict=False):
        if info.header_offset + _LOCAL + info.compress_size > end:
            raise NotNpz("has members that lie in each other")
        if info.flag_bits & 1 or info.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
            raise NotNpz("is encrypted, or compressed in a way that NumPy never uses")
    members = {info.filename.removesuffix(".npy"): info for info in infos}
    if len(members) != len(infos):
        raise NotNpz("has two members of one name")
    return members


_LOCAL: Final = 30
"""bytes before each member, and its name"""


def _description(stream: Any) -> tuple[tuple[int, ...], bool, np.dtype[Any]]:
    """The shape, whether it is in Fortran's order, and the type, with which an array begins."""
    version = np.lib.format.read_magic(stream)
    size = struct.Struct("<H" if version == (1, 0) else "<I")
    raw = stream.read(size.size)
    if version not in ((1, 0), (2, 0)) or size.unpack(raw)[0] > _LONGEST_DESCRIPTION:
        raise ValueError("it is described at length")
    whole = io.BytesIO(raw + stream.read(size.unpack(raw)[0]))
    read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    return read(whole)
