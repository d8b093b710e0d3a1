"""Requests for re-fitting, and their answers, as messages of the worker (docs/worker-protocol.md)."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from handfit_core.common.arrays import LARGEST, check_arrays, packed, unpacked
from handfit_core.common.errors import Cancelled, OptionError, ProtocolError
from handfit_core.common.skeleton import Side
from handfit_core.detect.keypoints import Detections
from handfit_core.edit.hand import Prop, RefineHand, SecondSight
from handfit_core.edit.refit import refit_each, refit_grip, refit_range
from handfit_core.fit.solvers import ShouldStop
from handfit_core.hand_model.motion import HandMotion
from handfit_core.take.found import FoundRows

MODES = ("each", "draft", "range", "grip")
_LAST: list[tuple[tuple[object, ...], HandMotion]] = []
"""The last result of a single frame, and what it was of: none or one. A drag asks many times for the same
frame with a pin that has moved a little; the solver needs a few steps from the last result, and many from
where the drag began"""


def to_message(hand: RefineHand) -> dict[str, Any]:
    """Return a hand as JSON's types: the `hand` of a `refit` request, with its arrays and its detections
    packed."""
    message = packed(hand) | _packed(hand.detections, hand.side, len(hand))
    second = hand.second
    if second is not None:
        message["second"] = packed(second) | _packed(second.detections, hand.side, len(second.times))
    return message


def _packed(hands: Detections, side: Side, count: int) -> dict[str, Any]:
    return packed(replace(FoundRows.of(hands, side, count), right_side=None))


def from_message(message: Mapping[str, Any]) -> RefineHand:
    """Read the hand that `to_message` made. `model`, `fps`, `smoothing`, `holes`, `added`, `other_side`,
    `keypoints_2020`, `overlapped`, `touches` and `second` may be missing.

    Raises ProtocolError for a field that is missing or not of its kind, OptionError for one of a wrong shape
    or range; both name it.
    """
    if not isinstance(message, Mapping):
        raise ProtocolError("refit: hand must be an object")
    fields = unpacked(RefineHand, message, "refit: ")
    seen = FoundRows(**unpacked(FoundRows, message, "refit: "))
    second = None
    if message.get("second") is not None:
        second = _second_from(message["second"], fields["side"])
    check_arrays(seen, OptionError, T=len(fields["pins"]))
    return RefineHand(detections=seen.detections(fields["side"]), second=second, **fields)


def _second_from(message: Any, side: Side) -> SecondSight:
    where = "refit: second: "
    if not isinstance(message, Mapping):
        raise ProtocolError(f"{where.removesuffix(': ')} must be an object")
    seen = FoundRows(**unpacked(FoundRows, message, where))
    check_arrays(seen, OptionError, "second: ")
    return SecondSight(detections=seen.detections(side), **unpacked(SecondSight, message, where))


def answer(message: Mapping[str, Any], should_stop: ShouldStop) -> dict[str, Any]:
    """Answer a `refit` request with the fields of its `done` event: {"result": {...}, "seconds": s}.

    The request's `mode` is "each", "draft" (see `refit_each`), "range" or "grip", its `hand` what
    `to_message` made, and its `prop`, for a grip, a packed `Prop`. The result is a HandMotion. Raises
    HandfitError; Cancelled when stopped.
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
    elif mode == "grip":
        prop = message.get("prop")
        if not isinstance(prop, Mapping):
            raise ProtocolError("refit: prop must be an object")
        result = refit_grip(hand, Prop(**unpacked(Prop, prop, "refit: prop: ")), should_stop)
    else:
        key = _drag(hand)
        guess = next((last for of, last in _LAST if of == key), None)
        result = refit_each(hand, guess, draft=mode == "draft")
        _LAST[:] = [(key, result)] if len(hand) == 1 else []
    if should_stop():
        raise Cancelled("re-fitting was stopped; nothing was changed")
    # A fit that ran away, as one close to the camera can, costs its own frame and no other.
    lost = np.logical_or.reduce([(np.abs(rows) > LARGEST).any(axis=1) for rows in result.pose])
    return {"result": packed(result.posed_at(~lost)), "seconds": time.perf_counter() - begin}


def _drag(hand: RefineHand) -> tuple[object, ...]:
    """Return the part of a hand that a drag does not change: frame, first pose, shape and locks."""
    arrays = [hand.betas, *hand.pose, hand.locked, hand.detections.keypoints]
    numbers = (np.asarray(a, dtype=np.float64).tobytes() for a in arrays)
    return (hand.side, hand.model, hand.intrinsics, len(hand), *numbers)


def result_from_message(done: Mapping[str, Any], count: int = 1) -> HandMotion:
    """Read the result in the `done` event of a `refit` request for `count` frames. Raises ProtocolError for
    anything else."""
    result = done.get("result")
    if not isinstance(result, Mapping):
        raise ProtocolError("refit: the answer has no result")
    found = HandMotion(**unpacked(HandMotion, result, "refit: the answer's "))
    check_arrays(found, ProtocolError, "refit: the answer's ", T=count)
    return found
