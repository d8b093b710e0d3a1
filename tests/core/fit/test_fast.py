"""The fast solver on hands whose pose is known: recovered, mirrored, within limits, marked when in doubt."""

from __future__ import annotations

from dataclasses import replace
from itertools import chain

import numpy as np
import pytest

from handfit_core.common.skeleton import PARENTS, SIDES, Side
from handfit_core.detect.keypoints import Detections, Track
from handfit_core.fit import fast
from handfit_core.fit.fast import fit_track
from handfit_core.fit.settings import MOTION
from handfit_core.geometry.rotations import rotmat_to_rotvec, rotvec_to_rotmat
from handfit_core.hand_model.anatomy import anatomical_angles, anatomical_axes
from handfit_core.hand_model.length import betas_of_length, flat_hand_length, warn_of_odd_shapes
from handfit_core.hand_model.motion import HandMotion
from tests.core.fit.detections import (
    CAMERA,
    FrameFits,
    Pose,
    detections_of,
    ends_of_range,
    fit_frames,
    keypoints_of,
    laid_error,
    mirror_image,
    mirrored,
    model_of,
    poses,
    track_of,
)

FPS = 25.0


def points_of(side: Side, fits: FrameFits) -> np.ndarray:
    return keypoints_of(side, *fits.pose)


@pytest.mark.parametrize("side", SIDES)
def test_a_hand_is_recovered(side: Side) -> None:
    true = poses(16, side=side)
    fits = fit_frames(side, detections_of(side, true))
    aims, found = keypoints_of(side, *true), points_of(side, fits)
    error = laid_error(found, aims)
    assert error.max() < 0.007  # metres; the network moves perfect landmarks a little
    assert error.mean() < 0.004
    pixels = np.linalg.norm(CAMERA.project(found) - CAMERA.project(aims), axis=-1).mean(axis=1)
    assert pixels.max() < 5.0  # of hands some 150 pixels large
    # A hand's size is guessed, and its distance with it.
    assert np.abs(found[:, 0, 2] / aims[:, 0, 2] - 1.0).max() < 0.15
    assert fits.solution.converged.all()
    assert fits.doubtful.mean() < 0.1


def test_left_mirrors_right() -> None:
    detections = detections_of("right", poses(6, seed=2), noise=3.0)
    ours, theirs = fit_frames("right", detections), fit_frames("left", [mirror_image(d) for d in detections])
    flipped = points_of("left", theirs) * np.array([-1.0, 1.0, 1.0])
    np.testing.assert_allclose(flipped, points_of("right", ours), atol=2e-4)  # float32, and where it stops
    expected = mirrored(*ours.pose)
    np.testing.assert_allclose(theirs.pose[0], expected[0], atol=2e-2)
    turns, aims = (rotvec_to_rotmat(pose[2].reshape(-1, 3)) for pose in (theirs.pose, expected))
    np.testing.assert_allclose(turns, aims, atol=1e-2)
    np.testing.assert_array_equal(theirs.doubtful, ours.doubtful)
    np.testing.assert_allclose(theirs.expected_error, ours.expected_error, rtol=1e-2)


def garbage(side: Side, count: int) -> list[Detections]:
    """Landmarks of nothing."""
    rng = np.random.default_rng(0)
    hands = ((rng.uniform(100, 400, (21, 3)), rng.normal(size=(21, 3)) * 0.05) for _ in range(count))
    return [Detections.hand(side, 0.5, *hand) for hand in hands]


