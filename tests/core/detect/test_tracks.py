from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from handfit_core.detect.keypoints import SURE_SIDE_SCORE, Detections, HandDetection, Track
from handfit_core.detect.matching import covers, distance
from handfit_core.detect.tracks import LINKING, link_and_count, without_duplicates
from handfit_core.errors import NoHandFoundError
from handfit_core.skeleton import HandChoice, Side

SHAPE = np.random.default_rng(5).uniform(-50, 50, (21, 3))


def hand(x: float, side: Side = "right", score: float = 0.9, y: float = 300.0) -> HandDetection:
    return HandDetection(side, score, SHAPE + [x, y, 0.0], SHAPE / 1000)


def unsure_hand(
    x: float, side: Side = "right", right_side: float = 1.0, score: float = 0.85, y: float = 300.0
) -> HandDetection:
    """A hand with a score below `SURE_SIDE_SCORE`, so that the network judges its side."""
    return replace(hand(x, side, score, y), right_side=right_side)


def count_tracks(
    frames: Sequence[Sequence[HandDetection]], hands: HandChoice = "auto", **options: Any
) -> tuple[tuple[Track, ...], int]:
    return link_and_count(Detections.of(frames), len(frames), hands, **options)


def link_tracks(
    frames: Sequence[Sequence[HandDetection]], hands: HandChoice = "auto", **options: Any
) -> tuple[Track, ...]:
    return count_tracks(frames, hands, **options)[0]


def places(track: Track) -> list[float | None]:
    """Where the hand is in each frame; None: it is not there."""
    x = np.full(track.frame_count, np.nan)
    x[track.detections.frame] = (track.detections.keypoints - SHAPE)[:, 0, 0]
    return [None if np.isnan(each) else round(float(each), 6) for each in x]


def test_crossing_hands_keep_their_identity() -> None:
    frames = []
    for t in range(21):
        left, right = hand(100 + 20 * t, "left"), hand(500 - 20 * t, "right", y=340)
        frames.append([left, right] if t % 2 else [right, left])
    tracks = {t.side: t for t in link_tracks(frames)}
    assert places(tracks["left"]) == [100 + 20 * t for t in range(21)]
    assert places(tracks["right"]) == [500 - 20 * t for t in range(21)]


def test_side_is_decided_over_the_clip() -> None:
    frames = [[hand(100 + t, "left" if t in (3, 4) else "right")] for t in range(10)]
    (track,) = link_tracks(frames)
    assert track.side == "right"
    assert track.detected.all()


def test_hand_that_leaves_and_returns_elsewhere_is_one_track() -> None:
    frames = [[hand(100)], [hand(110)], [], [], [hand(900)], [hand(905)]]
    (track,) = link_tracks(frames)
    assert places(track) == [100, 110, None, None, 900, 905]
    np.testing.assert_array_equal(track.detected, [True, True, False, False, True, True])


def test_duplicates_of_one_hand_are_merged() -> None:
    tracks = link_tracks([[hand(100, score=0.6), hand(104, score=0.9)]])
    assert len(tracks) == 1
    assert places(tracks[0])[0] == 104


def test_two_hands_of_one_side_stay_two() -> None:
    frame = [hand(100, "left", 0.97), hand(500, "left", 0.96)]
    assert [t.side for t in link_tracks([frame])] == ["left", "left"]


def test_a_side_that_a_person_has_given_is_believed() -> None:
    told = replace(hand(120, "left", 0.1), shown=True, given_side="right")
    frames = [[hand(100 + 10 * t, "left"), hand(600, "left")] if t != 2 else [told] for t in range(5)]
    assert [t.side for t in link_tracks(frames)] == ["right", "left"]
    assert [t.side for t in link_tracks(frames, "both")] == ["right", "left"]
    (only,), seen = count_tracks(frames, only_shown=True)
    assert (only.side, seen) == ("right", 1)
    assert only.detected.all()


