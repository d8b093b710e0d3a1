"""The one door through which every hand model enters: shapes, finiteness, plausibility."""

from __future__ import annotations

from typing import Any

import numpy as np

from handfit_core.errors import HandModelError
from handfit_core.hand_model.data import HandModel
from handfit_core.skeleton import NUM_BETAS, NUM_JOINTS, SIDES


def checked_model(
    *,
    where: str,
    name: str,
    side: str,
    v_template: Any,
    faces: Any,
    shapedirs: Any,
    posedirs: Any,
    joint_regressor: Any,
    weights: Any,
    hands_mean: Any,
    hands_components: Any,
    tip_vertices: Any,
    quads: Any = None,
    uv: Any = None,
    uv_faces: Any = None,
    source: str = "",
) -> HandModel:
    """Build a HandModel from raw arrays, or say in one sentence what is wrong with them.

    `where` names the file in messages. Raises HandModelError.
    """
    if side not in SIDES:
        raise HandModelError(f"{where}: the side must be left or right, not {side!r}")
    v_template = _floats(where, "v_template", v_template, (None, 3))
    count = len(v_template)
    faces = _indices(where, "faces", faces, 3, count)
    shapedirs = _floats(where, "shapedirs", shapedirs, (count, 3, None))
    if shapedirs.shape[2] < NUM_BETAS:
        raise HandModelError(
            f"{where}: shapedirs has {shapedirs.shape[2]} shape directions, {NUM_BETAS} are needed"
        )
    weights = _floats(where, "weights", weights, (count, NUM_JOINTS))
    if np.any(weights < -1e-6) or np.any(np.abs(weights.sum(axis=1) - 1.0) > 1e-3):
        raise HandModelError(f"{where}: the skin weights must be positive and sum to 1 for every vertex")
    tips = _indices(where, "tip_vertices", np.reshape(tip_vertices, (-1, 1)), 1, count).reshape(-1)
    if tips.shape != (5,):
        raise HandModelError(f"{where}: tip_vertices must name 5 vertices, not {len(tips)}")
    return HandModel(
        name=name,
        side=side,
        v_template=v_template,
        faces=faces,
        shapedirs=_frozen(shapedirs[:, :, :NUM_BETAS]),
        posedirs=_floats(where, "posedirs", posedirs, (count, 3, 9 * (NUM_JOINTS - 1))),
        joint_regressor=_floats(where, "J_regressor", joint_regressor, (NUM_JOINTS, count)),
        # Some released weights sum to 1 within 1e-4 only; skinning wants exactly 1.
        weights=_frozen(weights / weights.sum(axis=1, keepdims=True)),
        hands_mean=_floats(where, "hands_mean", hands_mean, (45,)),
        hands_components=_floats(where, "hands_components", hands_components, (45, 45)),
        tip_vertices=tips,
        quads=None if quads is None else _indices(where, "quads", quads, 4, count),
        uv=None if uv is None else _floats(where, "uv", uv, (None, 2)),
        uv_faces=None
        if uv_faces is None or uv is None
        else _indices(where, "uv_faces", uv_faces, np.shape(uv_faces)[1], len(uv)),
        source=source,
    )


def _floats(where: str, key: str, array: Any, shape: tuple[int | None, ...]) -> np.ndarray:
    try:
        array = np.asarray(array, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise HandModelError(f"{where}: {key} is not an array of numbers") from error
    expected = "x".join("N" if n is None else str(n) for n in shape)
    if array.ndim != len(shape) or any(
        n is not None and n != m for n, m in zip(shape, array.shape, strict=True)
    ):
        found = "x".join(map(str, array.shape)) or "a single number"
        raise HandModelError(f"{where}: {key} has shape {found}, a MANO-format file has {expected}")
    if not np.all(np.isfinite(array)):
        raise HandModelError(f"{where}: {key} holds values that are not finite (NaN or infinity)")
    return _frozen(array)


def _indices(where: str, key: str, array: Any, width: int, limit: int) -> np.ndarray:
    array = np.asarray(array)
    if array.ndim != 2 or array.shape[1] != width or not np.issubdtype(array.dtype, np.integer):
        raise HandModelError(
            f"{where}: {key} has shape {'x'.join(map(str, array.shape))} and type {array.dtype}, expected "
            f"integers Nx{width}"
        )
    array = array.astype(np.int64)
    if array.size and (array.min() < 0 or array.max() >= limit):
        raise HandModelError(f"{where}: {key} names vertices that do not exist (there are {limit})")
    return _frozen(array)


def _frozen(array: np.ndarray) -> np.ndarray:
    array = np.array(array)
    array.setflags(write=False)
    return array
