"""Painted stills: the hand is where its mesh projects."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from scripts.benchmark.kinematics import model_of
from scripts.benchmark.shots import Shot
from scripts.benchmark.stills import still_shot
from scripts.training import painter
from scripts.training.painter import paint

SIZE = 160


def bare_shot(number: int = 0) -> Shot:
    """A still of one whole hand without props."""
    shots = (still_shot(5, i, SIZE) for i in range(number, 100))
    return next(s for s in shots if len(s.hands) == 1 and not s.props and s.tags[0]["framing"] == "whole")


def silhouette(shot: Shot) -> np.ndarray:
    """(size, size) bool: where triangles of the hand and its arm project, filled one by one."""
    mask = np.zeros((shot.size, shot.size), dtype=np.uint8)
    (hand,) = shot.hands
    model = model_of(hand.side)
    vertices = model.posed(hand.betas, hand.global_orient[0], hand.hand_pose[0], hand.transl[0]).vertices
    pixels = np.round((shot.camera.project(vertices) - 0.5) * 16).astype(np.int32)
    for triangle in model.faces:
        cv2.fillConvexPoly(mask, pixels[triangle], 1, cv2.LINE_8, 4)
    return mask.astype(bool)


@pytest.fixture
def without_noise(monkeypatch: pytest.MonkeyPatch) -> None:
    """A black background, and a picture as it is filled."""
    monkeypatch.setattr(painter, "_background", lambda size, _: np.zeros((size, size, 3), np.uint8))
    monkeypatch.setattr(painter, "_through_lens", lambda picture, _: picture)


@pytest.mark.usefixtures("without_noise")
@pytest.mark.parametrize("number", [0, 30, 40])  # none is seen into its open wrist
def test_the_hand_covers_what_its_mesh_projects_to(number: int) -> None:
    shot = bare_shot(number)
    hand = shot.hands[0]
    # The arm hides nothing here, but is painted too.
    shot = replace(shot, hands=(replace(hand, arm=None),))
    painted = paint(shot, np.random.default_rng(1)).max(axis=-1) > 0
    expected = silhouette(shot)
    wrong = cv2.erode((painted != expected).astype(np.uint8), np.ones((2, 2), np.uint8))
    assert expected.sum() > 300
    assert wrong.sum() <= 0.02 * expected.sum()  # all that differs is a line of smoothed edge


@pytest.mark.usefixtures("without_noise")
def test_keypoints_lie_on_the_painted_hand() -> None:
    shot = bare_shot()
    painted = paint(shot, np.random.default_rng(1)).max(axis=-1) > 0
    near = cv2.dilate(painted.astype(np.uint8), np.ones((3, 3), np.uint8)).astype(bool)
    pixels = shot.camera.project(shot.hands[0].keypoints()[0])
    column, row = pixels.astype(int).T
    assert near[row, column].all()


def test_the_same_seed_paints_the_same_picture() -> None:
    shot = bare_shot()
    first, second, other = (paint(shot, np.random.default_rng(s)) for s in (3, 3, 4))
    assert first.shape == (SIZE, SIZE, 3)
    assert first.dtype == np.uint8
    np.testing.assert_array_equal(first, second)
    assert np.abs(first.astype(int) - other).mean() > 5


def test_what_is_nearer_is_painted_over() -> None:
    """A prop between the camera and the hand hides it."""
    shot = next(s for s in (still_shot(5, i, SIZE) for i in range(200)) if s.props and len(s.hands) == 1)
    picture = paint(shot, np.random.default_rng(0))
    without = paint(replace(shot, props=()), np.random.default_rng(0))
    assert (np.abs(picture.astype(int) - without).max(axis=-1) > 40).sum() > 50


@pytest.mark.parametrize("sides", [4, 7])
def test_lids_become_quads(sides: int) -> None:
    """A fan covers a polygon's area once."""
    angle = np.linspace(0, 2 * np.pi, sides, endpoint=False)
    corners = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    quads = painter._as_quads((tuple(range(sides)),))
    points = corners[quads]
    after = np.roll(points, -1, axis=1)
    area = 0.5 * (points[..., 0] * after[..., 1] - after[..., 0] * points[..., 1]).sum()
    assert area == pytest.approx(0.5 * sides * np.sin(2 * np.pi / sides))


def test_long_quads_are_divided_where_they_are() -> None:
    from scripts.benchmark.meshes import Mesh

    plane = Mesh(
        np.array([[0, 0, 1], [0.1, 0, 1], [0.1, 0.05, 1], [0, 0.05, 1]], dtype=float), ((0, 1, 2, 3),)
    )
    fine = painter._divided(plane)
    corners = fine.vertices[np.array(fine.polygons)]
    edges = np.linalg.norm(corners - np.roll(corners, -1, axis=1), axis=-1)
    assert edges.max() <= painter._COARSE + 1e-12
    diagonals = corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1]
    area = 0.5 * np.cross(*diagonals)[:, 2]
    assert area.sum() == pytest.approx(0.005)
    assert (area > 0).all()
