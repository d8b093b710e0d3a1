"""Samples: pictures turned, zoomed and mirrored keep their labels."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from handfit_core.detect.finder import open_finder
from handfit_core.geometry.camera import Intrinsics
from handfit_core.options import CaptureOptions
from handfit_core.skeleton import SIDES
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
    with open_finder(CaptureOptions(plain_detection=True)) as detector:
        for number in range(6):
            hands, some = samples_of(0, number, detector, 320)
            count += hands
            all_found += some
    return count, all_found


def test_labels_agree_with_the_detector(found: tuple[int, list[Sample]]) -> None:
    """In every view of the still, turned and mirrored ones too."""
    count, all_found = found
    assert 0.4 * count < len(all_found) <= count
    errors = {view: [] for view in range(samples.VIEWS)}
    for sample in all_found:
        pixels = sample.intrinsics.project(sample.joints_3d)
        extent = np.ptp(pixels, axis=0).max()
        off = np.linalg.norm(sample.detection.keypoints_2d - pixels, axis=1).mean() / extent
        errors[sample.view].append(off)
    assert all(len(e) for e in errors.values())
    assert all(np.median(e) < 0.08 for e in errors.values())
    named = np.mean([s.detection.side == s.side for s in all_found])
    assert named > 0.6


def test_mirroring_swaps_the_side_and_nothing_else(found: tuple[int, list[Sample]]) -> None:
    by_hand: dict[tuple[int, bytes], list[Sample]] = {}
    for sample in found[1]:
        by_hand.setdefault((sample.number, sample.hand_pose.tobytes()), []).append(sample)
    assert any(len(group) > 1 for group in by_hand.values())
    for group in by_hand.values():
        # The side before mirroring is one and the same, and so are the bones and the distance.
        assert len({(s.side == "left") != s.mirrored for s in group}) == 1
        lengths = [np.linalg.norm(s.joints_3d - s.joints_3d[0], axis=1) for s in group]
        np.testing.assert_allclose(lengths, np.broadcast_to(lengths[0], np.shape(lengths)), atol=1e-12)
        for s in group:
            np.testing.assert_allclose(s.joints_3d[:, 2], group[0].joints_3d[:, 2])


def test_rows_hold_numbers_only(found: tuple[int, list[Sample]]) -> None:
    rows = [s.row() for s in found[1]]
    stacked = {name: np.array([r[name] for r in rows]) for name in rows[0]}
    assert all(a.dtype.kind in "biuf" for a in stacked.values())
    assert stacked["joints_3d"].shape == (len(rows), 21, 3)
    assert [SIDES[i] for i in stacked["side"]] == [s.side for s in found[1]]
