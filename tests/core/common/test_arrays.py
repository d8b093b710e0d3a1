"""Arrays of dataclasses: there and back through messages and files, and one sentence for each that is not as
declared."""

import io
import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from handfit_core.common.arrays import (
    array,
    array_dataclass,
    arrays_of,
    check_arrays,
    declared,
    kept_arrays,
    pack,
    packed,
    reading_arrays,
    unpack,
    unpacked,
    value,
)
from handfit_core.common.errors import ProtocolError, TakeError
from handfit_core.common.npz import NotNpz, NpzArchive
from handfit_core.common.slices import run_to_completion
from handfit_core.common.values import Unfit, number, one_of

ROWS = 4
SEEN = np.array([True, True, False, True])


@array_dataclass
class Motion:
    side: str = value(one_of("left", "right"))
    betas: np.ndarray = array(10, finite="all", most=1e3)
    pose: np.ndarray = array("T", 45, finite="seen", sent=np.float32)
    seen: np.ndarray = array("T", kind="b", most_rows=1000)
    first: np.ndarray = array("N", kind="i", most_rows=5)
    depth: np.ndarray | None = array("T", 21, default=None)
    start: np.ndarray = array(2, 3, default=0.0)
    fps: float = value(number, default=25.0, least=1.0, most=100.0)


def motion(**changes: Any) -> Motion:
    pose = np.where(SEEN[:, None], np.random.default_rng(0).normal(size=(ROWS, 45)), np.nan)
    return replace(Motion("left", np.arange(10.0), pose, SEEN, np.arange(3)), **changes)


def test_a_dataclass_as_any_other():
    assert list(declared(Motion)) == ["betas", "pose", "seen", "first", "depth", "start"]
    np.testing.assert_array_equal(motion().start, np.zeros((2, 3)))
    assert motion().start is not motion().start
    assert list(arrays_of(motion())) == ["betas", "pose", "seen", "first", "start"]
    assert list(arrays_of(motion(depth=np.zeros((ROWS, 21))), "T")) == ["pose", "seen", "depth"]


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"depth": np.full((ROWS, 21), np.nan)},
        {"betas": list(range(10))},
        {"first": np.array([], dtype=np.uint8)},
        {"pose": np.zeros((0, 45)), "seen": np.zeros(0, dtype=bool)},
        {"pose": np.zeros((ROWS, 45), dtype=np.float16), "betas": np.full(10, -1e3)},
    ],
    ids=["plain", "unknown depths", "a list", "no first", "no rows", "at the bounds"],
)
def test_what_is_as_declared(changes):
    check_arrays(motion(**changes))


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"betas": np.zeros(9)}, "betas has shape (9,), expected (10,)"),
        ({"betas": np.full(10, np.nan)}, "betas is not finite"),
        ({"pose": np.full((ROWS, 45), np.nan)}, "pose is not finite where the hand is seen"),
        ({"seen": np.ones(ROWS)}, "seen holds float64, expected bools"),
        ({"first": np.zeros(3)}, "first holds float64, expected whole numbers"),
        ({"first": np.arange(6)}, "first has 6 rows, more than 5"),
        ({"depth": np.zeros((ROWS + 1, 21))}, f"depth has shape ({ROWS + 1}, 21), expected ({ROWS}, 21)"),
        ({"side": "both"}, "side must be left or right, not 'both'"),
        ({"fps": 0.5}, "fps must be a finite number from 1 to 100, not 0.5"),
    ],
    ids=lambda value: str(value)[:50],
)
def test_what_is_not(changes, said):
    with pytest.raises(Unfit) as caught:
        check_arrays(motion(**changes))
    assert str(caught.value) == said
    with pytest.raises(TakeError, match=r"^the left hand's pose has shape \(4, 45\), expected \(5, 45\)$"):
        check_arrays(motion(), TakeError, "the left hand's ", T=5)


@pytest.mark.parametrize("depth", [None, np.ones((ROWS, 21))], ids=["absent", "present"])
def test_they_come_back(depth):
    one = motion(depth=depth)
    message = json.loads(json.dumps(packed(one), allow_nan=False))
    assert message["pose"]["dtype"] == "float32"
    stream = io.BytesIO()
    np.savez(stream, **kept_arrays(one, "hand0_", np.float32))
    archive = NpzArchive(stream.getvalue(), 100_000)
    for found in (
        unpacked(Motion, message),
        run_to_completion(reading_arrays(Motion, archive, "hand0_")),
    ):
        back = Motion(**{"side": "left"} | found)
        check_arrays(back, T=ROWS)
        for name, rows in arrays_of(one).items():
            np.testing.assert_allclose(getattr(back, name), rows, rtol=1e-6)
            assert getattr(back, name).dtype == rows.dtype
        assert (back.depth is None) == (depth is None)


