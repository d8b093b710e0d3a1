"""Arrays of dataclasses, declared once: shapes, kinds and bounds. They are checked, sent in messages, kept in
`.npz` files and read from that declaration. So are plain values, but for the files.

    @array_dataclass
    class Motion:
        side: Side = value(one_of(*SIDES))
        betas: np.ndarray = array(10, finite="all")
        hand_pose: np.ndarray = array("T", 45, finite="present")
        present: np.ndarray = array("T", kind="b")
        filled: np.ndarray | None = array("T", kind="b", default=None)

Needs no more than NumPy, as Blender and the worker both import it.
"""

from __future__ import annotations

import base64
import binascii
import math
from collections.abc import Callable, Generator, Mapping
from dataclasses import MISSING, dataclass, field, is_dataclass
from functools import cache
from typing import Any, Final, Literal, TypeVar, dataclass_transform

import numpy as np

from handfit_core.common.errors import ProtocolError
from handfit_core.common.npz import NpzArchive
from handfit_core.common.values import Unfit, shortly, whole

LARGEST: Final = 1e9
"""The largest magnitude that a measured number may have, in metres, pixels or radians; anything beyond it,
positive or negative, was not measured"""

_LARGEST_PACKED: Final = 1 << 28
"""The most items along one axis of an array in a message, and the most bytes of a request"""
_MOST_DIMENSIONS: Final = 8
_DTYPES: Final = ("bool", "uint8", "int32", "int64", "float32", "float64")

_KINDS: Final = {"f": "floats", "b": "bools", "i": "whole numbers"}
_HELD: Final = {"f": "fiu", "b": "b", "i": "iu"}
"""NumPy's kinds that are as good as a declared one: whole numbers can be computed with as floats can"""
_KEPT: Final = {"f": "f", "b": "b", "i": "iu"}
"""NumPy's kinds that files may hold for a declared one: nobody writes whole numbers for floats"""

_Class = TypeVar("_Class", bound=type)
_Object = TypeVar("_Object")


@dataclass(frozen=True)
class Array:
    """The declaration of one array field of a dataclass: its shape, kind and bounds."""

    shape: tuple[int | str, ...]
    """The size of each axis: a number, or a letter for an axis that has one size in all arrays of an
    object"""
    kind: Literal["f", "b", "i"] = "f"
    """The kind of the entries: floats ("f"), bools ("b") or whole numbers ("i")"""
    finite: str = ""
    """Where floats must be finite: everywhere ("all"), in the rows that the object's attribute of that name,
    (T,) bool, says, or nowhere (""). NaN stands elsewhere for what is not known; infinity is beyond `most`"""
    most: float = LARGEST
    """The largest magnitude that a number in the array may have, positive or negative"""
    most_rows: float = math.inf
    """How many rows the array may have along its first axis"""
    sent: type = np.float64
    """The type in which floats are sent in messages"""
    optional: bool = False
    """True if the array may be absent, which is None in an object"""

    def check_form(self, name: str, array: np.ndarray, axes: dict[str, int]) -> None:
        """Raise Unfit, which names the array, unless it is of this shape and kind. `axes` has the known sizes
        of lettered axes, and gets those that become known."""
        fits = array.ndim == len(self.shape) and all(
            (axes.setdefault(n, m) if isinstance(n, str) else n) == m
            for n, m in zip(self.shape, array.shape, strict=True)
        )
        if not fits:
            wanted = str(tuple(axes.get(n, n) if isinstance(n, str) else n for n in self.shape))
            raise Unfit(f"{name} has shape {array.shape}, expected {wanted.replace(chr(39), '')}")
        if array.dtype.kind not in _HELD[self.kind]:
            raise Unfit(f"{name} holds {array.dtype}, expected {_KINDS[self.kind]}")
        if array.ndim and len(array) > self.most_rows:
            raise Unfit(f"{name} has {len(array)} rows, more than {self.most_rows}")

    def check_numbers(self, name: str, array: np.ndarray, of: Any) -> None:
        """Raise Unfit, which names the array, unless the numbers of that object's array are within bounds."""
        if self.finite == "all" and not np.isfinite(array).all():
            raise Unfit(f"{name} is not finite")
        if self.finite not in ("", "all") and not np.isfinite(array[getattr(of, self.finite)]).all():
            raise Unfit(f"{name} is not finite where the hand is {self.finite}")
        if np.any(np.abs(np.asarray(array, dtype=np.float64)) > self.most):  # NaN is not
            raise Unfit(f"{name} holds numbers beyond {self.most:g}")

    def dtype(self, floats: type) -> type:
        """The dtype in which the array is kept or sent, where floats are kept as `floats`."""
        return {"f": floats, "b": bool, "i": np.int64}[self.kind]


