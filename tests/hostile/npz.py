"""Lies that any .npz can tell: in the zip around its arrays, in an array's own header, in its values."""

from __future__ import annotations

import io
import json
import struct
import zipfile
from collections.abc import Callable, Iterator
from functools import cache, partial
from typing import Any

import numpy as np

from tests.hostile.engine import Case, Place, file_case
from tests.hostile.mutations import json_with, system_call

Arrays = dict[str, np.ndarray]

DEEP = 100_000
"""Brackets in brackets: more than any parser's stack."""

VALUES: dict[str, str] = {
    "null": "null", "true": "true", "minus": "-1", "zero": "0", "nan": "NaN", "infinity": "Infinity", "huge": "1e308",
    "whole": "9" * 400, "text": '"x"', "surrogate": r'"\ud800"', "nul": r'"a\u0000b"', "list": "[]",
    "lists": "[[[1]], null]", "object": "{}", "deep": "[" * DEEP + "]" * DEEP,
}  # fmt: skip
"""What may stand in JSON where something else is expected, by name."""


def member(array: np.ndarray) -> bytes:
    stream = io.BytesIO()
    np.lib.format.write_array(stream, array, allow_pickle=True)
    return stream.getvalue()


def raw_member(shape: str, descr: str = "'<f8'", data: bytes = bytes(64), version: int = 1) -> bytes:
    header = f"{{'descr': {descr}, 'fortran_order': False, 'shape': {shape}, }}\n".encode("latin1")
    size = struct.pack("<H" if version == 1 else "<I", len(header))
    return b"\x93NUMPY" + bytes((version, 0)) + size + header + data


def zipped(members: dict[str, bytes], compression: int = zipfile.ZIP_DEFLATED) -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", compression, compresslevel=6) as archive:
        for name, data in members.items():
            archive.writestr(zipfile.ZipInfo(f"{name}.npy"), data, compression)
    return stream.getvalue()


def bomb(members: dict[str, bytes], name: str, size: int) -> bytes:
    """A zip whose member `name` unpacks from a thousandth to `size` zero bytes (uint8)."""
    stream, chunk = io.BytesIO(), bytes(1 << 20)
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED, compresslevel=6) as archive:
        for other, data in members.items():
            archive.writestr(f"{other}.npy", data)
        with archive.open(f"{name}.npy", "w") as packed:
            packed.write(raw_member(f"({size},)", "'|u1'", b""))
            for _ in range(size // len(chunk)):
                packed.write(chunk)
    return stream.getvalue()


ARRAY_LIES: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "nan": lambda a: np.full(a.shape, np.nan),
    "infinity": lambda a: np.full(a.shape, np.inf),
    "huge": lambda a: np.full(a.shape, 1e300),
    "large": lambda a: np.full(a.shape, 3e15),
    "whole": lambda a: np.full(a.shape, np.iinfo(np.int64).min),
    "minus": lambda a: np.full(a.shape, -1, np.int64),
    "unsigned": lambda a: np.full(a.shape, np.iinfo(np.uint64).max),
    "complex": lambda a: np.full(a.shape, 1 + 2j),
    "text": lambda a: np.full(a.shape, "1"),
    "bytes": lambda a: np.full(a.shape, b"1"),
    "time": lambda a: np.zeros(a.shape, "M8[s]"),
    "record": lambda a: np.zeros(a.shape, [("x", "f8"), ("y", "U3")]),
    "half": lambda a: np.full(a.shape, 6e4, np.float16),
    "empty": lambda a: np.zeros((0, *a.shape[1:])),
    "scalar": lambda _: np.array(1.0),
    "longer": lambda a: np.concatenate([np.atleast_1d(a)] * 2),
    "flat": lambda a: np.ravel(a),
    "deeper": lambda a: a[..., None],
    "turned": lambda a: a.T if a.ndim > 1 else np.atleast_1d(a)[::-1],
}

_HEADER_LIES: dict[str, bytes] = {
    "claims-2-31": raw_member("(2147483648, 3)"),
    "claims-2-62": raw_member(f"({1 << 62},)"),
    "overflows": raw_member(f"({1 << 32}, {1 << 32})"),
    "negative": raw_member("(-3, 3)"),
    "boolean": raw_member("(True, 3)"),
    "float": raw_member("(1e3,)"),
    "many-axes": raw_member("(" + "1, " * 70 + ")", data=bytes(8)),
    "deep-shape": raw_member("(" * 5000 + ")" * 5000),
    "deep-header": raw_member("()", "[" * 9000 + "]" * 9000),
    "code": raw_member("()", "__import__('os').system('touch canary')"),
    "wide-item": raw_member("(4,)", "'<U500000000'"),
    "no-item": raw_member("(4,)", "'V0'"),
    "nested-record": raw_member("(4,)", "[('x', [('y', '<f8', (9999, 9999))])]"),
    "subarray": raw_member("()", "('<f8', (30000, 30000))"),
    "long-header": b"\x93NUMPY\x02\x00\xff\xff\xff\xff{",
    "other-version": b"\x93NUMPY\x09\x00\x10\x00" + b" " * 16,
    "objects": member(np.array([{"a": 1}, None], dtype=object)),
    "payload": raw_member("(1,)", "'|O'", system_call()),
    "no-array": b"plain words",
    "nothing": b"",
}


