"""Pickles of arrays: read as NumPy reads them, and nothing else. Whole hostile files: tests/hostile."""

import contextlib
import io
import pickle
from collections import defaultdict
from typing import Any

import numpy as np
import pytest

from handfit_core.common import safe_pickle
from handfit_core.interchange.document import Document
from tests.torch_files import KINDS, SYSTEM, Storage, Tensor, older_torch


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
    "torch.load torch.hub.load torch._utils._rebuild_qtensor joblib.load collections.Counter "
    "_codecs.decode chumpyevil.run chumpy.ch.__init__ chumpy.os.2".split(),
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


# PyTorch and joblib


def read(data: bytes) -> Any:
    return safe_pickle.plain(safe_pickle.load(data))


FOUR = Storage("Float", bytes(16), 4)


@pytest.mark.parametrize(
    ("tensor", "said"),
    [
        (Tensor(FOUR, (5,), (1,)), "more numbers than are stored"),
        (Tensor(FOUR, (2, 2), (3, 1)), "more numbers than are stored"),
        (Tensor(FOUR, (2,), (1,), 3), "more numbers than are stored"),
        (Tensor(FOUR, (4,), (10**30,)), "more numbers than are stored"),
        (Tensor(FOUR, (2,), (-1,), 1), "damaged"),
        (Tensor(FOUR, (4,), (1,), -1), "damaged"),
        (Tensor(FOUR, (-4,), (1,)), "damaged"),
        (Tensor(FOUR, (4, 1), (1,)), "damaged"),
        (Tensor(FOUR, (2.0,), (1,)), "damaged"),
        (Tensor(FOUR, (10**6, 10**6), (0, 0)), "more numbers than such files"),
        ([Tensor(FOUR, (10**8,), (0,)) for _ in range(2)], "more numbers than such files"),
    ],
)
def test_tensors_stay_within_their_storage(tensor, said):
    with pytest.raises(safe_pickle.Refused, match=said):
        read(older_torch(tensor))


def test_a_storage_is_not_read_over_and_over():

    def within(storage: bytes, times: int) -> bytes:
        start = b"\x80\x04(B" + len(storage).to_bytes(4, "little") + storage + b"\x94ctorch.storage\n"
        return start + b"_load_from_bytes\n\x94" + b"h\x01h\x00\x85R" * times + b"l."

    storage = older_torch(Storage("Float", bytes(4_000_000), 1_000_000))
    assert len(safe_pickle.load(within(storage, 1))) == 3
    nested = older_torch(0).replace(pickle.dumps(0, 2), within(storage, 1))
    for data in (within(storage, 10_000), within(nested, 1)):
        with pytest.raises(safe_pickle.Refused, match="more numbers"):
            safe_pickle.load(data)


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (older_torch(FOUR).replace(b"little_endianq\x02\x88", b"little_endianq\x02\x89"), "order"),
        (older_torch(FOUR).replace(b"storage", b"modules"), "refers to parts"),
        (b"\x80\x02(X\7\0\0\0storagectorch\nFloatStorage\n)X\3\0\0\0cpuK\1tQ.", "refers to parts"),
        (older_torch(FOUR).split(b"u.")[1].split(b"\x80\x02]")[0], "refers to parts"),
    ],
)
def test_references_to_other_parts_are_refused(data, said):
    assert b"little_endianq\x02\x88" in pickle.dumps(SYSTEM, 2)
    with pytest.raises(safe_pickle.Refused, match=said):
        safe_pickle.load(data)


def test_joblib_as_it_writes():
    """Among them are WHAM's, a defaultdict with a dictionary for each person."""
    joblib = pytest.importorskip("joblib")
    numbers = np.arange(24, dtype=np.float32).reshape(2, 3, 4)
    held = defaultdict(dict, {0: {"pose": numbers, "turned": numbers.T, "valid": numbers[0] > 5}})
    held[1] = {"objects": np.array([numbers, "x"], dtype=object), "texts": np.array(["ab"]), "after": numbers}
    stream = io.BytesIO()
    joblib.dump(held, stream)
    found = read(stream.getvalue())
    for name in ("pose", "turned", "valid"):
        np.testing.assert_array_equal(found["0"][name], held[0][name])
    np.testing.assert_array_equal(found["1"]["objects"][0], numbers)
    assert (found["1"]["objects"][1], found["1"]["texts"]) == ("x", None)
    np.testing.assert_array_equal(found["1"]["after"], numbers)
    for cut in range(0, len(stream.getvalue()) - 1, 7):
        with contextlib.suppress(Exception):
            read(stream.getvalue()[:cut] + b".")


@pytest.mark.parametrize("kind", ["zip", "older", "pickle", "joblib"])
def test_torch_as_it_writes(tmp_path, kind):
    torch = pytest.importorskip("torch")
    numbers = torch.arange(24.0).reshape(4, 6)
    held = {
        "turned": numbers.T,
        "part": numbers[1:, 2:],
        "expanded": numbers[:1].expand(3, 6),
        "parameter": torch.nn.Parameter(numbers),
        "number": torch.tensor(2.5),
        "none": torch.zeros((0, 3)),
        "half of a float": torch.tensor([1.0, -2.5], dtype=torch.bfloat16),
        **{kind: torch.from_numpy(np.array([[0, 1], [1, 0]], kind)) for kind in KINDS},
    }
    path, other = tmp_path / "a.pt", {"size": numbers.shape, "kind": torch.float32, "device": numbers.device}
    if kind in ("zip", "older"):
        torch.save(held | other, path, _use_new_zipfile_serialization=kind == "zip")
    else:
        path.write_bytes(pickle.dumps(held | other))
    if kind == "joblib":
        pytest.importorskip("joblib").dump(held | other, path, compress=3)
    found = Document(path).objects
    for name, tensor in held.items():
        expected = tensor.detach()
        expected = (expected.float() if expected.dtype == torch.bfloat16 else expected).numpy()
        np.testing.assert_array_equal(found[name], expected, name)
        assert (found[name].dtype, found[name].shape) == (expected.dtype, expected.shape)
    assert [found[name] for name in other] == [None, None, None]
