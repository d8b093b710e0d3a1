"""MANO's pickles: read as released, refused when hostile or damaged, written for other tools."""

from __future__ import annotations

import pickle
import pickletools
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from handfit_core.common.errors import HandModelError
from handfit_core.hand_model.data import LIMITS
from handfit_core.hand_model.mano_pickle import load_mano_pickle
from tests.imitation_mano import csc_fields, imitation_arrays, write_mano_pickle

MODEL_ARRAYS = {
    "v_template": "v_template",
    "faces": "f",
    "shapedirs": "shapedirs",
    "posedirs": "posedirs",
    "joint_regressor": "J_regressor",
    "weights": "weights",
    "hands_mean": "hands_mean",
    "hands_components": "hands_components",
}


MISSING = object()


def assert_same_arrays(model: Any, arrays: dict[str, np.ndarray]) -> None:
    for ours, theirs in MODEL_ARRAYS.items():
        np.testing.assert_allclose(getattr(model, ours), arrays[theirs], rtol=0, atol=1e-15, err_msg=ours)


def message_of(path: Path) -> str:
    """The one-line message with which a file is refused; it names the file."""
    with pytest.raises(HandModelError) as caught:
        load_mano_pickle(path)
    message = str(caught.value)
    assert str(path) in message
    assert "\n" not in message
    return message


# Reading what MANO releases


@pytest.mark.parametrize("side", ["right", "left"])
@pytest.mark.parametrize("select", [False, True], ids=["Ch", "Select"])
def test_reads_a_released_file(tmp_path: Path, side: str, select: bool) -> None:
    arrays = imitation_arrays(side)
    path = write_mano_pickle(tmp_path / f"MANO_{side.upper()}.pkl", arrays, select=select)
    asked = {str(arg) for op, arg, _ in pickletools.genops(path.read_bytes()) if op.name == "GLOBAL"}
    # The imitation is only worth something while it asks for what the released file asks for.
    assert {"chumpy.ch Ch", "scipy.sparse.csc csc_matrix", "numpy.core.multiarray _reconstruct"} <= asked
    model = load_mano_pickle(path)
    assert_same_arrays(model, arrays)
    assert (model.side, model.name, model.source) == (side, f"MANO_{side.upper()}", str(path))
    assert model.tip_vertices.tolist() == [745, 317, 444 if side == "right" else 445, 556, 673]


@pytest.mark.parametrize("protocol", range(pickle.HIGHEST_PROTOCOL + 1))
def test_reads_converted_files(tmp_path: Path, protocol: int) -> None:
    """In every protocol, with Fortran's order, other numbers, SciPy's matrices, and -1 above the root."""
    sparse = pytest.importorskip("scipy.sparse", reason="SciPy is not installed")
    arrays, path = imitation_arrays(), tmp_path / "converted.pkl"
    stored = dict(arrays, posedirs=np.asfortranarray(arrays["posedirs"]), f=arrays["f"].astype(">i4"))
    stored["kintree_table"] = arrays["kintree_table"].astype(np.int64)
    stored["kintree_table"][0, 0] = -1
    for kind in (np.asarray, sparse.csc_matrix, sparse.csr_matrix, sparse.csc_array):
        path.write_bytes(pickle.dumps(stored | {"J_regressor": kind(arrays["J_regressor"])}, protocol))
        assert_same_arrays(load_mano_pickle(path), arrays)


# The left model's fault


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("left_fault", [False, True])
def test_the_released_left_fault_is_undone(tmp_path: Path, seed: int, left_fault: bool) -> None:
    sound = imitation_arrays("left", seed=seed)["shapedirs"]
    stored = imitation_arrays("left", seed=seed, left_fault=left_fault)
    np.testing.assert_array_equal(stored["shapedirs"][:, 0], sound[:, 0] * (-1 if left_fault else 1))
    model = load_mano_pickle(write_mano_pickle(tmp_path / "MANO_LEFT.pkl", stored))
    np.testing.assert_array_equal(model.shapedirs, sound)


# Files that are refused


def test_web_pages_and_programs(tmp_path: Path) -> None:
    path = tmp_path / "MANO_RIGHT.pkl"
    for data, said in (
        (b"<!DOCTYPE html><html>please log in</html>", "copy it again"),
        (pickle.dumps([1.0]), "holds no hand model"),
        (b"cposix\nsystem\n(Vtrue\ntR.", "do not trust it"),
    ):
        path.write_bytes(data)
        assert said in message_of(path)


