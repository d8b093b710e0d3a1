"""The networks on the bundled sample: as MediaPipe's graph runs them, and where it finds too little."""

import logging
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from handfit_core import capture
from handfit_core.capturing import sources
from handfit_core.capturing.detection import find_in_frame, open_detector
from handfit_core.capturing.options import CaptureOptions, region_of
from handfit_core.common.errors import NoHandFoundError, OptionError
from handfit_core.common.skeleton import SIDES, other_side
from handfit_core.detect import clips
from handfit_core.detect.clips import ClipFinder
from handfit_core.detect.crops import Crop
from handfit_core.detect.detector import Detector, DetectorSettings, Region
from handfit_core.detect.keypoints import Detections
from handfit_core.detect.matching import distance
from handfit_core.detect.networks import Networks, crop_around
from handfit_core.detect.stills import StillFinder
from handfit_core.media.frame_range import FrameRange
from handfit_core.worker.events import log_warnings_to
from tests.child import peak_megabytes
from tests.core.detect import clips as sample
from tests.core.detect.clips import SAMPLE

BLACK = np.zeros((480, 640, 3), dtype=np.uint8)
GRAPH = CaptureOptions(max_hands=1, detector="mediapipe")


pytestmark = pytest.mark.usefixtures("landmark_model")


@pytest.fixture(scope="module")
def networks() -> Iterator[Networks]:
    with Networks() as both:
        yield both


@pytest.fixture(scope="module")
def stills() -> Iterator[Detector]:
    with open_detector(CaptureOptions()) as detector:
        yield detector


@pytest.fixture(scope="module")
def plain() -> Iterator[Detector]:
    with open_detector(GRAPH) as detector:
        yield detector


def picture(number: int) -> np.ndarray:
    """Frame `number` of the sample."""
    return sample.picture(number - 1)


def clip_finder(networks: Networks) -> ClipFinder:
    return ClipFinder(DetectorSettings(max_hands=2, video=True), networks)


def as_the_graph_cuts(crop: Crop) -> Crop:
    """MediaPipe lays the middle of the picture's first pixel onto that of the crop's first one, so it
    predicts in this crop, half a pixel on."""
    half = np.array([0.5, 0.5])
    return Crop(crop.linear, crop.offset - crop.linear @ half + half, crop.size)


def test_landmarks_are_those_of_the_graph(networks):
    """It finds them from those of the frame before."""
    with open_detector(GRAPH, video=True) as graph:
        before = graph.find(picture(1), 0.0)
        for number in range(2, 8):
            rgb = picture(number)
            expected = graph.find(rgb, number / 25)
            prediction = networks.predict(rgb, as_the_graph_cuts(crop_around(before.keypoints[0])))
            found = prediction.keypoints[0] - [0.5, 0.5, 0.0]
            found[:, :2] += np.linalg.inv(crop_around(before.keypoints[0]).linear) @ [0.5, 0.5]
            assert np.abs(found - expected.keypoints).max() < 2e-3 * expected.extent
            assert np.abs(prediction.world - expected.world).max() < 2e-4  # metres
            assert prediction.score == pytest.approx(expected.score, abs=1e-3)
            assert prediction.side == expected.side
            assert prediction.certainty > 0.9
            before = expected


@pytest.mark.parametrize("quarter_turns", range(4))
def test_a_hand_that_fills_the_picture(stills, plain, quarter_turns):
    rgb = picture(13)
    whole = plain.find(rgb)
    (left, top), (right, bottom) = (f(whole.keypoints_2d[0], axis=0).astype(int) for f in (np.min, np.max))
    cut = np.rot90(rgb[top:bottom, left:right], quarter_turns)
    assert len(plain.find(cut)) == 0
    hand = stills.find(cut)
    assert hand.side == whole.side
    turn = np.eye(3)
    turn[:2, :2] = np.linalg.matrix_power([[0, 1], [-1, 0]], quarter_turns)
    middle = np.array([(right - left) / 2.0, (bottom - top) / 2.0])
    about = whole.keypoints_2d - [left, top] - middle
    expected = about @ turn[:2, :2].T + (middle[::-1] if quarter_turns % 2 else middle)
    assert np.linalg.norm(hand.keypoints_2d - expected, axis=-1).mean() < 0.06 * whole.extent
    assert np.linalg.norm(hand.world - whole.world @ turn.T, axis=-1).mean() < 0.015  # metres
    assert np.abs(hand.keypoints[..., 2] - whole.keypoints[..., 2]).mean() < 0.1 * whole.extent


