"""Re-fitting as messages: what comes back, and what is refused, by name."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from handfit_core.common.arrays import pack
from handfit_core.common.errors import Cancelled, HandfitError, OptionError, ProtocolError
from handfit_core.common.skeleton import can_touch
from handfit_core.edit import (
    RefineHand,
    answer,
    from_message,
    refit_each,
    refit_range,
    result_from_message,
    to_message,
    touching_pair,
)
from handfit_core.fit.solvers import never
from handfit_core.hand_model.motion import POSE_ARRAYS
from tests.core.edit.hands import drag, locked, missed, photo, rows_of, to_refine, true_hands
from tests.core.fit.detections import detections_of

TIP = 8


def sent(message: dict[str, Any]) -> dict[str, Any]:
    return json.loads(json.dumps(message, allow_nan=False))


def clip() -> RefineHand:
    """Three frames, of which the last is taken for the other hand, and the first not seen."""
    motion = true_hands("right", 3)
    hand = drag(to_refine(motion, detections_of("right", rows_of(motion), noise=1.0)), {TIP: (3.0, 3.0)})
    seen, odd = hand.detections, np.array([False, False, True])
    seen = replace(
        seen, side=np.where(odd, 1 - seen.side, seen.side), overlapped=odd[:, None] & (np.arange(21) > 3)
    )
    touches = np.full((3, 21), np.nan)
    touches[1, 12] = 0.0
    fields = {"smoothing": 0.5, "holes": (1,), "locked": locked(3), "touches": touches, "added": True}
    return replace(hand, detections=seen.select(seen.frame > 0), **fields)


def test_messages_come_back() -> None:
    hand = clip()
    back = from_message(sent(to_message(hand)))
    for name in ("side", "model", "intrinsics", "fps", "smoothing", "holes", "added"):
        assert getattr(back, name) == getattr(hand, name)
    for name in ("betas", "pins", "locked", "touches", *POSE_ARRAYS):
        np.testing.assert_array_equal(getattr(back, name), getattr(hand, name))
    for name in ("frame", "side", "overlapped", "keypoints", "world", "score"):
        found, aim = getattr(back.detections, name), getattr(hand.detections, name)
        np.testing.assert_allclose(found, aim, rtol=1e-6, atol=1e-6)  # sent as float32


def test_optional_fields_have_defaults() -> None:
    message = to_message(photo())
    optional = ("model", "fps", "smoothing", "holes", "other_side", "added", "touches")
    hand = from_message({name: value for name, value in message.items() if name not in optional})
    assert (hand.model, hand.fps, hand.smoothing, hand.holes) == ("open-hand", 25.0, 1.0, ())
    assert (hand.added, hand.touches) == (False, None)


@pytest.mark.parametrize("mode", ["each", "draft", "range"])
def test_answers(mode: str) -> None:
    hand = drag(photo(), {TIP: (9.0, 7.0)})
    request = sent({"id": 1, "request": "refit", "mode": mode, "hand": to_message(hand)})
    done = sent(answer(request, never))
    assert 0 < done["seconds"] < 60
    found = result_from_message(done)
    assert missed(hand, found).max() < (3.0 if mode == "draft" else 1.5)
    if mode != "draft":  # which goes on from whatever was answered last
        again = refit_range(hand) if mode == "range" else refit_each(hand)
        for name in ("betas", *POSE_ARRAYS):
            np.testing.assert_allclose(getattr(found, name), getattr(again, name), rtol=1e-3, atol=5e-2)
    with pytest.raises(Cancelled):
        answer(request, lambda: True)


def test_diverged_frame_is_isolated(monkeypatch: pytest.MonkeyPatch) -> None:
    hand = clip()
    good = refit_each(hand)
    transl = good.transl.copy()
    transl[1, 2] = 1e12
    monkeypatch.setattr("handfit_core.edit.messages.refit_range", lambda *_: replace(good, transl=transl))
    found = result_from_message(answer({"mode": "range", "hand": to_message(hand)}, never), 3)
    np.testing.assert_array_equal(found.present, [True, False, True])
    np.testing.assert_allclose(found.hand_pose[2], good.hand_pose[2], atol=1e-6)


@pytest.mark.parametrize(
    ("field", "value", "named"),
    [
        ("transl", np.zeros((2, 3)), "transl has shape"),
        ("pins", np.tile([np.nan, 3.0], (1, 21, 1)), "pins must have x and y"),
        ("pins", np.zeros((0, 21, 2)), "pins has shape"),
        ("detections", replace(photo().detections, frame=np.array([1])), "detections: at most one"),
        *(
            ("touches", np.where(np.arange(21) == 8, other, np.nan)[None], "touches: keypoint 8 must name")
            for other in (7.0, 1.5, np.inf, -7.0, -5.0, -9.0)
        ),
    ],
)
def test_bad_hands_are_named(field: str, value: Any, named: str) -> None:
    with pytest.raises(OptionError, match=named):
        replace(photo(), **{field: value})


@pytest.mark.parametrize(("one", "other"), [(8, 6), (5, 0), (8, 8), (13, 9), (21, 4)])
def test_points_that_cannot_touch(one: int, other: int) -> None:
    with pytest.raises(OptionError, match=r"choose points of two fingers|points that touch are 0 to 20"):
        touching_pair(one, other)
    assert not can_touch(max(one, other), min(one, other))


@pytest.mark.parametrize(
    ("field", "value"),
    [("side", None), ("keypoints_2d", None), ("world_landmarks", pack(np.zeros((3, 21, 3)))), ("added", 1)],
)
def test_bad_messages_are_named(field: str, value: Any) -> None:
    message = to_message(photo()) | {field: value}
    with pytest.raises(HandfitError, match=field):
        from_message({name: kept for name, kept in message.items() if kept is not None})


@pytest.mark.parametrize(
    ("message", "named"),
    [({"mode": "all"}, "mode"), ({"mode": "each"}, "hand"), ({"hand": 3}, "hand"), ({"hand": {}}, "side")],
)
def test_bad_requests_are_named(message: dict[str, Any], named: str) -> None:
    with pytest.raises(HandfitError, match=named):
        answer(message, never)
    with pytest.raises(ProtocolError, match="result"):
        result_from_message(message)


def test_bad_answers_are_named() -> None:
    done = answer({"mode": "draft", "hand": to_message(photo())}, never)
    wrong = {**done["result"], "transl": pack(np.zeros((2, 3)))}
    with pytest.raises(ProtocolError, match="transl"):
        result_from_message({"result": wrong})