_ZIP_LIES: dict[str, Callable[[dict[str, bytes]], bytes]] = {
    "bomb-many": lambda members: zipped({**members, **{f"u{n}": bytes(30 << 20) for n in range(60)}}),
    "members-60000": lambda members: zipped({**members, **dict.fromkeys(map(str, range(60_000)), b"")}, zipfile.ZIP_STORED),
    "upwards": lambda members: zipped({"../../canary": b"x", "/tmp/canary": b"x", **members}),
    "stored": lambda members: zipped(members, zipfile.ZIP_STORED)[:-1],
    "bzip2": lambda members: zipped(members, zipfile.ZIP_BZIP2),
    "lzma": lambda members: zipped(members, zipfile.ZIP_LZMA),
    "secret": lambda members: zipped(members).replace(
        b"PK\x01\x02\x14\x00\x14\x00\x00", b"PK\x01\x02\x14\x00\x14\x00\x01"
    ),
}  # fmt: skip
_NO_ZIPS: dict[str, Callable[[dict[str, bytes]], bytes]] = {
    "a-npy-alone": lambda members: next(data for name, data in members.items() if name != "header"),
    "a-pickle": lambda _: system_call(),
    "nothing": lambda _: b"",
    "zeros": lambda _: bytes(100_000),
    "an-empty-zip": lambda _: zipped({}),
}


def some(name: str, part: int) -> bool:
    """Whether this is one of a part of the cases, which are more than anybody waits for."""
    return sum(name.encode("utf-8", "replace")) % part == 0


def lies(
    stem: str, door: str, good: Callable[[], Arrays], file: str, *, ours: bool = True, **arguments: Any
) -> Iterator[Case]:
    """Cases for an npz of these arrays; the door gets the path and `arguments`. Not `ours`: it has no header,
    and arrays that nobody reads."""
    members = cache(lambda: {key: member(array) for key, array in good().items()})

    def case(name: str, build: Callable[[dict[str, bytes]], bytes], **options: bool) -> Case:
        return file_case(f"{stem}-{name}", door, file, lambda _: build(members()), **options, **arguments)

    def changed(name: str, change: Callable[[np.ndarray], np.ndarray]) -> Callable[[dict[str, bytes]], bytes]:
        return lambda members: zipped({**members, name: member(np.asarray(change(good()[name])))})

    def without(members: dict[str, bytes], name: str) -> dict[str, bytes]:
        return {key: data for key, data in members.items() if key != name}

    names = [name for name in good() if name != "header"]
    for name in names:
        for lie, change in ARRAY_LIES.items():
            known = (name, lie) in {("hand0_betas", "nan"), ("faces", "flat")}
            yield case(f"{name}-{lie}", changed(name, change), known=known)
        yield case(f"{name}-missing", lambda members, name=name: zipped(without(members, name)))
    for number, (lie, data) in enumerate(_HEADER_LIES.items()):
        for name in ("header", names[number % len(names)], "unknown"):
            with_it = lambda members, name=name, data=data: zipped({**members, name: data})  # noqa: E731
            yield case(f"{lie}-{name}", with_it, refused=ours and name != "unknown")
    for name in ("unknown", names[0], "header"):
        packed = lambda members, name=name: bomb(without(members, name), name, 3 << 29)  # noqa: E731
        yield case(f"bomb-{name}", packed, known=True)
    for name, build in _ZIP_LIES.items():
        yield case(name, build, known=name in ("bomb-many", "members-60000"))
    for name, build in _NO_ZIPS.items():
        yield case(name, build, refused=True)
    first = "header" if ours else names[0]
    yield case("twice", lambda members: zipped(members) + zipped({first: members[first]}))


def npy_lies(
    stem: str, door: str, good: Callable[[], np.ndarray], file: str, **arguments: Any
) -> Iterator[Case]:
    """The same lies of a .npy of one array."""
    for lie, change in ARRAY_LIES.items():
        data = lambda _, change=change: member(np.asarray(change(good())))  # noqa: E731
        yield file_case(f"{stem}-{lie}", door, file, data, **arguments)
    for lie, data in _HEADER_LIES.items():
        yield file_case(f"{stem}-{lie}", door, file, lambda _, data=data: data, refused=True, **arguments)


def header_lies(
    stem: str,
    door: str,
    good: Callable[[], Arrays],
    file: str,
    fields: list[tuple[str, ...]],
    **arguments: Any,
) -> Iterator[Case]:
    """Cases in which one field of the JSON in `header` holds each of VALUES."""

    def lying(field: tuple[str, ...], text: str, _: Place) -> bytes:
        arrays = dict(good())
        arrays["header"] = np.array(json_with(json.loads(str(arrays["header"][()])), field, text))
        return zipped({key: member(array) for key, array in arrays.items()})

    for field in fields:
        for value, text in VALUES.items():
            known = (field[-1], value) in {("fps", "infinity"), ("width", "whole"), ("solver", "object")}
            name, data = f"{stem}-{'-'.join(field)}-{value}", partial(lying, field, text)
            yield file_case(name, door, file, data, known=known, **arguments)
