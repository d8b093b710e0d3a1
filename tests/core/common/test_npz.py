"""`.npz` files from anywhere: what NumPy writes is read, what claims to be something else is not."""

import io
import json
import pickle
import struct
import tracemalloc
import zipfile
from typing import Any

import numpy as np
import pytest

from handfit_core.common.npz import NotNpz, NpzArchive, npy_array, npy_pickle

ENOUGH = 1_000_000
"""bytes that the arrays of these small files may have"""


def npy(array: np.ndarray) -> bytes:
    stream = io.BytesIO()
    np.save(stream, array, allow_pickle=True)
    return stream.getvalue()


def npz(compressed: bool = True, **arrays: Any) -> bytes:
    stream = io.BytesIO()
    (np.savez_compressed if compressed else np.savez)(stream, **arrays)
    return stream.getvalue()


def described(array: np.ndarray, **changes: Any) -> bytes:
    """A `.npy` whose description says something else than what follows it."""
    said = {"descr": array.dtype.str, "fortran_order": False, "shape": array.shape, **changes}
    stream = io.BytesIO()
    np.lib.format.write_array_header_1_0(stream, said)
    return stream.getvalue() + array.tobytes()


def zipped(*members: tuple[str, bytes], method: int = zipfile.ZIP_DEFLATED) -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", method) as archive:
        for name, data in members:
            archive.writestr(name, data)
    return stream.getvalue()


@pytest.mark.parametrize(
    ("array", "kinds"),
    [
        (np.arange(6.0).reshape(2, 3), "f"),
        (np.asfortranarray(np.arange(6, dtype=np.float32).reshape(2, 3)), "f"),
        (np.arange(6, dtype=">f8"), "f"),
        (np.arange(6, dtype=">i4"), "iu"),
        (np.array([True, False]), "b"),
        (np.zeros((0, 3), dtype=np.uint8), "iu"),
        (np.array(2.5), "f"),
    ],
    ids=str,
)
def test_what_numpy_writes_comes_back(array, kinds):
    for compressed in (True, False):
        archive = NpzArchive(npz(compressed, a=array, other=np.array([None])), ENOUGH)
        found = archive.array("a", kinds)
        np.testing.assert_array_equal(found, array)
        assert found.dtype == (np.float64 if kinds == "f" else array.dtype.newbyteorder("="))
        assert found.flags.writeable
        assert "a" in archive
        assert "b" not in archive
        with pytest.raises(KeyError):
            archive.array("b", kinds)
    np.testing.assert_array_equal(npy_array(npy(array), kinds, ENOUGH), array)


def test_a_header_is_one_json_object():
    """It is long by its texts alone, and one without an end costs no more than its length."""
    name = 'a "quoted" name, [1, {}] ' * 400_000
    for header in ({"a": [1]}, {name: 1}):
        assert NpzArchive(npz(header=np.array(json.dumps(header))), 0).header() == header


@pytest.mark.parametrize(
    ("header", "said"),
    [
        *(([odd], "header") for odd in ("[1]", "{", "[" * 100_000, "3", "")),
        (["{}", "{}"], "no single text"),
        ([json.dumps({"a": [[]] * 1_500_000})], "very many parts"),
        (['"' + '\\"' * 1_000_000], "header"),  # hours, if each quote began a search
    ],
    ids=["list", "cut off", "nested", "number", "nothing", "two", "many parts", "no end"],
)
def test_no_header(header, said):
    with pytest.raises(NotNpz, match=said):
        NpzArchive(npz(header=np.array(header[0] if len(header) == 1 else header)), ENOUGH).header()


NUMBERS = np.arange(4.0)

FALSE_MEMBERS: dict[str, bytes] = {
    "a shape beyond all memory": described(NUMBERS, shape=(2**40,)),
    "a shape that overflows": described(NUMBERS, shape=(2**32, 2**32, 4)),
    "a shape below zero": described(NUMBERS, shape=(-2, -2)),
    "less than it says": described(NUMBERS, shape=(5,)),
    "more than it says": described(NUMBERS, shape=(3,)),
    "objects": npy(np.array({"a": 1}, dtype=object)),
    "texts": described(NUMBERS, descr="<U8"),
    "a long description": b"\x93NUMPY\x02\x00" + struct.pack("<I", 2**31) + b"{" * 2000,
    "no description": b"hello",
    "code for a description": b"\x93NUMPY\x01\x00\x1e\x00" + b"__import__('os').abort()".ljust(30),
    "too many numbers": npy(np.zeros(1_000_000)),
}


