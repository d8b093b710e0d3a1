"""Files of PyTorch, written without it: its zip, its older kind, and a pickle that holds tensors."""

from __future__ import annotations

import io
import pickle
import struct
import zipfile
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

KINDS = {
    "f8": "Double", "f4": "Float", "f2": "Half", "i8": "Long", "i4": "Int", "i2": "Short", "i1": "Char",
    "u1": "Byte", "b1": "Bool",
}  # fmt: skip
MAGIC = 0x1950A86A20F9469CFC6C
SYSTEM = {
    "protocol_version": 1001,
    "little_endian": True,
    "type_sizes": {"short": 2, "int": 4, "long": 4},
}


@dataclass
class Name:
    """A class or a function that is not there."""

    module: str
    name: str

    def __call__(self) -> None:
        """What is called must be callable to be pickled."""


@dataclass
class Storage:
    kind: str
    data: bytes
    count: int


@dataclass
class Tensor:
    storage: Storage
    shape: tuple[float, ...]
    strides: tuple[float, ...]
    offset: int = 0


def tensor(array: np.ndarray) -> Tensor:
    """An array as PyTorch has it."""
    held = np.array(array, order="C")
    storage = Storage(KINDS[held.dtype.str[1:]], held.tobytes(), held.size)
    return Tensor(storage, held.shape, tuple(step // held.itemsize for step in held.strides))


class _Pickler(pickle._Pickler):
    # Python's own has no types for what it is made of.
    write: Callable[[bytes], Any]
    save: Callable[[Any], None]
    save_reduce: Callable[..., None]
    dispatch: ClassVar[dict[Any, Any]] = dict(pickle._Pickler.dispatch)

    def __init__(self, stream: io.BytesIO, beside: tuple[Any, ...] | None) -> None:
        """`beside`: what PyTorch's references to storages that lie beside the pickle end with; None: they lie
        within it."""
        super().__init__(stream, 2)
        self.beside, self.storages = beside, list[Storage]()

    def persistent_id(self, obj: Any) -> Any:
        if not isinstance(obj, Storage) or self.beside is None:
            return None
        if not any(obj is each for each in self.storages):
            self.storages.append(obj)
        key = next(str(n) for n, each in enumerate(self.storages) if each is obj)
        return "storage", Name("torch", f"{obj.kind}Storage"), key, "cuda:0", obj.count, *self.beside

    def save_name(self, name: Name) -> None:
        self.write(f"c{name.module}\n{name.name}\n".encode())

    def save_array(self, array: np.ndarray) -> None:
        self.save(tensor(array))

    def save_storage(self, storage: Storage) -> None:
        self.save_reduce(Name("torch.storage", "_load_from_bytes"), (older_torch(storage),), obj=storage)

    def save_tensor(self, made: Tensor) -> None:
        parts = made.storage, made.offset, made.shape, made.strides, False, OrderedDict()
        self.save_reduce(Name("torch._utils", "_rebuild_tensor_v2"), parts)

    dispatch |= {Name: save_name, np.ndarray: save_array, Storage: save_storage, Tensor: save_tensor}


def _pickled(content: Any, beside: tuple[Any, ...] | None) -> tuple[bytes, list[Storage]]:
    stream = io.BytesIO()
    pickler = _Pickler(stream, beside)
    pickler.dump(content)
    return stream.getvalue(), pickler.storages


def tensors_in_pickle(content: Any) -> bytes:
    """As pickle and joblib write what holds tensors; arrays are written as tensors."""
    return _pickled(content, None)[0]


def older_torch(content: Any) -> bytes:
    """As torch.save wrote files before 1.6, and writes each storage within a pickle."""
    data, storages = _pickled(content, (None,))
    keys = [str(n) for n in range(len(storages))]
    start = b"".join(pickle.dumps(each, 2) for each in (MAGIC, 1001, SYSTEM))
    numbers = b"".join(struct.pack("<q", each.count) + each.data for each in storages)
    return start + data + pickle.dumps(keys, 2) + numbers


def torch_zip(content: Any, **members: bytes) -> bytes:
    """As torch.save writes files, with the longer record at the end; `members` replace others."""
    data, storages = _pickled(content, ())
    files = {"data.pkl": data, "byteorder": b"little", "version": b"3\n"}
    files |= {f"data/{n}": each.data for n, each in enumerate(storages)} | members
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        for name, held in files.items():
            archive.writestr(f"archive/{name}", held)
    written = stream.getvalue()
    end, count = written[-22:], len(files)
    size, start = struct.unpack("<II", end[12:20])
    longer = b"PK\6\6" + struct.pack("<QHHIIQQQQ", 44, 30, 45, 0, 0, count, count, size, start)
    return written[:-22] + longer + b"PK\6\7" + struct.pack("<IQI", 0, len(written) - 22, 1) + end
