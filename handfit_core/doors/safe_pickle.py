"""Pickles of NumPy arrays and plain containers, read without running anything in them.

A pickle is a program. Here every name that such a file may ask for becomes an inert stand-in that
only remembers what it was given, any other name is refused, and arrays are read from the stand-ins'
raw bytes afterwards, when asked for. So nothing of NumPy or anybody else runs on the file's behalf.

Nor can it keep the reader busy: its instructions are counted, none makes more than the file holds, and
nothing that it nests is ever hashed or compared: keys of dictionaries are texts, and sets become lists.
"""

from __future__ import annotations

import io
import pickle
import re
from collections.abc import Callable
from typing import Any, ClassVar

import numpy as np


class Refused(Exception):
    """What a pickle does that no such file needs, to be put after `the file`."""


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


class _Scalar(StandIn):
    """numpy.core.multiarray.scalar: args (dtype, bytes)."""

    __slots__ = ()

    def number(self) -> float | None:
        """None for what is no number."""
        try:
            dtype = _dtype_of(self.args[0])
            raw = self.args[1]
            raw = raw.encode("latin1") if isinstance(raw, str) else raw
            return float(np.frombuffer(raw, dtype=dtype, count=1)[0])
        except (NotAnArray, IndexError, ValueError, TypeError):
            return None


class Unused(StandIn):
    """Names that occur around the arrays but carry nothing that is read."""

    __slots__ = ()


class _Encode(StandIn):
    """_codecs.encode(text, "latin1"), which is how protocol 2 writes bytes from Python 3."""

    __slots__ = ()

    def __new__(cls, text: Any, encoding: Any) -> Any:
        if type(text) is not str or encoding not in ("latin1", "latin-1"):
            raise Refused("asks to run _codecs.encode in a way that no array needs")
        return text.encode("latin1")


class _Reconstructor(StandIn):
    """copy_reg._reconstructor(class, object, None), which is how protocols 0 and 1 make instances."""

    __slots__ = ()

    def __new__(cls, made: Any, *_args: Any) -> Any:
        if not (isinstance(made, type) and issubclass(made, StandIn)):
            raise Refused("asks to run copy_reg._reconstructor in a way that no array needs")
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
    STAND_INS[f"{_core}.multiarray.scalar"] = _Scalar
    STAND_INS[f"{_core}.numeric._frombuffer"] = _ArrayFromBuffer


MOST_STEPS = 100_000
"""instructions of a pickle with a few arrays, such as MANO's, which has some hundred; each may make an object
of a hundred bytes"""

MOST_ARGUMENTS = 16
"""that a stand-in is called with; those of arrays have four"""

MOST_NESTED = 100
"""containers that are begun in one another; those of such files are some ten"""

MOST_NUMBERED = 10_000_000
"""Keys that are whole numbers lie below it: so few share a place in a dictionary that none takes long"""


def load(
    data: bytes,
    find: Callable[[str], type[StandIn] | None] = STAND_INS.get,
    *,
    most_steps: int = MOST_STEPS,
    numbered: bool = False,
) -> Any:
    """What a pickle holds: plain containers, texts, numbers, None, and stand-ins (see `array_of`).

    `find` gives the stand-in for a `module.name`, or None for what is not allowed. `most_steps`: how many
    instructions the pickle may have. `numbered`: whether dictionaries may have whole numbers as keys. Sets
    are read as lists, texts of Python 2 as Latin-1. Raises Refused for anything that is not allowed, and
    whatever a damaged file leads to otherwise: callers catch Exception.
    """
    return _Reader(data, find, most_steps, numbered).load()


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


MOST_PARTS = 3_000_000
"""values of a pickle, each as often as it is named, that `plain` gives"""
MOST_BYTES = 1 << 29
"""of all its arrays"""


def plain(value: Any) -> Any:
    """What `load` gave as dictionaries, lists, texts, numbers and arrays: those of objects are lists, or
    their only object where they have no dimension; keys are texts; what is none of these is None.

    Raises Refused for one that is nested without end, or names the same parts over and over.
    """
    return _Plain().of(value, 0)


class _Plain:
    """Each array once, however often it is named, and only so many values."""

    def __init__(self) -> None:
        self._left, self._bytes = MOST_PARTS, MOST_BYTES
        self._arrays: dict[int, Any] = {}

    def of(self, value: Any, depth: int) -> Any:
        self._left -= 1
        if self._left < 0 or depth > MOST_NESTED:
            raise Refused("nests more values than arrays need")
        if isinstance(value, dict):
            return {str(key): self.of(each, depth + 1) for key, each in value.items()}
        if isinstance(value, list | tuple):
            return [self.of(each, depth + 1) for each in value]
        if isinstance(value, _Array | _ArrayFromBuffer):
            if id(value) not in self._arrays:
                self._arrays[id(value)] = self._array(value, depth)
            return self._arrays[id(value)]
        if isinstance(value, _Scalar):
            return value.number()
        return value if value is None or isinstance(value, str | int | float | bool) else None

    def _array(self, value: StandIn, depth: int) -> Any:
        try:
            array = array_of(value)
        except NotAnArray:
            pass
        else:
            self._bytes -= array.nbytes
            if self._bytes < 0:  # one text may be the contents of many arrays
                raise Refused("has more numbers than such files have")
            return array
        state = value.state
        if not (isinstance(state, tuple) and len(state) in (4, 5) and isinstance(state[-1], list)):
            return None  # texts and times
        objects = self.of(state[-1], depth + 1)
        return objects[0] if state[-4] == () and len(objects) == 1 else objects


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


