"""Pickles of NumPy arrays and plain containers, read without running anything in them.

A pickle is a program. Here every name that such a file may ask for becomes an inert stand-in that
only remembers what it was given, any other name is refused, and arrays are read from the stand-ins'
raw bytes afterwards, when asked for. So nothing of NumPy or anybody else runs on the file's behalf.
"""

from __future__ import annotations

import io
import pickle
import re
from collections.abc import Callable
from typing import Any, ClassVar

import numpy as np


class Refused(Exception):
    """The name that a pickle asked for, which no such file needs."""


class NotAnArray(Exception):
    """Why a value is no array of numbers, to be put after its name, as in `is not an array`."""


class StandIn:
    """Remembers what a pickle gives it. Subclasses stand for the classes and functions it names."""

    __slots__ = ("args", "state")

    def __init__(self, *args: Any) -> None:
        self.args = args
        self.state: Any = None

    def __new__(cls, *_args: Any) -> Any:
        """An instance with no arguments; pickles can make one without `__init__`."""
        made = object.__new__(cls)
        made.args, made.state = (), None
        return made

    def __setstate__(self, state: Any) -> None:
        self.state = state

    def fields(self) -> dict[str, Any]:
        """The attributes that the real object would have."""
        state = self.state[0] if isinstance(self.state, tuple) and self.state else self.state
        return state if isinstance(state, dict) else {}


class _Array(StandIn):
    """numpy.core.multiarray._reconstruct: args (class, shape, code); its contents are the state."""

    __slots__ = ()


class _ArrayFromBuffer(StandIn):
    """numpy.core.numeric._frombuffer: args (buffer, dtype, shape, order), pickle protocol 5."""

    __slots__ = ()


class _Dtype(StandIn):
    """numpy.dtype: args (code, align, copy), byte order in its state."""

    __slots__ = ()


class Unused(StandIn):
    """Names that occur around the arrays but carry nothing that is read."""

    __slots__ = ()


class _Encode(StandIn):
    """_codecs.encode(text, "latin1"), which is how protocol 2 writes bytes from Python 3."""

    __slots__ = ()

    def __new__(cls, text: Any, encoding: Any) -> Any:
        if type(text) is not str or encoding not in ("latin1", "latin-1"):
            raise Refused("_codecs.encode in a way that no array needs")
        return text.encode("latin1")


class _Reconstructor(StandIn):
    """copy_reg._reconstructor(class, object, None), which is how protocols 0 and 1 make instances."""

    __slots__ = ()

    def __new__(cls, made: Any, *_args: Any) -> Any:
        if not (isinstance(made, type) and issubclass(made, StandIn)):
            raise Refused("copy_reg._reconstructor in a way that no array needs")
        return StandIn.__new__(made)


STAND_INS: dict[str, type[StandIn]] = {
    "numpy.ndarray": Unused,
    "numpy.dtype": _Dtype,
    "__builtin__.object": Unused,
    "builtins.object": Unused,
    "__builtin__.set": Unused,
    "builtins.set": Unused,
    "_codecs.encode": _Encode,
    "copy_reg._reconstructor": _Reconstructor,
    "copyreg._reconstructor": _Reconstructor,
}
"""What pickles of arrays ask for, under the names of NumPy 1 and 2 and Python 2 and 3."""

for _core in ("numpy.core", "numpy._core"):
    STAND_INS[f"{_core}.multiarray._reconstruct"] = _Array
    STAND_INS[f"{_core}.multiarray.scalar"] = Unused
    STAND_INS[f"{_core}.numeric._frombuffer"] = _ArrayFromBuffer


def load(data: bytes, find: Callable[[str], type[StandIn] | None] = STAND_INS.get) -> Any:
    """What a pickle holds: plain containers, texts, numbers, None, and stand-ins (see `array_of`).

    `find` gives the stand-in for a `module.name`, or None for what is not allowed. Texts of Python 2
    are read as Latin-1. Raises Refused, with the name, for anything that is not allowed, and whatever
    a damaged file leads to otherwise: callers catch Exception.
    """
    return _Reader(data, find).load()


