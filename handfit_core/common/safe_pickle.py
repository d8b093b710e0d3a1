"""Pickles of arrays and plain containers, NumPy's, PyTorch's and joblib's, read without running anything in
them.

A pickle is a program that calls what it names. Here a name must be on a list, and a call is only remembered:
nothing of NumPy, PyTorch, SciPy, chumpy or anybody else runs on the file's behalf, whichever process reads
it. Arrays are made of the remembered bytes afterwards, where they are asked for.

Nor can a file keep its reader busy: its instructions are counted, none makes more than the file holds, and
nothing that it nests is hashed or compared: keys are texts or small numbers, and sets become lists.
"""

from __future__ import annotations

import io
import math
import pickle
import re
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar, Final

import numpy as np

_NAMES: Final = re.compile(
    r"numpy\.(ndarray|dtype)|numpy\._?core\.(multiarray\.(_reconstruct|scalar)|numeric\._frombuffer)"
    r"|(__builtin__|builtins)\.(object|set|dict|list)|_codecs\.encode|copy_?reg\._reconstructor"
    r"|collections\.(OrderedDict|defaultdict)|joblib\.numpy_pickle\.NumpyArrayWrapper"
    r"|torch\.([A-Z]\w+Storage|Size|device|[a-z]+\d+|bool)|torch\.storage\._load_from_bytes"
    r"|torch\._utils\._rebuild_(tensor_v2|parameter)"
    r"|scipy\.sparse\._?cs[cr]\.cs[cr]_(matrix|array)|chumpy(\.\w+)*\.[A-Za-z]\w*",
    re.ASCII,
)
"""The names that arrays use in pickles of NumPy 1 and 2, Python 2 and 3, PyTorch and joblib, and those that
MANO's files use besides"""
_STORAGES: Final = {
    f"torch.{name}Storage": np.dtype(kind)
    for name, kind in zip(
        "Float Double Half BFloat16 Long Int Short Char Byte Bool".split(),
        "<f4 <f8 <f2 <u2 <i8 <i4 <i2 i1 u1 u1".split(),
        strict=True,
    )
}
"""The numbers of PyTorch's storages; the upper half of a float32 for bfloat16"""
_OLDER_TORCH: Final = b"\x80\x02\x8a\nl\xfc\x9cF\xf9 j\xa8P\x19."
"""The bytes with which PyTorch's files begin that are no zips, and a storage within a pickle"""

MOST_STEPS: Final = 100_000
"""The most instructions of a pickle with a few arrays; MANO's has some hundred"""
MOST_NUMBERED: Final = 10_000_000
"""The bound below which dictionary keys that are whole numbers must lie: so few share a place in a dictionary
that no look-up takes long"""
MOST_PARTS: Final = 3_000_000
"""The most values that `plain` gives, each counted as often as it is named"""
_MOST_NESTED: Final = 100
MOST_BYTES: Final = 1 << 28
"""The most bytes of all arrays that `plain` gives, with 8 bytes for each float"""
MOST_DENSE: Final = 2_000_000
"""The most numbers of a sparse matrix that is made dense (MANO's have 16 x 778), or of a tensor that repeats
some"""


class Refused(Exception):
    """A pickle does what no file of arrays needs; the message is to be put after `the file`."""


@dataclass(eq=False, slots=True)
class Call:
    """An object that a pickle asks for: the name of a class or function, its arguments, and the state that
    the object shall have."""

    name: str
    args: tuple[Any, ...] = ()
    state: Any = None

    def __setstate__(self, state: Any) -> None:
        self.state = state

    @property
    def fields(self) -> dict[str, Any]:
        """Return the attributes that the object would have."""
        state = self.state[0] if isinstance(self.state, tuple) and self.state else self.state
        return state if isinstance(state, dict) else {}


def load(data: bytes, *, most_steps: int = MOST_STEPS, contents: Callable[[str], bytes] | None = None) -> Any:
    """What a pickle, or an older file of PyTorch, holds: plain containers, texts, numbers, None, and a `Call`
    for everything else.

    `contents`: the bytes of one of the storages that lie beside a pickle in PyTorch's zip, by its key.

    Sets are read as lists, and bytes of Python 2 as Latin-1. Raises Refused for a name that is not allowed,
    for more than `most_steps` instructions and for other keys than texts and small numbers, and whatever a
    damaged file leads to otherwise: callers catch Exception.
    """
    steps = _Counted(_Reader.dispatch, most_steps)
    if data.startswith(_OLDER_TORCH):
        return _older_torch(data, steps, len(data))
    if not data.endswith(pickle.STOP):  # or the end of a cut file could be half a name
        raise EOFError
    reader = _Reader(io.BytesIO(data), steps, len(data))
    held = reader.load()
    for key, storage in reader.storages.items():
        if contents is None:
            raise Refused("refers to parts that it does not have")
        storage.state = contents(key)
    return held


