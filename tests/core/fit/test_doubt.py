"""How far off hands are expected to be: more the worse they are seen, always a number, right in the mean."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from handfit_core.detect.correction.corrected import with_side_judged
from handfit_core.detect.keypoints import HandDetection, Track
from handfit_core.fit import doubt
from handfit_core.fit.fast import fit_track, fitter_of
from handfit_core.fit.gaps import Times
from handfit_core.skeleton import SIDES, Side
from tests.core.fit.detections import (
    CAMERA,
    columns,
    landmarks_of,
    mirror_image,
    mirrored,
    model_of,
    poses,
    seen,
)
from tests.core.fit.frames import fit_frames

COUNT = 16


def detections_of(noise: float = 0.0, side: Side = "right") -> list[HandDetection]:
    true = poses(COUNT) if side == "right" else mirrored(*poses(COUNT))
    return [seen(points, side, noise=noise, seed=i) for i, points in enumerate(landmarks_of(side, *true))]


def expected_of(detections: list[HandDetection]) -> np.ndarray:
    return fit_frames(model_of("right"), columns(detections), CAMERA).expected_error


def test_error_grows_with_noise() -> None:
    means = [expected_of(detections_of(noise)).mean() for noise in (0.0, 6.0, 20.0, 60.0)]
    assert np.all(np.diff(means) > 0.0)
    assert means[0] < doubt.DOUBT.doubtful_error < means[-1] < doubt.DOUBT.max_error


def test_displaced_finger_has_larger_error() -> None:
    clean = detections_of()
    spoilt = []
    for detection in clean:
        points = detection.keypoints.copy()
        points[6:9, :2] += 40.0  # the index finger, of hands some 150 pixels large
        spoilt.append(replace(detection, keypoints=points))
    grown = expected_of(spoilt) / expected_of(clean)
    assert np.all(grown.mean(axis=0) > 1.0)
    assert grown.mean(axis=0).argmax() == 1


def test_sides_have_equal_error() -> None:
    ours = detections_of(noise=3.0)
    theirs = fit_frames(model_of("left"), columns([mirror_image(d) for d in ours]), CAMERA)
    np.testing.assert_allclose(theirs.expected_error, expected_of(ours), rtol=1e-2)


@pytest.mark.parametrize("side", SIDES)
def test_unsure_side_raises_error(side: Side) -> None:
    (one,) = detections_of(side=side)[:1]
    certain = doubt.side_logits(columns([replace(one, right_side=1.0)]), side).item()
    cases = [
        (None, None, certain),  # nobody judged
        (0.3, side, certain),  # a person has said it
        (0.75, None, np.log(3.0)),
        (0.5, None, 0.0),
    ]
    for probability, given, expected in cases:
        detection = replace(one, right_side=probability, given_side=given)
        assert doubt.side_logits(columns([detection]), side).item() == pytest.approx(expected)
    other = replace(one, side="left" if side == "right" else "right", right_side=0.25)
    assert doubt.side_logits(columns([other]), side).item() == pytest.approx(np.log(3.0))
    fits = [
        fit_frames(model_of(side), columns([replace(one, right_side=p)]), CAMERA).expected_error.mean()
        for p in (0.999, 0.9, 0.6)
    ]
    assert fits[0] < fits[1] < fits[2]


def test_crops_that_differ_raise_the_error() -> None:
    """By how far they differ, in parts of the hand's size; a single crop tells nothing."""
    one, clean, apart = detections_of()[:3]
    hands = columns([one, *(replace(d, spread=np.full((21, 3), s)) for d, s in ((clean, 0.0), (apart, 9.0)))])
    spread = 9.0 * np.sqrt(2.0) / apart.extent / doubt.DOUBT.clean_crop_spread
    expected = np.array([1.0, doubt.DOUBT.min_crop_spread, spread]) ** doubt.DOUBT.crop_spread_power
    factor = doubt.crop_spread_factor(hands)
    np.testing.assert_allclose(factor, doubt.DOUBT.calibration_factor * expected)
    assert doubt.crop_spread_factor(columns([one])) == factor[0]


def test_degenerate_hands_have_errors() -> None:
    """All in one point, far away, behind the camera, at the camera, and nowhere."""
    fitter = fitter_of(model_of("right"))
    (one,) = detections_of()[:1]
    flat = replace(one, keypoints=np.full((21, 3), 50.0), world=np.zeros((21, 3)))
    observed = fitter.observe(columns([flat]), CAMERA)
    start = fitter.chain.points(fitter.start(fitter.observe(columns([one]), CAMERA)))
    for points in (start, 1e6 * start, -start, 0.0 * start, np.nan * start, np.inf * start):
        for sure in (-6.0, 0.0, 6.0):
            expected = doubt.expected_error(doubt.evidence(observed, points, np.array([sure])))
            assert expected.shape == (1, 5)
            assert np.all((expected > 0.0) & (expected <= doubt.DOUBT.max_error))
    assert doubt.doubtful(doubt.expected_error(doubt.evidence(observed, np.nan * start, np.ones(1)))).all()


def test_doubtful_threshold() -> None:
    at = np.full((1, 5), doubt.DOUBT.doubtful_error)
    assert not doubt.doubtful(at).any()
    assert doubt.doubtful(at + np.array([1e-3, 0.0, 0.0, 0.0, 0.0])).all()


def test_errors_of_a_track() -> None:
    found = with_side_judged(columns(detections_of(noise=2.0)))
    track = Track("right", found.select(np.arange(COUNT) != 3), COUNT)
    fit = fit_track(0.0, model_of("right"), track, CAMERA, lambda: None)
    assert fit.expected_error is not None
    assert fit.doubtful is not None
    np.testing.assert_array_equal(np.isfinite(fit.expected_error).all(axis=1), track.detected)
    np.testing.assert_array_equal(fit.doubtful, fit.expected_error.mean(axis=1) > doubt.DOUBT.doubtful_error)


def test_temporal_mean() -> None:
    expected = np.full((12, 5), 0.005)
    expected[6] = 0.04
    frames = np.array([0, 1, 2, 3, 4, 5, 6, 7, 8, 20, 21, 22])
    shots = (frames > 6).astype(int)
    found = doubt.temporal_mean(expected, Times(frames, shots, 25.0))
    np.testing.assert_allclose(found[[0, 1, 2, 7, 8, 9, 10, 11]], 0.005)
    assert np.all(found[3:7] > 0.005)
    np.testing.assert_allclose(found[6], (0.005**3 * 0.04) ** 0.25)
    np.testing.assert_allclose(doubt.temporal_mean(expected, Times(frames, shots, 1.0)), expected)
    alone = doubt.temporal_mean(expected[:1], Times(frames[:1], shots[:1], 25.0))
    assert alone == pytest.approx(expected[:1])
