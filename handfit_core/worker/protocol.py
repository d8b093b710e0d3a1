"""The messages between Blender and the worker process: JSON lines, arrays packed into them.

Both sides import this, so it needs no more than NumPy. docs/worker-protocol.md describes every message.
"""

from __future__ import annotations

import base64
import binascii
import json
import math
from collections.abc import Mapping
from typing import Any, Final

import numpy as np

from handfit_core.errors import ProtocolError

PROTOCOL: Final = 1
"""Version of the messages; the `ready` event carries it, and both sides must have the same"""

JOBS: Final = ("capture", "probe", "refit", "warm", "check")
"""Requests that are done one at a time, in order, and answered by `done` or `error`"""

REQUESTS: Final = (*JOBS, "cancel", "end")
"""`cancel` and `end` act at once and have no answer of their own"""

_DTYPES: Final = ("bool", "uint8", "int32", "int64", "float32", "float64")


def encode(message: Mapping[str, Any]) -> bytes:
    """One message -> one line, its end included.

    Plain ASCII: whatever a file is called, the line is valid UTF-8 and comes back as it was. Raises
    ProtocolError for what JSON cannot hold: NaN outside a packed array, and objects.
    """
    try:
        return json.dumps(message, allow_nan=False, separators=(",", ":")).encode("ascii") + b"\n"
    except (TypeError, ValueError) as error:
        raise ProtocolError(f"a message must hold JSON's types only ({error}); pack arrays") from error


def decode(line: bytes) -> dict[str, Any]:
    """One line -> its message. Raises ProtocolError for anything but one JSON object."""
    try:
        message = json.loads(line.decode("utf-8"), parse_constant=_no_number)
    except (ValueError, RecursionError) as error:
        raise ProtocolError(f"a line that is not JSON came: {_beginning(line)}") from error
    if not isinstance(message, dict):
        raise ProtocolError(f"a message must be one JSON object a line; got {_beginning(line)}")
    return message


def _no_number(name: str) -> None:
    """Python reads NaN and Infinity where JSON has none."""
    raise ValueError(name)


def _beginning(line: bytes) -> str:
    text = line.decode("utf-8", errors="replace").strip()
    return repr(text if len(text) <= 60 else f"{text[:60]}...")


def pack(array: np.ndarray) -> dict[str, Any]:
    """An array of numbers -> what JSON can hold: {"dtype", "shape", "data"}, little-endian, in C order,
    base64. NaN is fine here. Raises ProtocolError for other dtypes than those of numbers and bool."""
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
    """What `pack` made -> the array, writable and in the machine's byte order. Raises ProtocolError."""
    try:
        assert isinstance(packed, dict)
        name, shape = packed["dtype"], [int(n) for n in packed["shape"]]
        assert name in _DTYPES
        data = base64.b64decode(packed["data"], validate=True)
        dtype = np.dtype(name)
        assert min(shape, default=0) >= 0
        assert len(data) == math.prod(shape) * dtype.itemsize
    except (AssertionError, KeyError, TypeError, ValueError, binascii.Error) as error:
        raise ProtocolError(
            "an array in a message must be an object with dtype, shape and data in base64 of that size"
        ) from error
    return np.frombuffer(data, dtype=dtype.newbyteorder("<")).astype(dtype).reshape(shape)


def check_id(message: Mapping[str, Any], key: str = "id") -> int:
    """The message's `id`, or `job` of a cancel. Raises ProtocolError unless it is a positive integer."""
    number = message.get(key)
    if not isinstance(number, int) or isinstance(number, bool) or number < 1:
        raise ProtocolError(f"a request's {key} must be a positive whole number, not {number!r}")
    return number
