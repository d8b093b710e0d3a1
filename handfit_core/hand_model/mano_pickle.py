"""MANO's own `.pkl` files: read without running anything in them, and written for other tools.

A pickle is a program. MANO's asks for NumPy, SciPy and chumpy objects; chumpy does not even import
on current Python. They are read through `safe_pickle`: everything that a file may ask for becomes an
inert stand-in, so nothing of NumPy, SciPy or chumpy runs on the file's behalf.
"""

from __future__ import annotations

import os
import pickle
import re
from pathlib import Path
from typing import Any

import numpy as np

from handfit_core.doors.safe_pickle import STAND_INS, NotAnArray, Refused, StandIn, array_of, load, reshaped
from handfit_core.errors import HandModelError
from handfit_core.files import read_file, shown, why, written_whole
from handfit_core.hand_model.checks import checked_model
from handfit_core.hand_model.data import LIMITS, HandModel
from handfit_core.skeleton import MANO_TIP_VERTICES, NUM_JOINTS, PARENTS, Side

_REQUIRED = (
    "v_template",
    "f",
    "shapedirs",
    "posedirs",
    "J_regressor",
    "weights",
    "kintree_table",
    "hands_components",
    "hands_mean",
)
_TIPS: dict[Side, tuple[int, ...]] = {
    "right": MANO_TIP_VERTICES,
    # The left mesh is no exact mirror; manotorch takes the neighbour for its middle finger.
    "left": tuple(445 if vertex == 444 else vertex for vertex in MANO_TIP_VERTICES),
}
_COPY_AGAIN = "copy it again from the archive that mano.is.tue.mpg.de gives"


def load_mano_pickle(path: str | os.PathLike[str]) -> HandModel:
    """Read `MANO_RIGHT.pkl` or `MANO_LEFT.pkl`, or a file of `save_mano_pickle`, safely.

    The side is taken from the geometry (from the wrist, a right hand's fingers point to -x). Left
    models get the released file's sign fault undone, see `_has_left_fault`. hands_mean is kept but
    never added to the pose. The model is named after the file.

    Raises HandModelError, in one line, for a file that is missing, too large, no pickle, truncated,
    asks for anything a MANO file does not need, or does not hold MANO's arrays; and where the name
    says MANO_LEFT or MANO_RIGHT but the geometry says otherwise.
    """
    path = Path(path)
    content = _unpickled(path)
    try:
        with np.errstate(all="ignore"):  # what is not finite is refused, not warned of
            return _model_from(path, content)
    except _Unfit as error:
        raise HandModelError(f"{shown(path)}: {error}; {_COPY_AGAIN}") from error


def _model_from(path: Path, content: Any) -> HandModel:
    if not isinstance(content, dict):
        raise _Unfit("this pickle holds no hand model")
    missing = [key for key in _REQUIRED if key not in content]
    if missing:
        raise _Unfit(f"not a MANO hand model, it lacks {', '.join(missing)}")
    arrays = {key: _array_of(key, content[key]) for key in _REQUIRED}

    parents = arrays["kintree_table"]
    expected = np.array([[p % 2**32 for p in PARENTS], range(NUM_JOINTS)])
    # Masked, because some converters store the root's parent as -1.
    if parents.dtype.kind not in "iu" or not np.array_equal(parents.astype(np.int64) & (2**32 - 1), expected):
        raise _Unfit("kintree_table does not describe MANO's 16 joints (a body model has more)")
    v_template, regressor = arrays["v_template"], arrays["J_regressor"]
    if v_template.ndim != 2 or v_template.shape[1] != 3 or regressor.shape != (NUM_JOINTS, len(v_template)):
        raise _Unfit(
            f"v_template has shape {_by(v_template)} and J_regressor {_by(regressor)}, expected Nx3 and 16xN"
        )

    joints = regressor @ v_template
    if not np.all(np.isfinite(joints)):
        raise _Unfit("v_template or J_regressor holds values that are not finite (NaN or infinity)")
    side: Side = "right" if joints[1:, 0].mean() < joints[0, 0] else "left"
    named = _side_in_name(path)
    if named not in (None, side):
        raise HandModelError(
            f"{shown(path)}: the name says {named}, but this is a {side} hand; give the file its right name"
        )
    shapedirs = arrays["shapedirs"]
    if side == "left" and _has_left_fault(v_template, shapedirs):
        shapedirs = shapedirs * np.array([-1.0, 1.0, 1.0])[:, None]
    tips = _array_of("tip_vertices", content["tip_vertices"]) if "tip_vertices" in content else _TIPS[side]
    try:
        return checked_model(
            arrays
            | {
                "faces": arrays["f"],
                "shapedirs": shapedirs,
                "joint_regressor": regressor,
                "hands_mean": arrays["hands_mean"].reshape(-1),
                "tip_vertices": tips,
            },
            where=shown(path),
            name=path.stem,
            side=side,
            source=str(path),
        )
    except HandModelError as error:
        raise HandModelError(f"{error}; {_COPY_AGAIN}") from error


