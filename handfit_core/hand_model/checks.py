"""Validation of every hand model that is read: shapes, finiteness, plausibility."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

import numpy as np

from handfit_core.doors.values import shortly
from handfit_core.errors import HandModelError
from handfit_core.hand_model.data import HandModel
from handfit_core.skeleton import NUM_BETAS, NUM_JOINTS, SIDES

MOST_VERTICES: Final = 50_000
MOST_FACES: Final = 2 * MOST_VERTICES
"""MANO has 778 vertices and 1538 faces, the open hand 1609 and 1598"""

SMALLEST_HAND: Final = 0.01
LARGEST_HAND: Final = 10.0
"""metres across"""

LARGEST: Final = 1e4
"""Largest magnitude of any number in a model: metres, weights and radians"""

_PER_VERTEX: Final = -1
_FLOATS: Final[dict[str, tuple[int | None, ...]]] = {
    "shapedirs": (_PER_VERTEX, 3, None),
    "weights": (_PER_VERTEX, NUM_JOINTS),
    "posedirs": (_PER_VERTEX, 3, 9 * (NUM_JOINTS - 1)),
    "joint_regressor": (NUM_JOINTS, _PER_VERTEX),
    "hands_mean": (45,),
    "hands_components": (45, 45),
}
"""A model's arrays of floats besides its vertices, and their shapes; None: as many as there are"""


def checked_model(
    arrays: Mapping[str, Any], *, where: str, name: str, side: str, source: str = ""
) -> HandModel:
    """Build a HandModel from raw arrays, or say in one sentence what is wrong with them.

    `arrays` are named as the fields of HandModel, whose optional ones may be missing or None; others are not
    looked at. `where` names the file in messages. Raises HandModelError.
    """
    if side not in SIDES:
        raise HandModelError(f"{where}: the side must be left or right, not {shortly(side)}")
    v_template = _floats(where, "v_template", arrays["v_template"], (None, 3))
    count = len(v_template)
    if not 0 < count <= MOST_VERTICES:
        raise HandModelError(f"{where}: a hand model has 1 to {MOST_VERTICES} vertices, not {count}")
    size = float(np.ptp(v_template, axis=0).max())
    if not SMALLEST_HAND <= size <= LARGEST_HAND:
        raise HandModelError(
            f"{where}: this hand is {size:.3g} m long; a hand model is in metres, from {SMALLEST_HAND:g} to "
            f"{LARGEST_HAND:g} m"
        )
    faces = _indices(where, "faces", arrays["faces"], 3, count)
    found = {}
    for key, sizes in _FLOATS.items():
        shape = tuple(count if n == _PER_VERTEX else n for n in sizes)
        shown_key = "J_regressor" if key == "joint_regressor" else key
        found[key] = _floats(where, shown_key, arrays[key], shape)
    shapedirs, weights = found.pop("shapedirs"), found.pop("weights")
    if shapedirs.shape[2] < NUM_BETAS:
        raise HandModelError(
            f"{where}: shapedirs has {shapedirs.shape[2]} shape directions, {NUM_BETAS} are needed"
        )
    if np.any(weights < -1e-6) or np.any(np.abs(weights.sum(axis=1) - 1.0) > 1e-3):
        raise HandModelError(f"{where}: the skin weights must be positive and sum to 1 for every vertex")
    tips = _indices(where, "tip_vertices", np.reshape(arrays["tip_vertices"], (-1, 1)), 1, count).reshape(-1)
    if tips.shape != (5,):
        raise HandModelError(f"{where}: tip_vertices must name 5 vertices, not {len(tips)}")
    quads, uv, uv_faces = (arrays.get(key) for key in ("quads", "uv", "uv_faces"))
    quads = None if quads is None else _indices(where, "quads", quads, 4, count)
    if uv is None or uv_faces is None:
        uv = uv_faces = None
    else:
        polygons = faces if quads is None else quads
        uv = _floats(where, "uv", uv, (None, 2))
        uv_faces = _indices(where, "uv_faces", uv_faces, polygons.shape[1], len(uv))
        if len(uv_faces) != len(polygons):
            raise HandModelError(f"{where}: uv_faces has {len(uv_faces)} rows for {len(polygons)} polygons")
    return HandModel(
        name=name,
        side=side,
        v_template=v_template,
        faces=faces,
        shapedirs=_frozen(shapedirs[:, :, :NUM_BETAS]),
        # Some released weights sum to 1 within 1e-4 only; skinning wants exactly 1.
        weights=_frozen(weights / weights.sum(axis=1, keepdims=True)),
        tip_vertices=tips,
        quads=quads,
        uv=uv,
        uv_faces=uv_faces,
        source=source,
        **found,
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
    if np.any(np.abs(array) > LARGEST):
        raise HandModelError(f"{where}: {key} holds values beyond {LARGEST:g}")
    return _frozen(array)


def _indices(where: str, key: str, array: Any, width: int, limit: int) -> np.ndarray:
    array = np.asarray(array)
    if array.ndim and len(array) > MOST_FACES:
        raise HandModelError(f"{where}: {key} has {len(array)} rows, more than {MOST_FACES}")
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
