"""How far off hands are expected to be: more the worse they are seen, always a number, right in the mean."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from handfit_core.common.skeleton import SIDES, Side
from handfit_core.detect.correction.corrected import with_side_judged
from handfit_core.detect.keypoints import Detections, Track
from handfit_core.fit import doubt
from handfit_core.fit.doubt import DOUBT
from handfit_core.fit.fast import fit_track, fitter_of
from tests.core.fit.detections import CAMERA, columns, detections_of, fit_frames, model_of, poses

COUNT = 16


def seen(noise: float = 0.0, side: Side = "right", count: int = COUNT) -> list[Detections]:
    return detections_of(side, poses(count, side=side), noise)


def expected_of(detections: list[Detections], side: Side = "right") -> np.ndarray:
    return fit_frames(side, detections).expected_error


def test_error_grows_with_noise() -> None:
    means = [expected_of(seen(noise)).mean() for noise in (0.0, 6.0, 20.0, 60.0)]
    assert np.all(np.diff(means) > 0.0)
    assert means[0] < DOUBT.doubtful_error < means[-1] < DOUBT.max_error


def test_displaced_finger_has_larger_error() -> None:
    spoilt = seen()
    for detection in spoilt:
        detection.keypoints[0, 6:9, :2] += 40.0  # the index finger, of hands some 150 pixels large
    grown = (expected_of(spoilt) / expected_of(seen())).mean(axis=0)
    assert np.all(grown > 1.0)
    assert grown.argmax() == 1


@pytest.mark.parametrize("side", SIDES)
def test_unsure_side_raises_error(side: Side) -> None:
    (one,) = seen(side=side, count=1)
    errors = [expected_of([replace(one, right_side=np.array([p]))], side).mean() for p in (0.999, 0.9, 0.6)]
    assert np.all(np.diff(errors) > 0.0)


def test_degenerate_hands_have_errors() -> None:
    """All in one point, far away, behind the camera, at the camera, and nowhere."""
    fitter = fitter_of(model_of("right"))
    (one,) = seen(count=1)
    flat = replace(one, keypoints=np.full((1, 21, 3), 50.0), world=np.zeros((1, 21, 3)))
    observed = fitter.observe(columns([flat]), CAMERA)
    start = fitter.chain.points(fitter.start(fitter.observe(columns([one]), CAMERA)))
    for factor in (1.0, 1e6, -1.0, 0.0, np.nan, np.inf):
        for sure in (-6.0, 0.0, 6.0):
            expected = doubt.expected_error(doubt.evidence(observed, factor * start, np.array([sure])))
            assert expected.shape == (1, 5)
            assert np.all((expected > 0.0) & (expected <= DOUBT.max_error))
            assert not np.isnan(factor) or doubt.doubtful(expected).all()


def test_errors_of_a_track() -> None:
    found = with_side_judged(columns(seen(noise=2.0)))
    track = Track("right", found.select(np.arange(COUNT) != 3), COUNT)
    fit = fit_track(0.0, model_of("right"), track, CAMERA, lambda: None)
    np.testing.assert_array_equal(np.isfinite(fit.expected_error).all(axis=1), track.detected)
    np.testing.assert_array_equal(fit.doubtful, fit.expected_error.mean(axis=1) > DOUBT.doubtful_error)