def _side_in_name(path: Path) -> Side | None:
    stem = path.stem.lower()
    if "mano_right" in stem:
        return "right"
    return "left" if "mano_left" in stem else None


def _has_left_fault(v_template: np.ndarray, shapedirs: np.ndarray) -> bool:
    """Whether a left model's shape directions carry the right hand's sign in x (smplx issue 48).

    Others compare with the right file; one file is enough. Betas are independent with unit variance,
    so the sum over directions of (relative growth along x) * (relative growth across x) is the
    covariance of hand length with hand breadth and thickness among the people that the model spans.
    Large hands are large in all of them: it is positive. The fault negates all x components, hence
    exactly this sum and nothing else. Shapes that do not correlate either way are left alone.
    """
    if shapedirs.ndim != 3 or shapedirs.shape[:2] != v_template.shape:
        return False  # checked_model says so with the shapes
    centred = v_template - v_template.mean(axis=0)
    growth = np.einsum("vc,vcd->cd", centred, shapedirs) / np.sum(centred**2, axis=0)[:, None]  # (3, 10)
    along, across = growth[0], growth[1] + growth[2]
    size = np.linalg.norm(along) * np.linalg.norm(across)
    return bool(along @ across < -0.1 * size)


def save_mano_pickle(model: HandModel, path: str | os.PathLike[str]) -> Path:
    """Write `model` with MANO's keys, types and conventions, for tools that read MANO's files.

    smplx and manotorch load the result. No chumpy is needed to read it. One key goes beyond MANO's:
    `tip_vertices` (5,), which other tools ignore. Needs SciPy. Raises OutputError.
    """
    from scipy.sparse import csc_matrix  # slow to load

    path = Path(path)
    parents = np.array([[p % 2**32 for p in PARENTS], range(NUM_JOINTS)], dtype=np.uint32)
    content = {
        "v_template": np.array(model.v_template),
        "f": np.array(model.faces, dtype=np.uint32),
        "shapedirs": np.array(model.shapedirs),
        "posedirs": np.array(model.posedirs),
        "J_regressor": csc_matrix(model.joint_regressor),
        "J": model.joint_regressor @ model.v_template,
        "weights": np.array(model.weights),
        "kintree_table": parents,
        "hands_components": np.array(model.hands_components),
        "hands_mean": np.array(model.hands_mean),
        "tip_vertices": np.array(model.tip_vertices, dtype=np.int64),
        "bs_style": "lbs",
        "bs_type": "lrotmin",
    }
    data = pickle.dumps(content, protocol=2)
    # NumPy 2 names its private modules; under their old names NumPy 1 reads the file as well.
    data = data.replace(b"cnumpy._core.multiarray\n", b"cnumpy.core.multiarray\n")
    with written_whole(path, load_mano_pickle) as beside:
        beside.write_bytes(data)
    return path


class _Unfit(Exception):
    """The content of a file that could be read is no hand model; the message says why."""


def _unpickled(path: Path) -> Any:
    try:
        data = read_file(path, LIMITS.file_bytes)
    except (OSError, ValueError) as error:
        raise HandModelError(
            f"{shown(path)}: cannot be read ({why(error)}); give the path of a MANO .pkl file, which has 4 MB"
        ) from error
    try:
        return load(data, _stand_in)
    except Refused as error:
        raise HandModelError(
            f"{shown(path)}: refused: the file {error}; a MANO file never does, do not trust it"
        ) from error
    except Exception as error:  # a damaged pickle can fail in any way
        raise HandModelError(
            f"{shown(path)}: not a MANO .pkl file, or a damaged or truncated one; {_COPY_AGAIN}"
        ) from error