def test_damaged_files(tmp_path: Path) -> None:
    whole = write_mano_pickle(tmp_path / "whole.pkl", imitation_arrays()).read_bytes()
    path = tmp_path / "MANO_RIGHT.pkl"
    for end in [*range(1, 200, 7), *np.linspace(200, len(whole) - 1, 20).astype(int)]:
        path.write_bytes(whole[:end])
        assert "copy it again" in message_of(path)
    with path.open("wb") as stream:
        stream.truncate(LIMITS.file_bytes + 1)  # sparse, takes no room
    assert "too large" in message_of(path)
    assert "cannot be read" in message_of(tmp_path / "nowhere.pkl")
    (tmp_path / "folder.pkl").mkdir()
    assert "cannot be read" in message_of(tmp_path / "folder.pkl")


@pytest.mark.parametrize(
    ("key", "value", "says"),
    [
        ("v_template", np.zeros((700, 3)), "700x3"),
        ("v_template", np.full((778, 3), np.nan), "not finite"),
        ("posedirs", np.zeros((778, 3, 207)), "posedirs has shape (778, 3, 207), expected (778, 3, 135)"),
        ("weights", np.zeros((778, 16)), "sum to 1"),
        ("f", np.zeros((5, 3)), "expected whole numbers"),
        ("f", np.full((5, 3), 778, dtype=np.uint32), "do not exist"),
        ("kintree_table", np.zeros((2, 16), dtype=np.uint32), "kintree_table"),
        ("weights", np.array([[None]]), "weights is not an array of numbers"),
        *((key, MISSING, f"lacks {key}") for key in (*MODEL_ARRAYS.values(), "kintree_table")),
    ],
)
def test_wrong_arrays_are_named(tmp_path: Path, key: str, value: Any, says: str) -> None:
    path = tmp_path / "hand.pkl"
    content = {k: v for k, v in (imitation_arrays() | {key: value}).items() if v is not MISSING}
    path.write_bytes(pickle.dumps(content, protocol=2))
    message = message_of(path)
    assert says in message
    assert "copy it again" in message


@pytest.mark.parametrize(
    ("name", "value"),
    [
        *(("_shape", shape) for shape in ((16, 10**12), (16, -778), (24, 778), None)),
        *(("indices", np.full(12448, index)) for index in (16, -1, 0.0)),
        *(("indptr", np.array(indptr)) for indptr in ([0] * 779, range(779, 0, -1), [0] + [2**62] * 778)),
        *(("indices", np.zeros(3, dtype=np.int32)), ("data", np.zeros((2, 2)))),
    ],
    ids=str,
)
def test_damaged_sparse_regressors(tmp_path: Path, name: str, value: Any, monkeypatch) -> None:
    arrays = imitation_arrays()
    fields = csc_fields(arrays["J_regressor"])
    if name == "indices" and len(value) > 3:
        value = value[: len(fields["data"])]
    monkeypatch.setattr("tests.imitation_mano.csc_fields", lambda _dense: fields | {name: value})
    assert "J_regressor" in message_of(write_mano_pickle(tmp_path / "hand.pkl", arrays))


def test_name_contradicts_geometry(tmp_path: Path) -> None:
    path = write_mano_pickle(tmp_path / "MANO_LEFT.pkl", imitation_arrays("right"))
    assert "the name says left, but this is a right hand" in message_of(path)
    path = write_mano_pickle(tmp_path / "my_mano_right_v1_2.pkl", imitation_arrays("left"))
    assert "the name says right, but this is a left hand" in message_of(path)
    # Without the word MANO_ a name is only a name.
    write_mano_pickle(tmp_path / "left.pkl", imitation_arrays("right"))
    assert load_mano_pickle(tmp_path / "left.pkl").side == "right"


@pytest.mark.parametrize("side", ["right", "left"])
def test_smplx_agrees_with_our_layer(tmp_path: Path, side: Any) -> None:
    smplx = pytest.importorskip("smplx", reason="smplx is not installed (its licence is non-commercial)")
    import torch  # slow to load

    from handfit_core.paper.layer import HandLayer

    path = write_mano_pickle(tmp_path / f"MANO_{side.upper()}.pkl", imitation_arrays(side))
    kind = {"use_pca": False, "flat_hand_mean": True, "dtype": torch.float64}
    theirs = smplx.MANO(model_path=str(path), is_rhand=side == "right", **kind)
    generator = torch.Generator().manual_seed(0)
    betas, global_orient, hand_pose, transl = (
        torch.randn(3, n, generator=generator, dtype=torch.float64) * 0.5 for n in (10, 3, 45, 3)
    )
    expected = theirs(betas=betas, global_orient=global_orient, hand_pose=hand_pose, transl=transl)
    out = HandLayer(load_mano_pickle(path))(betas, global_orient, hand_pose, transl)
    # smplx adds 1e-8 to rotation vectors before it takes their length.
    torch.testing.assert_close(out.vertices, expected.vertices, rtol=0, atol=1e-6)
    torch.testing.assert_close(out.joints, expected.joints[:, :16], rtol=0, atol=1e-6)
