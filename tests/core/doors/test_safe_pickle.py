"""Pickles of arrays: read as NumPy reads them, and nothing else. Hostile files: also test_mano_pickle."""

from __future__ import annotations

import pickle
import tracemalloc

import numpy as np
import pytest

from handfit_core.doors import safe_pickle

ARRAYS = [
    np.arange(6.0).reshape(2, 3),
    np.asfortranarray(np.arange(6, dtype=np.float32).reshape(2, 3)),
    np.arange(6, dtype=">i4"),
    np.arange(24, dtype=np.uint8).reshape(2, 3, 4),
    np.array(2.5),
]


@pytest.mark.parametrize("protocol", range(pickle.HIGHEST_PROTOCOL + 1))
@pytest.mark.parametrize("array", ARRAYS, ids=lambda a: f"{a.dtype}{list(a.shape)}")
def test_arrays_as_numpy_reads_them(array: np.ndarray, protocol: int) -> None:
    read = safe_pickle.array_of(safe_pickle.load(pickle.dumps(array, protocol)))
    np.testing.assert_array_equal(read, array)
    assert read.dtype == array.dtype.newbyteorder("=")
    assert read.shape == array.shape


def test_plain_containers_are_plain() -> None:
    content = {"a": [1, 2.5, None, True], "b": ("text", b"bytes"), "nested": {"x": []}}
    assert safe_pickle.load(pickle.dumps(content)) == content


@pytest.mark.parametrize(
    "value", [np.array([None]), np.array(["a"]), np.array([1 + 2j]), np.float64(1), [1.0]]
)
def test_anything_else_is_no_array(value: object) -> None:
    with pytest.raises(safe_pickle.NotAnArray, match="is not an array"):
        safe_pickle.array_of(safe_pickle.load(pickle.dumps(value)))


@pytest.mark.parametrize("value", [Exception, open, np.load, pickle.loads, range(3), slice(1)])
def test_any_other_name_is_refused(value: object) -> None:
    with pytest.raises(safe_pickle.Refused, match=r"^asks to run [\w.]+$"):
        safe_pickle.load(pickle.dumps(value))


def test_what_numpy_names_may_not_do() -> None:
    """Names that are allowed make stand-ins; none of them runs."""
    huge = b"cnumpy.core.multiarray\n_reconstruct\n(cnumpy\nndarray\n(L99999999999999L\ntVb\ntR."
    assert isinstance(safe_pickle.load(huge), safe_pickle.StandIn)
    with pytest.raises(safe_pickle.Refused, match=r"_codecs\.encode"):
        safe_pickle.load(b"c_codecs\nencode\n(Vabc\nVrot13\ntR.")
    with pytest.raises(safe_pickle.NotAnArray):
        safe_pickle.array_of(safe_pickle.load(huge))


# What takes time or memory and is no array

PROTOCOL = b"\x80\x02"


def text(value: str) -> bytes:
    return b"X" + len(value).to_bytes(4, "little") + value.encode()


CLASS = b"cnumpy\nndarray\n"

COSTLY: dict[str, tuple[bytes, str]] = {
    # Hashing it recurses in C; 100 000 levels end the interpreter.
    "a nested tuple as a key": (b"})" + b"\x85" * 50 + b"Ns.", "key that is no text"),
    "a nested tuple as one of many keys": (b"}(" + text("a") + b"N)\x85\x85Nu.", "key that is no text"),
    "a key of a dictionary at once": (b"()\x85Nd.", "key that is no text"),
    # All in one place of the dictionary: 130 000 of them take hours.
    "whole numbers with the same hash": (
        b"}("
        + b"".join(b"\x8a\x0b" + (i * (2**61 - 1)).to_bytes(11, "little") + b"N" for i in range(9))
        + b"u.",
        "key that is no text",
    ),
    "a stand-in as a key": (b"}" + CLASS + b")RNs.", "key that is no text"),
    "a text that is encoded again and again": (
        text("a" * 1000) + b"q\x000" + (b"c_codecs\nencode\nh\x00" + text("latin1") + b"\x86R0") * 3 + b"N.",
        "more bytes of its texts than it has",
    ),
    "arguments that are used again and again": (
        b"(" + b"N" * 17 + b"tq\x000" + (CLASS + b"h\x00R0") * 2 + b"N.",
        "more than arrays need",
    ),
    "marks in marks": (b"(" * 101 + b".", "nests more than 100"),
    "lists without end": (b"]0" * safe_pickle.MOST_STEPS + b"N.", "more instructions than arrays need"),
    "a memo without end": (b"Nq\x00" * safe_pickle.MOST_STEPS + b".", "more instructions than arrays need"),
}


