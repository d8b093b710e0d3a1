"""The fast solver on hands whose pose is known: recovered, mirrored, within limits, marked when in doubt."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from handfit_core.detect.keypoints import HandDetection, Track
from handfit_core.fit import fast as fit
from handfit_core.fit.fast import fit_track
from handfit_core.fit.settings import MOTION
from handfit_core.geometry.rotations import rotmat_to_rotvec, rotvec_to_rotmat
from handfit_core.hand_model.length import betas_of_length, flat_hand_length, warn_of_odd_shapes
from handfit_core.hand_model.motion import HandMotion
from handfit_core.skeleton import PARENTS, SIDES, Side
from tests.core.fit.detections import (
    CAMERA,
    angles_of_pose,
    columns,
    ends_of_range,
    keypoints_of,
    laid_error,
    landmarks_of,
    mirror_image,
    mirrored,
    model_of,
    poses,
    seen,
    track_of,
)
from tests.core.fit.frames import FrameFits, fit_frames

FPS = 25.0
Parameters = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]


def parameters_of(side: Side, count: int, seed: int = 0) -> Parameters:
    right = poses(count, seed)
    return right if side == "right" else mirrored(*right)


def detections_of(side: Side, parameters: Parameters, noise: float = 0.0) -> list[HandDetection]:
    return [seen(p, side, noise=noise, seed=i) for i, p in enumerate(landmarks_of(side, *parameters))]


def points_of(side: Side, fits: FrameFits) -> np.ndarray:
    return keypoints_of(side, fits.betas, fits.global_orient, fits.hand_pose, fits.transl)


@pytest.mark.parametrize("side", SIDES)
def test_a_hand_is_recovered(side: Side) -> None:
    true = parameters_of(side, 16)
    fits = fit_frames(model_of(side), columns(detections_of(side, true)), CAMERA)
    aims, found = keypoints_of(side, *true), points_of(side, fits)
    error = laid_error(found, aims)
    assert error.max() < 0.007  # metres; the network moves perfect landmarks a little
    assert error.mean() < 0.004
    pixels = np.linalg.norm(CAMERA.project(found) - CAMERA.project(aims), axis=-1).mean(axis=1)
    assert pixels.max() < 5.0  # of hands some 150 pixels large
    # A hand's size is guessed, and its distance with it.
    distance = found[:, 0, 2] / aims[:, 0, 2]
    assert np.all((distance > 0.85) & (distance < 1.15))
    assert fits.solution.converged.all()
    assert fits.doubtful.mean() < 0.1


def test_left_mirrors_right() -> None:
    detections = detections_of("right", poses(6, seed=2), noise=3.0)
    ours = fit_frames(model_of("right"), columns(detections), CAMERA)
    theirs = fit_frames(model_of("left"), columns([mirror_image(d) for d in detections]), CAMERA)
    flipped = points_of("left", theirs) * np.array([-1.0, 1.0, 1.0])
    np.testing.assert_allclose(flipped, points_of("right", ours), atol=2e-4)  # float32, and where it stops
    expected = mirrored(ours.betas, ours.global_orient, ours.hand_pose, ours.transl)
    np.testing.assert_allclose(theirs.betas, expected[0], atol=2e-2)
    turns = rotvec_to_rotmat(theirs.hand_pose.reshape(-1, 3))
    np.testing.assert_allclose(turns, rotvec_to_rotmat(expected[2].reshape(-1, 3)), atol=1e-2)
    np.testing.assert_array_equal(theirs.doubtful, ours.doubtful)


def test_alone_or_among_others() -> None:
    """The same result, but for the rounding of float32."""
    detections = detections_of("right", poses(12, seed=3), noise=4.0)
    together = fit_frames(model_of("right"), columns(detections), CAMERA)
    for i in (0, 5, 11):
        alone = fit_frames(model_of("right"), columns([detections[i]]), CAMERA)
        np.testing.assert_allclose(
            points_of("right", alone)[0],
            points_of("right", together)[i],
            atol=2e-4,  # metres
        )


def excess(pose: np.ndarray, side: Side) -> np.ndarray:
    """(N,) by how many degrees the worst angle of each hand lies outside of its range."""
    angles, (lower, upper) = angles_of_pose(pose, side), ends_of_range(side)
    return np.degrees(np.maximum(angles - upper, lower - angles).max(axis=(1, 2)))


def garbage(side: Side, count: int) -> list[HandDetection]:
    """Landmarks of nothing."""
    rng = np.random.default_rng(0)
    return [
        HandDetection(side, 0.5, rng.uniform(100, 400, (21, 3)), rng.normal(size=(21, 3)) * 0.05)
        for _ in range(count)
    ]


@pytest.mark.parametrize("side", SIDES)
def test_angles_stay_within_limits(side: Side) -> None:
    true = parameters_of(side, 16, seed=4)
    inputs = [
        *(d for noise in (0.0, 5.0, 15.0, 40.0) for d in detections_of(side, true, noise)),
        # Of the other hand, with fingers mixed up, and of no hand at all.
        *(replace(mirror_image(d), side=side) for d in detections_of(side, true)),
        *(
            replace(d, keypoints=d.keypoints[order], world=d.world[order])
            for i, d in enumerate(detections_of(side, true))
            for order in [np.random.default_rng(i).permutation(21)]
        ),
        *garbage(side, 30),
    ]
    fits = fit_frames(model_of(side), columns(inputs), CAMERA)
    assert np.isfinite(fits.hand_pose).all()
    assert excess(fits.hand_pose, side).max() < 5.0


def test_garbage_is_doubtful() -> None:
    """More than half of it: the network knows no pictures of nothing."""
    assert fit_frames(model_of("right"), columns(garbage("right", 60)), CAMERA).doubtful.mean() > 0.4
    clean = fit_frames(model_of("right"), columns(detections_of("right", poses(20), noise=2.0)), CAMERA)
    assert clean.doubtful.mean() <= 0.05


def test_too_few_iterations(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fit, "SOLVER", replace(fit.SOLVER, max_iterations=1))
    fits = fit_frames(model_of("right"), columns(detections_of("right", poses(4))), CAMERA)
    assert not fits.solution.converged.any()
    assert (fits.solution.iterations == 1).all()


def clip(
    side: Side, count: int, missing: tuple[int, ...] = (), noise: float = 0.0
) -> tuple[Parameters, Track]:
    """A hand that closes, turns and wanders."""
    betas, orient, pose, transl = poses(1, seed=6)
    t = np.arange(count) / FPS
    close = 1.0 + 0.5 * np.sin(2.5 * t)
    turns = rotvec_to_rotmat(np.sin(2 * t)[:, None] * np.array([0.2, 0.1, 0.3])) @ rotvec_to_rotmat(orient)
    path = np.stack([0.05 * np.sin(2 * t), 0.03 * np.cos(3 * t), 0.05 * t], axis=-1)
    whole = (np.repeat(betas, count, 0), rotmat_to_rotvec(turns), close[:, None] * pose, transl + path)
    true = whole if side == "right" else mirrored(*whole)
    detections = [None if i in missing else d for i, d in enumerate(detections_of(side, true, noise))]
    return true, track_of(side, detections, FPS)


def fitted(track: Track, smoothing: float = 1.0) -> HandMotion:
    return fit_track(smoothing, model_of(track.side), track, CAMERA, lambda: None)


def points_of_track(side: Side, found: HandMotion) -> np.ndarray:
    return model_of(side).keypoints(found.betas, found.global_orient, found.hand_pose, found.transl)


@pytest.mark.parametrize("side", SIDES)
def test_recovers_clip(side: Side) -> None:
    true, track = clip(side, 14)
    found = fitted(track)
    assert found.betas.shape == (10,)
    assert found.present.all()
    points, aims = points_of_track(side, found), keypoints_of(side, *true)
    assert laid_error(points, aims).max() < 0.006  # metres
    joints = np.array(
        [
            model_of(side).posed(found.betas, o[None], p[None], t[None]).joints[0]
            for o, p, t in zip(found.global_orient, found.hand_pose, found.transl, strict=True)
        ]
    )
    bones = np.linalg.norm(joints[:, 1:] - joints[:, list(PARENTS[1:])], axis=-1)
    np.testing.assert_allclose(bones, np.broadcast_to(bones[0], bones.shape), atol=1e-9)


def test_smoothing_takes_jitter_out() -> None:
    true, track = clip("right", 20, noise=3.0)
    aims = keypoints_of("right", *true)

    def shape_of(points: np.ndarray) -> np.ndarray:
        return points - points[:, :1]

    each, smooth = (shape_of(points_of_track("right", fitted(track, s))) for s in (0.0, 1.0))
    jitter = [np.linalg.norm(np.diff(p - shape_of(aims), 2, axis=0), axis=-1).mean() for p in (each, smooth)]
    assert jitter[1] < 0.4 * jitter[0]
    error = [laid_error(p, aims).mean() for p in (each, smooth)]
    assert error[1] < error[0]


@pytest.mark.parametrize("smoothing", [0.0, 1.0])
def test_short_gaps_are_filled(smoothing: float) -> None:
    most = int(MOTION.max_gap_seconds * FPS)
    true, track = clip("right", 40, missing=(0, *range(3, 6), *range(20, 20 + most + 1)))
    found = fitted(track, smoothing)
    expected = np.zeros(40, dtype=bool)
    expected[3:6] = True
    present = expected | track.detected
    np.testing.assert_array_equal(found.present, present)
    for rows in (found.global_orient, found.hand_pose, found.transl):
        np.testing.assert_array_equal(np.isfinite(rows).all(axis=1), present)
        assert np.isnan(rows[~present]).all()
    assert found.doubtful is not None
    assert not found.doubtful[~track.detected].any()
    points = points_of_track("right", found)
    aims = keypoints_of("right", *true)
    assert laid_error(points[3:6], aims[3:6]).mean() < 0.008  # metres
    # Every frame is fitted to its own picture, before the gap and behind it.
    off = np.linalg.norm(CAMERA.project(points) - CAMERA.project(aims), axis=-1).mean(axis=1)
    assert off[present].max() < 5.0  # pixels


def test_single_detection() -> None:
    _, track = clip("right", 5, missing=(0, 1, 3, 4))
    found = fitted(track)
    np.testing.assert_array_equal(found.present, track.detected)


def test_long_clips_are_cut_into_chunks(monkeypatch: pytest.MonkeyPatch) -> None:
    _, track = clip("right", 9, noise=2.0)
    whole = fitted(track, 0.0)
    monkeypatch.setattr(fit, "SOLVER", replace(fit.SOLVER, chunk_frames=4))
    cut = fitted(track, 0.0)
    np.testing.assert_allclose(points_of_track("right", cut), points_of_track("right", whole), atol=1e-4)


def test_stopped_clip_keeps_chunks(monkeypatch: pytest.MonkeyPatch) -> None:
    _, track = clip("right", 9, missing=(1,), noise=2.0)
    monkeypatch.setattr(fit, "SOLVER", replace(fit.SOLVER, chunk_frames=3))
    calls: list[int] = []
    answers = iter([False, True])
    found = fit_track(1.0, model_of("right"), track, CAMERA, lambda: calls.append(1), lambda: next(answers))
    assert len(calls) == 6
    # Six of the eight detections, and the gap among them, which is filled.
    np.testing.assert_array_equal(found.present, [True] * 7 + [False] * 2)
    whole = points_of_track("right", fitted(track, 0.0))[:7]
    assert laid_error(points_of_track("right", found)[:7], whole).max() < 0.004  # metres


@pytest.mark.parametrize("side", SIDES)
@pytest.mark.parametrize("length", [0.15, 0.17, 0.21])
def test_given_length(side: Side, length: float) -> None:
    model = model_of(side)
    _, orient, pose, transl = (np.tile(values, (3, 1)) for values in parameters_of(side, 12, seed=5))
    betas = np.tile(betas_of_length(model, length), (36, 1))
    true = (betas, orient, pose, transl)
    detections = detections_of(side, true, noise=2.0)
    guessed = fit_frames(model, columns(detections), CAMERA)
    told = fit_frames(model, columns(detections), CAMERA, hand_length=length)
    lengths = np.array([flat_hand_length(model, b) for b in told.betas])
    np.testing.assert_allclose(lengths, length, rtol=0.01)

    def distance(fits: FrameFits) -> np.ndarray:
        return points_of(side, fits)[:, 0, 2] / keypoints_of(side, *true)[:, 0, 2]

    assert abs(distance(told).mean() - 1.0) < 0.025
    assert abs(distance(guessed).mean() - 1.0) > 0.05  # without being told it is an average hand's
    assert distance(guessed).std() < 0.05  # and does not grow and shrink with what little a picture tells
    track = track_of(side, detections[:12], FPS)
    found = fit_track(0.0, model, track, CAMERA, lambda: None, hand_length=length)
    assert flat_hand_length(model, found.betas) == pytest.approx(length, rel=0.01)


def test_warns_of_odd_lengths(caplog: pytest.LogCaptureFixture) -> None:
    _, track = clip("right", 2)
    model = model_of("right")
    for length, said, reached in [
        (0.17, None, 0.17),
        (0.14, "140 mm long is 3.5 standard deviations from the model's average of 187 mm", 0.14),
        (0.06, "106 mm is as far as it goes", 0.106),
    ]:
        caplog.clear()
        found = fit_track(1.0, model, track, CAMERA, lambda: None, hand_length=length)
        assert not caplog.records  # it is not this hand's alone
        warn_of_odd_shapes(model, length)
        assert (said or "") in caplog.text
        assert bool(caplog.records) == (said is not None)
        assert flat_hand_length(model, found.betas) == pytest.approx(reached, rel=0.01)


def test_overlapped_fingers_in_clips() -> None:
    """In a few frames the detector takes the other hand's fingers for this one's."""
    poses, track = clip("right", 30)
    model, wrong = model_of("right"), np.isin(np.arange(30), range(12, 17))
    covered = wrong[:, None] & (np.arange(21) > 8)
    keypoints = track.detections.keypoints + np.where(covered[..., None], [40.0, 0.0, 0.0], 0.0)
    errors, aims = [], keypoints_of("right", *poses)
    for overlapped in (None, covered):
        given = replace(track.detections, keypoints=keypoints, overlapped=overlapped)
        found = fit_track(1.0, model, replace(track, detections=given), CAMERA, lambda: None)
        points = keypoints_of(
            "right", np.tile(found.betas, (30, 1)), found.global_orient, found.hand_pose, found.transl
        )
        # As seen from the wrist: the hand's size is guessed, and its distance with it.
        off = (points - points[:, :1]) - (aims - aims[:, :1])
        errors.append(np.linalg.norm(off, axis=-1)[wrong].mean())
        distance = points[:, 0, 2] / aims[:, 0, 2]
        assert np.all((distance > 0.9) & (distance < 1.1))
    assert errors[1] < 0.6 * errors[0]
