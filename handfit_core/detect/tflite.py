"""Metadata for TensorFlow Lite's model files, added without TensorFlow's own tools.

A model file is a FlatBuffer (https://flatbuffers.dev/internals): tables refer to objects behind them by
offsets in bytes. So a new root table with the metadata goes before the old file, which stays as it is.
MediaPipe's tasks read the metadata (schema: `mediapipe/tasks/metadata/metadata_schema.fbs`).
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from typing import Final

Writer = Callable[[bytearray], int]
"""Appends an object to a buffer, or finds it there; returns its offset"""
Field = int | Writer | None
"""A table's field: a number, the object that it refers to, or absent"""

_PREFIX_BYTES: Final = 4096
"""Before the old file: a multiple of the 16 to which tensors are aligned"""
_BUFFERS, _METADATA, _MODEL_FIELDS = 4, 6, 7
"""Fields of the root table, and how many are copied"""
_FEATURE, _IMAGE, _NORMALIZATION, _RGB = 1, 2, 1, 1
"""Values of the metadata's unions and of its colour space"""


def with_image_metadata(network: bytes, mean: float, std: float, outputs: Sequence[str]) -> bytes:
    """Add to a model file without metadata that of a network with one RGB picture as input.

    A picture's channel is 0..255 before (channel - mean) / std; `outputs` names all of the network's outputs,
    which are feature vectors. Equal arguments give equal bytes.
    """
    (root,) = struct.unpack_from("<I", network)
    buffers = _field(network, root, _BUFFERS)
    assert buffers is not None
    buffers += _number(network, buffers)
    many = _number(network, buffers)
    places = [buffers + 4 * i for i in range(1, many + 1)]
    kept = [_existing(place + _number(network, place)) for place in places]
    fields: list[Field] = []
    for i in range(_MODEL_FIELDS):
        at = _field(network, root, i)
        value = 0 if at is None else _number(network, at)
        # The first is the schema's version; all others refer to something.
        fields.append(None if at is None else value if i == 0 else _existing(at + value))
    metadata = bytearray()
    _references(metadata, [_image_metadata(mean, std, outputs)], between=b"M001")
    fields[_BUFFERS] = _vector(*kept, _table(_bytes(bytes(metadata))))
    fields[_METADATA] = _vector(_table(_bytes(b"TFLITE_METADATA\0", counted=15), many))
    made = bytearray()
    _references(made, [_table(*fields)], between=b"TFL3")
    return bytes(made).ljust(_PREFIX_BYTES, b"\0") + network


def _image_metadata(mean: float, std: float, outputs: Sequence[str]) -> Writer:
    scaling = _table(_vector(_float(mean)), _vector(_float(std)))
    picture = _table(_IMAGE, _table(_RGB))
    image = _table(_text("image"), None, None, picture, _vector(_table(_NORMALIZATION, scaling)))
    features = [_table(_text(name), None, None, _table(_FEATURE, _table())) for name in outputs]
    graph = _table(None, None, _vector(image), _vector(*features))
    return _table(None, None, None, _vector(graph), None, None, None, _text("1.0.0"))


def _number(data: bytes, at: int) -> int:
    return struct.unpack_from("<I", data, at)[0]


def _field(data: bytes, table: int, index: int) -> int | None:
    """Offset of a table's field; None where it is absent."""
    entries = table - struct.unpack_from("<i", data, table)[0]
    size = struct.unpack_from("<H", data, entries)[0]
    inside = 4 + 2 * index
    offset = struct.unpack_from("<H", data, entries + inside)[0] if inside < size else 0
    return table + offset if offset else None


def _float(value: float) -> int:
    return struct.unpack("<I", struct.pack("<f", value))[0]


def _existing(place: int) -> Writer:
    return lambda _: _PREFIX_BYTES + place


def _table(*fields: Field) -> Writer:
    def append(out: bytearray) -> int:
        entries = [0 if field is None else 4 + 4 * i for i, field in enumerate(fields)]
        sizes = (4 + 2 * len(fields), 4 + 4 * len(fields))
        described = struct.pack(f"<{2 + len(fields)}H", *sizes, *entries)
        out += bytes(-(len(out) + len(described)) % 4) + described
        return _references(out, fields, before=struct.pack("<i", len(described)))

    return append


def _vector(*items: Field) -> Writer:
    return lambda out: _references(out, items, before=struct.pack("<I", len(items)))


def _references(out: bytearray, fields: Sequence[Field], before: bytes = b"", between: bytes = b"") -> int:
    """Append numbers and offsets, between two other pieces, then the objects that the offsets lead to."""
    start = len(out)
    out += before + bytes(4 * len(fields)) + between
    for at, field in enumerate(fields):
        place = start + len(before) + 4 * at
        value = field(out) - place if callable(field) else field or 0
        struct.pack_into("<I", out, place, value)
    return start


def _bytes(content: bytes, counted: int | None = None) -> Writer:
    """A vector of bytes, aligned to 16 as tensors are; `counted` is its length where the last do not
    count."""

    def append(out: bytearray) -> int:
        out += bytes(-(len(out) + 4) % 16)
        start = len(out)
        out += struct.pack("<I", len(content) if counted is None else counted) + content
        out += bytes(-len(out) % 4)
        return start

    return append


def _text(text: str) -> Writer:
    content = text.encode()
    return _bytes(content + b"\0", len(content))
