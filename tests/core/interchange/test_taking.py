"""What is made of recordings: points in space as tracks, and keypoints in pictures with a depth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

from handfit_core.capturing.fitting import hand_track
from handfit_core.common.arrays import check_arrays
from handfit_core.common.skeleton import KEYPOINT_PARENTS, NUM_JOINTS, SIDES, Side
from handfit_core.detect.correction.corrected import BLEND, landmarked
from handfit_core.detect.keypoints import Track
from handfit_core.edit.hand import RefineHand
from handfit_core.edit.refit import refit_range
from handfit_core.fit.solvers import get_solver
from handfit_core.geometry.camera import Intrinsics
from handfit_core.geometry.rotations import rotmat_to_rotvec, rotvec_to_rotmat
from handfit_core.geometry.similarity import align
from handfit_core.hand_model import OPEN_HAND
from handfit_core.hand_model.motion import HandMotion
from handfit_core.interchange.lift import lifted
from handfit_core.interchange.recording import PointsHand, Recording, SeenHands
from handfit_core.interchange.taking import before_camera, detected_in, tracks_of
from tests.core.fit.detections import CAMERA as DETECTOR
from tests.core.fit.detections import columns, landmarks_of, mirrored, model_of, poses, seen

CAMERA = Intrinsics(900.0, 900.0, 640.0, 360.0)
COUNT = 40
BETAS = np.array([1.5, -1.0, 0.8, -0.6, 0.5, 0.4, -0.4, 0.3, 0.2, -0.2])
"""Of a hand that is no average one"""


def moving(count: int, way: Sequence[float]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(T, 3), (T, 45), (T, 3) of a hand that goes from one pose to another, by so many metres."""
    _, orient, pose, transl = poses(3, seed=4)
    part = 0.5 - 0.5 * np.cos(np.linspace(0.0, np.pi, count))[:, None]
    turned = orient[0] + part * 0.4 * np.array([1.0, 0.5, -0.3])
    bent = (1.0 - part) * pose[0] + part * pose[2]
    return turned, bent, transl[0] + part * np.array(way)


def joints_of(side: Side) -> tuple[np.ndarray, np.ndarray]:
    """(T, 45) poses and (T, 21, 3) metres of a hand that moves, turns and bends."""
    parameters = np.zeros((COUNT, 10)), *moving(COUNT, (0.10, -0.05, 0.25))
    _, orient, pose, transl = parameters if side == "right" else mirrored(*parameters)
    return pose, model_of(side).keypoints(BETAS, orient, pose, transl)


def tracked(*hands: PointsHand) -> list[Track]:
    numbers = np.arange(1, COUNT + 1)
    return tracks_of(Recording("points", ("a",), 30.0, numbers, points=hands, intrinsics=CAMERA), CAMERA)


def off(side: Side, points: np.ndarray, truth: np.ndarray) -> tuple[HandMotion, np.ndarray]:
    """The fit of a hand's points (T, 21, 3), and metres (T, 21) from its joints to the true ones."""
    (track,) = tracked(PointsHand(side, points))
    fit = get_solver("fast")(model_of(side), track, CAMERA, lambda: None)
    return fit, np.linalg.norm(model_of(side).keypoints(fit.betas, *fit.pose) - truth, axis=-1)


@pytest.mark.parametrize("side", SIDES)
def test_points_come_back_in_metres(side: Side) -> None:
    """Distance and size, too, which a picture would not tell; and the angles, but for fingers' twists."""
    pose, truth = joints_of(side)
    fit, error = off(side, truth, truth)
    assert error.max() < 0.001
    turns = [rotvec_to_rotmat(p.reshape(-1, 15, 3)) for p in (fit.hand_pose, pose)]
    angle = np.linalg.norm(rotmat_to_rotvec(np.swapaxes(turns[0], -1, -2) @ turns[1]), axis=-1)
    assert np.degrees(angle).mean() < 2.0