class _CscMatrix(StandIn):
    __slots__ = ()


class _CsrMatrix(StandIn):
    __slots__ = ()


class _Chumpy(StandIn):
    """Any chumpy object; plain ones (`Ch`) hold their array as x."""

    __slots__ = ()


class _ChumpySelect(_Chumpy):
    """chumpy.reordering.Select: elements `idxs` of the flattened array `a`."""

    __slots__ = ()


_STAND_INS: dict[str, type[StandIn]] = {**STAND_INS, "chumpy.reordering.Select": _ChumpySelect}
for _module in ("csc", "_csc"):
    _STAND_INS[f"scipy.sparse.{_module}.csc_matrix"] = _CscMatrix
    _STAND_INS[f"scipy.sparse.{_module}.csc_array"] = _CscMatrix
for _module in ("csr", "_csr"):
    _STAND_INS[f"scipy.sparse.{_module}.csr_matrix"] = _CsrMatrix
    _STAND_INS[f"scipy.sparse.{_module}.csr_array"] = _CsrMatrix


def _stand_in(asked: str) -> type[StandIn] | None:
    """The stand-in for a name that MANO files use; None for all others."""
    if re.fullmatch(r"chumpy(\.\w+)*\.[A-Za-z]\w*", asked, re.ASCII):
        return _STAND_INS.get(asked, _Chumpy)
    return _STAND_INS.get(asked)


def _array_of(key: str, value: Any, depth: int = 0) -> np.ndarray:
    """The plain array behind a stand-in; J_regressor's sparse matrix becomes dense. Raises _Unfit."""
    if depth > 4:
        raise _Unfit(f"{key} is nested too deeply")
    if isinstance(value, _Chumpy) and not isinstance(value, _ChumpySelect):
        return _array_of(key, value.fields().get("x"), depth + 1)
    if isinstance(value, (_CscMatrix, _CsrMatrix)):
        return _dense(key, value, depth)
    try:
        return _selected(key, value, depth) if isinstance(value, _ChumpySelect) else array_of(value)
    except NotAnArray as error:
        raise _Unfit(f"{key} {error}") from error


def _selected(key: str, value: _ChumpySelect, depth: int) -> np.ndarray:
    fields = value.fields()
    whole = _array_of(key, fields.get("a"), depth + 1).reshape(-1)
    chosen = _array_of(key, fields.get("idxs"), depth + 1)
    if chosen.dtype.kind not in "iu" or np.any((chosen < 0) | (chosen >= whole.size)):
        raise _Unfit(f"{key} selects elements that do not exist")
    shape = fields.get("preferred_shape")
    return reshaped(whole[chosen], chosen.shape if shape is None else shape, "C")


def _dense(key: str, matrix: StandIn, depth: int) -> np.ndarray:
    fields = matrix.fields()
    data, minor, starts = (_array_of(key, fields.get(k), depth + 1) for k in ("data", "indices", "indptr"))
    shape = fields.get("_shape", fields.get("shape"))
    if not (isinstance(shape, tuple) and len(shape) == 2 and all(isinstance(n, int) for n in shape)):
        raise _Unfit(f"{key} is a sparse matrix without a shape")
    rows, columns = shape
    majors, minors = (columns, rows) if isinstance(matrix, _CscMatrix) else (rows, columns)
    sound = (
        rows == NUM_JOINTS
        and data.ndim == minor.ndim == starts.ndim == 1
        and minor.dtype.kind in "iu"
        and starts.dtype.kind in "iu"
        and len(starts) == majors + 1
        and starts[0] == 0
        and starts[-1] == len(data) == len(minor)
        and np.all(starts[1:] >= starts[:-1])
        and np.all((minor >= 0) & (minor < minors))
        # The dense matrix must not be beyond what the file itself could hold.
        and 0 < columns <= LIMITS.file_bytes // 1000
    )
    if not sound:
        raise _Unfit(f"{key} is a damaged sparse matrix, or not of 16 joints")
    major = np.repeat(np.arange(majors), np.diff(starts.astype(np.int64)))
    dense = np.zeros((majors, minors))
    np.add.at(dense, (major, minor), data)
    return dense.T if isinstance(matrix, _CscMatrix) else dense


def _by(array: np.ndarray) -> str:
    return "x".join(map(str, array.shape))
