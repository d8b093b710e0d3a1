"""Looks at one hand agree and are averaged; what a view shows lies where its mapping says, and back."""

from dataclasses import replace

import numpy as np
import pytest

from handfit_core.detect.keypoints import HandDetection
from handfit_core.detect.looks import View, distance, mean_of, of_one, overlapped, same_hand, shrunk
from handfit_core.skeleton import Side

SHAPE = np.random.default_rng(5).uniform(0, 1, (21, 3))
SHAPE = 100.0 * (SHAPE - SHAPE.min(axis=0)) / np.ptp(SHAPE, axis=0)  # 100 pixels a side


def hand(x: float, side: Side = "right", score: float = 0.9) -> HandDetection:
    return HandDetection(side, score, SHAPE + [x, 0.0, 0.0], SHAPE / 1000 + x)


def test_distance_is_in_units_of_the_hand() -> None:
    assert distance(hand(0), hand(30)) == pytest.approx(0.3)
    assert distance(hand(0), hand(30), moved=np.array([20.0, 0.0])) == pytest.approx(0.1)


def test_points_on_another_hand() -> None:
    """Those of the other's tips are on its bones; of those around it, the near ones."""
    points = SHAPE.copy()
    points[:, :2] = SHAPE[4, :2]
    middle = SHAPE[:, :2].mean(axis=0)
    points[1:, :2] += np.linspace(0.0, 400.0, 20)[:, None] * (SHAPE[4, :2] - middle) / 100.0
    covered = overlapped(HandDetection("left", 0.9, points, SHAPE), hand(0))
    assert covered[0]
    assert not covered[-1]
    assert overlapped(hand(0), hand(0)).all()
    assert not overlapped(hand(0), hand(150)).any()
    assert np.array_equal(overlapped(hand(0), hand(50, "left")), overlapped(hand(7), hand(57)))


@pytest.mark.parametrize(
    ("x", "scale", "turn", "expected"),
    [
        (20.0, 1.0, 0, True),
        (0.0, 1.0, 2, True),
        (0.0, 0.8, 1, True),
        (90.0, 1.0, 0, False),
        (0.0, 0.3, 0, True),
    ],
    ids=["beside", "upside down", "a part of it", "the next one", "a finger of it"],
)
def test_of_one_hand_or_of_two(x: float, scale: float, turn: int, expected: bool) -> None:
    first, keypoints = hand(0), SHAPE.copy()
    about = keypoints[:, :2] - 50.0
    for _ in range(turn):
        about = about @ np.array([[0.0, 1.0], [-1.0, 0.0]])
    keypoints[:, :2] = 50.0 + scale * about + [x, 0.0]
    second = HandDetection("left", 0.9, keypoints, SHAPE)
    assert same_hand(first, second) is same_hand(second, first) is expected


@pytest.mark.parametrize(
    ("x", "scale", "expected"), [(60.0, 0.4, True), (90.0, 0.4, False), (0.0, 0.8, False), (0.0, 2.5, True)]
)
def test_a_hand_and_its_part(x: float, scale: float, expected: bool) -> None:
    """Or the hand with its forearm; of two of about one size each may be a hand."""
    second = HandDetection("left", 0.9, scale * SHAPE + [x, 0.0, 0.0], SHAPE)
    assert of_one(hand(0), second) is of_one(second, hand(0)) is expected


def test_the_mean_of_looks() -> None:
    looks = [hand(0, "left", 0.6), hand(6, "right", 0.9), hand(12, "left", 0.6)]
    mean = mean_of(looks)
    assert mean.side == "left"
    assert mean.score == pytest.approx(1.2 / 3)  # the second saw another side
    np.testing.assert_allclose(mean.keypoints, SHAPE + [6.0, 0.0, 0.0])
    np.testing.assert_allclose(mean.world, SHAPE / 1000 + 6.0)
    assert mean.spread is not None
    np.testing.assert_allclose(mean.spread, np.tile([np.sqrt(24.0), 0.0, 0.0], (21, 1)), atol=1e-9)
    assert mean.keypoints_2020 is None
    assert mean_of([hand(0)]).spread is None


