import numpy as np
import pytest

from handfit_core.detect.tracks import link_tracks
from handfit_core.errors import NoHandFoundError, OptionError
from handfit_core.keypoints import HandDetection
from handfit_core.skeleton import Side

SHAPE = np.random.default_rng(5).uniform(-50, 50, (21, 3))


def hand(x: float, side: Side = "right", score: float = 0.9, y: float = 300.0) -> HandDetection:
    return HandDetection(side, score, SHAPE + [x, y, 0.0], SHAPE / 1000)


def x_of(detection: HandDetection | None) -> float | None:
    return None if detection is None else round(float((detection.keypoints - SHAPE)[0, 0]), 6)


def test_crossing_hands_keep_their_identity() -> None:
    frames = []
    for t in range(21):
        left, right = hand(100 + 20 * t, "left"), hand(500 - 20 * t, "right", y=340)
        frames.append([left, right] if t % 2 else [right, left])
    tracks = {t.side: t for t in link_tracks(frames)}
    assert [x_of(d) for d in tracks["left"].detections] == [100 + 20 * t for t in range(21)]
    assert [x_of(d) for d in tracks["right"].detections] == [500 - 20 * t for t in range(21)]


def test_side_is_decided_over_the_clip() -> None:
    frames = [[hand(100 + t, "left" if t in (3, 4) else "right")] for t in range(10)]
    (track,) = link_tracks(frames)
    assert track.side == "right"
    assert track.detected.all()


def test_hand_that_leaves_and_returns_elsewhere_is_one_track() -> None:
    frames = [[hand(100)], [hand(110)], [], [], [hand(900)], [hand(905)]]
    (track,) = link_tracks(frames)
    assert [x_of(d) for d in track.detections] == [100, 110, None, None, 900, 905]
    np.testing.assert_array_equal(track.detected, [True, True, False, False, True, True])


def test_duplicates_of_one_hand_are_merged() -> None:
    tracks = link_tracks([[hand(100, score=0.6), hand(104, score=0.9)]])
    assert len(tracks) == 1
    assert x_of(tracks[0].detections[0]) == 104


def test_two_hands_of_one_side_stay_two() -> None:
    frame = [hand(100, "left", 0.97), hand(500, "left", 0.96)]
    assert [t.side for t in link_tracks([frame])] == ["left", "left"]


def test_hand_choice() -> None:
    both = [[hand(100, "left", 0.8), hand(500, "right", 0.9)]]
    assert [t.side for t in link_tracks(both, "left")] == ["left"]
    assert [t.side for t in link_tracks(both, "right")] == ["right"]
    assert [t.side for t in link_tracks(both, "auto", max_hands=1)] == ["right"]
    alike = [[hand(100, "left", 0.99), hand(500, "left", 0.6)]]
    assert {t.side: x_of(t.detections[0]) for t in link_tracks(alike, "both")} == {"left": 100, "right": 500}
    assert [t.side for t in link_tracks([[hand(100, "left")]], "both")] == ["left"]
    # A weak track of the missing side is better than relabelling a strong one.
    three = [[hand(100, "right", 0.9), hand(500, "right", 0.8)]] * 3 + [[hand(900, "left", 0.9)]]
    found = {t.side: x_of(next(d for d in t.detections if d)) for t in link_tracks(three, "both")}
    assert found == {"right": 100, "left": 900}


def test_a_stray_misdetection_is_no_second_hand() -> None:
    frames = [[hand(100 + t)] for t in range(30)]
    frames[7] = [*frames[7], hand(900, "left", 0.6)]
    assert [t.side for t in link_tracks(frames)] == ["right"]


def test_nothing_found() -> None:
    with pytest.raises(NoHandFoundError, match="threshold"):
        link_tracks([[], []])
    with pytest.raises(NoHandFoundError, match="only a left one"):
        link_tracks([[hand(1, "left")]], "right")
    with pytest.raises(OptionError, match="auto, left, right, both"):
        link_tracks([[hand(1)]], "lefty")  # pyright: ignore[reportArgumentType]