def array_of(value: Any) -> np.ndarray:
    """The plain array of integers or floats behind a stand-in, in native byte order.

    Raises NotAnArray for anything else, arrays of objects and of texts included.
    """
    if isinstance(value, _Array) and isinstance(value.state, tuple) and len(value.state) in (4, 5):
        shape, dtype, fortran, raw = value.state[-4:]
    elif isinstance(value, _ArrayFromBuffer) and len(value.args) == 4:
        raw, dtype, shape, order = value.args
        fortran = order == "F"
    else:
        raise NotAnArray("is not an array")
    raw = raw.encode("latin1") if isinstance(raw, str) else raw  # Python 2's bytes are read as text
    numpy_dtype = _dtype_of(dtype)
    if not isinstance(raw, bytes | bytearray) or len(raw) % numpy_dtype.itemsize:
        raise NotAnArray("is not an array of numbers")
    return reshaped(np.frombuffer(raw, dtype=numpy_dtype), shape, "F" if fortran else "C")


def reshaped(array: np.ndarray, shape: Any, order: Any) -> np.ndarray:
    """A flat array in a shape that a file names. Raises NotAnArray where it does not fit."""
    sizes = shape if isinstance(shape, (tuple, list)) else None
    if (
        sizes is None
        or len(sizes) > 4
        or not all(isinstance(n, int) and 0 <= n <= array.size for n in sizes)
        or int(np.prod(sizes, dtype=object)) != array.size
    ):
        raise NotAnArray(f"holds {array.size} numbers, which do not fill its shape")
    return array.reshape(tuple(sizes), order=order).astype(array.dtype.newbyteorder("="))


def _dtype_of(dtype: Any) -> np.dtype[Any]:
    code = dtype.args[0] if isinstance(dtype, _Dtype) and dtype.args else None
    order = dtype.state[1] if isinstance(dtype, _Dtype) and isinstance(dtype.state, tuple) else "<"
    if not (isinstance(code, str) and re.fullmatch(r"[<>|=]?[fiu][1248]", code) and code[-2:] != "f1"):
        raise NotAnArray("is not an array of numbers")
    return np.dtype((">" if order == ">" else "<") + code[-2:])


class _WholeReads(io.BytesIO):
    """Bytes whose end is an error at once, not a shorter answer: a cut-off name is no other name."""

    def read(self, size: int | None = -1, /) -> bytes:
        data = super().read(size)
        if size is not None and len(data) < size:
            raise EOFError
        return data

    def readline(self, size: int | None = -1, /) -> bytes:
        line = super().readline(size)
        if not line.endswith(b"\n"):
            raise EOFError
        return line


class _Reader(pickle._Unpickler):
    """An unpickler that makes stand-ins only.

    The Python implementation rather than the C one, for two reasons: the C one allocates whatever
    memo size a file names, and here those opcodes that reach outside the file
    (persistent ids, the extension registry, buffers) are gone, and none allocates ahead of reading.
    """

    dispatch: ClassVar[dict[int, Any]] = {
        code: method
        for code, method in pickle._Unpickler.dispatch.items()
        if bytes([code])
        not in (
            pickle.PERSID,
            pickle.BINPERSID,
            pickle.EXT1,
            pickle.EXT2,
            pickle.EXT4,
            pickle.NEXT_BUFFER,
            pickle.READONLY_BUFFER,
        )
    }

    def _load_bytearray8(self) -> None:
        size = int.from_bytes(self.read(8), "little")  # type: ignore[attr-defined]
        self.append(self.read(size))  # type: ignore[attr-defined]

    dispatch[pickle.BYTEARRAY8[0]] = _load_bytearray8

    def __init__(self, data: bytes, find: Callable[[str], type[StandIn] | None]) -> None:
        super().__init__(_WholeReads(data), encoding="latin1")
        self._find = find

    def find_class(self, module: Any, name: Any) -> type[StandIn]:
        """The stand-in for an allowed name; Refused for all others."""
        asked = f"{module}.{name}"
        found = self._find(asked)
        if found is None:
            raise Refused(re.sub(r"[^\x20-\x7e]", "?", asked)[:80])
        return found