def test_a_small_hand_in_a_large_picture(stills, plain):
    small = cv2.resize(picture(1), (160, 120), interpolation=cv2.INTER_AREA)
    large_hand = plain.find(picture(1))
    far = np.full((960, 1280, 3), 120, dtype=np.uint8)
    far[100:220, 900:1060] = small
    assert len(plain.find(far)) == 0
    hand = stills.find(far)
    expected = large_hand.keypoints_2d / 4 + [900, 100]
    assert np.linalg.norm(hand.keypoints_2d - expected, axis=-1).mean() < 0.06 * large_hand.extent / 4


def test_pictures_without_hands(stills):
    noise = np.random.default_rng(0).integers(0, 255, (300, 400, 3), dtype=np.uint8)
    assert [len(stills.find(rgb)) for rgb in (BLACK, noise, None)] == [0, 0, 0]


def test_a_still_has_test_time_augmentation(stills, plain):
    once, mean = plain.find(picture(5)), stills.find(picture(5))
    assert once.spread is None
    assert 0.0 < mean.spread.mean() < 0.05 * once.extent
    assert mean.side == once.side
    assert distance(mean, once) < 0.05


@pytest.mark.slow
def test_a_picture_of_100_megapixels(tmp_path):
    """Palms are searched in a smaller copy; the hand is a tenth of it."""
    whole = np.full((10_000, 10_000, 3), 120, dtype=np.uint8)
    whole[3000:3960, 4000:5280] = cv2.resize(picture(1)[..., ::-1], (1280, 960))
    cv2.imwrite(str(tmp_path / "large.png"), whole, [cv2.IMWRITE_PNG_COMPRESSION, 1])
    del whole
    code = """
        import sys
        from handfit_core import capture
        (hand,) = capture(sys.argv[1], max_megapixels=100).hands
        assert abs(hand.keypoints_2d[0].mean(axis=0) - [4619, 3359]).max() < 40, hand.keypoints_2d
    """
    assert peak_megabytes(code, tmp_path / "large.png") < 1000


@pytest.mark.slow
def test_any_number_of_threads_finds_the_same():
    rgb, found = four_hands()[..., ::-1], []
    for threads in (1, 3):
        with StillFinder(DetectorSettings(max_hands=None)) as finder:
            finder._networks.threads = threads
            hands = [*finder.find(rgb), finder.detect_in_box(rgb, [0.0, 0.0, 640.0, 480.0])]
            found.append([(*h.side, *h.certainty, *h.keypoints.ravel(), *h.world.ravel()) for h in hands])
    assert found[0] == found[1]
    assert len(found[0]) >= 4


def test_a_hand_that_jumps_is_found_again(networks, plain):
    jump = np.array([120, 80])
    frames = [picture(n) for n in range(1, 8)]
    truth = [plain.find(rgb) for rgb in frames]
    for i in (3, 4):
        frames[i] = np.roll(frames[i], tuple(jump[::-1]), axis=(0, 1))
        truth[i] = replace(truth[i], keypoints=truth[i].keypoints + [*jump, 0.0])
    with clip_finder(networks) as finder:
        for rgb in frames:
            finder.find(rgb)
        found = finder.frames
    assert [len(hands) for hands in found] == [1] * 7
    assert all(distance(hands[0], expected) < 0.1 for hands, expected in zip(found, truth, strict=True))


