"""Re-fitting as the worker's messages: docs/worker-protocol.md."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import fields
from typing import Any

import numpy as np

from handfit_core.arrays import LARGEST
from handfit_core.batch import spread
from handfit_core.detect.keypoints import HandDetection
from handfit_core.doors.values import Unfit, number, path, shortly, whole
from handfit_core.edit.hand import RESULT_SHAPES, START_ARRAYS, RefineHand, RefineResult
from handfit_core.edit.recent import Recent
from handfit_core.edit.refit import refit_each, refit_range
from handfit_core.errors import Cancelled, HandfitError, OptionError, ProtocolError
from handfit_core.geometry.camera import Intrinsics
from handfit_core.hand_model import OPEN_HAND
from handfit_core.options import CaptureOptions
from handfit_core.skeleton import NUM_KEYPOINTS, SIDES, other_side
from handfit_core.solvers import ShouldStop
from handfit_core.worker.protocol import pack, unpack

MODES = ("each", "draft", "range")
_POINTS = ("keypoints", "world")
_RECENT = Recent()


def to_message(hand: RefineHand) -> dict[str, Any]:
    """A hand as JSON's types: the `hand` of a `refit` request.

    Arrays are packed; detections are `keypoints` and `world` (T, 21, 3), `score` (T,) and `agrees` (T,)
    (whether the detector named this side), NaN rows where there is none; `keypoints_2020` (T, 21, 3)
    and `overlapped` (T, 21) bool where a detection has it; `touches` (T, 21) where points do.
    """
    count, there = len(hand), hand.detected
    found = [d for d in hand.detections if d is not None]
    points = {name: np.reshape([getattr(d, name) for d in found], (-1, NUM_KEYPOINTS, 3)) for name in _POINTS}
    camera = hand.intrinsics
    nowhere, unasked = np.zeros(NUM_KEYPOINTS, dtype=bool), np.full((NUM_KEYPOINTS, 3), np.nan)
    second = [unasked if d.keypoints_2020 is None else d.keypoints_2020 for d in found]
    overlapped = [nowhere if d.overlapped is None else d.overlapped for d in found]
    return {
        "side": hand.side,
        "model": hand.model,
        "intrinsics": [camera.fx, camera.fy, camera.cx, camera.cy],
        "fps": float(hand.fps),
        "smoothing": float(hand.smoothing),
        "holes": [int(row) for row in hand.holes],
        "added": bool(hand.added),
        "betas": pack(np.asarray(hand.betas, dtype=np.float64)),
        **{name: pack(np.asarray(getattr(hand, name), dtype=np.float64)) for name in START_ARRAYS},
        "pins": pack(np.asarray(hand.pins, dtype=np.float64)),
        "locked": pack(np.asarray(hand.locked, dtype=bool)),
        **{name: pack(spread(rows, there, count).astype(np.float32)) for name, rows in points.items()},
        "score": pack(spread([d.score for d in found], there, count).astype(np.float32)),
        "agrees": pack(spread([d.side == hand.side for d in found], there, count, True)),
        **(
            {"keypoints_2020": pack(spread(second, there, count).astype(np.float32))}
            if np.isfinite(second).any()
            else {}
        ),
        **({"overlapped": pack(spread(overlapped, there, count, False))} if np.any(overlapped) else {}),
        **({"touches": pack(np.asarray(hand.touches, dtype=np.float64))} if hand.touches is not None else {}),
    }


def from_message(message: Mapping[str, Any]) -> RefineHand:
    """The inverse of `to_message`. `model`, `fps`, `smoothing`, `holes`, `added`, `agrees`, `keypoints_2020`,
    `overlapped` and `touches` may be missing.

    Raises ProtocolError for a field that is missing or not of its kind, OptionError for one of a wrong
    shape or range; both name it.
    """
    if not isinstance(message, Mapping):
        raise ProtocolError("refit: hand must be an object")
    side = message.get("side")
    if side not in SIDES:
        raise OptionError(f"side must be left or right, not {shortly(side)}")
    points = {name: _array(message, name) for name in _POINTS}
    count = points["keypoints"].shape[0] if points["keypoints"].ndim else 0
    of_frames = {"score": _array(message, "score"), "agrees": np.ones(count, dtype=bool)}
    if "agrees" in message:
        of_frames["agrees"] = _array(message, "agrees")
    for name, array in (points | of_frames).items():
        shape = (count, NUM_KEYPOINTS, 3) if name in points else (count,)
        if array.shape != shape:
            raise OptionError(f"{name} must have the shape {shape}, not {array.shape}")
    overlapped = _array(message, "overlapped") if "overlapped" in message else None
    if overlapped is not None and (overlapped.shape != (count, NUM_KEYPOINTS) or overlapped.dtype != bool):
        raise OptionError(f"overlapped must be bools of the shape {(count, NUM_KEYPOINTS)}")
    second = np.full((count, NUM_KEYPOINTS, 3), np.nan)
    if "keypoints_2020" in message:
        second = _array(message, "keypoints_2020").astype(np.float64)
        if second.shape != (count, NUM_KEYPOINTS, 3):
            raise OptionError(
                f"keypoints_2020 must have the shape {(count, NUM_KEYPOINTS, 3)}, not {second.shape}"
            )
    score, agrees = of_frames.values()
    detections = tuple(
        HandDetection(
            side if agrees[row] else other_side(side),
            float(np.nan_to_num(score[row], nan=0.5)),
            points["keypoints"][row].astype(np.float64),
            points["world"][row].astype(np.float64),
            keypoints_2020=second[row] if np.isfinite(second[row]).all() else None,
            overlapped=None if overlapped is None else overlapped[row],
        )
        if np.isfinite([points[name][row] for name in _POINTS]).all()
        else None
        for row in range(count)
    )
    camera, holes, model = message.get("intrinsics"), message.get("holes", []), message.get("model")
    if not isinstance(camera, list) or len(camera) != 4:
        raise ProtocolError(f"refit: intrinsics must be a list of 4 numbers, not {shortly(camera)}")
    added = message.get("added", False)
    if not isinstance(added, bool):
        raise ProtocolError(f"refit: added must be true or false, not {shortly(added)}")
    if not isinstance(holes, list):
        raise ProtocolError(f"refit: holes must be a list of whole numbers, not {shortly(holes)}")
    try:
        holes = [number("holes", row) for row in holes]
        return RefineHand(
            side=side,
            betas=_array(message, "betas"),
            intrinsics=Intrinsics(*(number("intrinsics", value) for value in camera)),
            detections=detections,
            # Whole numbers would have no NaN for what is not pinned.
            pins=_array(message, "pins").astype(np.float64),
            **{name: _array(message, name).astype(np.float64) for name in START_ARRAYS},
            locked=_array(message, "locked"),
            model=OPEN_HAND if model in (None, "") else path("model", model),
            fps=number("fps", message.get("fps", 25.0)),
            smoothing=number("smoothing", message.get("smoothing", CaptureOptions.smoothing)),
            holes=tuple(whole("holes", int(n) if n.is_integer() else n) for n in holes),
            added=added,
            touches=_array(message, "touches") if "touches" in message else None,
        )
    except Unfit as error:
        raise ProtocolError(f"refit: {error}") from error


def answer(message: Mapping[str, Any], should_stop: ShouldStop) -> dict[str, Any]:
    """What the `done` event of a `refit` request says: {"result": {...}, "seconds": s}.

    The request's `mode` is "each", "draft" (see `refit_each`) or "range", its `hand` what `to_message` made.
    The result's arrays are those of RefineResult, packed as float32. Raises HandfitError; Cancelled when
    stopped.
    """
    mode = message.get("mode", "each")
    if mode not in MODES:
        raise OptionError(f"refit: mode must be one of {', '.join(MODES)}; not {mode!r}")
    if "hand" not in message:
        raise ProtocolError("refit: hand is missing")
    begin = time.perf_counter()
    hand = from_message(message["hand"])
    if should_stop():
        raise Cancelled("re-fitting was stopped; nothing was changed")
    if mode == "range":
        result = refit_range(hand, should_stop)
    else:
        draft = mode == "draft"
        result = refit_each(hand, _RECENT.of(hand) if draft else None, draft=draft)
        _RECENT.keep(hand, result)
    if should_stop():
        raise Cancelled("re-fitting was stopped; nothing was changed")
    arrays = {f.name: getattr(result, f.name) for f in fields(RefineResult)}
    # A fit that ran away, as one close to the camera can, costs its own frame and no other.
    lost = np.logical_or.reduce(
        [(np.abs(a) > LARGEST).reshape(len(a), -1).any(axis=1) for a in arrays.values()]
    )
    packed = {
        name: pack(np.where(lost.reshape(-1, *[1] * (a.ndim - 1)), np.nan, a).astype(np.float32))
        for name, a in arrays.items()
    }
    return {"result": packed, "seconds": time.perf_counter() - begin}


def result_from_message(done: Mapping[str, Any], count: int = 1) -> RefineResult:
    """What the `done` event of a `refit` request for `count` frames carries. Raises ProtocolError."""
    result = done.get("result")
    if not isinstance(result, Mapping):
        raise ProtocolError("refit: the answer has no result")
    arrays = {f.name: _array(result, f.name).astype(np.float64) for f in fields(RefineResult)}
    for name, array in arrays.items():
        if array.shape != (count, *RESULT_SHAPES[name]):
            raise ProtocolError(f"refit: the answer's {name} has the wrong shape, {array.shape}")
        if np.any(np.abs(array) > LARGEST):  # NaN, in rows without a hand, is not
            raise ProtocolError(f"refit: the answer's {name} holds numbers beyond {LARGEST:g}")
    return RefineResult(**arrays)


def _array(message: Mapping[str, Any], name: str) -> np.ndarray:
    if name not in message:
        raise ProtocolError(f"refit: {name} is missing")
    try:
        return unpack(message[name])
    except HandfitError as error:
        raise ProtocolError(f"refit: {name}: {error}") from error
