"""Metadata for TensorFlow Lite's model files, added without TensorFlow's own tools, and the removal of
outputs.

A model file is a FlatBuffer (https://flatbuffers.dev/internals): tables refer to objects behind them by
offsets in bytes. So a new root table with the metadata goes before the old file, which stays as it is.
MediaPipe's tasks read the metadata (schema: `mediapipe/tasks/metadata/metadata_schema.fbs`).
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from typing import Final

Writer = Callable[[bytearray], int]
"""Function that appends an object to a buffer, or finds it there, and returns its offset in bytes"""
Field = int | Writer | None
"""A table's field: a number, the object that it refers to, or absent"""

_PREFIX_BYTES: Final = 4096
"""Bytes that are put before the old file: a multiple of the 16 to which tensors are aligned"""
_SUBGRAPHS, _BUFFERS, _METADATA, _MODEL_FIELDS = 2, 4, 6, 7
"""Numbers of fields of the root table, and how many of its fields are copied"""
_OUTPUTS, _OPERATORS, _SUBGRAPH_FIELDS = 2, 3, 5
"""Numbers of fields of a subgraph's table, and how many of its fields are copied"""
_OPERATOR_INPUTS, _OPERATOR_OUTPUTS = 1, 2
"""Numbers of fields of an operator's table"""
_FEATURE, _IMAGE, _NORMALIZATION, _RGB = 1, 2, 1, 1
"""Values of the metadata's unions and of its colour space"""


def with_image_metadata(
    network: bytes, mean: float, std: float, outputs: Sequence[str], kept: Sequence[int] | None = None
) -> bytes:
    """Give a model file the metadata of a network with one RGB picture as input, in place of its own.

    A picture's channel is 0..255 before (channel - mean) / std; `outputs` names the network's outputs, which
    are feature vectors. With `kept`, the indices of those that stay, the others are left out, and so are the
    operators that only they need. Equal arguments give equal bytes.
    """
    (root,) = struct.unpack_from("<I", network)
    weights = [_existing(place) for place in _referred(network, root, _BUFFERS)]
    fields: list[Field] = []
    for i in range(_MODEL_FIELDS):
        at = _field(network, root, i)
        value = 0 if at is None else _number(network, at)
        # The first is the schema's version; all others refer to something.
        fields.append(None if at is None else value if i == 0 else _existing(at + value))
    if kept is not None:
        fields[_SUBGRAPHS] = _vector(_pruned(network, root, kept))
    metadata = bytearray()
    _references(metadata, [_image_metadata(mean, std, outputs)], between=b"M001")
    fields[_BUFFERS] = _vector(*weights, _table(_bytes(bytes(metadata))))
    fields[_METADATA] = _vector(_table(_bytes(b"TFLITE_METADATA\0", counted=15), len(weights)))
    made = bytearray()
    _references(made, [_table(*fields)], between=b"TFL3")
    assert len(made) <= _PREFIX_BYTES
    return bytes(made).ljust(_PREFIX_BYTES, b"\0") + network


def _pruned(network: bytes, root: int, kept: Sequence[int]) -> Writer:
    """Make the table of the only subgraph, with the outputs of the indices `kept` and the operators that they
    need."""
    (graph,) = _referred(network, root, _SUBGRAPHS)
    outputs = _numbers(network, graph, _OUTPUTS)
    wanted = {outputs[i] for i in kept}
    operators: list[Field] = []
    for operator in reversed(_referred(network, graph, _OPERATORS)):  # in the order of running
        if wanted.intersection(_numbers(network, operator, _OPERATOR_OUTPUTS)):
            wanted.update(_numbers(network, operator, _OPERATOR_INPUTS))
            operators.insert(0, _existing(operator))
    fields: list[Field] = []
    for i in range(_SUBGRAPH_FIELDS):
        at = _field(network, graph, i)
        fields.append(None if at is None else _existing(at + _number(network, at)))
    fields[_OUTPUTS], fields[_OPERATORS] = _vector(*(outputs[i] for i in kept)), _vector(*operators)
    return _table(*fields)


def _numbers(data: bytes, table: int, field: int) -> list[int]:
    """Return the whole numbers in the vector that a table's field refers to; empty where the field is
    absent."""
    if (at := _field(data, table, field)) is None:
        return []
    at += _number(data, at)
    return list(struct.unpack_from(f"<{_number(data, at)}I", data, at + 4))


def _referred(data: bytes, table: int, field: int) -> list[int]:
    """Return the offsets, in bytes, of the tables in the vector that a table's field refers to."""
    at = _field(data, table, field)
    assert at is not None
    at += _number(data, at) + 4
    return [at + 4 * i + offset for i, offset in enumerate(_numbers(data, table, field))]


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
    """Return the offset in bytes of a table's field; None where it is absent."""
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
    """Make a writer of a vector of bytes, aligned to 16 as tensors are; `counted` is the length that it
    states, where the last bytes do not count."""

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
