"""What is learned from samples whose truth and detections are made here."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from handfit_core.detect.correction.canonical import canonical
from handfit_core.detect.correction.network import LandmarkNetwork
from handfit_core.geometry.camera import Intrinsics
from handfit_core.hand_model.landmarks import NO_OFFSETS, Landmarks, detector_landmarks
from handfit_core.skeleton import SIDES, TIP_KEYPOINTS, Side, other_side
from scripts.benchmark.shots import ShotHand
from scripts.training import learn
from scripts.training.learn import Samples
from scripts.training.samples import sample
from tests.core.fit.detections import columns, keypoints_of, landmarks_of, mirrored, poses, seen

torch.set_num_threads(1)
SIZE = 480
CAMERA = Intrinsics.assumed(SIZE, SIZE)
MIRROR = np.array([-1.0, 1.0, 1.0])


def samples_with(noise: float = 0.0, count: int = 12) -> tuple[Samples, np.ndarray]:
    """Rows of right and left hands, every third in a mirrored picture, with perfect or noisy detections; and
    (N, 21, 3) where their landmarks are."""
    rows, truth = [], []
    betas, orient, pose, transl = poses(count, seed=8)
    # In the middle of the picture and not too near: a detector's view is of weak perspective.
    transl = transl * np.array([0.0, 0.0, 1.5])
    middle = landmarks_of("right", betas, orient, pose, transl).mean(axis=1)
    right = (betas, orient, pose, transl - middle * np.array([1.0, 1.0, 0.0]))
    for i in range(count):
        side: Side = "right" if i % 2 else "left"
        one = tuple(p[i : i + 1] for p in (right if side == "right" else mirrored(*right)))
        joints, points = keypoints_of(side, *one)[0], landmarks_of(side, *one)[0]
        flip = i % 3 == 0
        if flip:
            joints, points = joints * MIRROR, points * MIRROR
        shown = other_side(side) if flip else side
        detection = seen(points, shown, CAMERA, noise=noise, seed=i)
        hand = ShotHand(side, *one[0], *one[1:])
        rows.append(sample(detection, CAMERA, SIZE, hand, joints, mirrored=flip))
        truth.append(points)
    return {name: np.array([r[name] for r in rows]) for name in rows[0]}, np.array(truth)


def test_true_landmarks_are_where_they_were_put() -> None:
    samples, truth = samples_with()
    found = learn.true_landmarks(samples, detector_landmarks())
    np.testing.assert_allclose(found, truth, atol=1e-6)  # metres
    np.testing.assert_allclose(learn.true_landmarks(samples, NO_OFFSETS), samples["joints_3d"], atol=1e-6)


def test_targets_come_back_as_places() -> None:
    """Targets in the picture are the points' own projection, and their depth along the line of sight."""
    samples, truth = samples_with()
    frame = learn._canonical(samples, samples["side"])
    picture = frame.to_picture(learn.targets(samples, truth, frame))
    np.testing.assert_allclose(picture[..., :2], CAMERA.project(truth), atol=1e-6)  # pixels
    ray = CAMERA.rays(samples["keypoints"][..., :2].mean(axis=1))
    ray /= np.linalg.norm(ray, axis=1, keepdims=True)
    along = np.einsum("nkc,nc->nk", truth, ray)
    metres = picture[..., 2] * along.mean(axis=1, keepdims=True) / CAMERA.fx
    np.testing.assert_allclose(metres, along - along.mean(axis=1, keepdims=True), atol=1e-9)


def test_calibration_finds_the_fingertips() -> None:
    """Perfect detections of landmarks that lie off the joints."""
    samples, _ = samples_with(count=24)
    offsets = learn.calibrate(samples)
    tips = list(TIP_KEYPOINTS)
    others = np.setdiff1d(np.arange(21), tips)
    assert np.all(offsets[others] == 0)
    expected = detector_landmarks().offsets[tips]
    # Both landmark sets meet in the depth, of which the perspective is not undone: a few millimetres.
    assert np.linalg.norm(offsets[tips] - expected, axis=1).mean() < 0.06


def test_pose_prior_is_that_of_a_right_hand() -> None:
    samples, _ = samples_with(count=24)
    mean, covariance = learn.pose_prior(samples)
    assert mean.shape == (5, 9)
    assert covariance.shape == (5, 9, 9)
    np.testing.assert_allclose(covariance, covariance.swapaxes(1, 2), atol=1e-12)
    assert np.linalg.eigvalsh(covariance).min() >= learn.PRIOR_FLOOR**2 - 1e-9
    assert np.degrees(mean[1:, [2, 5, 8]]).min() > 0  # bends of both sides are positive
    # Left hands are mirror images: a clip of each side says the same of the same poses.
    halves = []
    for side in SIDES:
        one = {k: v[:6].copy() for k, v in samples.items()}
        right = poses(6, seed=9)
        one["hand_pose"] = (right if side == "right" else mirrored(*right))[2]
        one["mirrored"][:], one["side"][:] = False, SIDES.index(side)
        # Both sides are needed: the other half is always the same.
        halves.append(learn.pose_prior({k: np.concatenate([v, samples[k]]) for k, v in one.items()}))
    np.testing.assert_allclose(halves[0][0], halves[1][0], atol=2e-3)
    np.testing.assert_allclose(halves[0][1], halves[1][1], atol=2e-3)


@pytest.fixture
def few_neurons(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(learn, "HIDDEN", 16)


@pytest.mark.usefixtures("few_neurons")
def test_training_yields_what_the_network_reads(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(learn, "EPOCHS", 1)
    samples, _ = samples_with(noise=3.0)
    said: list[str] = []
    arrays, again = (learn.train(samples, detector_landmarks(), seed=0, report=said.append) for _ in "ab")
    assert [line.partition(" landmarks ")[0] for line in said] == ["epoch 1/1:"] * 2
    correction = LandmarkNetwork(arrays)(learn._canonical(samples, samples["side"]))
    assert correction.points.shape == correction.sigma.shape == (12, 21, 3)
    assert np.isfinite(correction.points).all()
    assert np.all((correction.right_side > 0) & (correction.right_side < 1))
    for name, array in arrays.items():
        np.testing.assert_array_equal(again[name], array)


@pytest.mark.usefixtures("few_neurons")
def test_training_learns(monkeypatch: pytest.MonkeyPatch) -> None:
    """A detector that puts every landmark off by the same amount: a bias is the first thing to be learned."""
    monkeypatch.setattr(learn, "EPOCHS", 60)
    samples, _ = samples_with(noise=1.0)
    shifted = Landmarks(np.full((21, 3), 0.08))
    arrays = learn.train(samples, shifted, seed=0, report=lambda _: None)
    frame = learn._canonical(samples, samples["side"])
    goal = learn.targets(samples, learn.true_landmarks(samples, shifted), frame)
    before = np.abs(frame.fused - goal).mean()
    after = np.abs(LandmarkNetwork(arrays)(frame).points - goal).mean()
    assert after < 0.7 * before


def test_the_samples_canonical_frame_is_the_networks() -> None:
    """From arrays as from detections."""
    samples, truth = samples_with()
    hands = [seen(p, SIDES[side], CAMERA) for p, side in zip(truth, samples["side"], strict=True)]
    ours = learn._canonical(samples, samples["side"])
    theirs = canonical(columns(hands), samples["side"])
    np.testing.assert_allclose(ours.features, theirs.features, atol=1e-9)