@pytest.mark.parametrize("side", SIDES)
def test_angles_stay_within_limits(side: Side) -> None:
    """Also of the other hand, with fingers mixed up, and of no hand at all."""
    rng = np.random.default_rng(0)
    noisy = [detections_of(side, poses(16, 4, side), noise) for noise in (0.0, 5.0, 15.0, 40.0)]
    others = [replace(mirror_image(hand), side=hand.side) for hand in noisy[0]]
    orders = [rng.permutation(21) for _ in noisy[0]]
    mixed = [
        replace(hand, keypoints=hand.keypoints[:, order], world=hand.world[:, order])
        for hand, order in zip(noisy[0], orders, strict=True)
    ]
    fits = fit_frames(side, [*chain(*noisy), *others, *mixed, *garbage(side, 30)])
    pose = fits.pose[2]
    assert np.isfinite(pose).all()
    angles = anatomical_angles(rotvec_to_rotmat(pose.reshape(-1, 15, 3)), anatomical_axes(model_of(side)))
    lower, upper = ends_of_range(side)
    assert np.degrees(np.maximum(angles - upper, lower - angles)).max() < 5.0


def test_garbage_is_doubtful() -> None:
    """More than half of it: the network knows no pictures of nothing."""
    assert fit_frames("right", garbage("right", 60)).doubtful.mean() > 0.4
    clean = detections_of("right", poses(20), noise=2.0)
    assert fit_frames("right", clean).doubtful.mean() <= 0.05


def clip(
    side: Side, count: int, missing: tuple[int, ...] = (), noise: float = 0.0
) -> tuple[np.ndarray, Track]:
    """A hand that closes, turns and wanders: its keypoints (T, 21, 3), and what is seen of it."""
    betas, orient, pose, transl = poses(1, seed=6)
    t = np.arange(count)[:, None] / FPS
    turns = rotvec_to_rotmat(np.sin(2 * t) * np.array([0.2, 0.1, 0.3])) @ rotvec_to_rotmat(orient)
    path = np.hstack([0.05 * np.sin(2 * t), 0.03 * np.cos(3 * t), 0.05 * t])
    bent = (1.0 + 0.5 * np.sin(2.5 * t)) * pose
    true: Pose = (np.repeat(betas, count, 0), rotmat_to_rotvec(turns), bent, transl + path)
    true = true if side == "right" else mirrored(*true)
    detections = [None if i in missing else d for i, d in enumerate(detections_of(side, true, noise))]
    return keypoints_of(side, *true), track_of(side, detections, FPS)


def fitted(track: Track, smoothing: float = 1.0, length: float | None = None) -> HandMotion:
    model = model_of(track.side)
    return fit_track(smoothing, model, track, CAMERA, lambda: None, hand_length=length)


def shape_of(points: np.ndarray) -> np.ndarray:
    return points - points[:, :1]


def points_of_track(found: HandMotion) -> np.ndarray:
    return model_of(found.side).keypoints(found.betas, *found.pose)


@pytest.mark.parametrize("side", SIDES)
def test_recovers_clip(side: Side) -> None:
    aims, track = clip(side, 14)
    found = fitted(track)
    assert found.present.all()
    assert laid_error(points_of_track(found), aims).max() < 0.006  # metres
    joints = model_of(side).posed(found.betas, *found.pose).joints
    bones = np.linalg.norm(joints[:, 1:] - joints[:, list(PARENTS[1:])], axis=-1)
    np.testing.assert_allclose(bones, np.broadcast_to(bones[0], bones.shape), atol=1e-9)


@pytest.mark.parametrize("smoothing", [0.0, 1.0])
def test_short_gaps_are_filled(smoothing: float) -> None:
    most = int(MOTION.max_gap_seconds * FPS)
    aims, track = clip("right", 40, missing=(0, *range(3, 6), *range(20, 20 + most + 1)))
    found = fitted(track, smoothing)
    present = track.detected | np.isin(np.arange(40), range(3, 6))
    for rows in found.pose:
        np.testing.assert_array_equal(np.isfinite(rows), np.repeat(present[:, None], rows.shape[1], axis=1))
    assert not found.doubtful[~track.detected].any()
    points = points_of_track(found)
    assert laid_error(points[3:6], aims[3:6]).mean() < 0.008  # metres
    # Every frame is fitted to its own picture, before the gap and behind it.
    off = np.linalg.norm(CAMERA.project(points) - CAMERA.project(aims), axis=-1).mean(axis=1)
    assert off[present].max() < 5.0  # pixels