def _older_torch(data: bytes, steps: _Counted, room: int) -> Any:
    """What is in a file of PyTorch that is no zip: five pickles, of which the fourth is what was saved and
    the fifth the keys of the storages, whose numbers follow."""
    stream = io.BytesIO(data)
    reader = _Reader(stream, steps, room)
    _, _, system, held, keys = [reader.load() for _ in range(5)]
    if system["little_endian"] is not True:
        raise Refused("has its bytes in an order that is not read")
    for key in keys:
        storage, count = reader.storages[key], int.from_bytes(stream.read(8), "little")
        start = stream.tell()
        end = start + count * _STORAGES[storage.name].itemsize if storage.name in _STORAGES else len(data)
        storage.state = memoryview(data)[start:end]
        stream.seek(end)
    return held


def plain(value: Any) -> Any:
    """What `load` gave as dictionaries, lists, texts, numbers and arrays; keys are texts.

    Arrays are of integers, floats (bfloat16 as float32) or bools in native byte order, those of PyTorch,
    chumpy and SciPy's sparse ones as well; those of objects are lists, or their only object where they have
    no dimension. What is none of these, or damaged, is None.

    Raises Refused for a value that is nested without end, or names the same parts over and over, and for a
    tensor beyond its storage.
    """
    return _Plain().of(value, 0)