def array(
    *shape: int | str,
    kind: Literal["f", "b", "i"] = "f",
    finite: str = "",
    most: float = LARGEST,
    most_rows: float = math.inf,
    sent: type = np.float64,
    default: Any = MISSING,
) -> Any:
    """A field that holds an array, as `Array` says. `default`: None for one that may be absent, or a number
    that fills an array of a fixed shape."""
    metadata = {"array": Array(shape, kind, finite, most, most_rows, sent, default is None)}
    if default is None or default is MISSING:
        return field(default=default, metadata=metadata)
    sizes = [n for n in shape if isinstance(n, int)]
    return field(default_factory=lambda: np.full(sizes, default), metadata=metadata)


@dataclass(frozen=True)
class Value:
    """The declaration of one plain-valued field of a dataclass."""

    kind: Callable[..., Any]
    """Reads a value of that name out of a message, or passes it: `kind(name, value)` raises Unfit. It takes
    the bounds as well"""
    bounds: Mapping[str, float]


def value(kind: Callable[..., Any], default: Any = MISSING, **bounds: float) -> Any:
    """A field that holds a plain value, as `Value` says. `default`: a class for a new object of it."""
    metadata = {"value": Value(kind, bounds)}
    if isinstance(default, type):
        return field(default_factory=default, metadata=metadata)
    return field(default=default, metadata=metadata)


@dataclass_transform(eq_default=False, frozen_default=True, field_specifiers=(array, value, field))
def array_dataclass(cls: _Class) -> _Class:
    """Make of a class a frozen dataclass, whose fields may be arrays; an object equals none but itself."""
    return dataclass(frozen=True, eq=False)(cls)


def declared_values(of: Any) -> dict[str, Value]:
    """The plain values of a dataclass, or of one of its objects, by their fields' names."""
    fields = of.__dataclass_fields__.items()
    return {name: each.metadata["value"] for name, each in fields if "value" in each.metadata}


def declared(of: Any) -> dict[str, Array]:
    """The arrays of a dataclass, or of one of its objects, by their fields' names."""
    return _declared(of if isinstance(of, type) else type(of))


@cache
def _declared(cls: Any) -> dict[str, Array]:
    fields = cls.__dataclass_fields__.items()
    return {name: each.metadata["array"] for name, each in fields if "array" in each.metadata}


def arrays_of(of: Any, axis: str | None = None) -> dict[str, Any]:
    """Return an object's arrays by their names, without absent ones; with `axis`, only the arrays whose first
    axis has that letter."""
    found = {n: getattr(of, n) for n, spec in declared(of).items() if axis in (None, *spec.shape[:1])}
    return {name: value for name, value in found.items() if value is not None}


def check_arrays(of: Any, error: type[Exception] = Unfit, where: str = "", **axes: int) -> None:
    """Raise an `error` that begins with `where` and names the field, unless all arrays and values of an
    object are as declared. `axes`: sizes that lettered axes must have."""
    specs = declared(of)
    values = {name: getattr(of, name) for name in specs}
    given = {n: np.asarray(v) for n, v in values.items() if v is not None or not specs[n].optional}
    try:
        for name, spec in declared_values(of).items():
            spec.kind(name, getattr(of, name), **spec.bounds)
        for name, value in given.items():
            specs[name].check_form(name, value, axes)
        # Only then, as other arrays say where floats must be finite.
        for name, value in given.items():
            specs[name].check_numbers(name, value, of)
    except Unfit as unfit:
        raise error(f"{where}{unfit}") from unfit


def pack(array: np.ndarray) -> dict[str, Any]:
    """Turn an array of numbers into what JSON can hold: {"dtype", "shape", "data"}, little-endian, in C
    order, base64. NaN may be in it. Raises ProtocolError for other dtypes than those of numbers and bool."""
    array = np.asarray(array)
    if array.dtype.name not in _DTYPES:
        raise ProtocolError(f"arrays in messages are {', '.join(_DTYPES)}; not {array.dtype}")
    plain = np.ascontiguousarray(array, dtype=array.dtype.newbyteorder("<"))
    return {
        "dtype": array.dtype.name,
        "shape": list(array.shape),
        "data": base64.b64encode(plain.tobytes()).decode("ascii"),
    }