def test_a_new_hand_is_tracked_back(networks):
    """The second one comes in after the search of the first frame, and before the next."""
    with_both = [
        np.hstack([picture(n), picture(n)[:, ::-1]]) for n in range(1, 2 + clips.TRACKING.search_interval)
    ]
    frames = [rgb.copy() for rgb in with_both]
    for rgb in frames[:4]:
        rgb[:, 640:] = rgb.mean(axis=(0, 1))
    with clip_finder(networks) as finder:
        assert [len(finder.find(rgb)) for rgb in frames] == [1] * clips.TRACKING.search_interval + [2]
        found = finder.frames
    assert [len(hands) for hands in found] == [1] * 4 + [2] * (clips.TRACKING.search_interval - 3)
    for hands in found[4:]:
        mirrored = hands[1].keypoints_2d * [-1, 1] + [1280, 0]
        assert np.abs(mirrored - hands[0].keypoints_2d).mean() < 0.06 * hands[0].extent
        assert {int(hand.side[0]) for hand in hands} == {0, 1}


def four_hands() -> np.ndarray:
    """(960, 1280, 3) uint8 BGR: the rendered right hand, twice, and mirrored, twice."""
    picture = cv2.imread(str(SAMPLE / "hand.0001.jpg"))
    assert picture is not None
    row = np.hstack([picture, picture[:, ::-1]])
    return np.vstack([row, row])


@pytest.mark.slow
def test_four_hands(tmp_path, caplog, monkeypatch):
    """All hands of a photo are captured, and two of a clip; what was left out, and a crowd, is said."""
    for number in range(1, 4):
        cv2.imwrite(str(tmp_path / f"four.{number:04d}.png"), four_hands())
    photo = tmp_path / "four.0001.png"

    def captured(source: str | Path, **options: Any) -> tuple[int, list[str]]:
        caplog.clear()
        return len(capture(source, **options).hands), [record.getMessage() for record in caplog.records]

    assert captured(photo) == (4, [])
    count, (said,) = captured(photo, max_hands=3)
    assert count == 3
    assert said == (
        "4 hands were seen, and the 3 surest were captured: draw boxes around others (--region, or Find "
        "Hands in Blender), or allow more (--max-hands)"
    )
    count, (said,) = captured(photo, hands="left")
    assert (count, said.partition(":")[0]) == (1, "2 left hands were seen, and the surest was captured")
    count, (said,) = captured(tmp_path)
    assert (count, said.partition(",")[0]) == (2, "4 hands were seen")
    monkeypatch.setattr(sources, "CROWD", 3)
    count, (said,) = captured(photo)
    assert said == "4 hands are captured, and building so many takes long: --max-hands 3 keeps the surest"
    assert captured(photo, max_hands=4) == (4, [])


def box_around(hand: Detections, by: float = 10.0) -> list[float]:
    low, high = hand.box_min[0] - by, hand.box_max[0] + by
    return [*low, *(high - low)]


@pytest.mark.slow
def test_a_hand_in_a_box_is_found_however_unsure(plain, caplog):
    expected = plain.find(picture(7))
    photo = SAMPLE / "hand.0007.jpg"
    with pytest.raises(NoHandFoundError, match=r"draw a box .*--region.* Find Hands"):
        capture(photo, threshold=1.0)
    with pytest.raises(NoHandFoundError, match=r"not in the region .* Add Hand"):
        capture(photo, threshold=1.0, regions=[(1, 1, 40, 40)])
    with caplog.at_level(logging.WARNING, "handfit"):
        take = capture(photo, threshold=1.0, regions=[box_around(expected), (1, 1, 40, 40)])
    (hand,) = take.hands
    off = np.linalg.norm(hand.keypoints_2d[0] - expected.keypoints_2d[0], axis=-1).mean()
    assert off < 0.06 * expected.extent
    assert hand.side == SIDES[expected.side[0]]
    *_, said = [record.getMessage() for record in caplog.records]
    assert said.startswith("no hand was found in the region 1,1,40,40: draw the box")


def test_a_hand_that_was_likely_missed_is_told(monkeypatch):
    photo = SAMPLE / "hand.0007.jpg"
    told: list[tuple[str, str]] = []
    with log_warnings_to(lambda *warning: told.append(warning)):
        capture(photo)
        assert not told
        monkeypatch.setattr(StillFinder, "missed", True)
        capture(photo, hands="right")
        capture(photo, max_hands=1)
        assert not told
        capture(photo)
        capture(photo, regions=[(1, 1, 2, 2)])
    assert [offer for _, offer in told] == ["find_hands", "add_hand"]
    assert told[0][0].startswith("the picture may show another hand: draw a box around it")


