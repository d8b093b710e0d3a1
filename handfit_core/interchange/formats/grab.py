"""GRAB's sequences: .npz of Python objects, hands as coefficients of MANO's directions without its mean."""

from __future__ import annotations

from typing import Any

import numpy as np

from handfit_core.doors.values import Unfit
from handfit_core.hand_model.motion import HandMotion
from handfit_core.interchange import mano
from handfit_core.interchange.document import Document
from handfit_core.interchange.readers import Reader
from handfit_core.interchange.recording import Asked, Recording
from handfit_core.skeleton import NUM_BETAS, SIDES, Side


def _recognises(document: Document) -> bool:
    return set(document.names) >= {"body", "lhand", "rhand"}


def _read(document: Document, asked: Asked) -> Recording:
    assumed: list[str] = []
    turn = mano.standing(
        mano.rotations("body's global_orient", _params(document, "body")["global_orient"], 1), assumed
    )
    posed = []
    for side in SIDES:
        params = _params(document, {"left": "lhand", "right": "rhand"}[side])
        orient = mano.rotations("global_orient", params["global_orient"], 1)
        pose = mano.from_flat(_pose(params, side, asked, len(orient)), side, asked, "flat")
        transl = mano.numbers("transl", params["transl"], 3)
        if len(transl) != len(orient):
            raise Unfit(f"transl has {len(transl)} rows where {len(orient)} are expected")
        hand = HandMotion(side, np.zeros(NUM_BETAS), orient, pose, transl)
        posed.append(mano.seen_from(hand, asked, turn))
    assumed.append("the subject's own shape (vtemp) is left out")
    told = document.value("framerate")
    fps = mano.rate(120.0 if told is None else told, asked)
    frames = np.arange(1, len(posed[0].hand_pose) + 1)
    return mano.recording_of("grab", document, fps, frames, posed, asked, assumed)


def _params(document: Document, name: str) -> dict[str, Any]:
    held = document.value(name)
    params = held.get("params") if isinstance(held, dict) else None
    if not isinstance(params, dict):
        raise Unfit(f"{name} must hold params, and does not")
    return params


def _pose(params: dict[str, Any], side: Side, asked: Asked, count: int) -> np.ndarray:
    """`fullpose` is the pose in axis-angle, which needs no model; else there are coefficients only."""
    full = params.get("fullpose")
    if full is not None and np.shape(full)[-1:] in ((mano.POSE,), (mano.POSE + 3,)):
        return mano.rotations("fullpose", np.asarray(full)[..., -mano.POSE :], 15, count)
    coefficients = np.asarray(params["hand_pose"], dtype=np.float64)
    if coefficients.ndim != 2 or len(coefficients) != count or not 0 < coefficients.shape[1] <= mano.POSE:
        raise Unfit(f"hand_pose must be {count} rows of at most {mano.POSE} coefficients")
    return mano.from_directions(coefficients, side, asked)


READER = Reader("GRAB", "a sequence's .npz with body, lhand and rhand", _recognises, _read)
