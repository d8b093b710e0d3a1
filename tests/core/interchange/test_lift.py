"""Keypoints without depth: what is known stays as it is, what is guessed is nearly right, and is doubted."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from handfit_core.arrays import check_arrays
from handfit_core.detect.correction.corrected import TRUST, landmarked
from handfit_core.detect.keypoints import Detections, Track
from handfit_core.edit.hand import RefineHand
from handfit_core.edit.refit import refit_range
from handfit_core.fitting import hand_track
from handfit_core.geometry.similarity import align
from handfit_core.hand_model import OPEN_HAND
from handfit_core.interchange.lift import lifted
from handfit_core.interchange.recording import Recording, SeenHands
from handfit_core.interchange.taking import detected_in
from handfit_core.skeleton import KEYPOINT_PARENTS, NUM_JOINTS, SIDES, Side
from handfit_core.solvers import get_solver
from tests.core.fit.detections import CAMERA, columns, landmarks_of, mirrored, model_of, poses, seen

COUNT = 60


@cache
def truth_of(side: Side, count: int = COUNT) -> np.ndarray:
    """(N, 21, 3) metres: hands with the palm or the back to the camera, give or take 40 degrees."""
    parameters = poses(count, seed=11)
    return landmarks_of(side, *(parameters if side == "right" else mirrored(*parameters)))


def hands_of(side: Side, points: np.ndarray, **values: np.ndarray) -> SeenHands:
    """Of pixels (N, 21, 2)."""
    count = len(points)
    there = np.isfinite(points[..., 0])
    return SeenHands(
        row=np.arange(count),
        left=np.full(count, side == "left"),
        score=np.ones(count),
        keypoints=points,
        confidence=there.astype(float),
        **values,
    )


def lifted_pixels(side: Side) -> tuple[np.ndarray, Detections]:
    pixels = CAMERA.project(truth_of(side))
    return pixels, lifted(hands_of(side, pixels))


def moving(count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(T, 3), (T, 45), (T, 3) of a hand that goes from one pose to another, to the side and away."""
    _, orient, pose, transl = poses(3, seed=4)
    part = 0.5 - 0.5 * np.cos(np.linspace(0.0, np.pi, count))[:, None]
    turned = orient[0] + part * 0.4 * np.array([1.0, 0.5, -0.3])
    bent = (1.0 - part) * pose[0] + part * pose[2]
    return turned, bent, transl[0] + part * np.array([0.05, -0.05, 0.1])


@pytest.mark.parametrize("side", SIDES)
def test_depth_is_nearly_that_of_the_hand(side: Side) -> None:
    """Seen from the palm or the back, a pose's depth follows from its picture but for some millimetres; a
    plane would be as far off as the hand is deep."""
    truth = truth_of(side)
    pixels, found = lifted_pixels(side)
    errors, flat = [], []

    def off(found: np.ndarray, real: np.ndarray) -> np.ndarray:
        return np.linalg.norm(align(found, real, with_scale=True).apply(found) - real, axis=1)

    assert np.array_equal(found.keypoints_2d, pixels)
    assert not found.keypoints[:, 0, 2].any()
    assert set(found.side) == set(found.given_side) == {SIDES.index(side)}
    assert not np.any(found.overlapped)
    for points, world, real in zip(pixels, found.world, truth, strict=True):
        errors.append(off(world, real))
        flat.append(off(np.column_stack([points, np.zeros(21)]), real))
    assert np.mean(errors) < 0.007
    assert np.mean(errors) < 0.5 * np.mean(flat)


def test_a_turned_larger_picture_is_lifted_alike() -> None:
    pixels = CAMERA.project(truth_of("right", 6))
    turn = np.array([[np.cos(2.0), -np.sin(2.0)], [np.sin(2.0), np.cos(2.0)]])
    plain = lifted(hands_of("right", pixels))
    other = lifted(hands_of("right", 3.0 * pixels @ turn.T + 40.0))
    off = np.abs(3.0 * plain.keypoints[..., 2] - other.keypoints[..., 2])
    assert (off.max(axis=1) < 0.01 * plain.extent).all()
    assert np.abs(plain.world[..., :2] @ turn.T - other.world[..., :2]).max() < 1e-3


def test_the_world_is_that_of_an_average_hand() -> None:
    world = lifted_pixels("right")[1].world
    bones = np.linalg.norm(world[:, 1:] - world[:, KEYPOINT_PARENTS[1:]], axis=2)
    assert np.allclose(bones.mean(axis=1), 0.0416)
    flat = model_of("right").keypoints(np.zeros(10), *(np.zeros((1, n)) for n in (3, 45, 3)))[0]
    assert abs(np.linalg.norm(flat[1:] - flat[list(KEYPOINT_PARENTS[1:])], axis=1).mean() - 0.0416) < 1e-4


