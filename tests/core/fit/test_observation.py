"""What the solver fits to: detections corrected by the network, in pixels, with a line of sight."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from handfit_core.detect.correction.canonical import canonical
from handfit_core.detect.correction.corrected import Trust, landmarked
from handfit_core.detect.correction.network import landmark_network
from handfit_core.fit.observation import observation_of
from handfit_core.skeleton import Side
from tests.core.fit.detections import CAMERA, columns, landmarks_of, mirror_image, poses, seen

RIGHT: Side = "right"
POINTS = landmarks_of(RIGHT, *poses(6, seed=5))
HANDS = [seen(p, RIGHT) for p in POINTS]
DETECTIONS = columns(HANDS)
RIGHTS = DETECTIONS.side


def test_no_trust_keeps_detection() -> None:
    found = landmarked(DETECTIONS, RIGHT, Trust(plane=0.0, depth=0.0))
    np.testing.assert_allclose(found.pixels, DETECTIONS.keypoints_2d, atol=1e-9)
    np.testing.assert_allclose(found.depth.mean(axis=1), 0.0, atol=1e-9)
    # Image and world landmarks are exact here: so is their mean.
    depth = DETECTIONS.keypoints[..., 2]
    expected, size = depth - depth.mean(axis=1, keepdims=True), DETECTIONS.extent
    assert (
        np.abs((found.depth - expected) / size[:, None]).max() < 0.08
    )  # of the hand's size: perspective is all that is left


def test_full_trust_takes_network() -> None:
    found = landmarked(DETECTIONS, RIGHT, Trust(plane=1.0, depth=1.0))
    frame = canonical(DETECTIONS, RIGHTS)
    said = frame.to_picture(landmark_network()(frame).points)
    np.testing.assert_allclose(found.pixels, said[..., :2], atol=1e-9)
    np.testing.assert_allclose(
        found.depth, said[..., 2] - said[..., 2].mean(axis=1, keepdims=True), atol=1e-9
    )


def test_half_the_trust_lies_half_way() -> None:
    ends = [landmarked(DETECTIONS, RIGHT, Trust(plane=t, depth=t)) for t in (0.0, 0.5, 1.0)]
    np.testing.assert_allclose(ends[1].pixels, (ends[0].pixels + ends[2].pixels) / 2, atol=1e-9)
    np.testing.assert_allclose(ends[1].depth, (ends[0].depth + ends[2].depth) / 2, atol=1e-9)


def test_trust_in_the_plane_and_in_depth() -> None:
    none, plane, depth, full = (
        landmarked(DETECTIONS, RIGHT, Trust(plane=p, depth=d)) for p, d in [(0, 0), (1, 0), (0, 1), (1, 1)]
    )
    np.testing.assert_allclose(plane.pixels, full.pixels, atol=1e-9)
    np.testing.assert_allclose(plane.depth, none.depth, atol=1e-9)
    np.testing.assert_allclose(depth.pixels, none.pixels, atol=1e-9)
    np.testing.assert_allclose(depth.depth, full.depth, atol=1e-9)


def test_expected_errors_scale() -> None:
    large = replace(DETECTIONS, keypoints=2 * DETECTIONS.keypoints)
    small, twice = landmarked(DETECTIONS, RIGHT, Trust()), landmarked(large, RIGHT, Trust())
    np.testing.assert_allclose(twice.pixel_sigma, 2 * small.pixel_sigma, rtol=1e-4)
    np.testing.assert_allclose(twice.depth_sigma, 2 * small.depth_sigma, rtol=1e-4)
    floor = Trust(floor=10.0, plane_sigma=0.5, depth_sigma=0.7, knuckles=1.0)
    least = landmarked(DETECTIONS, RIGHT, floor)
    size = canonical(DETECTIONS, RIGHTS).size
    np.testing.assert_allclose(least.pixel_sigma, np.broadcast_to(5.0 * size[:, None, None], (6, 21, 2)))
    np.testing.assert_allclose(least.depth_sigma, np.broadcast_to(7.0 * size[:, None], (6, 21)))
    knuckles = np.isin(np.arange(21), [5, 9, 13, 17])
    more = landmarked(DETECTIONS, RIGHT, replace(floor, knuckles=3.0))
    np.testing.assert_allclose(more.depth_sigma, least.depth_sigma * np.where(knuckles, 3.0, 1.0))
    np.testing.assert_allclose(more.pixel_sigma[:, ~knuckles], least.pixel_sigma[:, ~knuckles])


def test_a_mirrored_picture_is_seen_alike() -> None:
    ours = landmarked(DETECTIONS, RIGHT, Trust())
    theirs = landmarked(columns([mirror_image(d) for d in HANDS]), "left", Trust())
    np.testing.assert_allclose(2 * CAMERA.cx - theirs.pixels[..., 0], ours.pixels[..., 0], atol=1e-3)
    np.testing.assert_allclose(theirs.pixels[..., 1], ours.pixels[..., 1], atol=1e-3)
    np.testing.assert_allclose(theirs.depth, ours.depth, atol=1e-3)
    np.testing.assert_allclose(theirs.pixel_sigma, ours.pixel_sigma, rtol=1e-4)


def test_through_a_camera() -> None:
    found = landmarked(DETECTIONS, RIGHT, Trust())
    observation = observation_of(found, CAMERA)
    assert len(observation) == 6
    middle = found.pixels.mean(axis=1)
    rays = np.concatenate([(middle - [CAMERA.cx, CAMERA.cy]) / CAMERA.fx, np.ones((6, 1))], axis=1)
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    np.testing.assert_allclose(observation.ray, rays, rtol=1e-5, atol=1e-7)
    np.testing.assert_allclose(observation.focal, np.full((6, 2), CAMERA.fx))
    np.testing.assert_allclose(observation.centre, np.tile([CAMERA.cx, CAMERA.cy], (6, 1)))
    assert observation.kept is None
