from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from handfit_core.common.errors import NoHandFoundError
from handfit_core.common.skeleton import HandChoice, Side, other_side
from handfit_core.detect.keypoints import SURE_SIDE_SCORE, Detections, Track
from handfit_core.detect.matching import distance
from handfit_core.detect.tracks import LINKING, link_and_count, without_duplicates

SHAPE = np.random.default_rng(5).uniform(-50, 50, (21, 3))


def hand(x: float, side: Side = "right", score: float = 0.9, y: float = 300.0) -> Detections:
    return Detections.hand(side, score, SHAPE + [x, y, 0.0], SHAPE / 1000)


def unsure_hand(
    x: float, side: Side = "right", right_side: float = 1.0, score: float = 0.85, y: float = 300.0
) -> Detections:
    """A hand with a score below `SURE_SIDE_SCORE`, so that the network judges its side."""
    return replace(hand(x, side, score, y), right_side=np.array([right_side]))


def count_tracks(
    frames: Sequence[Sequence[Detections]], hands: HandChoice = "auto", **options: Any
) -> tuple[tuple[Track, ...], int]:
    return link_and_count(Detections.of(frames), len(frames), hands, **options)


def link_tracks(
    frames: Sequence[Sequence[Detections]], hands: HandChoice = "auto", **options: Any
) -> tuple[Track, ...]:
    return count_tracks(frames, hands, **options)[0]


def places(track: Track) -> list[float | None]:
    """Where the hand is in each frame; None: it is not there."""
    x = np.full(track.frame_count, np.nan)
    x[track.detections.frame] = (track.detections.keypoints - SHAPE)[:, 0, 0]
    return [None if np.isnan(each) else round(float(each), 6) for each in x]


def crossing(left: Callable[[int], Detections], right: Callable[[int], Detections]) -> list:
    """21 frames of two hands, listed in another order in every second one."""
    return [[left(t), right(t)][:: 1 if t % 2 else -1] for t in range(21)]


def part(x: float) -> Detections:
    """Fingers that are taken for a small hand."""
    return Detections.hand("left", 0.7, 0.4 * SHAPE + [x, 300.0, 0.0], SHAPE / 1000)


TEN = [100 + t for t in range(10)]
TO_RIGHT, TO_LEFT = [100 + 20 * t for t in range(21)], [500 - 20 * t for t in range(21)]
CROSSED = {"left": TO_RIGHT, "right": TO_LEFT}

LINKED: dict[str, tuple[list[list[Detections]], dict[Side, list]]] = {
    "crossing": (
        crossing(lambda t: hand(TO_RIGHT[t], "left"), lambda t: hand(TO_LEFT[t], y=340)),
        CROSSED,
    ),
    "crossing in one line, both named alike meanwhile": (
        crossing(
            lambda t: hand(100 + 21 * t, "right" if 8 <= t <= 12 else "left"),
            lambda t: hand(520 - 20 * t, y=330),
        ),
        {"left": [100 + 21 * t for t in range(21)], "right": [520 - 20 * t for t in range(21)]},
    ),
    "crossing, told apart by the network alone": (
        crossing(
            lambda t: unsure_hand(TO_RIGHT[t], right_side=0.1),
            lambda t: unsure_hand(TO_LEFT[t], right_side=0.95, y=340),
        ),
        CROSSED,
    ),
    "each a little nearer to where the other one was": (
        [
            [unsure_hand(100, right_side=0.1), unsure_hand(200, right_side=0.9)],
            [unsure_hand(152, right_side=0.1, y=340), unsure_hand(148, right_side=0.9, y=260)],
        ],
        {"left": [100, 152], "right": [200, 148]},
    ),
    "named the other side twice": (
        [[hand(x, "left" if x in (103, 104) else "right")] for x in TEN],
        {"right": TEN},
    ),
    "a side that flickers": (
        [[hand(x, "left" if x % 2 else "right", 0.9 if x % 2 else 0.8)] for x in TEN],
        {"left": TEN},
    ),
    "leaves and returns elsewhere": (
        [[hand(100)], [hand(110)], [], [], [hand(900)], [hand(905)]],
        {"right": [100, 110, None, None, 900, 905]},
    ),
    "returns as one of the other side": (
        [*([hand(x)] for x in TEN), *[[]] * 5, *[[hand(220, "left", 0.7)]] * 3],
        {"right": [*TEN, *[None] * 5, *[220] * 3]},
    ),
    "may well be the other hand after a long time": (
        [*([hand(x)] for x in TEN), *[[]] * 30, *[[hand(220, "left", 0.7)]] * 3],
        {"right": [*TEN, *[None] * 33], "left": [*[None] * 40, *[220] * 3]},
    ),
    "twice in a frame": ([[hand(100, score=0.6), hand(104, score=0.9)]], {"right": [104]}),
    "found as two, too far apart for duplicates": (
        [[hand(x), hand(x + 30, "left", 0.6)] for x in TEN],
        {"right": TEN},
    ),
    "fingers taken for a hand": ([[hand(x), part(x)] for x in TEN], {"right": TEN}),
    "a stray misdetection": (
        [[hand(x), hand(900, "left", 0.6)] if x == 107 else [hand(x)] for x in range(100, 130)],
        {"right": [*range(100, 130)]},
    ),
}


@pytest.mark.parametrize(("frames", "expected"), LINKED.values(), ids=LINKED)
def test_linked(frames, expected):
    tracks = link_tracks(frames, fps=12.5)
    assert {track.side: places(track) for track in tracks} == expected
    assert len(tracks) == len(expected)
    for track in tracks:
        assert track.detected.tolist() == [x is not None for x in expected[track.side]]
        assert track.fps == 12.5