@pytest.mark.parametrize("side", SIDES)
def test_missing_points_and_frames_leave_the_others_in_place(side: Side) -> None:
    """Of each hand single points, here and there the wrist, and whole frames: what is left is enough. A gap
    of some frames is bridged."""
    _, truth = joints_of(side)
    points = truth.copy()
    points[np.random.default_rng(2).random(points.shape[:2]) < 0.15] = np.nan
    points[10:14, 0] = points[20:23] = np.nan
    fit, error = off(side, points, truth)
    seen = np.delete(error, slice(20, 23), axis=0)
    assert seen.mean() < 0.001
    assert np.quantile(seen, 0.98) < 0.005
    assert error[20:23].mean() < 0.005
    assert fit.present.all()


def test_noise_is_told_from_bones_that_change_their_length() -> None:
    """A hand of noisy points is smoothed, and is nearer to the truth than its points."""
    _, truth = joints_of("right")
    noisy = truth + 0.004 * np.random.default_rng(3).normal(size=truth.shape)
    (track,) = tracked(PointsHand("right", noisy))
    assert track.detections.corrected is not None
    sigma = track.detections.corrected[0, 0, 2] * track.detections.distance[0] / CAMERA.fx
    assert 0.003 < sigma < 0.005
    error = off("right", noisy, truth)[1]
    assert error.mean() < 0.6 * np.linalg.norm(noisy - truth, axis=-1).mean()


@pytest.mark.parametrize(
    ("place", "placed", "said"),
    [
        ([0.3, 0.0, 0.5], True, None),
        ([3.0, 1.0, 0.5], False, "outside the view"),
        ([0.0, 0.0, -2.0], True, "behind the camera"),
    ],
)
def test_hands_that_no_camera_sees_are_moved_together(
    place: list[float], placed: bool, said: str | None
) -> None:
    """And that is said; those whose camera is known stay, far to the side, too."""
    transl = np.tile(place, (2, 1))
    hand = HandMotion("right", np.zeros(10), np.zeros((2, 3)), np.zeros((2, 45)), transl)
    points = PointsHand("right", transl[:, None] + 0.01 * np.arange(21)[:, None])
    recording = Recording("a", ("a",), 30.0, np.arange(1, 3), posed=(hand,), points=(points,))
    recording = before_camera(recording, placed=placed)
    moved = recording.posed[0].transl
    assert (moved[:, 2] > 0.25).all()
    assert said is not None or moved.tolist() == [place, place]
    np.testing.assert_allclose(recording.points[0].points[:, 0], moved)
    assert [said in phrase for phrase in recording.assumed] == ([True] if said else [])


# Keypoints in pictures


@cache
def truth_of(side: Side, count: int = 60) -> np.ndarray:
    """(N, 21, 3) metres: hands with the palm or the back to the camera, give or take 40 degrees."""
    parameters = poses(count, seed=11)
    return landmarks_of(side, *(parameters if side == "right" else mirrored(*parameters)))


def hands_of(side: Side, points: np.ndarray, world: Any = np.nan) -> SeenHands:
    """Of pixels (N, 21, 2), or with a depth (N, 21, 3)."""
    rows = np.arange(len(points))
    return SeenHands.of(rows, rows * 0 + SIDES.index(side), rows, rows * 0 + 1, points, world)


@pytest.mark.parametrize("side", SIDES)
def test_depth_is_nearly_that_of_the_hand(side: Side) -> None:
    """Seen from the palm or the back, a pose's depth follows from its picture but for some millimetres; a
    plane would be as far off as the hand is deep."""
    truth = truth_of(side)
    pixels = DETECTOR.project(truth)
    found = lifted(hands_of(side, pixels))
    assert np.array_equal(found.keypoints_2d, pixels)
    assert not found.keypoints[:, 0, 2].any()
    assert set(found.side) == set(found.given_side) == {SIDES.index(side)}
    assert not np.any(found.overlapped)
    errors = [
        [np.linalg.norm(align(each, real, with_scale=True).apply(each) - real, axis=1) for each in row]
        for *row, real in zip(found.world, np.pad(pixels, ((0, 0), (0, 0), (0, 1))), truth, strict=True)
    ]
    lifted_error, flat = np.mean(errors, axis=(0, 2))
    assert lifted_error < 0.007
    assert lifted_error < 0.5 * flat