def test_missing_points_are_guessed_and_believed_less() -> None:
    pixels = CAMERA.project(truth_of("right"))
    rng = np.random.default_rng(0)
    gone = rng.random(pixels.shape[:2]) < 0.15
    some = pixels.copy()
    some[gone] = np.nan
    found = lifted(hands_of("right", some))
    extent = np.ptp(pixels, axis=1).max(axis=1)
    off = np.linalg.norm(found.keypoints_2d - pixels, axis=2)
    assert np.all(off[~gone] == 0.0)
    relative = (off / extent[:, None])[gone]
    assert np.median(relative) < 0.05
    assert relative.mean() < 0.10
    np.testing.assert_array_equal(found.overlapped, gone)
    plain = landmarked(replace(found, overlapped=None), "right")
    doubted = landmarked(found, "right").pixel_sigma[gone]
    assert np.allclose(doubted, TRUST.overlapped * plain.pixel_sigma[gone])


def test_points_that_the_program_doubts_are_believed_less() -> None:
    """By its own measure: half of what it says of the hand's others."""
    pixels = CAMERA.project(truth_of("right", 3))
    hands = hands_of("right", pixels)
    confidence = np.array([1.0, 0.4, 0.02])[:, None] * np.ones(21)
    confidence[1:, 7] *= 0.4
    found = lifted(replace(hands, confidence=confidence))
    assert found.overlapped is not None
    assert np.argwhere(found.overlapped).tolist() == [[1, 7], [2, 7]]


@pytest.mark.parametrize("gone", [[0], [0, 5, 9, 13, 17], list(range(5, 21)), [4, 8, 12, 16, 20]])
def test_whatever_is_missing_numbers_come_back(gone: list[int]) -> None:
    """The wrist, all knuckles with it, all but the thumb's points and the wrist, all fingertips."""
    pixels = CAMERA.project(truth_of("right", 6))
    size = np.ptp(pixels, axis=1).max()
    pixels[:, [k for k in gone if k > 0 or len(gone) < 16]] = np.nan
    found = lifted(hands_of("right", pixels))
    check_arrays(found)
    assert (found.extent < 4.0 * size).all()


def test_points_in_one_place_are_no_trouble() -> None:
    check_arrays(lifted(hands_of("right", np.full((1, 21, 2), 7.0))))


def test_what_is_known_of_depth_stays() -> None:
    """Of MediaPipe's own exports; where that is missing, too, it is guessed."""
    whole = columns([seen(points, "right") for points in truth_of("right", 4)])
    points, world = whole.keypoints.copy(), whole.world.copy()
    same = lifted(hands_of("right", points[..., :2], depth=points[..., 2], world=world))
    assert np.array_equal(same.keypoints, whole.keypoints)
    assert np.array_equal(same.world, whole.world)
    points[1, 8] = np.nan
    world[1, 8] = np.nan
    same = lifted(hands_of("right", points[..., :2], depth=points[..., 2], world=world))
    check_arrays(same)
    assert np.array_equal(same.world[2], whole.world[2])


def test_a_take_of_such_keypoints_is_refitted_as_it_was_fitted() -> None:
    """What a take keeps, its keypoints with their guessed depth, says as much as the fit was made from."""
    points = CAMERA.project(landmarks_of("right", np.zeros((30, 10)), *moving(30)))
    points[np.random.default_rng(5).random(points.shape[:2]) < 0.08] = np.nan
    found = detected_in(Recording("x", ("a",), 30.0, np.arange(1, 31), hands_of("right", points)))
    model = model_of("right")
    track = Track("right", found.hands, 30, 30.0)
    kept = hand_track(model, track, get_solver("fast")(model, track, CAMERA, lambda: None), CAMERA)
    assert kept.overlapped is not None
    assert np.array_equal(kept.overlapped, np.isnan(points[..., 0]))
    nothing = np.full((30, 21, 2), np.nan), np.zeros(NUM_JOINTS, dtype=bool), OPEN_HAND
    hand = RefineHand("right", kept.betas, *kept.pose, CAMERA, kept.detections(), *nothing)
    again = refit_range(hand)
    apart = np.linalg.norm(model.keypoints(again.betas, *again.pose) - kept.joints_3d, axis=-1)
    assert apart.mean() < 0.002
    assert apart.max() < 0.008
