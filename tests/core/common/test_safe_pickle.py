"""Pickles of arrays: read as NumPy reads them, and nothing else. Whole hostile files: tests/hostile."""

import contextlib
import pickle
import tracemalloc

import numpy as np
import pytest

from handfit_core.common import safe_pickle


@pytest.mark.parametrize("protocol", range(pickle.HIGHEST_PROTOCOL + 1))
def test_arrays_as_numpy_reads_them(protocol):
    numbers = np.arange(24.0).reshape(2, 3, 4)
    for array in (numbers, np.asfortranarray(numbers), numbers.astype(">i4"), np.array(2.5, np.float32)):
        read = safe_pickle.plain(safe_pickle.load(pickle.dumps(array, protocol)))
        np.testing.assert_array_equal(read, array)
        assert read.dtype == array.dtype.newbyteorder("=")


@pytest.mark.parametrize(
    "asked",
    "os.system builtins.getattr numpy.load numpy.core.multiarray.fromfile scipy.sparse.load_npz "
    "_codecs.decode chumpyevil.run chumpy.ch.__init__ chumpy.os.2 collections.OrderedDict".split(),
)
def test_any_other_name_is_refused(asked):
    module, _, name = asked.rpartition(".")
    with pytest.raises(safe_pickle.Refused, match=f"^asks to run {asked}$"):
        safe_pickle.load(f"c{module}\n{name}\n(Vx\ntR.".encode())


def test_nothing_runs(tmp_path):
    """Each of these leaves a file behind when Python's own unpickler reads it, and none with ours."""
    trace = tmp_path / "trace"
    command = f"open({str(trace)!r}, 'w').close()"
    eval_it = f"cbuiltins\nexec\n(V{command}\ntR".encode()
    wrapped = {
        "plain": eval_it + b".",
        "in a dict": b"(dVv_template\n" + eval_it + b"s.",
        "INST": f"(V{command}\nibuiltins\nexec\n.".encode(),
        "OBJ": f"(cbuiltins\nexec\nV{command}\no.".encode(),
        "STACK_GLOBAL": b"\x80\x04\x8c\x08builtins\x8c\x04exec\x93"
        + b"\x8c" + bytes([len(command)]) + command.encode() + b"\x85R.",
        "as state": b"cnumpy\ndtype\n(Vf8\ntR" + eval_it + b"b.",
    }  # fmt: skip
    for name, data in wrapped.items():
        with pytest.raises(safe_pickle.Refused):
            safe_pickle.load(data)
        assert not trace.exists(), name
        # Once the code has run, the rest of the pickle may fail.
        with contextlib.suppress(TypeError, AttributeError, IndexError):
            pickle.loads(data)
        assert trace.exists(), f"{name}: this test would not notice code that runs"
        trace.unlink()


def text(value: str) -> bytes:
    return b"X" + len(value).to_bytes(4, "little") + value.encode()


ASKED = b"cnumpy\nndarray\n"
COSTLY = {
    # Hashing it recurses in C; 100 000 levels end the interpreter.
    "a nested tuple as a key": b"})" + b"\x85" * 50 + b"Ns.",
    "a nested tuple as one of many keys": b"}(" + text("a") + b"N)\x85\x85Nu.",
    "a key of a dictionary at once": b"()\x85Nd.",
    # All in one place of the dictionary: 130 000 of them take hours.
    "numbers of one hash": b"}\x8a\x0b" + (7 * (2**61 - 1)).to_bytes(11, "little") + b"Ns.",
    "a call as a key": b"}" + ASKED + b")RNs.",
    "lists without end": b"]0" * safe_pickle.MOST_STEPS + b"N.",
    "a memo without end": b"Nq\x00" * safe_pickle.MOST_STEPS + b".",
}


@pytest.mark.parametrize("data", COSTLY.values(), ids=COSTLY.keys())
def test_what_would_take_long_is_refused(data):
    with pytest.raises(safe_pickle.Refused, match=r"key that is no text|more instructions"):
        safe_pickle.load(b"\x80\x02" + data)


@pytest.mark.parametrize(
    "data",
    [
        text("a" * 200_000) + b"q\x000" + (b"c_codecs\nencode\nh\x00" + text("latin1") + b"\x86R") * 400,
        b"(" + b"N" * 20_000 + b"tq\x000" + (ASKED + b"h\x00R") * 400,
        b"}" + text("a") + b")" + b"\x85" * 50_000 + b"s",
        b"\x8f()" + b"\x85" * 50_000 + b"\x90",
        ASKED + b"q\x000N" + b"\x85q\x010h\x00h\x01R" * 9_000,
    ],
    ids=["text", "arguments", "tuples", "set", "calls"],
)
def test_what_is_named_again_and_again_takes_nothing(data):
    tracemalloc.start()
    try:
        safe_pickle.load(b"\x80\x04" + data + b".")
        assert tracemalloc.get_traced_memory()[1] < 12_000_000
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize("protocol", range(pickle.HIGHEST_PROTOCOL + 1))
def test_plain_values(protocol):
    held = {
        "lists": [1, 2.5, None, "x", True, ("text", b"bytes"), {"x": []}],
        "sets": [{"x"}, frozenset("y")],
        "numbers": (np.float32(0.5), np.int64(7)),
        "arrays": np.array([{"e": np.ones((2, 2))}, "f"], dtype=object),
        "object": np.array({"a": 1}, dtype=object),
        "texts": np.array(["u"]),
        41_257: {},
    }
    if protocol < 4:
        held["sets"] = [["x"], ["y"]]
    found = safe_pickle.load(pickle.dumps(held, protocol))
    assert found[41_257] == found.pop(41_257) == {}
    assert found["sets"] == [["x"], ["y"]]
    found = safe_pickle.plain(found)
    np.testing.assert_array_equal(found["arrays"][0].pop("e"), np.ones((2, 2)))
    assert found["arrays"] == [{}, "f"]
    assert (found["numbers"], found["object"], found["texts"]) == ([0.5, 7.0], {"a": 1}, None)
    assert found["lists"][:5] == [1, 2.5, None, "x", True]


def test_plain_ends(monkeypatch):
    endless: list[object] = []
    endless.append(endless)
    with pytest.raises(safe_pickle.Refused, match="nests more values"):
        safe_pickle.plain(safe_pickle.load(pickle.dumps(endless)))
    monkeypatch.setattr(safe_pickle, "MOST_BYTES", 1000)
    arrays = [np.arange(100.0) + i for i in range(2)]
    with pytest.raises(safe_pickle.Refused, match="more numbers"):
        safe_pickle.plain(safe_pickle.load(pickle.dumps(arrays)))
    held = safe_pickle.plain(safe_pickle.load(pickle.dumps([arrays[0]] * 50)))
    assert all(array is held[0] for array in held)