def test_a_turned_larger_picture_is_lifted_alike() -> None:
    pixels = DETECTOR.project(truth_of("right", 6))
    turn = np.array([[np.cos(2.0), -np.sin(2.0)], [np.sin(2.0), np.cos(2.0)]])
    plain = lifted(hands_of("right", pixels))
    other = lifted(hands_of("right", 3.0 * pixels @ turn.T + 40.0))
    off = np.abs(3.0 * plain.keypoints[..., 2] - other.keypoints[..., 2])
    assert (off.max(axis=1) < 0.01 * plain.extent).all()
    assert np.abs(plain.world[..., :2] @ turn.T - other.world[..., :2]).max() < 1e-3
    bones = np.linalg.norm(plain.world[:, 1:] - plain.world[:, KEYPOINT_PARENTS[1:]], axis=2)
    assert np.allclose(bones.mean(axis=1), 0.0416), "of an average hand"


def test_missing_points_are_guessed_and_believed_less() -> None:
    pixels = DETECTOR.project(truth_of("right"))
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
    assert np.allclose(doubted, BLEND.overlapped * plain.pixel_sigma[gone])


def test_points_that_the_program_doubts_are_believed_less() -> None:
    """By its own measure: half of what it says of the hand's others."""
    pixels = DETECTOR.project(truth_of("right", 3))
    hands = hands_of("right", pixels)
    confidence = np.array([1.0, 0.4, 0.02])[:, None] * np.ones(21)
    confidence[1:, 7] *= 0.4
    found = lifted(replace(hands, confidence=confidence))
    assert found.overlapped is not None
    assert np.argwhere(found.overlapped).tolist() == [[1, 7], [2, 7]]


@pytest.mark.parametrize("gone", [[0], [0, 5, 9, 13, 17], list(range(5, 21)), [4, 8, 12, 16, 20]])
def test_whatever_is_missing_numbers_come_back(gone: list[int]) -> None:
    """The wrist, all knuckles with it, all but the thumb's points and the wrist, all fingertips."""
    pixels = DETECTOR.project(truth_of("right", 6))
    size = np.ptp(pixels, axis=1).max()
    pixels[:, [k for k in gone if k > 0 or len(gone) < 16]] = np.nan
    found = lifted(hands_of("right", pixels))
    check_arrays(found)
    assert (found.extent < 4.0 * size).all()
    check_arrays(lifted(hands_of("right", np.full((1, 21, 2), 7.0))))


def test_what_is_known_of_depth_stays() -> None:
    """Of MediaPipe's own exports; where that is missing, too, it is guessed."""
    whole = columns([seen(points, "right") for points in truth_of("right", 4)])
    points, world = whole.keypoints.copy(), whole.world.copy()
    same = lifted(hands_of("right", points, world))
    assert np.array_equal(same.keypoints, whole.keypoints)
    assert np.array_equal(same.world, whole.world)
    points[1, 8] = world[1, 8] = np.nan
    same = lifted(hands_of("right", points, world))
    check_arrays(same)
    assert np.array_equal(same.world[2], whole.world[2])


def test_a_take_of_such_keypoints_is_refitted_as_it_was_fitted() -> None:
    """What a take keeps, its keypoints with their guessed depth, says as much as the fit was made from."""
    points = DETECTOR.project(landmarks_of("right", np.zeros((30, 10)), *moving(30, (0.05, -0.05, 0.1))))
    points[np.random.default_rng(5).random(points.shape[:2]) < 0.08] = np.nan
    found = detected_in(Recording("x", ("a",), 30.0, np.arange(1, 31), hands_of("right", points)))
    model = model_of("right")
    track = Track("right", found.hands, 30, 30.0)
    kept = hand_track(model, track, get_solver("fast")(model, track, DETECTOR, lambda: None), DETECTOR)
    assert kept.rows.overlapped is not None
    assert np.array_equal(kept.rows.overlapped, np.isnan(points[..., 0]))
    nothing = np.full((30, 21, 2), np.nan), np.zeros(NUM_JOINTS, dtype=bool), OPEN_HAND
    hand = RefineHand("right", kept.betas, *kept.pose, DETECTOR, kept.detections, *nothing)
    again = refit_range(hand)
    apart = np.linalg.norm(model.keypoints(again.betas, *again.pose) - kept.joints_3d, axis=-1)
    assert apart.mean() < 0.002
    assert apart.max() < 0.008