def test_chosen_hands_and_no_others_are_captured(tmp_path):
    """Boxes about hands that are found mean those hands, wherever they are in the ranking, and a side that
    somebody gives is believed."""
    photo = tmp_path / "four.jpg"
    cv2.imwrite(str(photo), four_hands())
    _, hands = find_in_frame(photo, CaptureOptions())
    assert len(hands) == 4
    certain = hands.certainty.tolist()
    assert certain == sorted(certain, reverse=True)
    chosen = list(hands)[1:]
    sides = [SIDES[hand.likely_side[0]] for hand in chosen]
    sides[0] = other_side(sides[0])
    regions = [[*box_around(hand, 0.0), side] for hand, side in zip(chosen, sides, strict=True)]
    take = capture(photo, regions=regions, only_regions=True)
    assert len(take.hands) == 3
    for hand, side in zip(chosen, sides, strict=True):
        (same,) = [t for t in take.hands if np.allclose(t.keypoints_2d[0], hand.keypoints_2d[0], atol=1e-3)]
        assert same.side == side
    # A box that was drawn by hand about another place is one more prediction.
    _, shown = find_in_frame(
        photo, CaptureOptions(regions=(region_of(box_around(hands.select(slice(1)))),), only_regions=True)
    )
    assert (distance(shown, hands.select(slice(1))) < 0.06).tolist() == [True]


def test_where_no_region_has_a_hand_nothing_is_captured():
    photo = SAMPLE / "hand.0007.jpg"
    with pytest.raises(NoHandFoundError, match="not in the region that was drawn either"):
        capture(photo, regions=[(1, 1, 40, 40)], only_regions=True)
    nowhere = CaptureOptions(regions=(Region(1, 1, 40, 40),), only_regions=True)
    assert len(find_in_frame(photo, nowhere)[1]) == 0
    with pytest.raises(OptionError, match="give a region"):
        capture(photo, only_regions=True)
    with pytest.raises(OptionError, match="the detector direct can"):
        capture(photo, detector="mediapipe", regions=["1,2,30,40"])


def test_a_tracked_hand_is_chosen_in_any_frame(tmp_path):
    """Of two hands in a clip, the one whose box is given; the frame is searched as a photo is."""
    for number in range(1, 8):
        two = np.hstack([picture(number), picture(number)[:, ::-1]])
        cv2.imwrite(str(tmp_path / f"two.{number:04d}.png"), two[..., ::-1])
    pattern = str(tmp_path / "two.%04d.png")
    frame, hands = find_in_frame(pattern, CaptureOptions(frames=FrameRange(4, 4)))
    assert (frame.number, len(hands)) == (4, 2)
    left = min(hands, key=lambda hand: hand.centroid[0, 0])
    given = other_side(SIDES[left.likely_side[0]])
    take = capture(pattern, regions=[[*box_around(left, 0.0), 4, given]], only_regions=True)
    (hand,) = take.hands
    assert hand.side == given
    assert hand.detected.all()
    assert (hand.keypoints_2d[..., 0] < 640).all()


@pytest.mark.slow
def test_a_box_starts_a_track_both_ways(plain, caplog, monkeypatch):
    """Also farther back than hands that turn up by themselves are tracked."""
    monkeypatch.setattr(clips, "TRACKING", replace(clips.TRACKING, backtrack_frames=4))
    last = 20
    expected = plain.find(picture(last))
    pattern = str(SAMPLE / "hand.%04d.jpg")
    regions = [[*box_around(expected), last], [*box_around(expected), 400]]
    with caplog.at_level(logging.WARNING, "handfit"):
        take = capture(pattern, threshold=1.0, regions=regions)
    (hand,) = take.hands
    assert hand.detected.all()
    for number in (1, 12, last, 24):
        seen = plain.find(picture(number))
        off = np.linalg.norm(hand.keypoints_2d[number - 1] - seen.keypoints_2d[0], axis=-1).mean()
        assert off < 0.06 * seen.extent
    said = [record.getMessage() for record in caplog.records]
    assert said == ["the region in frame 400 was not looked at: that frame is not used"]
