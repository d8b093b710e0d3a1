"""Fits of points in space: what is metric stays so, whatever is missing."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest

from handfit_core.geometry.camera import Intrinsics
from handfit_core.geometry.rotations import rotmat_to_rotvec, rotvec_to_rotmat
from handfit_core.hand_model.motion import HandMotion
from handfit_core.interchange.recording import PointsHand, Recording, SeenHands
from handfit_core.interchange.taking import before_camera, detected_in, tracks_of
from handfit_core.skeleton import SIDES, Side
from handfit_core.solvers import get_solver
from tests.core.fit.detections import model_of, poses

CAMERA = Intrinsics(900.0, 900.0, 640.0, 360.0)
COUNT = 40
BETAS = np.array([1.5, -1.0, 0.8, -0.6, 0.5, 0.4, -0.4, 0.3, 0.2, -0.2])
"""Of a hand that is no average one"""
MIRROR = np.array([-1.0, 1.0, 1.0])


def motion(side: Side) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """global_orient (T, 3), hand_pose (T, 45) and transl (T, 3) of a hand that goes from one pose to another,
    to the side and away."""
    _, orient, pose, transl = poses(3, seed=4)
    part = 0.5 - 0.5 * np.cos(np.linspace(0.0, np.pi, COUNT))[:, None]
    turned = orient[0] + part * 0.4 * np.array([1.0, 0.5, -0.3])
    bent = (1.0 - part) * pose[0] + part * pose[2]
    moved = transl[0] + part * np.array([0.10, -0.05, 0.25])
    if side == "left":
        flip = np.array([1.0, -1.0, -1.0])
        return turned * flip, bent * np.tile(flip, 15), moved * MIRROR
    return turned, bent, moved


def joints_of(side: Side) -> np.ndarray:
    """(T, 21, 3) metres"""
    return model_of(side).keypoints(BETAS, *motion(side))


def fitted(hands: Sequence[PointsHand]) -> list[HandMotion]:
    numbers = np.arange(1, COUNT + 1)
    recording = Recording("points", ("a",), 30.0, numbers, points=tuple(hands), intrinsics=CAMERA)
    solve = get_solver("fast")
    return [
        solve(model_of(track.side), track, CAMERA, lambda: None) for track in tracks_of(recording, CAMERA)
    ]


def off(side: Side, fit: HandMotion, truth: np.ndarray, rows: np.ndarray | slice = slice(None)) -> np.ndarray:
    """(T, 21) metres from a fit's joints to the true ones."""
    found = model_of(side).keypoints(
        fit.betas, fit.global_orient[rows], fit.hand_pose[rows], fit.transl[rows]
    )
    return np.linalg.norm(found - truth[rows], axis=-1)


@pytest.mark.parametrize("side", SIDES)
def test_points_come_back_in_metres(side: Side) -> None:
    """Distance and size, too, which a picture would not tell; and the angles, but for fingers' twists."""
    truth = joints_of(side)
    (fit,) = fitted([PointsHand(side, truth)])
    assert off(side, fit, truth).max() < 0.001
    turns = [rotvec_to_rotmat(p.reshape(-1, 15, 3)) for p in (fit.hand_pose, motion(side)[1])]
    angle = np.linalg.norm(rotmat_to_rotvec(np.swapaxes(turns[0], -1, -2) @ turns[1]), axis=-1)
    assert np.degrees(angle).mean() < 2.0


def test_points_of_one_frame_come_back_in_metres() -> None:
    """Of one frame the shape is expected to be average, so that less is told."""
    truth = joints_of("right")
    truth[1:] = np.nan
    (fit,) = fitted([PointsHand("right", truth)])
    assert off("right", fit, truth, slice(1)).mean() < 0.002
    assert np.isnan(fit.transl[1:]).all()


