"""Hostile pickles of hand models: they want to run, to fill the memory, to take forever, to go too deep."""

from __future__ import annotations

import pickle
import struct
from collections.abc import Callable, Iterator
from functools import cache, partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from tests.hostile.engine import Case, table
from tests.hostile.mutations import mutants
from tests.hostile.npz import ARRAY_LIES
from tests.imitation_mano import imitation_arrays, write_mano_pickle

FILE = "MANO_RIGHT.pkl"
COMMAND = b"touch canary"


@cache
def mano() -> bytes:
    return _written(imitation_arrays("right"))


def _written(arrays: dict[str, Any]) -> bytes:
    with TemporaryDirectory() as folder:
        return write_mano_pickle(Path(folder) / "a.pkl", arrays).read_bytes()


def _text(value: bytes) -> bytes:
    return pickle.BINUNICODE + struct.pack("<I", len(value)) + value


def _payloads() -> Iterator[tuple[str, bytes]]:
    """One payload by every opcode that calls, and under every name that could get through."""
    argument = b"(" + _text(COMMAND) + b"t"
    for module, name in (
        ("os", "system"), ("builtins", "eval"), ("__builtin__", "eval"), ("builtins", "getattr"), ("numpy", "load"), ("chumpy.ch", "os.system"), ("chumpy", "__import__"),
        ("scipy.sparse.csc", "csc_matrix.__init__"), ("numpy.core.multiarray", "os.system"), ("_codecs", "decode"),
        ("handfit_core.common.safe_pickle", "load"), ("copyreg", "__newobj__"), ("operator", "attrgetter"),
    ):  # fmt: skip
        found = f"c{module}\n{name}\n".encode()
        stacked = _text(module.encode()) + _text(name.encode()) + pickle.STACK_GLOBAL
        tag = f"{module}.{name}"
        yield f"reduce-{tag}", b"\x80\x02" + found + argument + b"R."
        yield f"stacked-{tag}", b"\x80\x04" + stacked + argument + b"R."
        yield f"newobj-{tag}", b"\x80\x02" + found + argument + b"\x81."
        yield f"inst-{tag}", b"(" + _text(COMMAND) + f"i{module}\n{name}\n.".encode()
        yield f"obj-{tag}", b"(" + found + _text(COMMAND) + b"o."
    yield "persistent", b"P" + COMMAND + b"\n."
    yield "binary-persistent", _text(COMMAND) + b"Q."
    yield "extension", b"\x82\x01."
    yield (
        "build",
        b"cnumpy\nndarray\n(tR}" + _text(b"__setstate__") + b"cos\nsystem\nsb" + _text(COMMAND) + b"b.",
    )
    yield "reconstructor", b"ccopy_reg\n_reconstructor\n(cos\nsystem\n" + _text(COMMAND) + b"NtR."


DEEP = 200_000
MODULUS = (1 << 61) - 1
"""Python's hash of each multiple of this number is 0."""
_ENCODE = b"c_codecs\nencode\n"


def _colliding(between: bytes) -> bytes:
    numbers = ((n * MODULUS).to_bytes(11, "little", signed=True) for n in range(130_000))
    return b"".join(b"\x8a\x0b" + number + between for number in numbers)


def _encoded(times: int, after: bytes) -> bytes:
    """8 MB of text, encoded again and again out of the memo."""
    text = _text(b"\xc3\xa9" * 4_000_000) + b"q\x000"
    pair = b"h\x00" + _text(b"latin1") + b"\x86q\x010" + _ENCODE + b"q\x020"
    return b"\x80\x02" + text + pair + (b"h\x02h\x01R" + after) * times + b"N."


def _doubled(opening: bytes, closing: bytes) -> bytes:
    """Each holds the one before it twice: small here, 2^200 in whatever walks through it."""
    return opening + b"q\x00" + b"".join(
        b"(" + b"h" + bytes([n]) + b"h" + bytes([n]) + closing + b"q" + bytes([n + 1]) for n in range(200)
    )  # fmt: skip


