"""Pickles of arrays: read as NumPy reads them, and nothing else. Hostile files: also test_mano_pickle."""

from __future__ import annotations

import pickle

import numpy as np
import pytest

from handfit_core import safe_pickle

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