def test_hand_choice() -> None:
    both = [[hand(100, "left", 0.8), hand(500, "right", 0.9)]]
    assert [t.side for t in link_tracks(both, "left")] == ["left"]
    assert [t.side for t in link_tracks(both, "right")] == ["right"]
    assert [t.side for t in link_tracks(both, "auto", max_hands=1)] == ["right"]
    alike = [[hand(100, "left", 0.99), hand(500, "left", 0.6)]]
    assert {t.side: places(t)[0] for t in link_tracks(alike, "both")} == {"left": 100, "right": 500}
    assert [t.side for t in link_tracks([[hand(100, "left")]], "both")] == ["left"]
    # A weak track of the missing side is better than relabelling a strong one.
    three = [[hand(100, "right", 0.9), hand(500, "right", 0.8)]] * 3 + [[hand(900, "left", 0.9)]]
    found = {t.side: next(x for x in places(t) if x) for t in link_tracks(three, "both")}
    assert found == {"right": 100, "left": 900}


def test_a_stray_misdetection_is_no_second_hand() -> None:
    frames = [[hand(100 + t)] for t in range(30)]
    frames[7] = [*frames[7], hand(900, "left", 0.6)]
    assert [t.side for t in link_tracks(frames)] == ["right"]


def test_hands_that_cross_in_one_line_keep_their_identity() -> None:
    """Both pass the same place, and the detector names both alike while they do."""
    frames = []
    for t in range(21):
        unsure = 8 <= t <= 12
        frames.append([hand(100 + 21 * t, "right" if unsure else "left"), hand(520 - 20 * t, "right", y=330)])
    tracks = {t.side: t for t in link_tracks(frames)}
    assert places(tracks["left"]) == [100 + 21 * t for t in range(21)]
    assert places(tracks["right"]) == [520 - 20 * t for t in range(21)]


def test_a_moving_hand_is_found_again_after_a_gap() -> None:
    """Two hands of one side: only their motion tells which one comes back where."""
    frames = [[hand(30 * t), hand(30 * t, y=500)] for t in range(6)]
    frames += [[]] * 4
    frames += [[hand(30 * t, y=500), hand(30 * t)] for t in range(10, 14)]
    tracks = link_tracks(frames)
    assert len(tracks) == 2
    for track in tracks:
        assert np.ptp(track.detections.keypoints[:, 0, 1]) == 0
        assert track.detected.sum() == 10


def test_a_hand_whose_side_flickers_is_one_track() -> None:
    frames = [[hand(100 + 3 * t, "left" if t % 2 else "right", 0.9 if t % 2 else 0.8)] for t in range(20)]
    (track,) = link_tracks(frames)
    assert track.side == "left"
    assert track.detected.all()


def test_a_lost_hand_that_comes_back_as_one_of_the_other_side() -> None:
    frames = [[hand(100 + t)] for t in range(10)] + [[]] * 5 + [[hand(220, "left", 0.7)]] * 3
    (track,) = link_tracks(frames)
    assert track.side == "right"
    assert track.detected.sum() == 13
    # After a long time, it may well be the other hand.
    apart = [[hand(100 + t)] for t in range(10)] + [[]] * 30 + [[hand(220, "left", 0.7)]] * 3
    assert {t.side for t in link_tracks(apart)} == {"left", "right"}


def test_one_hand_found_as_two_is_one_track() -> None:
    """A little too far apart for a duplicate within the frame."""
    frames = [[hand(100 + t), hand(130 + t, "left", 0.6)] for t in range(10)]
    (track,) = link_tracks(frames)
    assert track.side == "right"
    assert places(track) == [100 + t for t in range(10)]


def test_fingers_taken_for_a_small_hand_are_part_of_their_hand() -> None:
    def part(t: float) -> HandDetection:
        return HandDetection("left", 0.7, 0.4 * SHAPE + [100 + t, 300.0, 0.0], SHAPE / 1000)

    (track,) = link_tracks([[hand(100 + t), part(t)] for t in range(10)])
    assert track.side == "right"
    # Beside the hand, it is another, farther away.
    assert len(link_tracks([[hand(100 + t), part(t + 90)] for t in range(10)])) == 2