_BOMBS: dict[str, Callable[[], bytes]] = {
    "deep-tuple-as-key": lambda: b"\x80\x02})" + b"\x85" * DEEP + b"Ns.",
    "deep-tuple-in-set": lambda: b"\x80\x04\x8f()" + b"\x85" * DEEP + b"\x90.",
    "deep-tuple-in-frozenset": lambda: b"\x80\x04()" + b"\x85" * DEEP + b"\x91.",
    "deep-list": lambda: b"\x80\x02" + b"]" * DEEP + b"a" * (DEEP - 1) + b".",
    "deep-dict": lambda: b"\x80\x02" + b"}N" * DEEP + b"}" + b"s" * DEEP + b".",
    "deep-marks": lambda: b"(" * DEEP + b"t" * DEEP + b".",
    "deep-stand-in": lambda: b"\x80\x02cnumpy\nndarray\n)" + b"\x85" * DEEP + b"R.",
    "deep-state": lambda: b"\x80\x02cnumpy\nndarray\n)\x81q\x00" + b"\x85" * DEEP + b"h\x00b.",
    "encode-flood": lambda: _encoded(400, b"0"),
    "encode-flood-kept": lambda: _encoded(400, b""),
    "colliding-keys": lambda: b"\x80\x02}(" + _colliding(b"N") + b"u.",
    "colliding-members": lambda: b"\x80\x04\x8f(" + _colliding(b"") + b"\x90.",
    "colliding-frozen": lambda: b"\x80\x04(" + _colliding(b"") + b"\x91.",
    "colliding-tuples": lambda: b"\x80\x02}(" + _colliding(b"\x85N") + b"u.",
    "laughing-lists": lambda: b"\x80\x02" + _doubled(b"]", b"l") + b".",
    "laughing-key": lambda: b"\x80\x02}" + _doubled(b")", b"t") + b"Ns.",
    "laughing-member": lambda: b"\x80\x04\x8f(" + _doubled(b")", b"t") + b"\x90.",
    "long-number": lambda: b"I" + b"9" * 5_000_000 + b"\n.",
    "long4": lambda: b"\x80\x02\x8b\xff\xff\xff\x7f.",
    "long-bytes": lambda: b"\x80\x02\x8b" + struct.pack("<I", 8_000_000) + b"\x7f" * 8_000_000 + b".",
    "duplicates": lambda: b"\x80\x02" + _text(b"x" * 1000) + b"2" * 8_000_000 + b".",
    "memo-flood": lambda: b"\x80\x02N" + b"".join(b"r" + struct.pack("<I", n) for n in range(900_000)) + b".",
    "memo-far": lambda: b"\x80\x02Nr\xff\xff\xff\xff.",
    "memoize-flood": lambda: b"\x80\x04N" + b"\x94" * 9_000_000 + b".",
    "empty-dicts": lambda: b"\x80\x02(" + b"}" * 9_000_000 + b"t.",
    "stand-ins": lambda: b"\x80\x02cnumpy\nndarray\nq\x00(" + b"h\x00)R" * 2_400_000 + b"t.",
    "frame": lambda: b"\x80\x04\x95" + b"\xff" * 8 + b"N.",
    "frames": lambda: b"\x80\x04" + (b"\x95" + bytes(8)) * 1_000_000 + b"N.",
    **{
        f"{name}-2-{power}": lambda code=code, power=power: (
            b"\x80\x05" + code + struct.pack("<Q", 1 << power) + b"x."
        )
        for name, code in (("bytes8", b"\x8e"), ("text8", b"\x8d"), ("bytearray8", b"\x96"))
        for power in (32, 63)
    },
    "pops": lambda: b"0" * 100 + b".",
    "nothing": lambda: b"",
    "proto-255": lambda: b"\x80\xffN.",
    "no-stop": lambda: b"N" * 5_000_000,
    "a-list": lambda: pickle.dumps([1, 2, 3]),
    "number-keys": lambda: pickle.dumps(dict.fromkeys(range(1000))),
}


_LIES: dict[str, Callable[[np.ndarray], Any]] = {
    **ARRAY_LIES,
    "words": lambda _: "words",
    "none": lambda _: None,
    "list": lambda _: [[1.0, 2.0]],
    "objects": lambda _: np.array([1, "x", None], dtype=object),
}


def _lying(key: str, lie: str) -> bytes:
    arrays: dict[str, Any] = dict(imitation_arrays("right"))
    arrays[key] = _LIES[lie](arrays[key])
    if key == "J_regressor" and np.shape(arrays[key]) != (16, 778):  # no sparse matrix could be made of it
        arrays[key] = np.zeros((3, 5))
    return _written(arrays)


KNOWN = ("deep-tuple-as-key", "deep-tuple-in-set", "encode-flood-kept", "colliding-keys")


def harms() -> Iterator[tuple[str, Callable[[], bytes]]]:
    """Pickles that no door may take, by name."""
    for name, data in _payloads():
        yield f"runs-{name}", lambda data=data: data
    for name, made in _BOMBS.items():
        yield f"bomb-{name}", made


def cases() -> Iterator[Case]:
    yield from mutants("pickle", "core.model", mano, FILE, 16, side="right")
    known = {f"bomb-{name}" for name in KNOWN}
    yield from table("pickle", "core.model", FILE, dict(harms()), refused=True, known=known, side="right")
    keys = sorted(imitation_arrays("right").keys() - {"J", "hands_coeffs"})
    lies = {f"{key}-{lie}": partial(_lying, key, lie) for key in keys for lie in _LIES}
    yield from table("pickle", "core.model", FILE, lies, side="right")
