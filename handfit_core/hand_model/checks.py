"""Validation of every hand model that is read: shapes, finiteness, plausibility."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from handfit_core.common.arrays import arrays_of, check_arrays, declared
from handfit_core.common.errors import HandModelError
from handfit_core.common.skeleton import NUM_BETAS, SIDES
from handfit_core.common.values import shortly
from handfit_core.hand_model.data import LIMITS, HandModel


def checked_model(
    arrays: Mapping[str, Any], *, where: str, name: str, side: str, source: str = ""
) -> HandModel:
    """Build a HandModel from raw arrays, or say in one sentence what is wrong with them.

    `arrays` are named as the fields of HandModel, whose optional ones may be missing or None; others are not
    looked at. `where` names the file in messages. Raises HandModelError.
    """
    if side not in SIDES:
        raise HandModelError(f"{where}: the side must be left or right, not {shortly(side)}")
    found: dict[str, Any] = {name: arrays.get(name) for name in declared(HandModel)}
    for key, spec in declared(HandModel).items():
        if found[key] is None and not spec.optional:
            raise HandModelError(f"{where}: the hand model lacks {key}")
        if found[key] is not None:
            kinds, kind = ("iu", np.int64) if spec.kind == "i" else ("fiu", np.float64)
            value = np.asarray(found[key])
            found[key] = value.astype(kind) if value.dtype.kind in kinds else value
    if found["uv"] is None or found["uv_faces"] is None:
        found["uv"] = found["uv_faces"] = None
    vertices, shapedirs = found["v_template"], found["shapedirs"]
    if vertices.ndim and not 0 < len(vertices) <= LIMITS.vertices:
        raise HandModelError(
            f"{where}: a hand model has 1 to {LIMITS.vertices} vertices, not {len(vertices)}"
        )
    if shapedirs.ndim == 3:
        if shapedirs.shape[2] < NUM_BETAS:
            raise HandModelError(
                f"{where}: shapedirs has {shapedirs.shape[2]} shape directions, {NUM_BETAS} are needed"
            )
        found["shapedirs"] = np.array(shapedirs[..., :NUM_BETAS])
    found["tip_vertices"] = found["tip_vertices"].reshape(-1)
    model = HandModel(name=name, side=side, source=source, **found)
    check_arrays(model, HandModelError, f"{where}: ")
    size = float(np.ptp(model.v_template, axis=0).max())
    if not LIMITS.min_hand <= size <= LIMITS.max_hand:
        raise HandModelError(
            f"{where}: this hand is {size:.3g} m long; a hand model is in metres, "
            f"from {LIMITS.min_hand:g} to {LIMITS.max_hand:g} m"
        )
    weights = model.weights
    if np.any(weights < -1e-6) or np.any(np.abs(weights.sum(axis=1) - 1.0) > 1e-3):
        raise HandModelError(f"{where}: the skin weights must be positive and sum to 1 for every vertex")
    if model.uv_faces is not None and model.uv_faces.shape != model.polygons.shape:
        raise HandModelError(
            f"{where}: uv_faces has shape {model.uv_faces.shape}, expected {model.polygons.shape} as the "
            "polygons have"
        )
    for key in ("faces", "tip_vertices", "quads", "uv_faces"):
        indices, of = getattr(model, key), model.uv if key == "uv_faces" else model.v_template
        if indices is not None and of is not None and np.any((indices < 0) | (indices >= len(of))):
            raise HandModelError(f"{where}: {key} names points that do not exist (there are {len(of)})")
    # Some released weights sum to 1 within 1e-4 only; skinning wants exactly 1.
    model = replace(model, weights=weights / weights.sum(axis=1, keepdims=True))
    for value in arrays_of(model).values():
        value.setflags(write=False)
    return model
