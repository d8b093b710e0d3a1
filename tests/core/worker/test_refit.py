"""The request `refit`: where it is stopped, and one sentence for every field that is not right."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from handfit_core import Intrinsics, Take
from handfit_core.common.errors import Cancelled, HandfitError, OptionError, ProtocolError
from handfit_core.detect.keypoints import Detections
from handfit_core.edit import RefineHand, to_message
from handfit_core.edit.messages import answer, from_message
from handfit_core.fit.solvers import never
from tests.conftest import ROOT
from tests.core.fit.detections import columns

COUNT = 8


@pytest.fixture(scope="module")
def hand() -> RefineHand:
    """The rendered hand, without depth; as a capture has it."""
    truth = Take.load(ROOT / "samples" / "rendered_hand" / "truth.take.npz")
    track = truth.hands[0]
    points = track.joints_3d - track.joints_3d.mean(axis=1, keepdims=True)
    flat = np.zeros((21, 1))
    return RefineHand(
        side="right",
        betas=track.betas,
        intrinsics=truth.intrinsics,
        detections=columns(
            [
                Detections.hand(
                    "right", 0.9, np.concatenate([track.keypoints_2d[i], flat], axis=1), points[i]
                )
                for i in range(COUNT)
            ]
        ),
        pins=np.full((COUNT, 21, 2), np.nan),
        global_orient=track.global_orient[:COUNT],
        hand_pose=track.hand_pose[:COUNT],
        transl=track.transl[:COUNT],
        locked=np.zeros(16, dtype=bool),
    )


def test_a_drag_is_stopped_before_answering(hand: RefineHand) -> None:
    asked: list[int] = []
    with pytest.raises(Cancelled):
        answer({"hand": to_message(hand)}, lambda: asked.append(1) or len(asked) > 1)


def test_mode_may_be_missing(hand: RefineHand) -> None:
    done = answer({"hand": to_message(hand)}, never)
    assert done["result"] == answer({"hand": to_message(hand), "mode": "each"}, never)["result"]


@pytest.mark.parametrize(
    ("changes", "kind", "said"),
    [
        ({"holes": [float("nan")]}, ProtocolError, "holes must be a finite number, not"),
        ({"holes": [1.5]}, ProtocolError, "holes must be a whole number, not"),
        ({"holes": 3}, ProtocolError, "holes must be a list, not 3"),
        ({"fps": True}, ProtocolError, "fps must be a finite number, not True"),
        (
            {"smoothing": 10**400},
            ProtocolError,
            "smoothing must be a finite number, not a number that is too large",
        ),
        ({"intrinsics": ["a", 1, 2, 3]}, ProtocolError, "intrinsics must be a finite number, not 'a'"),
        ({"intrinsics": [1, 2]}, ProtocolError, "intrinsics must be a list of 4 numbers, not"),
        ({"intrinsics": [1e-300, 1e-300, 0, 0]}, OptionError, "positive, finite focal lengths"),
        ({"model": 3}, ProtocolError, "model must be a text of at most 32767 characters, not 3"),
    ],
    ids=lambda value: str(value)[:40],
)
def test_a_wrong_field_is_one_short_sentence(
    hand: RefineHand, changes: dict[str, Any], kind: type[HandfitError], said: str
) -> None:
    with pytest.raises(kind) as caught:
        from_message({**to_message(hand), **changes})
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 250


def test_numbers_that_are_right(hand: RefineHand) -> None:
    message = {
        **to_message(hand),
        "holes": [2, 5.0],
        "fps": 30,
        "smoothing": 0,
        "intrinsics": [700, 710, 3, 4],
    }
    back = from_message(message)
    assert (back.holes, back.fps, back.smoothing) == ((2, 5), 30.0, 0.0)
    assert back.intrinsics == Intrinsics(700, 710, 3, 4)