class _Plain:
    """The work of `plain` on one file: it makes each array once, however often it is named, and only so many
    values."""

    def __init__(self) -> None:
        self._left, self._bytes = MOST_PARTS, MOST_BYTES
        self._made: dict[int, Any] = {}

    def of(self, value: Any, depth: int) -> Any:
        self._left -= 1
        if self._left < 0 or depth > _MOST_NESTED:
            raise Refused("nests more values than arrays need")
        if isinstance(value, dict):
            return {str(key): self.of(each, depth + 1) for key, each in value.items()}
        if isinstance(value, list | tuple):
            return [self.of(each, depth + 1) for each in value]
        if isinstance(value, Call):
            if id(value) not in self._made:
                made = self._made[id(value)] = self._call(value, depth + 1)
                if isinstance(made, np.ndarray):
                    self._bytes -= made.size * (8 if made.dtype.kind == "f" else made.itemsize)
                if self._bytes < 0:  # one text may be the contents of many arrays
                    raise Refused("has more numbers than such files have")
            return self._made[id(value)]
        return value if value is None or isinstance(value, str | int | float | bool) else None

    def _call(self, call: Call, depth: int) -> Any:
        state, fields = call.state, call.fields
        if call.name.startswith("chumpy.") and call.name != "chumpy.reordering.Select":
            return self.of(fields.get("x"), depth)
        if call.name == "torch._utils._rebuild_parameter":
            return self.of(call.args[0] if call.args else None, depth)
        try:
            if call.name == "torch._utils._rebuild_tensor_v2":
                return self._tensor(*call.args[:4])
            if call.name.startswith("scipy."):
                parts = [self.of(fields.get(name), depth) for name in ("data", "indices", "indptr")]
                return _dense(parts, fields.get("_shape", fields.get("shape")), ".csc_" in call.name)
            if call.name.startswith("chumpy."):
                whole, chosen = (self.of(fields.get(name), depth) for name in ("a", "idxs"))
                shape = fields.get("preferred_shape")
                return _shaped(whole.reshape(-1)[_indices(chosen, whole.size)], shape or chosen.shape, "C")
            if call.name.endswith(".scalar"):
                return float(_numbers(call.args[1], call.args[0])[0])
            if call.name.endswith("._frombuffer"):
                raw, dtype, shape, order = call.args
                return _shaped(_numbers(raw, dtype), shape, order)
            shape, dtype, fortran, contents = state[-4:]
            if not isinstance(contents, list):
                return _shaped(_numbers(contents, dtype), shape, "F" if fortran else "C")
        except (AttributeError, IndexError, TypeError, ValueError):
            return None  # texts and times, and what is damaged
        objects = self.of(contents, depth)
        return objects[0] if shape == () and len(objects) == 1 else objects

    def _tensor(self, storage: Call, offset: int, shape: tuple[int, ...], strides: tuple[int, ...]) -> Any:
        """Return the numbers of a tensor, whose shape and strides may place them anywhere in its storage.
        None for kinds of numbers that NumPy lacks."""
        kind = _STORAGES.get(storage.name)
        if kind is None:
            return None
        flat = np.frombuffer(storage.state[: len(storage.state) // kind.itemsize * kind.itemsize], kind)
        if len(shape) != len(strides) or any(type(n) is not int or n < 0 for n in (offset, *shape, *strides)):
            raise Refused("has a tensor that is damaged")
        count = math.prod(shape)
        if 8 * count > self._bytes or count > max(len(flat), MOST_DENSE):
            raise Refused("has more numbers than such files have")
        last = offset + sum((n - 1) * step for n, step in zip(shape, strides, strict=True))
        if count and last >= len(flat):
            raise Refused("has a tensor with more numbers than are stored of it")
        steps = [kind.itemsize * step if count else 0 for step in strides]
        laid = np.lib.stride_tricks.as_strided(flat[offset if count else 0 :], shape, steps).copy()
        if storage.name == "torch.BFloat16Storage":
            return (laid.astype(np.uint32) << 16).view(np.float32)
        return laid != 0 if storage.name == "torch.BoolStorage" else laid.astype(kind.newbyteorder("="))


def _shaped(array: np.ndarray, shape: Any, order: str) -> np.ndarray:
    """Return a flat array in a shape that a file names. Raises ValueError where it does not fit."""
    if len(shape) > 4 or not all(0 <= n <= array.size for n in shape) or math.prod(shape) != array.size:
        raise ValueError("another number of numbers")
    return array.reshape(shape, order="F" if order == "F" else "C").astype(array.dtype.newbyteorder("="))


def _indices(array: np.ndarray, size: int) -> np.ndarray:
    """Return indices after checking that they lie within `size`. Raises ValueError for others."""
    if array.dtype.kind not in "iu" or np.any((array < 0) | (array >= size)):
        raise ValueError("indices that do not exist")
    return array.astype(np.int64)


def _dense(parts: list[np.ndarray], shape: Any, by_columns: bool) -> np.ndarray:
    """Return the dense form of a sparse matrix of `data`, `indices` and `indptr`, as SciPy stores them.
    Raises ValueError."""
    (data, minor, starts), (rows, columns) = parts, shape
    majors, minors = (columns, rows) if by_columns else (rows, columns)
    if not 0 < rows * columns <= MOST_DENSE or any(part.ndim != 1 for part in parts):
        raise ValueError("no matrix, or a large one")
    minor, counts = _indices(minor, minors), np.diff(_indices(starts, len(data) + 1))
    if len(starts) != majors + 1 or starts[0] or starts[-1] != len(data) or np.any(counts < 0):
        raise ValueError("other columns than it has")
    dense = np.zeros((majors, minors))
    np.add.at(dense, (np.repeat(np.arange(majors), counts), minor), data)
    return dense.T if by_columns else dense


def _numbers(raw: Any, dtype: Any) -> np.ndarray:
    """Return the numbers (N,) of bytes, which protocol 2 writes as a text to be encoded, and Python 2 as a
    text. Raises ValueError where they are of another kind."""
    raw = _bytes(raw)
    known = re.fullmatch(r"[<>|=]?([iu][1248]|f[248]|b1)", dtype.args[0])
    if not known or not isinstance(raw, bytes | bytearray):
        raise ValueError("no numbers")
    big = isinstance(dtype.state, tuple) and dtype.state[1:2] == (">",)
    return np.frombuffer(raw, np.dtype((">" if big else "<") + known[1]))


def _bytes(raw: Any) -> Any:
    """Return the bytes of a text, or of a text that is to be encoded; all else is returned as it is."""
    if isinstance(raw, Call) and raw.name == "_codecs.encode" and raw.args[1:] == ("latin1",):
        raw = raw.args[0]
    return raw.encode("latin1") if isinstance(raw, str) else raw


class _Keyed(dict[Any, Any]):
    """A dictionary out of a pickle that refuses costly keys: nested ones take forever to hash, and chosen
    numbers to find a place."""

    __slots__ = ()

    def __setitem__(self, key: Any, value: Any) -> None:
        if type(key) is not str and not (type(key) is int and 0 <= key < MOST_NUMBERED):
            raise Refused("has a dictionary with a key that is no text")
        super().__setitem__(key, value)

    def __setstate__(self, state: Any) -> None:
        """Ignore attributes that a pickle gives the dictionary, such as those of a network's weights."""


class _Counted(dict[int, Any]):
    """A table of an unpickler's methods by their instructions, which gives out only so many of them."""

    def __init__(self, methods: dict[int, Any], most: int) -> None:
        super().__init__(methods)
        self._left = most

    def __getitem__(self, code: int) -> Any:
        self._left -= 1
        if self._left < 0:
            raise Refused("has more instructions than arrays need")
        return super().__getitem__(code)


class _Reader(pickle._Unpickler):
    """Python's own unpickler rather than the C one, which allocates whatever size a file names for its memo,
    and whose instructions cannot be counted."""

    # Python's own has no types for what it is made of.
    stack: list[Any]
    append: Callable[[Any], None]
    pop_mark: Callable[[], list[Any]]
    read: Callable[[int], bytes]
    dispatch: ClassVar[dict[int, Any]] = dict(pickle._Unpickler.dispatch)

    def __init__(self, stream: io.BytesIO, steps: _Counted, room: int) -> None:
        """`steps` are shared by all readers of a file; `room`: the bytes that all pickles within this one may
        have together."""
        super().__init__(stream, encoding="latin1")
        self.dispatch = self._steps = steps  # type: ignore[misc]
        self.storages: dict[str, Call] = {}
        """PyTorch's storages that lie beside the pickle, by their keys; their states are to be filled"""
        self._stream, self._room = stream, room

    def load(self) -> Any:
        """Read the next pickle and return its value."""
        self.memo: dict[int, Any] = {}
        return super().load()

    def find_class(self, module: Any, name: Any) -> Any:
        """Return a `Call` of an allowed name, which is only remembered. Raises Refused for all others."""
        asked = f"{module}.{name}"
        if len(asked) > 200 or not _NAMES.fullmatch(asked):
            raise Refused("asks to run " + re.sub(r"[^\x20-\x7e]", "?", asked)[:80])
        return Call(asked)

    def persistent_load(self, pid: Any) -> Call:
        """Return one of PyTorch's storages by what identifies it in the pickle."""
        if not isinstance(pid, tuple) or pid[:1] != ("storage",) or type(pid[2]) is not str or any(pid[5:]):
            raise Refused("refers to parts that it does not have")
        return self.storages.setdefault(pid[2], Call(pid[1].name))

    def _instantiate(self, called: Any, args: Any) -> None:
        if not isinstance(called, Call) or not isinstance(args, tuple | list):
            raise pickle.UnpicklingError("this cannot be called")
        if called.name.startswith("collections."):
            made = _Keyed()
            for key, value in args[0] if called.name.endswith(".OrderedDict") and args else ():
                made[key] = value
            self.append(made)
            return
        if called.name == "torch.storage._load_from_bytes":
            raw = _bytes(args[0])
            self._room -= len(raw)
            if self._room < 0:  # one text may be named again and again
                raise Refused("has more numbers than such files have")
            self.append(_older_torch(raw, self._steps, 0))
            return
        # Protocols 0 and 1 make an object of the class that is the first argument.
        made = args[0] if called.name.endswith("._reconstructor") else called
        self.append(Call(made.name, tuple(args)))

    def _load_call(self) -> None:
        args, called = self.stack.pop(), self.stack.pop()
        self._instantiate(called, args)

    dispatch[pickle.REDUCE[0]] = dispatch[pickle.NEWOBJ[0]] = _load_call

    def _load_build(self) -> None:
        """Read the numbers of joblib's arrays, which follow their descriptions behind bytes that align
        them."""
        super().load_build()  # type: ignore[misc]
        made = self.stack[-1]
        if not isinstance(made, Call) or not made.name.startswith("joblib."):
            return
        shape, dtype, align = made.fields["shape"], made.fields["dtype"], "numpy_array_alignment_bytes"
        kind, width = re.findall(r"^[<>|=]?([a-zA-Z])(\d+)$", dtype.args[0])[0]
        if kind == "O":
            self.stack[-1] = _Reader(self._stream, self._steps, 0).load()
            return
        if made.fields.get(align) is not None:
            self.read(self.read(1)[0])
        size = math.prod(shape) * int(width) * (4 if kind == "U" else 1)
        raw = self.read(size)
        if len(raw) != size:
            raise EOFError("an array breaks off")
        made.name, made.state = "numpy.ndarray", (shape, dtype, made.fields.get("order") == "F", raw)

    dispatch[pickle.BUILD[0]] = _load_build

    dispatch[pickle.EMPTY_DICT[0]] = lambda self: self.append(_Keyed())

    def _load_dict(self) -> None:
        items, made = self.pop_mark(), _Keyed()
        for key, value in zip(items[::2], items[1::2], strict=True):
            made[key] = value
        self.append(made)

    dispatch[pickle.DICT[0]] = _load_dict

    def _load_bytearray8(self) -> None:
        """Read a bytearray without allocating beforehand what the file names as its size, as Python's own
        method does."""
        self.append(self.read(int.from_bytes(self.read(8), "little")))

    dispatch[pickle.BYTEARRAY8[0]] = _load_bytearray8
    dispatch[pickle.EMPTY_SET[0]] = dispatch[pickle.EMPTY_LIST[0]]
    dispatch[pickle.ADDITEMS[0]] = dispatch[pickle.APPENDS[0]]
    dispatch[pickle.FROZENSET[0]] = dispatch[pickle.LIST[0]]
