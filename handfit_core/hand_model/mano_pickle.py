"""MANO's own `.pkl` files, read without running anything in them.

They ask for NumPy, SciPy and chumpy, which does not even import on current Python; `safe_pickle` only
remembers what they ask for.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any, Final

import numpy as np

from handfit_core.common.errors import HandModelError
from handfit_core.common.files import read_file, shown, why
from handfit_core.common.safe_pickle import Refused, load, plain
from handfit_core.common.skeleton import MANO_TIP_VERTICES, NUM_JOINTS, PARENTS, Side
from handfit_core.common.values import Unfit
from handfit_core.hand_model.checks import checked_model
from handfit_core.hand_model.data import LIMITS, HandModel

_REQUIRED: Final = (
    *("v_template", "f", "shapedirs", "posedirs", "J_regressor", "weights"),
    *("kintree_table", "hands_components", "hands_mean"),
)
_TIPS: Final[dict[Side, tuple[int, ...]]] = {
    "right": MANO_TIP_VERTICES,
    # The left mesh is no exact mirror; manotorch takes the neighbour for its middle finger.
    "left": tuple(445 if vertex == 444 else vertex for vertex in MANO_TIP_VERTICES),
}
_COPY_AGAIN: Final = "copy it again from the archive that mano.is.tue.mpg.de gives"


def load_mano_pickle(path: str | os.PathLike[str]) -> HandModel:
    """Read `MANO_RIGHT.pkl` or `MANO_LEFT.pkl`, or another file with their keys, safely.

    The side is taken from the geometry (from the wrist, a right hand's fingers point to -x). Left
    models get the released file's sign fault undone, see `_has_left_fault`. hands_mean is kept but
    never added to the pose. `tip_vertices` (5,) is read where a file has it. The model is named after the
    file.

    Raises HandModelError, in one line, for a file that is missing, too large, no pickle, truncated,
    asks for anything a MANO file does not need, or does not hold MANO's arrays; and where the name
    says MANO_LEFT or MANO_RIGHT but the geometry says otherwise.
    """
    path = Path(path)
    where = shown(path)
    try:
        data = read_file(path, LIMITS.file_bytes)
    except (OSError, ValueError) as error:
        raise HandModelError(
            f"{where}: cannot be read ({why(error)}); give the path of a MANO .pkl file, which has 4 MB"
        ) from error
    try:
        content = plain(load(data))
    except Refused as error:
        raise HandModelError(
            f"{where}: refused: the file {error}; a MANO file never does, do not trust it"
        ) from error
    except Exception as error:  # a damaged pickle can fail in any way
        raise HandModelError(
            f"{where}: not a MANO .pkl file, or a damaged or truncated one; {_COPY_AGAIN}"
        ) from error
    try:
        with np.errstate(all="ignore"):  # what is not finite is refused, not warned of
            arrays, side = _arrays_and_side(content)
            model = checked_model(arrays, where=where, name=path.stem, side=side, source=str(path))
    except Unfit as error:
        raise HandModelError(f"{where}: {error}; {_COPY_AGAIN}") from error
    except HandModelError as error:
        raise HandModelError(f"{error}; {_COPY_AGAIN}") from error
    for named in ("right", "left"):
        if f"mano_{named}" in path.stem.lower() and named != side:
            raise HandModelError(
                f"{where}: the name says {named}, but this is a {side} hand; give the file its right name"
            )
    return model


def _arrays_and_side(content: Any) -> tuple[dict[str, np.ndarray], Side]:
    """Return the arrays of a model, named as `checked_model` takes them, and its side. Raises Unfit where the
    file does not hold MANO's arrays."""
    if not isinstance(content, dict):
        raise Unfit("this pickle holds no hand model")
    if missing := [key for key in _REQUIRED if key not in content]:
        raise Unfit(f"not a MANO hand model, it lacks {', '.join(missing)}")
    arrays = {key: content[key] for key in (*_REQUIRED, "tip_vertices") if key in content}
    for key, array in arrays.items():
        if not isinstance(array, np.ndarray):
            raise Unfit(f"{key} is not an array of numbers")
    parents = arrays["kintree_table"]
    expected = np.array([[p % 2**32 for p in PARENTS], range(NUM_JOINTS)])
    # Masked, because some converters store the root's parent as -1.
    if parents.dtype.kind not in "iu" or not np.array_equal(parents.astype(np.int64) & (2**32 - 1), expected):
        raise Unfit("kintree_table does not describe MANO's 16 joints (a body model has more)")
    v_template, regressor = arrays["v_template"], arrays["J_regressor"]
    if v_template.ndim != 2 or v_template.shape[1] != 3 or regressor.shape != (NUM_JOINTS, len(v_template)):
        shapes = ("x".join(map(str, array.shape)) for array in (v_template, regressor))
        raise Unfit("v_template has shape {} and J_regressor {}, expected Nx3 and 16xN".format(*shapes))
    joints = regressor @ v_template
    if not np.all(np.isfinite(joints)):
        raise Unfit("v_template or J_regressor holds values that are not finite (NaN or infinity)")
    side: Side = "right" if joints[1:, 0].mean() < joints[0, 0] else "left"
    if side == "left" and _has_left_fault(v_template, arrays["shapedirs"]):
        arrays["shapedirs"] = arrays["shapedirs"] * np.array([-1.0, 1.0, 1.0])[:, None]
    return {"tip_vertices": np.array(_TIPS[side])} | arrays | {
        "faces": arrays["f"],
        "joint_regressor": regressor,
        "hands_mean": arrays["hands_mean"].reshape(-1),
    }, side


def _has_left_fault(v_template: np.ndarray, shapedirs: np.ndarray) -> bool:
    """Tell whether a left model's shape directions carry the right hand's sign in x (smplx issue 48).

    Others compare with the right file; one file is enough. Betas are independent with unit variance, so the
    sum over directions of (relative growth along x) * (relative growth across x) is the covariance of hand
    length with hand breadth and thickness among the people that the model spans. Large hands are large in all
    of them: it is positive. The fault negates all x components, hence exactly this sum and nothing else.
    Shapes that do not correlate either way are left alone.
    """
    if shapedirs.ndim != 3 or shapedirs.shape[:2] != v_template.shape:
        return False  # checked_model says so with the shapes
    centred = v_template - v_template.mean(axis=0)
    growth = np.einsum("vc,vcd->cd", centred, shapedirs) / np.sum(centred**2, axis=0)[:, None]  # (3, 10)
    along, across = growth[0], growth[1] + growth[2]
    size = np.linalg.norm(along) * np.linalg.norm(across)
    return bool(along @ across < -0.1 * size)
