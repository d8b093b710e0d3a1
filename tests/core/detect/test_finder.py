"""MediaPipe on the bundled sample, where its plain detector finds too little and where it finds all."""

import logging
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest

from handfit_core import capture
from handfit_core.detect import clips
from handfit_core.detect.clips import ClipFinder
from handfit_core.detect.detector import Backend, Detector, DetectorSettings
from handfit_core.detect.finder import COUNTED_EVERY, HandCounter, open_finder
from handfit_core.detect.keypoints import HandDetection
from handfit_core.detect.landmark_model import landmark_model_path
from handfit_core.detect.looks import distance
from handfit_core.detect.mediapipe_tasks import MEDIAPIPE
from handfit_core.detect.stills import StillFinder
from handfit_core.errors import LandmarkModelError
from handfit_core.media.pictures import read_picture
from handfit_core.options import CaptureOptions
from tests.conftest import ROOT

SAMPLE = ROOT / "samples" / "rendered_hand"
BLACK = np.zeros((480, 640, 3), dtype=np.uint8)
PLAIN = CaptureOptions(plain_detection=True)
ONE = CaptureOptions(max_hands=1, plain_detection=True)


@pytest.fixture(scope="module", autouse=True)
def _landmark_model() -> None:
    try:
        landmark_model_path()
    except LandmarkModelError as error:
        pytest.skip(str(error))


@pytest.fixture(scope="module")
def stills() -> Iterator[Detector]:
    with open_finder(CaptureOptions()) as finder:
        yield finder


@pytest.fixture(scope="module")
def plain() -> Iterator[Detector]:
    with open_finder(PLAIN) as finder:
        yield finder


def picture(number: int) -> np.ndarray:
    return read_picture(SAMPLE / f"hand.{number:04}.jpg")[0]


def dark(rgb: np.ndarray) -> np.ndarray:
    """Too dark for the plain detector to begin with."""
    return (rgb * 0.1).astype(np.uint8)


def moved(hand: HandDetection, by: np.ndarray) -> HandDetection:
    return HandDetection(hand.side, hand.score, hand.keypoints + [*by, 0.0], hand.world)


@pytest.mark.parametrize("quarter_turns", range(4))
def test_a_hand_that_fills_the_picture(stills: Detector, plain: Detector, quarter_turns: int) -> None:
    rgb = picture(13)
    (whole,) = plain.find(rgb)
    start = whole.keypoints_2d.min(axis=0).astype(int)
    (left, top), (right, bottom) = start, whole.keypoints_2d.max(axis=0).astype(int)
    cut = np.rot90(rgb[top:bottom, left:right], quarter_turns)
    assert plain.find(cut) == ()
    (hand,) = stills.find(cut)
    assert hand.side == whole.side
    expected, world = whole.keypoints_2d - start, whole.world.copy()
    width = right - left
    for _ in range(quarter_turns):
        expected = np.stack([expected[:, 1], width - expected[:, 0]], axis=-1)
        world[:, :2] = np.stack([world[:, 1], -world[:, 0]], axis=-1)
        width = bottom - top if width == right - left else right - left
    assert np.linalg.norm(hand.keypoints_2d - expected, axis=-1).mean() < 0.06 * whole.extent
    assert np.linalg.norm(hand.world - world, axis=-1).mean() < 0.015  # metres
    assert np.abs(hand.keypoints[:, 2] - whole.keypoints[:, 2]).mean() < 0.1 * whole.extent


def test_a_small_hand_in_a_large_picture(stills: Detector, plain: Detector) -> None:
    small = cv2.resize(picture(1), (160, 120), interpolation=cv2.INTER_AREA)
    (large_hand,) = plain.find(picture(1))
    far = np.full((960, 1280, 3), 120, dtype=np.uint8)
    far[100:220, 900:1060] = small
    assert plain.find(far) == ()
    (hand,) = stills.find(far)
    expected = large_hand.keypoints_2d / 4 + [900, 100]
    assert np.linalg.norm(hand.keypoints_2d - expected, axis=-1).mean() < 0.06 * large_hand.extent / 4


def test_pictures_without_hands(stills: Detector) -> None:
    noise = np.random.default_rng(0).integers(0, 255, (300, 400, 3), dtype=np.uint8)
    assert stills.find(BLACK) == ()
    assert stills.find(noise) == ()
    assert stills.find(None) == ()


def test_a_hand_that_is_found_is_looked_at_again(stills: Detector, plain: Detector) -> None:
    (once,), (mean,) = plain.find(picture(5)), stills.find(picture(5))
    assert once.spread is None
    assert mean.spread is not None
    assert mean.spread.shape == (21, 3)
    assert 0.0 < mean.spread.mean() < 0.05 * once.extent
    assert mean.side == once.side
    assert distance(mean, once) < 0.05


