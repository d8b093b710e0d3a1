from __future__ import annotations

import numpy as np
import pytest

from handfit_core.detect.keypoints import HandDetection
from handfit_core.errors import OptionError
from handfit_core.evaluate.methods import (
    TrackResult,
    fused_landmarks,
    get_method,
    in_metres,
    method_names,
    world_landmarks,
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


def test_fused_depth_is_the_mean_of_both_sets_and_the_picture_stays() -> None:
    points = joints()
    detection = seen(points)
    flattened = HandDetection("right", 0.9, detection.keypoints * [1, 1, 0.5], detection.world)
    fused = fused_landmarks(flattened.keypoints, flattened.world)
    np.testing.assert_array_equal(fused[:, :2], flattened.keypoints[:, :2])
    np.testing.assert_allclose(
        fused[:, 2],
        (flattened.keypoints[:, 2] + world_landmarks(flattened.keypoints, flattened.world)[:, 2]) / 2,
    )


def test_raw_landmarks_in_metres_have_the_world_landmarks_size_and_stand_where_the_hand_is() -> None:
    points = joints()
    detection = seen(points)
    placed = in_metres(detection.keypoints, detection.world, CAMERA)
    assert np.linalg.norm(placed.mean(axis=0) - points.mean(axis=0)) < 0.01
    # Only perspective is left.
    assert np.linalg.norm(placed - points, axis=1).max() < 0.02
    # A similarity transform apart from the detection itself, so PA errors are the detector's own.
    moved = align(detection.keypoints, placed, with_scale=True).apply(detection.keypoints)
    np.testing.assert_allclose(moved, placed, atol=1e-9)


def test_a_fitted_hand_tells_how_deep_it_stands_in_itself_and_points_without_one_do_not() -> None:
    model, nothing = load_model(None, "right"), np.empty((4, 0))
    crossed = np.zeros((15, 3))
    crossed[0, 1] = np.radians(-25.0)  # the index finger's first joint, sideways into the middle finger
    crossed[3, 1] = np.radians(25.0)
    poses = np.stack([np.zeros(45), model.hands_mean, crossed.ravel(), np.full(45, np.nan)])
    parameters = np.concatenate([np.zeros((4, 13)), poses, np.zeros((4, 3))], axis=1)
    fitted, bare = (TrackResult(nothing, nothing, nothing, p, nothing) for p in (parameters, nothing))
    assert fitted.penetration(model, 0) == 0.0
    assert fitted.penetration(model, 1) < 0.001
    assert 0.004 < fitted.penetration(model, 2) < 0.02
    assert np.isnan([fitted.penetration(model, 3), bare.penetration(model, 0)]).all()


@pytest.mark.parametrize("name", ["raw-image", "raw-world", "fused", "paper-a"])
def test_frames_without_a_detection_stay_empty(name: str) -> None:
    track = track_of("right", [None, seen(joints()), None])
    result = get_method(name, "strict")({"right": load_model(None, "right")}, track, CAMERA)
    assert np.isnan(result.points_3d[[0, 2]]).all()
    assert np.isfinite(result.points_3d[1]).all()
    assert np.isfinite(result.picture_points[1]).all()
    np.testing.assert_array_equal(np.isfinite(result.milliseconds), [False, name == "paper-a", False])


def test_a_fitted_hand_keeps_the_parameters_that_give_its_surface() -> None:
    model = load_model(None, "right")
    track = track_of("right", [seen(joints()), None])
    result = get_method("paper-a-plus", "strict")({"right": model}, track, CAMERA)
    vertices = result.vertices(model, 0)
    assert vertices is not None
    np.testing.assert_allclose(vertices[model.tip_vertices], result.points_3d[0, [4, 8, 12, 16, 20]])
    assert result.vertices(model, 1) is None
    raw = get_method("fused", "strict")({"right": model}, track, CAMERA)
    assert raw.vertices(model, 0) is None


def test_the_papers_protocol_takes_the_papers_own_picture_points() -> None:
    model, detection = load_model(None, "right"), seen(joints())
    result = get_method("paper-b", "paper")({"right": model}, track_of("right", [detection]), CAMERA)
    fit = PaperFitter(model, EXPERIMENTS["paper-b"]).fit(detection.keypoints)
    fitted = model.keypoints(fit.betas, fit.global_orient, fit.hand_pose, np.zeros(3))
    np.testing.assert_allclose(result.picture_points[0], fit.in_picture(fitted))