def test_what_the_network_of_2020_saw_stays_in_the_mean() -> None:
    first, last = replace(hand(0), keypoints_2020=SHAPE), replace(hand(0), keypoints_2020=SHAPE + 4.0)
    seen = mean_of([first, hand(6), last]).keypoints_2020
    assert seen is not None
    np.testing.assert_allclose(seen, SHAPE + 2.0)


SQUARES = [(0.0, False), (np.pi / 2, False), (-np.pi / 4, True), (2.5, True)]


def some_hand(seed: int = 1) -> HandDetection:
    rng = np.random.default_rng(seed)
    return HandDetection("left", 0.8, rng.uniform(0, 90, (21, 3)), rng.normal(0, 0.05, (21, 3)))


def seen_through(view: View, hand: HandDetection) -> HandDetection:
    """What a perfect detector finds in the view."""
    keypoints, world = hand.keypoints.copy(), hand.world.copy()
    scale = np.sqrt(abs(np.linalg.det(view.linear)))
    for i in range(21):
        keypoints[i, :2] = view.linear @ hand.keypoints[i, :2] + view.offset
        keypoints[i, 2] = hand.keypoints[i, 2] * scale
        world[i, :2] = view.linear @ hand.world[i, :2] / scale
    return HandDetection("right" if view.mirrored else "left", hand.score, keypoints, world)


@pytest.mark.parametrize(("turn", "mirrored"), SQUARES)
def test_there_and_back(turn: float, mirrored: bool) -> None:
    hand = some_hand()
    view = View.of_square(np.array([40.0, 70.0]), 120.0, 256, turn=turn, mirrored=mirrored)
    assert view.scale == pytest.approx(256 / 120)
    assert view.mirrored == mirrored
    back = view.to_picture(seen_through(view, hand))
    assert (back.side, back.score) == ("left", 0.8)
    np.testing.assert_allclose(back.keypoints, hand.keypoints, atol=1e-9)
    np.testing.assert_allclose(back.world, hand.world, atol=1e-12)


def test_a_turn_is_clockwise_about_the_centre() -> None:
    view = View.of_square(np.array([50.0, 60.0]), 100.0, 200, turn=np.pi / 2)
    np.testing.assert_allclose(view.linear @ [50, 60] + view.offset, [100, 100])
    # What lies to the right of it comes to lie below.
    np.testing.assert_allclose(view.linear @ [60, 60] + view.offset, [100, 120])


@pytest.mark.parametrize(("turn", "mirrored"), SQUARES)
@pytest.mark.parametrize("span", [100.0, 500.0, 2400.0])
def test_pixels_lie_where_the_mapping_says(turn: float, mirrored: bool, span: float) -> None:
    """A disc's centre of mass; the widest view shows 12 pixels in one."""
    centre, radius = np.array([700.0, 420.0]), span / 20
    y, x = np.mgrid[:900, :1300] + 0.5
    disc = np.hypot(x - centre[0], y - centre[1]) < radius
    rgb = np.repeat((disc * 255).astype(np.uint8)[..., None], 3, axis=2)
    view = View.of_square(centre + span / 10, span, 200, turn=turn, mirrored=mirrored)
    shown = view.render(rgb)[..., 0].astype(float)
    assert shown.shape == (200, 200)
    y, x = np.mgrid[:200, :200] + 0.5
    found = np.array([(shown * x).sum(), (shown * y).sum()]) / shown.sum()
    np.testing.assert_allclose(found, view.linear @ centre + view.offset, atol=0.1)
    # All of it is there: nothing is left out between the pixels.
    assert shown.sum() / 255 == pytest.approx(np.pi * (radius * view.scale) ** 2, rel=0.05)


def test_beyond_the_picture_its_border_goes_on() -> None:
    rgb = np.zeros((10, 10, 3), dtype=np.uint8)
    rgb[:, :5] = 200
    shown = View.of_square(np.array([5.0, 5.0]), 40.0, 40).render(rgb)
    assert (shown[:, :19] == 200).all()
    assert (shown[:, 21:] == 0).all()


@pytest.mark.parametrize("shape", [(1, 500, 3), (500, 1, 3)])
def test_slim_pictures_are_shrunk(shape: tuple[int, ...]) -> None:
    assert sorted(shrunk(np.full(shape, 9, np.uint8), 7, 7).shape) == [1, 3, 71]