def test_where_all_is_found_a_clip_costs_nothing_more() -> None:
    frames = [picture(n) for n in range(1, 9)]
    with ClipFinder(MEDIAPIPE, DetectorSettings(max_hands=1, video=True)) as finder:
        found = [finder.find(rgb, i / 25) for i, rgb in enumerate(frames)]
        assert finder._of_crops is None
        assert finder._of_frames is None
    with open_finder(ONE, video=True) as plain:
        for hands, expected in zip(
            found, [plain.find(rgb, i / 25) for i, rgb in enumerate(frames)], strict=True
        ):
            assert len(hands) == len(expected) == 1
            np.testing.assert_array_equal(hands[0].keypoints, expected[0].keypoints)


def test_a_hand_that_a_clip_loses_is_found_near_there() -> None:
    """It jumps, in the dark, for two frames: MediaPipe's following loses it until there is light."""
    jump = np.array([120, 80])
    frames = [picture(n) for n in range(1, 8)]
    truth: list[HandDetection] = []
    with open_finder(ONE) as still:
        truth = [still.find(rgb)[0] for rgb in frames]
    for i in (3, 4):
        frames[i] = dark(np.roll(frames[i], tuple(jump[::-1]), axis=(0, 1)))
        truth[i] = moved(truth[i], jump)
    counts = []
    for options in (PLAIN, CaptureOptions()):
        with open_finder(options, video=True) as finder:
            found = finder.completed([finder.find(rgb, i / 25) for i, rgb in enumerate(frames)])
        counts.append([len(hands) for hands in found])
    assert 0 in counts[0][3:5]
    assert counts[1] == [1] * 7
    assert all(distance(hands[0], expected) < 0.15 for hands, expected in zip(found, truth, strict=True))


def test_a_hand_that_turns_up_is_looked_for_in_the_frames_before() -> None:
    # The search of the first frame is in vain; the next one is not due in the second frame.
    frames = [BLACK, dark(picture(2)), picture(3), picture(4)]
    with open_finder(CaptureOptions(), video=True) as finder:
        found = [finder.find(rgb, i / 25) for i, rgb in enumerate(frames)]
        assert [len(hands) for hands in found] == [0, 0, 1, 1]
        found = finder.completed(found)
    assert [len(hands) for hands in found] == [0, 1, 1, 1]
    with open_finder(PLAIN) as still:
        assert distance(found[1][0], still.find(picture(2))[0]) < 0.15


def test_where_a_second_detector_cannot_be_opened_the_first_is_closed() -> None:
    opened: list[Detector] = []
    closed: list[Detector] = []

    class Toy(Detector):
        def close(self) -> None:
            closed.append(self)

    def open_toy(_: DetectorSettings) -> Detector:
        if len(opened) == 2:
            raise LandmarkModelError("no more")
        opened.append(Toy())
        return opened[-1]

    with pytest.raises(LandmarkModelError, match="no more"):
        StillFinder(Backend(open_toy, lambda _: "", second_looks=True), DetectorSettings())
    assert closed == opened[::-1]


def test_a_hand_that_has_left_costs_little(monkeypatch: pytest.MonkeyPatch) -> None:
    looked_again: list[int] = []
    searched: list[int] = []
    with ClipFinder(MEDIAPIPE, DetectorSettings(max_hands=2, video=True)) as finder:
        look_at, search = finder._look_at, clips.search
        monkeypatch.setattr(
            finder, "_look_at", lambda *a: (looked_again.append(len(finder.frames)), look_at(*a))[1]
        )
        monkeypatch.setattr(clips, "search", lambda *a: (searched.append(len(finder.frames)), search(*a))[1])
        finder.find(picture(1), 0.0)
        for i in range(1, 80):
            assert finder.find(BLACK if i % 10 else None, i / 25) == ()
        assert len(looked_again) <= clips.MOST_TRIES
        assert 1 <= len(searched) <= 6
        assert len(finder._past) <= clips.LOOK_BACK
        assert not finder._followed


def test_past_frames_are_bounded_in_bytes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(clips, "MOST_PAST_BYTES", 3 * BLACK.nbytes)
    with ClipFinder(MEDIAPIPE, DetectorSettings(max_hands=2, video=True)) as finder:
        for i in range(6):
            finder.find(BLACK, i / 25)
        assert len(finder._past) == 3


def four_hands() -> np.ndarray:
    """(960, 1280, 3) uint8 BGR: the rendered right hand, twice, and mirrored, twice."""
    picture = cv2.imread(str(SAMPLE / "hand.0001.jpg"))
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
        capture(SAMPLE / "hand.0001.jpg")
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
    with HandCounter(CaptureOptions()) as counter:
        for _ in range(3 * COUNTED_EVERY):
            counter.look(four_hands(), 1)
        assert counter._counting is None
        assert counter.seen == 0


def test_one_picture_of_a_clip_is_no_proof() -> None:
    nothing = np.zeros((480, 640, 3), dtype=np.uint8)
    with HandCounter(CaptureOptions()) as counter:
        pictures = [four_hands()[..., ::-1]] + [nothing] * COUNTED_EVERY
        for picture in pictures:
            counter.look(picture, 2)
        assert counter.seen == 0
        for _ in range(COUNTED_EVERY):
            counter.look(four_hands()[..., ::-1], 2)
        assert counter.seen == 4