def unpack(packed: object) -> np.ndarray:
    """Turn what `pack` made back into the array, writable and in the machine's byte order. Raises
    ProtocolError."""
    try:
        assert isinstance(packed, dict)
        name, shape = packed["dtype"], packed["shape"]
        assert name in _DTYPES
        assert isinstance(shape, list)
        assert len(shape) <= _MOST_DIMENSIONS
        shape = [whole("shape", n, 0, _LARGEST_PACKED) for n in shape]
        data = base64.b64decode(packed["data"], validate=True)
        dtype = np.dtype(name)
        assert len(data) == math.prod(shape) * dtype.itemsize
        return np.frombuffer(data, dtype=dtype.newbyteorder("<")).astype(dtype).reshape(shape)
    except (AssertionError, KeyError, TypeError, ValueError, binascii.Error) as error:
        raise ProtocolError(
            "an array in a message must be an object with dtype, shape and data in base64 of that size"
        ) from error


def packed(of: Any) -> dict[str, Any]:
    """Return an object's values and arrays as a message holds them; absent arrays are left out."""
    values = {name: getattr(of, name) for name in declared_values(of)}
    # A value that is an object, as a camera is, is sent as the list of its fields.
    plain = {n: list(vars(v).values()) if is_dataclass(v) else v for n, v in values.items()}
    specs = declared(of)
    arrays = {
        name: pack(np.asarray(a, specs[name].dtype(specs[name].sent))) for name, a in arrays_of(of).items()
    }
    return plain | arrays


def unpacked(cls: type, message: Mapping[str, Any], where: str = "") -> dict[str, Any]:
    """The values and arrays of a dataclass's object out of a message, by their fields' names, floats as
    float64; those that may be absent and are, are left out. Raises ProtocolError that begins with `where` and
    names the field for a lack, and for what is not of its kind; `check_arrays` looks at the rest."""
    found: dict[str, Any] = {}
    try:
        for name, each in declared_values(cls).items():
            declared_as = cls.__dataclass_fields__[name]
            if name in message or declared_as.default is declared_as.default_factory is MISSING:
                found[name] = each.kind(name, message.get(name))
    except Unfit as error:
        raise ProtocolError(f"{where}{error}") from error
    for name, spec in declared(cls).items():
        if name not in message:
            if spec.optional:
                continue
            raise ProtocolError(f"{where}{name} is missing")
        try:
            array = unpack(message[name])
        except ProtocolError as error:
            raise ProtocolError(f"{where}{name}: {error}") from error
        if array.dtype.kind not in _HELD[spec.kind]:
            raise ProtocolError(f"{where}{name} holds {array.dtype}, expected {_KINDS[spec.kind]}")
        found[name] = array.astype(spec.dtype(np.float64), copy=False)
    return found


def object_of(cls: type[_Object]) -> Callable[[str, Any], _Object]:
    """Make the check that turns a JSON object into an object of the class, all of whose fields are plain
    values."""

    def read(name: str, value: Any) -> _Object:
        if not isinstance(value, Mapping):
            raise Unfit(f"{name} must be an object, not {shortly(value)}")
        return cls(**unpacked(cls, value, f"{name}: "))

    return read


def kept_arrays(of: Any, prefix: str = "", floats: type = np.float64) -> dict[str, np.ndarray]:
    """Return an object's arrays as an `.npz` holds them, named after `prefix`; absent ones are left out."""
    specs = declared(of)
    return {f"{prefix}{name}": np.asarray(a, specs[name].dtype(floats)) for name, a in arrays_of(of).items()}


def reading_arrays(
    cls: type, archive: NpzArchive, prefix: str = ""
) -> Generator[None, None, dict[str, np.ndarray]]:
    """The inverse of `kept_arrays`, a step an array; none is made of another kind or beyond the archive's
    limit. Raises KeyError for a lack, and NotNpz; `check_arrays` looks at the rest."""
    found = {}
    for name, spec in declared(cls).items():
        if f"{prefix}{name}" in archive or not spec.optional:
            found[name] = archive.array(f"{prefix}{name}", _KEPT[spec.kind])
            yield
    return found