def test_single_detection() -> None:
    track = clip("right", 5, missing=(0, 1, 3, 4))[1]
    np.testing.assert_array_equal(fitted(track).present, track.detected)


def test_chunks(monkeypatch: pytest.MonkeyPatch) -> None:
    """Long clips are fitted in chunks, to the same poses; a stopped clip keeps what it has."""
    track = clip("right", 9, missing=(1,), noise=2.0)[1]
    whole = points_of_track(fitted(track, 0.0))
    monkeypatch.setattr(fast, "SOLVER", replace(fast.SOLVER, chunk_frames=3))
    np.testing.assert_allclose(points_of_track(fitted(track, 0.0)), whole, atol=1e-4)
    answers = iter([False, True])
    found = fit_track(1.0, model_of("right"), track, CAMERA, lambda: None, lambda: next(answers))
    # Six of the eight detections, and the gap among them, which is filled.
    np.testing.assert_array_equal(found.present, [True] * 7 + [False] * 2)
    assert laid_error(points_of_track(found)[:7], whole[:7]).max() < 0.004  # metres


@pytest.mark.parametrize("side", SIDES)
@pytest.mark.parametrize("length", [0.15, 0.21])
def test_given_length(side: Side, length: float) -> None:
    model = model_of(side)
    true = (np.tile(betas_of_length(model, length), (24, 1)), *poses(24, 5, side)[1:])
    detections = detections_of(side, true, noise=2.0)
    told, guessed = (fit_frames(side, detections, given) for given in (length, None))
    np.testing.assert_allclose([flat_hand_length(model, b) for b in told.pose[0]], length, rtol=0.01)
    aims = keypoints_of(side, *true)[:, 0, 2]
    assert abs((points_of(side, told)[:, 0, 2] / aims).mean() - 1.0) < 0.025
    distance = points_of(side, guessed)[:, 0, 2] / aims
    assert abs(distance.mean() - 1.0) > 0.05  # without being told it is an average hand's
    assert distance.std() < 0.05  # and does not grow and shrink with what little a picture tells
    found = fitted(track_of(side, detections[:12], FPS), 0.0, length)
    assert flat_hand_length(model, found.betas) == pytest.approx(length, rel=0.01)


@pytest.mark.parametrize(
    ("length", "said", "reached"),
    [
        (0.17, "", 0.17),
        (0.14, "140 mm long is 3.5 standard deviations from the model's average of 187 mm", 0.14),
        (0.06, "106 mm is as far as it goes", 0.106),
    ],
)
def test_warns_of_odd_lengths(
    caplog: pytest.LogCaptureFixture, length: float, said: str, reached: float
) -> None:
    found = fitted(clip("right", 2)[1], 1.0, length)
    assert not caplog.records  # it is not this hand's alone
    warn_of_odd_shapes(model_of("right"), length)
    assert said in caplog.text
    assert bool(caplog.records) == bool(said)
    assert flat_hand_length(model_of("right"), found.betas) == pytest.approx(reached, rel=0.01)


def test_overlapped_fingers_in_clips() -> None:
    """In a few frames the detector takes the other hand's fingers for this one's."""
    aims, track = clip("right", 30)
    wrong = np.isin(np.arange(30), range(12, 17))
    covered = wrong[:, None] & (np.arange(21) > 8)
    keypoints = track.detections.keypoints + np.where(covered[..., None], [40.0, 0.0, 0.0], 0.0)
    errors = []
    for overlapped in (None, covered):
        given = replace(track.detections, keypoints=keypoints, overlapped=overlapped)
        points = points_of_track(fitted(replace(track, detections=given)))
        off = shape_of(points) - shape_of(aims)
        errors.append(np.linalg.norm(off, axis=-1)[wrong].mean())
        assert np.abs(points[:, 0, 2] / aims[:, 0, 2] - 1.0).max() < 0.1
    assert errors[1] < 0.6 * errors[0]