def test_a_long_clip_with_a_long_gap() -> None:
    frames = [[hand(100 + t % 50), hand(600 - t % 40, "left")] for t in range(1000)]
    frames[500:600] = [[]] * 100
    assert [t.detected.sum() for t in link_tracks(frames)] == [900, 900]


def test_the_networks_word_decides_the_side() -> None:
    """The detector names all of them left, and the network says that is unlikely."""
    frames = [[unsure_hand(100 + t, "left", 0.2)] for t in range(6)]
    (track,) = link_tracks(frames)
    assert track.side == "right"
    assert [t.side for t in link_tracks(frames, "right")] == ["right"]
    with pytest.raises(NoHandFoundError, match="only a right one"):
        link_tracks(frames, "left")
    # A few frames that are sure of one side outweigh more that are not.
    mixed = [unsure_hand(100 + t, "left", 1.0 if t < 4 else 0.4) for t in range(10)]
    (track,) = link_tracks([[d] for d in mixed])
    assert track.side == "left"  # 0.85 (4 + 6 x 0.4) against 0.85 x 6 x 0.6


def test_the_network_does_not_overrule_a_sure_detector() -> None:
    """Of a clip's frames, those in which the detector is sure count for its side alone."""
    frames = [[unsure_hand(100 + t, "left", 0.2, SURE_SIDE_SCORE)] for t in range(6)]
    assert [track.side for track in link_tracks(frames)] == ["left"]
    with pytest.raises(NoHandFoundError, match="only a left one"):
        link_tracks(frames, "right")
    mixed = [unsure_hand(100 + t, "left", 0.2, 0.95 if t < 3 else 0.8) for t in range(6)]
    assert [track.side for track in link_tracks([[d] for d in mixed])] == ["left"]  # 2.85 + 0.48 against 1.92
    mixed = [unsure_hand(100 + t, "left", 0.2, 0.95 if t < 1 else 0.8) for t in range(6)]
    assert [track.side for track in link_tracks([[d] for d in mixed])] == ["right"]  # 0.95 + 0.8 against 3.2


def test_crossing_hands_by_the_networks_word() -> None:
    """The detector names both alike; only the network tells them apart."""
    frames = []
    for t in range(21):
        left = unsure_hand(100 + 20 * t, "right", 0.1)
        right = unsure_hand(500 - 20 * t, "right", 0.95, y=340)
        frames.append([left, right] if t % 2 else [right, left])
    tracks = {t.side: t for t in link_tracks(frames)}
    assert places(tracks["left"]) == [100 + 20 * t for t in range(21)]
    assert places(tracks["right"]) == [500 - 20 * t for t in range(21)]


def test_where_places_are_undecided_the_networks_word_decides() -> None:
    """Each hand is a little nearer to where the other one was."""
    before = [unsure_hand(100, right_side=0.1), unsure_hand(200, right_side=0.9)]
    after = [unsure_hand(152, right_side=0.1, y=340), unsure_hand(148, right_side=0.9, y=260)]
    tracks = {t.side: t for t in link_tracks([before, after])}
    assert places(tracks["left"]) == [100, 152]
    assert places(tracks["right"]) == [200, 148]


def test_points_where_another_hand_is_are_marked() -> None:
    frames = [[hand(100 + 20 * t, "left"), hand(500 - 20 * t, y=340)] for t in range(21)]
    counts = set()
    for track in (*link_tracks(frames), *link_tracks(frames, max_hands=1)):
        # A hand that is not chosen hides points, too.
        assert track.detections.overlapped is not None
        marked = track.detections.overlapped.any(axis=1)
        assert not marked[:5].any()
        assert not marked[-5:].any()
        assert marked[8:13].all()
        counts.add(int(marked.sum()))
    assert len(counts) == 1
    # One that was found twice hides none of its own.
    (twice,) = link_tracks([[hand(100 + t), hand(130 + t, "left", 0.6)] for t in range(10)])
    assert twice.detections.overlapped is None


