"""Re-fitting as the worker's messages: docs/worker-protocol.md."""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import Any

import numpy as np

from handfit_core.common.arrays import LARGEST, array, array_dataclass, check_arrays, packed, unpacked
from handfit_core.common.batch import scatter
from handfit_core.common.errors import Cancelled, OptionError, ProtocolError
from handfit_core.common.skeleton import NUM_KEYPOINTS, SIDES, Side
from handfit_core.detect.keypoints import Detections
from handfit_core.edit.hand import Prop, RefineHand, SecondSight
from handfit_core.edit.refit import refit_each, refit_grip, refit_range
from handfit_core.fit.solvers import ShouldStop
from handfit_core.hand_model.motion import HandMotion

MODES = ("each", "draft", "range", "grip")
_LAST: list[tuple[tuple[object, ...], HandMotion]] = []
"""The last result of a single frame, and what it was of: none or one. A drag asks many times for the same
frame with a pin that has moved a little; the solver needs a few steps from the last result, and many from
where the drag began"""


@array_dataclass
class _Detections:
    """What was detected in T frames, as a message has it: NaN in frames where nothing was."""

    keypoints: np.ndarray = array("T", NUM_KEYPOINTS, 3, sent=np.float32)
    """pixels, with depth"""
    world: np.ndarray = array("T", NUM_KEYPOINTS, 3, sent=np.float32)
    """metres"""
    score: np.ndarray = array("T", sent=np.float32)
    agrees: np.ndarray | None = array("T", kind="b", default=None)
    """Whether the detector named the hand's side; None: wherever it found the hand"""
    keypoints_2020: np.ndarray | None = array("T", NUM_KEYPOINTS, 3, sent=np.float32, default=None)
    """Pixels and depth, by the network of December 2020; NaN where it was not asked, None: nowhere"""
    overlapped: np.ndarray | None = array("T", NUM_KEYPOINTS, kind="b", default=None)

    def __post_init__(self) -> None:
        check_arrays(self, OptionError)

    @classmethod
    def of(cls, hands: Detections, side: Side, count: int) -> _Detections:
        """The detections of a hand of that side; arrays that no frame has are None."""
        second, overlapped = hands.keypoints_2020, hands.overlapped

        def over_time(rows: np.ndarray, nothing: Any = np.nan) -> np.ndarray:
            return scatter(rows, hands.frame, count, nothing)

        return cls(
            keypoints=over_time(hands.keypoints),
            world=over_time(hands.world),
            score=over_time(hands.score),
            agrees=over_time(hands.side == SIDES.index(side), True),
            keypoints_2020=None if second is None or not hands.asked_2020.any() else over_time(second),
            overlapped=None if overlapped is None or not overlapped.any() else over_time(overlapped, False),
        )

    def of_side(self, side: Side) -> Detections:
        """The inverse, for a hand of that side."""
        points = np.concatenate([self.keypoints, self.world], axis=1)
        frame = np.flatnonzero(np.isfinite(points).all(axis=(1, 2)))
        named = np.full(len(frame), SIDES.index(side))
        return Detections(
            frame=frame,
            side=named if self.agrees is None else np.where(self.agrees[frame], named, 1 - named),
            score=np.nan_to_num(self.score[frame], nan=0.5),
            keypoints=self.keypoints[frame],
            world=self.world[frame],
            keypoints_2020=None if self.keypoints_2020 is None else self.keypoints_2020[frame],
            overlapped=None if self.overlapped is None else self.overlapped[frame],
        )


def to_message(hand: RefineHand) -> dict[str, Any]:
    """A hand as JSON's types: the `hand` of a `refit` request, its arrays and its detections' packed."""
    message = packed(hand) | packed(_Detections.of(hand.detections, hand.side, len(hand)))
    second = hand.second
    if second is not None:
        seen = _Detections.of(second.detections, hand.side, len(second.times))
        message["second"] = packed(second) | packed(seen)
    return message


def from_message(message: Mapping[str, Any]) -> RefineHand:
    """The inverse of `to_message`. `model`, `fps`, `smoothing`, `holes`, `added`, `agrees`, `keypoints_2020`,
    `overlapped`, `touches` and `second` may be missing.

    Raises ProtocolError for a field that is missing or not of its kind, OptionError for one of a wrong
    shape or range; both name it.
    """
    if not isinstance(message, Mapping):
        raise ProtocolError("refit: hand must be an object")
    fields = unpacked(RefineHand, message, "refit: ")
    seen = _Detections(**unpacked(_Detections, message, "refit: "))
    second = None
    if message.get("second") is not None:
        second = _second_from(message["second"], fields["side"])
    hand = RefineHand(detections=seen.of_side(fields["side"]), second=second, **fields)
    check_arrays(seen, OptionError, T=len(hand))
    return hand


def _second_from(message: Any, side: Side) -> SecondSight:
    where = "refit: second: "
    if not isinstance(message, Mapping):
        raise ProtocolError(f"{where.removesuffix(': ')} must be an object")
    seen = _Detections(**unpacked(_Detections, message, where))
    return SecondSight(detections=seen.of_side(side), **unpacked(SecondSight, message, where))


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
    """What stays the same during a drag: the frame, the pose that it began from, the shape and the locks."""
    arrays = [hand.betas, *hand.pose, hand.locked, hand.detections.keypoints]
    numbers = (np.asarray(a, dtype=np.float64).tobytes() for a in arrays)
    return (hand.side, hand.model, hand.intrinsics, len(hand), *numbers)


def result_from_message(done: Mapping[str, Any], count: int = 1) -> HandMotion:
    """The result in the `done` event of a `refit` request for `count` frames. Raises ProtocolError."""
    result = done.get("result")
    if not isinstance(result, Mapping):
        raise ProtocolError("refit: the answer has no result")
    found = HandMotion(**unpacked(HandMotion, result, "refit: the answer's "))
    check_arrays(found, ProtocolError, "refit: the answer's ", T=count)
    return found