class _Steps(dict[int, Any]):
    """The methods of a reader by their instructions, of which only so many are given out."""

    def __init__(self, methods: dict[int, Any], most: int) -> None:
        super().__init__(methods)
        self._left = most

    def __getitem__(self, code: int) -> Any:
        self._left -= 1
        if self._left < 0:
            raise Refused("has more instructions than arrays need")
        return super().__getitem__(code)


class _Reader(pickle._Unpickler):
    """An unpickler that makes stand-ins only.

    The Python implementation rather than the C one, for three reasons: the C one allocates whatever
    memo size a file names; here those opcodes that reach outside the file
    (persistent ids, the extension registry, buffers) are gone, and none allocates ahead of reading; and here
    each instruction is looked up, and so can be counted.
    """

    # Python's own has no types for what it is made of.
    stack: list[Any]
    metastack: list[list[Any]]
    append: Callable[[Any], None]
    pop_mark: Callable[[], list[Any]]
    read: Callable[[int], bytes]

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
            pickle.NEWOBJ_EX,
        )
    }

    def __init__(
        self, data: bytes, find: Callable[[str], type[StandIn] | None], most_steps: int, numbered: bool
    ) -> None:
        super().__init__(_WholeReads(data), encoding="latin1")
        self._find = find
        self._numbered = numbered
        self._text_left = len(data)
        self.dispatch = _Steps(type(self).dispatch, most_steps)  # type: ignore[misc]

    def find_class(self, module: Any, name: Any) -> type[StandIn]:
        """The stand-in for an allowed name; Refused for all others."""
        asked = f"{module}.{name}"
        found = self._find(asked)
        if found is None:
            raise Refused("asks to run " + re.sub(r"[^\x20-\x7e]", "?", asked)[:80])
        return found

    def _load_mark(self) -> None:
        if len(self.metastack) >= MOST_NESTED:
            raise Refused(f"nests more than {MOST_NESTED} containers")
        pickle._Unpickler.load_mark(self)  # type: ignore[attr-defined]

    dispatch[pickle.MARK[0]] = _load_mark

    def _load_bytearray8(self) -> None:
        self.append(self.read(int.from_bytes(self.read(8), "little")))

    dispatch[pickle.BYTEARRAY8[0]] = _load_bytearray8

    def _load_call(self) -> None:
        """REDUCE and NEWOBJ: a stand-in with its arguments."""
        args = self.stack.pop()
        made = self.stack[-1]
        if (
            type(args) is not tuple or len(args) > MOST_ARGUMENTS
        ):  # the file may name the same ones ever again
            raise Refused("calls something with more than arrays need")
        if made is _Encode and args and isinstance(args[0], str):
            self._text_left -= len(args[0])
            if self._text_left < 0:
                raise Refused("makes more bytes of its texts than it has")
        self.stack[-1] = made(*args)

    dispatch[pickle.REDUCE[0]] = _load_call
    dispatch[pickle.NEWOBJ[0]] = _load_call

    # Dictionaries hash their keys, which for nested tuples never ends, and for chosen numbers takes hours.

    def _set(self, items: list[Any]) -> None:
        """Put keys and values, in turns, into the dictionary on the stack."""
        target = self.stack[-1]
        if type(target) is not dict or len(items) % 2:
            raise pickle.UnpicklingError("this is no dictionary")
        for key in items[::2]:
            if type(key) is str or (self._numbered and type(key) is int and 0 <= key < MOST_NUMBERED):
                continue
            raise Refused("has a dictionary with a key that is no text")
        target.update(zip(items[::2], items[1::2], strict=True))

    def _load_dict(self) -> None:
        items = self.pop_mark()
        self.append({})
        self._set(items)

    dispatch[pickle.DICT[0]] = _load_dict

    def _load_setitem(self) -> None:
        value, key = self.stack.pop(), self.stack.pop()
        self._set([key, value])

    dispatch[pickle.SETITEM[0]] = _load_setitem

    def _load_setitems(self) -> None:
        self._set(self.pop_mark())

    dispatch[pickle.SETITEMS[0]] = _load_setitems

    # Sets would, too; chumpy's objects hold some, of which nothing is read.
    dispatch[pickle.EMPTY_SET[0]] = dispatch[pickle.EMPTY_LIST[0]]
    dispatch[pickle.ADDITEMS[0]] = dispatch[pickle.APPENDS[0]]
    dispatch[pickle.FROZENSET[0]] = dispatch[pickle.LIST[0]]
