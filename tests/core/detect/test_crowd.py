"""More hands than are captured: said, and free of charge where there are none."""

import logging
from pathlib import Path

import cv2
import numpy as np
import pytest

from handfit_core import capture
from handfit_core.detect.crowd import EVERY, HandCounter
from tests.conftest import ROOT

HAND = ROOT / "samples" / "rendered_hand" / "hand.0001.jpg"


def four_hands() -> np.ndarray:
    """(960, 1280, 3) uint8 BGR: the rendered right hand, twice, and mirrored, twice."""
    picture = cv2.imread(str(HAND))
    assert picture is not None
    row = np.hstack([picture, picture[:, ::-1]])
    return np.vstack([row, row])


def told(caplog: pytest.LogCaptureFixture) -> list[str]:
    return [record.getMessage() for record in caplog.records if "were seen" in record.getMessage()]


def test_a_photo_of_four_hands(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    cv2.imwrite(str(tmp_path / "four.jpg"), four_hands())
    with caplog.at_level(logging.WARNING, "handfit"):
        take = capture(tmp_path / "four.jpg")
        assert len(take.hands) == 2
        capture(HAND)
    assert told(caplog) == [
        "4 hands were seen, and the 2 surest were captured: crop the footage to capture others"
    ]


def test_a_clip_of_four_hands(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    for number in range(1, 4):
        cv2.imwrite(str(tmp_path / f"four.{number:04d}.png"), four_hands())
    with caplog.at_level(logging.WARNING, "handfit"):
        take = capture(str(tmp_path / "four.%04d.png"))
    assert len(take.hands) == 2
    (sentence,) = told(caplog)
    assert sentence.startswith("4 hands were seen")


def test_nothing_is_looked_at_again_where_fewer_were_found_than_looked_for() -> None:
    with HandCounter(max_hands=2, threshold=0.5, landmark_model=None) as counter:
        for _ in range(3 * EVERY):
            counter.look(four_hands(), 1)
        assert counter._detector is None
        assert counter.seen == 0


def test_one_picture_of_a_clip_is_no_proof() -> None:
    nothing = np.zeros((480, 640, 3), dtype=np.uint8)
    with HandCounter(max_hands=2, threshold=0.5, landmark_model=None) as counter:
        pictures = [four_hands()[..., ::-1]] + [nothing] * EVERY
        for picture in pictures:
            counter.look(picture, 2)
        assert counter.seen == 0
        for _ in range(EVERY):
            counter.look(four_hands()[..., ::-1], 2)
        assert counter.seen == 4