def test_hands_of_other_shots():
    """The hand that a cut brings to the place of another one is of its own side, though single frames name
    the other one; motion still tells whose hands those of one side are."""
    sides: list[Side] = ["right", "right", "left", "right", "left", "left"]
    frames = [[hand(100 + 3 * s + t, side)] for s, side in enumerate(sides) for t in range(6)]
    frames[10], frames[26] = [hand(107, "left", 0.6)], [hand(114, "right", 0.6)]
    tracks = {track.side: track.detections.frame // 6 for track in link_tracks(frames, cuts=range(6, 36, 6))}
    assert {side: set(shots.tolist()) for side, shots in tracks.items()} == {
        "right": {0, 1, 3},
        "left": {2, 4, 5},
    }
    high, low = [hand(100 + t) for t in range(12)], [hand(100 + t, y=500) for t in range(12)]
    for track in link_tracks([list(pair) for pair in zip(high, low, strict=True)], cuts=[6]):
        assert np.ptp(track.detections.keypoints[:, 0, 1]) == 0


def test_two_hands_of_one_side():
    """Only their motion tells which one comes back where after a gap; a small one beside a hand is farther
    away."""
    frame = [hand(100, "left", 0.97), hand(500, "left", 0.96)]
    assert [t.side for t in link_tracks([frame])] == ["left", "left"]
    frames = [[hand(30 * t), hand(30 * t, y=500)] if t < 6 else [] for t in range(10)]
    frames += [[hand(30 * t, y=500), hand(30 * t)] for t in range(10, 14)]
    tracks = link_tracks(frames)
    assert len(tracks) == 2
    for track in tracks:
        assert np.ptp(track.detections.keypoints[:, 0, 1]) == 0
        assert track.detected.sum() == 10
    assert len(link_tracks([[hand(x), part(x + 90)] for x in TEN])) == 2


def test_tangled_hands_that_a_person_has_shown_are_two():
    near = hand(100), hand(100 + 0.3 * float(hand(0).extent[0]))
    assert len(link_tracks([near])) == 1
    assert len(link_tracks([[one.shown_by_person(None) for one in near]])) == 2


def test_a_side_that_a_person_has_given_is_believed():
    told = hand(120, "left", 0.1).shown_by_person("right")
    frames = [[hand(100 + 10 * t, "left"), hand(600, "left")] if t != 2 else [told] for t in range(5)]
    assert [t.side for t in link_tracks(frames)] == ["right", "left"]
    assert [t.side for t in link_tracks(frames, "both")] == ["right", "left"]
    (only,), seen = count_tracks(frames, only_shown=True)
    assert (only.side, seen) == ("right", 1)
    assert only.detected.all()


def test_hand_choice():
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
    with pytest.raises(NoHandFoundError, match="in any frame"):
        link_tracks([[], []])
    with pytest.raises(NoHandFoundError, match="only a left one"):
        link_tracks([[hand(1, "left")]], "right")


@pytest.mark.parametrize(
    ("seen", "side"),
    [
        ([(0.2, 0.85)] * 6, "right"),
        ([(1.0, 0.85)] * 4 + [(0.4, 0.85)] * 6, "left"),  # 0.85 (4 + 6 x 0.4) against 0.85 x 6 x 0.6
        ([(0.2, SURE_SIDE_SCORE)] * 6, "left"),
        ([(0.2, 0.95)] * 3 + [(0.2, 0.8)] * 3, "left"),  # 2.85 + 0.48 against 1.92
        ([(0.2, 0.95)] + [(0.2, 0.8)] * 5, "right"),  # 0.95 + 0.8 against 3.2
    ],
    ids=["unlikely", "sure frames outweigh others", "a sure detector", "often sure", "seldom sure"],
)
def test_the_networks_word_on_the_side(seen, side):
    """The detector names all of them left, with a score; the network says how likely that is."""
    frames = [[unsure_hand(100 + t, "left", *each)] for t, each in enumerate(seen)]
    assert [track.side for track in link_tracks(frames)] == [side]
    assert [track.side for track in link_tracks(frames, side)] == [side]
    with pytest.raises(NoHandFoundError, match=f"only a {side} one"):
        link_tracks(frames, other_side(side))


def test_points_where_another_hand_is_are_marked():
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
def test_hands_that_touch_are_left_and_right(unsure, score, apart, sides):
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


def crowd(count: int, spread: float, seed: int = 0) -> list[Detections]:
    """Hands of all sizes somewhere in a picture, every tenth of them found twice."""
    rng, found = np.random.default_rng(seed), []
    for _ in range(count):
        points = np.zeros((21, 3))
        points[:, :2] = rng.uniform(0.0, spread, 2) + rng.uniform(20.0, 90.0) * rng.random((21, 2))
        side: Side = "left" if rng.random() < 0.5 else "right"
        for again in range(1 + (rng.random() < 0.1)):
            found.append(Detections.hand(side, rng.random(), points + 5.0 * again, np.zeros((21, 3))))
    return found


def test_a_crowds_duplicates_are_those_of_pairs():
    found = crowd(150, 600.0)
    kept: list[Detections] = []
    for each in sorted(found, key=lambda hand: hand.score, reverse=True):
        if all(distance(each, other) > LINKING.duplicate_distance for other in kept):
            kept.append(each)
    assert len(kept) < len(found)
    hands = Detections.of([found])
    (best,) = without_duplicates(hands)
    np.testing.assert_array_equal(hands.keypoints[best], [each.keypoints[0] for each in kept])


def test_a_crowd_is_followed():
    frames = [crowd(400, 20_000.0)] * 2
    tracks, count = count_tracks(frames, max_hands=None)
    assert count == len(tracks) > 300
    assert all(track.detected.all() for track in tracks)
