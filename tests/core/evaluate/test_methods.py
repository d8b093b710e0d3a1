from __future__ import annotations

import numpy as np
import pytest

from handfit_core.common.errors import OptionError
from handfit_core.evaluate.methods import (
    get_method,
    in_metres,
    method_names,
)
from handfit_core.geometry.similarity import align
from handfit_core.hand_model import load_model
from handfit_core.paper import EXPERIMENTS
from handfit_core.paper.fitter import PaperFitter
from tests.core.evaluate.hands import CAMERA, joints, seen
from tests.core.fit.detections import track_of


def test_groups_open_in_place_and_nothing_is_run_twice() -> None:
    assert method_names(["paper-b", "raw", "paper-b", "raw-image"]) == ["paper-b", "raw-image", "raw-world"]
    assert method_names(["paper"]) == [f"paper-{letter}" for letter in "abcdefgh"]
    with pytest.raises(OptionError, match=r"no solver 'paper-z'.*fused.*paper-a"):
        method_names(["paper-z"])


def test_raw_landmarks_in_metres_have_the_world_landmarks_size_and_stand_where_the_hand_is() -> None:
    points = joints()
    detection = seen(points)
    placed = in_metres(detection.keypoints[0], detection.world[0], CAMERA)
    assert np.linalg.norm(placed.mean(axis=0) - points.mean(axis=0)) < 0.01
    # Only perspective is left.
    assert np.linalg.norm(placed - points, axis=1).max() < 0.02
    # A similarity transform apart from the detection itself, so PA errors are the detector's own.
    moved = align(detection.keypoints[0], placed, with_scale=True).apply(detection.keypoints[0])
    np.testing.assert_allclose(moved, placed, atol=1e-9)


@pytest.mark.parametrize("name", ["raw-image", "raw-world", "fused", "paper-a"])
def test_frames_without_a_detection_stay_empty(name: str) -> None:
    track = track_of("right", [None, seen(joints()), None])
    result = get_method(name, "strict")(load_model(None, "right"), track, CAMERA)
    assert np.isnan(result.points_3d[[0, 2]]).all()
    assert np.isfinite(result.points_3d[1]).all()
    assert np.isfinite(result.picture_points[1]).all()
    np.testing.assert_array_equal(np.isfinite(result.milliseconds), [False, name == "paper-a", False])


def test_a_fitted_hand_keeps_the_parameters_that_give_its_surface() -> None:
    model = load_model(None, "right")
    track = track_of("right", [seen(joints()), None])
    result = get_method("paper-a-plus", "strict")(model, track, CAMERA)
    betas, orient, pose, transl = np.split(result.parameters[0], [10, 13, 58])
    np.testing.assert_allclose(model.keypoints(betas, orient, pose, transl), result.points_3d[0], atol=1e-12)
    assert np.isnan(result.parameters[1]).all()
    assert get_method("fused", "strict")(model, track, CAMERA).parameters.shape == (2, 0)


def test_the_papers_protocol_takes_the_papers_own_picture_points() -> None:
    model, detection = load_model(None, "right"), seen(joints())
    result = get_method("paper-b", "paper")(model, track_of("right", [detection]), CAMERA)
    fit = PaperFitter(model, EXPERIMENTS["paper-b"]).fit(detection.keypoints[0])
    fitted = model.keypoints(fit.betas, fit.global_orient, fit.hand_pose, np.zeros(3))
    np.testing.assert_allclose(result.picture_points[0], fit.in_picture(fitted))