@pytest.mark.parametrize("member", FALSE_MEMBERS.values(), ids=FALSE_MEMBERS.keys())
def test_a_member_that_is_not_what_it_says_is_not_read(member):
    with pytest.raises(NotNpz, match=r"holds|more memory"):
        NpzArchive(zipped(("a.npy", member)), ENOUGH).array("a", "f")
    with pytest.raises(NotNpz, match=r"holds|more memory|damaged"):
        npy_array(member, "f", ENOUGH)


def test_only_what_is_asked_for_is_read_and_only_as_much_as_is_allowed():
    """A file of 200 kB that claims 200 MB: neither its other members nor too large ones take memory."""
    zeros = np.zeros(12_500_000)
    data = npz(unknown=zeros, known=zeros, small=np.zeros(10))
    del zeros
    assert len(data) < 500_000
    tracemalloc.start()
    try:
        archive = NpzArchive(data, ENOUGH)
        assert archive.array("small", "f").shape == (10,)
        with pytest.raises(NotNpz, match="more memory than such a file ever needs, with its known"):
            archive.array("known", "f")
        assert tracemalloc.get_traced_memory()[1] < 10_000_000
    finally:
        tracemalloc.stop()
    # All arrays together count, as they will be: numbers of 16 bits become numbers of 64.
    archive = NpzArchive(npz(**{f"a{i}": np.zeros(1000, np.float16) for i in range(4)}), 3 * 8000)
    for i in range(3):
        archive.array(f"a{i}", "f")
    with pytest.raises(NotNpz, match="more memory"):
        archive.array("a3", "f")


def patched(place: int, new: bytes) -> bytes:
    """`TWO` with bytes changed, so many after the beginning of its table of contents."""
    at = TABLE + place
    return TWO[:at] + new + TWO[at + len(new) :]


TWO = zipped(("a.npy", described(NUMBERS)), ("b.npy", described(NUMBERS)))
TABLE = TWO.index(b"PK\x01\x02")
FALSE_ZIPS: dict[str, bytes] = {
    "nothing": b"",
    "a comment, which may hold another end": TWO[:-2] + b"\x05\x0012345",
    "members with long names": zipped(*((f"{i:060000}.npy", b"") for i in range(40))),
    "the record of very large zips": TWO[:-22] + b"PK\x06\x07" + bytes(16) + TWO[-22:],
    "a member that is encrypted": patched(8, b"\x01\x00"),
    "a member of another method": zipped(("a.npy", described(NUMBERS)), method=zipfile.ZIP_LZMA),
    "a member that is longer": patched(24, struct.pack("<I", 2**31)),
    "a member elsewhere": patched(42, struct.pack("<I", 50)),
    "damaged numbers": patched(60 - TABLE, b"!!"),
}


@pytest.mark.parametrize("data", FALSE_ZIPS.values(), ids=FALSE_ZIPS.keys())
def test_a_zip_that_is_not_what_numpy_writes_is_not_read(data):
    with pytest.raises(NotNpz):
        NpzArchive(data, ENOUGH).array("a", "f")


def test_pickles_are_handed_over_unread():
    held = np.array({"a": 1}, dtype=object)
    pickled = npy_pickle(npy(held))
    assert pickle.loads(pickled)[()] == {"a": 1}
    archive = NpzArchive(npz(held=held, numbers=np.ones(3)), ENOUGH)
    assert archive.pickle("held") == pickled
    for wrong in (lambda: archive.pickle("numbers"), lambda: npy_pickle(npy(np.ones(3)))):
        with pytest.raises(NotNpz, match="no objects"):
            wrong()
    with pytest.raises(KeyError):
        archive.pickle("missing")
    with pytest.raises(NotNpz, match="damaged"):
        npy_pickle(b"\x93NUMPY\x01")