@pytest.mark.parametrize(
    ("unsure", "score", "apart", "sides"),
    [
        (0.4, 0.85, 60, {"left", "right"}),
        (0.05, 0.85, 60, {"right"}),
        (0.4, 0.85, 400, {"right"}),
        (0.4, 0.9, 60, {"right"}),
    ],
    ids=["one person's", "two people's", "apart", "sure"],
)
def test_hands_that_touch_are_left_and_right(
    unsure: float, score: float, apart: float, sides: set[Side]
) -> None:
    """The detector names both right, one of them with so much doubt."""
    frames = [
        [hand(100 + t), unsure_hand(100 + apart + t, right_side=1.0 - unsure, score=score)] for t in range(9)
    ]
    tracks = link_tracks(frames)
    assert {t.side for t in tracks} == sides
    assert len(tracks) == 2
    assert [places(t)[0] for t in tracks if t.side == "left"] in ([], [100 + apart])
    given = [[replace(h, given_side=h.side) for h in frame] for frame in frames]
    assert {t.side for t in link_tracks(given)} == {"right"}


def test_tracks_know_the_clips_rate() -> None:
    assert [t.fps for t in link_tracks([[hand(1)]], fps=12.5)] == [12.5]


def test_nothing_found() -> None:
    with pytest.raises(NoHandFoundError, match="in any frame"):
        link_tracks([[], []])
    with pytest.raises(NoHandFoundError, match="only a left one"):
        link_tracks([[hand(1, "left")]], "right")


def crowd(count: int, spread: float, seed: int = 0) -> list[HandDetection]:
    """Hands of all sizes somewhere in a picture, every tenth of them found twice."""
    rng, found = np.random.default_rng(seed), []
    for _ in range(count):
        points = np.zeros((21, 3))
        points[:, :2] = rng.uniform(0.0, spread, 2) + rng.uniform(20.0, 90.0) * rng.random((21, 2))
        side: Side = "left" if rng.random() < 0.5 else "right"
        for again in range(1 + (rng.random() < 0.1)):
            found.append(HandDetection(side, rng.random(), points + 5.0 * again, np.zeros((21, 3))))
    return found


def test_a_crowds_duplicates_are_those_of_pairs() -> None:
    found = crowd(150, 600.0)
    kept: list[HandDetection] = []
    for each in sorted(found, key=lambda hand: hand.score, reverse=True):
        if all(distance(each, other) > LINKING.duplicate_distance for other in kept):
            kept.append(each)
    assert len(kept) < len(found)
    hands = Detections.of([found])
    (best,) = without_duplicates(hands)
    np.testing.assert_array_equal(hands.keypoints[best], [each.keypoints for each in kept])


def test_hands_on_one_spot_cost_less_than_their_pairs(monkeypatch: pytest.MonkeyPatch) -> None:
    """Points that lie on hands are marked, and a few hands of a dense crowd cover all the others."""
    compared = 0

    def counted(vectors: np.ndarray, axis: int = -1) -> np.ndarray:
        nonlocal compared
        compared += vectors.size // 2
        return np.sqrt(np.square(vectors).sum(axis=axis))

    monkeypatch.setattr("handfit_core.detect.matching._lengths", counted)
    monkeypatch.setattr("numpy.linalg.norm", counted)
    rng, found = np.random.default_rng(0), []
    for each in crowd(300, 0.0):
        points = np.pad(rng.uniform(0.0, 100.0, (21, 2)), ((0, 0), (0, 1)))
        found.append(replace(each, keypoints=points))
    tracks = link_tracks([found], max_hands=None)
    hands = [track.detections for track in tracks]
    assert len(hands) > 50
    points_and_bones = 21 * 20 * len(hands) ** 2
    assert compared < 0.5 * points_and_bones
    for one in hands[::20]:
        others = [
            covers(each, np.zeros(1, dtype=int), one.keypoints_2d[0]) for each in hands if each is not one
        ]
        assert one.overlapped is not None
        np.testing.assert_array_equal(one.overlapped[0], np.any(others, axis=0))


def test_a_crowd_is_followed() -> None:
    frames = [crowd(400, 20_000.0)] * 2
    tracks, count = count_tracks(frames, max_hands=None)
    assert count == len(tracks) > 300
    assert all(track.detected.all() for track in tracks)