@pytest.mark.parametrize(
    ("changes", "of_messages", "of_files"),
    [
        ({"pose": None}, "refit: pose is missing", "hand0_pose"),
        ({"seen": np.ones(ROWS)}, "refit: seen holds float64, expected bools", "holds float64 as hand0_seen"),
        ({"first": np.ones(3)}, "refit: first holds float64, expected whole", "holds float64 as hand0_first"),
        ({"betas": np.ones(10, bool)}, "refit: betas holds bool, expected", "holds bool as hand0_betas"),
        ({"pose": np.zeros((9000, 45))}, "", "more memory than such a file ever needs, with its hand0_pose"),
    ],
    ids=["missing", "no bools", "no whole numbers", "no floats", "too large"],
)
def test_what_is_refused_before_it_is_made(changes, of_messages, of_files):
    given = {name: value for name, value in (arrays_of(motion()) | changes).items() if value is not None}
    if of_messages:
        with pytest.raises(ProtocolError, match=of_messages):
            unpacked(Motion, {"side": "left"} | {n: pack(a) for n, a in given.items()}, "refit: ")
    stream = io.BytesIO()
    np.savez_compressed(stream, **{f"hand0_{name}": value for name, value in given.items()})
    with pytest.raises((KeyError, NotNpz), match=of_files):
        run_to_completion(reading_arrays(Motion, NpzArchive(stream.getvalue(), 100_000), "hand0_"))


def test_values_in_messages():
    message = packed(motion(fps=30.0))
    assert (message["side"], message["fps"]) == ("left", 30.0)
    assert unpacked(Motion, {**message, "fps": 500})["fps"] == 500.0  # `check_arrays` refuses it
    assert "fps" not in unpacked(Motion, {name: each for name, each in message.items() if name != "fps"})
    for changes, said in (
        ({"side": None}, "^refit: side must be left or right, not None$"),
        ({"fps": "25"}, "^refit: fps must be a finite number, not '25'$"),
        ({"betas": [0.0] * 10}, "^refit: betas: an array in a message must be"),
    ):
        with pytest.raises(ProtocolError, match=said):
            unpacked(Motion, message | changes, "refit: ")


@pytest.mark.parametrize("dtype", ["bool", "int32", "float32", ">f8"])
@pytest.mark.parametrize("shape", [(), (0, 3), (2, 3, 5)], ids=str)
def test_arrays_come_back(dtype, shape):
    array = (np.random.default_rng(0).normal(size=shape) * 100).astype(dtype)
    for each in (array, np.asfortranarray(array).T):
        back = unpack(json.loads(json.dumps(pack(each))))
        assert back.dtype == array.dtype.newbyteorder("=")
        assert back.flags.writeable
        np.testing.assert_array_equal(back, each)
    odd = np.array([np.nan, np.inf, -0.0])
    np.testing.assert_array_equal(unpack(pack(odd)), odd)
    assert pack(np.array([1], dtype=np.int32))["data"] == "AQAAAA=="  # little-endian


def test_arrays_of_objects_are_not_packed():
    for held in (np.array(["a"]), np.array([None]), np.array([1j])):
        with pytest.raises(ProtocolError, match="float64; not"):
            pack(held)


@pytest.mark.parametrize(
    "change",
    [
        *({"dtype": dtype} for dtype in ("object", None, ["float32"])),
        *({"data": data} for data in ("AAAA", "no base64!", None)),
        *({"shape": shape} for shape in ([3, 2], 4, ["2"], [2.0], [True], "2", {"2": 1}, [-1])),
        *({"shape": shape} for shape in ([2**70], [0, 2**70], [1] * 100, [2**20] * 8)),
    ],
    ids=str,
)
def test_damaged_arrays_are_refused(change):
    good = pack(np.zeros(2, dtype=np.float32))
    lacking = {name: each for name, each in good.items() if name not in change}
    for given in (good | change, lacking, None, [1.0], "AAAA"):
        with pytest.raises(ProtocolError, match=r"an array in a message must be .*dtype, shape and data"):
            unpack(given)
