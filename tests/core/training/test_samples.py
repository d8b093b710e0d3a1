"""Samples: pictures turned, zoomed and mirrored keep their labels."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from handfit_core.detect.networks import Networks
from handfit_core.geometry.camera import Intrinsics
from scripts.benchmark.stills import still_shot
from scripts.training import samples
from scripts.training.samples import Sample, samples_of

SIZE = 160


@pytest.mark.parametrize("seed", range(8))
def test_a_view_shows_points_where_its_camera_projects_them(seed: int) -> None:
    """Dots painted at projected points lie, after warping, where the turned points project."""
    shot = still_shot(0, 3, SIZE)
    rng = np.random.default_rng(seed)
    turn, zoom = samples._random_view(rng)
    camera = Intrinsics(shot.camera.fx * zoom, shot.camera.fy * zoom, SIZE / 2, SIZE / 2)
    for x, y in [(0.1, 0.05), (-0.08, 0.12), (0.0, -0.15)]:
        point = np.array([x, y, shot.camera.fx / SIZE])
        at = shot.camera.project(point)
        picture = np.zeros((SIZE, SIZE, 3), dtype=np.uint8)
        centre = np.round((at - 0.5) * 256).astype(int).tolist()
        cv2.circle(picture, centre, 4 * 256, (255, 255, 255), -1, cv2.LINE_AA, 8)
        seen = samples._viewed(picture, turn, zoom, shot)[..., 0].astype(float)
        rows, columns = np.indices(seen.shape)
        found = np.array([(columns * seen).sum(), (rows * seen).sum()]) / seen.sum() + 0.5
        turned = point.copy()
        turned[:2] = turn @ point[:2]
        np.testing.assert_allclose(found, camera.project(turned), atol=0.15)


def test_views_are_turns_and_mirror_images_at_random() -> None:
    rng = np.random.default_rng(0)
    views = [samples._random_view(rng) for _ in range(200)]
    turns = np.array([turn for turn, _ in views])
    np.testing.assert_allclose(turns @ turns.swapaxes(1, 2), np.tile(np.eye(2), (200, 1, 1)), atol=1e-12)
    mirrored = np.linalg.det(turns) < 0
    assert 70 < mirrored.sum() < 130
    zooms = np.array([zoom for _, zoom in views])
    assert np.exp(-0.25) <= zooms.min() < 0.85
    assert 1.15 < zooms.max() <= np.exp(0.25)


@pytest.fixture(scope="module")
def found() -> tuple[int, list[Sample]]:
    count, all_found = 0, []
    with Networks() as networks:
        for number in range(6):
            hands, some = samples_of(0, number, networks, 320)
            count += hands
            all_found += some
    return count, all_found


def test_labels_agree_with_the_detector(found: tuple[int, list[Sample]]) -> None:
    """In every view of the still, turned and mirrored ones too."""
    count, rows = found
    assert 0.4 * count < len(rows) <= count
    errors = {view: [] for view in range(samples.VIEWS)}
    for row in rows:
        pixels = Intrinsics(row["focal"], row["focal"], *row["centre"]).project(row["joints_3d"])
        extent = np.ptp(pixels, axis=0).max()
        errors[row["view"]].append(np.linalg.norm(row["keypoints"][:, :2] - pixels, axis=1).mean() / extent)
    assert all(np.median(e) < 0.08 for e in errors.values())
    assert np.mean([row["detected_side"] == row["side"] for row in rows]) > 0.6
    stacked = {name: np.array([row[name] for row in rows]) for name in rows[0]}
    assert all(array.dtype.kind in "biuf" for array in stacked.values())
    assert stacked["joints_3d"].shape == (len(rows), 21, 3)


def test_mirroring_swaps_the_side_and_nothing_else(found: tuple[int, list[Sample]]) -> None:
    by_hand: dict[tuple[int, bytes], list[Sample]] = {}
    for row in found[1]:
        by_hand.setdefault((row["number"], row["hand_pose"].tobytes()), []).append(row)
    assert any(len(group) > 1 for group in by_hand.values())
    for group in by_hand.values():
        # The side before mirroring is one and the same, and so are the bones and the distance.
        assert len({row["side"] != row["mirrored"] for row in group}) == 1
        points = np.array([row["joints_3d"] for row in group])
        lengths = np.linalg.norm(points - points[:, :1], axis=2)
        np.testing.assert_allclose(lengths, np.broadcast_to(lengths[0], lengths.shape), atol=1e-12)
        np.testing.assert_allclose(points[..., 2], np.broadcast_to(points[0, :, 2], points.shape[:2]))