@pytest.mark.parametrize(("data", "said"), COSTLY.values(), ids=COSTLY.keys())
def test_what_would_take_long_is_refused(data: bytes, said: str) -> None:
    with pytest.raises(safe_pickle.Refused, match=said):
        safe_pickle.load(PROTOCOL + data)


def test_encoding_takes_no_more_than_the_file() -> None:
    """400 times 200 kB: refused before the second copy."""
    flood = text("a" * 200_000) + b"q\x000" + (b"c_codecs\nencode\nh\x00" + text("latin1") + b"\x86R") * 400
    tracemalloc.start()
    try:
        with pytest.raises(safe_pickle.Refused):
            safe_pickle.load(PROTOCOL + flood + b".")
        assert tracemalloc.get_traced_memory()[1] < 2_000_000
    finally:
        tracemalloc.stop()


def test_sets_are_lists() -> None:
    """chumpy's objects hold sets; nothing hashes what is in them."""
    assert safe_pickle.load(pickle.dumps({"a": {"x"}, "b": frozenset({"y"})}, 4)) == {"a": ["x"], "b": ["y"]}
    deep = b"\x80\x04\x8f()" + b"\x85" * 50_000 + b"\x90."
    assert isinstance(safe_pickle.load(deep), list)


def test_deep_values_are_no_trouble() -> None:
    """As long as nobody hashes, compares or prints them."""
    tuples = PROTOCOL + b"}" + text("a") + b")" + b"\x85" * 90_000 + b"s."
    assert list(safe_pickle.load(tuples)) == ["a"]
    made = PROTOCOL + CLASS + b"q\x000N" + b"\x85q\x010h\x00h\x01R" * 15_000 + b"."
    assert isinstance(safe_pickle.load(made), safe_pickle.StandIn)


def test_labels_may_be_numbered() -> None:
    content = {0: {"xyz": None}, 41_257: {}}
    assert safe_pickle.load(pickle.dumps(content), numbered=True) == content
    for key in (-1, safe_pickle.MOST_NUMBERED, True, 1.0):
        with pytest.raises(safe_pickle.Refused, match="key that is no text"):
            safe_pickle.load(pickle.dumps({key: None}), numbered=True)


# Values as plain as they were

PLAIN = {"a": [1, 2.5, None, "x", True], "b": {"c": np.arange(3.0)}, "d": (np.float32(0.5), np.int64(7))}


@pytest.mark.parametrize("protocol", range(pickle.HIGHEST_PROTOCOL + 1))
def test_plain_values(protocol: int) -> None:
    of_objects = np.array([{"e": np.ones((2, 2))}, "f"], dtype=object)
    held = safe_pickle.plain(
        safe_pickle.load(pickle.dumps({**PLAIN, "o": of_objects, "t": np.array(["u"])}, protocol))
    )
    assert held["a"] == PLAIN["a"]
    np.testing.assert_array_equal(held["b"]["c"], np.arange(3.0))
    assert held["d"] == [0.5, 7.0]
    np.testing.assert_array_equal(held["o"][0]["e"], np.ones((2, 2)))
    assert held["o"][1] == "f"
    assert held["t"] is None


def test_one_object_without_dimension() -> None:
    held = safe_pickle.plain(safe_pickle.load(pickle.dumps(np.array({"a": 1}, dtype=object))))
    assert held == {"a": 1}


def test_lists_of_the_same_lists_end() -> None:
    """Thirty lists of two references are a milliard values."""
    nested: list[object] = [1]
    for _ in range(30):
        nested = [nested, nested]
    with pytest.raises(safe_pickle.Refused, match="nests more values"):
        safe_pickle.plain(safe_pickle.load(pickle.dumps(nested)))
    endless: list[object] = []
    endless.append(endless)
    with pytest.raises(safe_pickle.Refused, match="nests more values"):
        safe_pickle.plain(safe_pickle.load(pickle.dumps(endless)))


def test_arrays_of_the_same_contents_end(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(safe_pickle, "MOST_BYTES", 1000)
    arrays = [np.arange(100.0) + i for i in range(2)]
    with pytest.raises(safe_pickle.Refused, match="more numbers"):
        safe_pickle.plain(safe_pickle.load(pickle.dumps(arrays)))
    same = [arrays[0]] * 50
    held = safe_pickle.plain(safe_pickle.load(pickle.dumps(same)))
    assert all(array is held[0] for array in held)