def test_missing_points_and_frames_leave_the_others_in_place() -> None:
    """Of each hand single points, here and there the wrist, and whole frames: what is left is enough. A gap
    of some frames is bridged."""
    rng = np.random.default_rng(2)
    hands, truths = [], []
    for side in SIDES:
        truth = joints_of(side)
        points = truth.copy()
        points[rng.random(points.shape[:2]) < 0.15] = np.nan
        points[10:14, 0] = np.nan
        points[20:23] = np.nan
        hands.append(PointsHand(side, points))
        truths.append(truth)
    seen = np.ones(COUNT, dtype=bool)
    seen[20:23] = False
    for side, truth, fit in zip(SIDES, truths, fitted(hands), strict=True):
        error = off(side, fit, truth)
        assert error[seen].mean() < 0.001
        assert np.quantile(error[seen], 0.98) < 0.005
        assert error[~seen].mean() < 0.005
        assert fit.present.all()


def test_noise_is_told_from_bones_that_change_their_length() -> None:
    """A hand of noisy points is smoothed, and is nearer to the truth than its points."""
    truth = joints_of("right")
    noisy = truth + 0.004 * np.random.default_rng(3).normal(size=truth.shape)
    (track,) = tracks_of(
        Recording("points", ("a",), 30.0, np.arange(COUNT), points=(PointsHand("right", noisy),)), CAMERA
    )
    seen = track.detections
    assert seen.corrected is not None
    sigma = seen.corrected[0, 0, 2] * seen.distance[0] / CAMERA.fx
    assert 0.003 < sigma < 0.005
    (fit,) = fitted([PointsHand("right", noisy)])
    assert off("right", fit, truth).mean() < 0.6 * np.linalg.norm(noisy - truth, axis=-1).mean()


def test_a_point_that_is_never_there_is_no_matter() -> None:
    truth = joints_of("right")
    points = truth.copy()
    points[:, 8] = np.nan
    (fit,) = fitted([PointsHand("right", points)])
    others = np.arange(21) != 8
    assert off("right", fit, truth)[:, others].max() < 0.002


def at(place: list[float], **more: Any) -> Recording:
    """Two frames of a flat hand whose wrist is there."""
    transl = np.tile(place, (2, 1))
    hand = HandMotion("right", np.zeros(10), np.zeros((2, 3)), np.zeros((2, 45)), transl)
    points = PointsHand("right", transl[:, None] + 0.01 * np.arange(21)[:, None])
    return Recording("a", ("a",), 30.0, np.arange(1, 3), posed=(hand,), points=(points,), **more)


def test_hands_whose_camera_is_known_stay_where_they_are() -> None:
    """Far to the side, where a virtual camera would not see them."""
    recording = before_camera(at([0.3, 0.0, 0.5]), placed=True)
    np.testing.assert_array_equal(recording.posed[0].transl, [[0.3, 0.0, 0.5]] * 2)
    np.testing.assert_array_equal(recording.points[0].points[:, 0], [[0.3, 0.0, 0.5]] * 2)
    assert not recording.assumed


@pytest.mark.parametrize(
    ("place", "placed", "said"),
    [([3.0, 1.0, 0.5], False, "outside the view"), ([0.0, 0.0, -2.0], True, "behind the camera")],
)
def test_hands_that_no_camera_sees_are_moved_together_and_that_is_said(
    place: list[float], placed: bool, said: str
) -> None:
    recording = before_camera(at(place), placed=placed)
    moved = recording.posed[0].transl
    assert (moved[:, 2] > 0.25).all()
    np.testing.assert_allclose(recording.points[0].points[:, 0], moved)
    assert said in recording.assumed[0]


def test_no_hands_in_pictures_are_no_detections() -> None:
    shapes, kinds = ((), (), (), (21, 2), (21,)), (int, bool, float, float, float)
    one = SeenHands(*(np.ones((0, *s), dtype=k) for s, k in zip(shapes, kinds, strict=True)))
    found = detected_in(Recording("a", ("a",), 30.0, np.arange(3), seen=one))
    assert found.numbers == [0, 1, 2]
    assert len(found.hands) == 0
