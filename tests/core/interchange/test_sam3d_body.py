"""SAM 3D Body's files: people whose hands are ours, posed, with the joints of Meta's skeleton."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from handfit_core.capturing.pipeline import capture
from handfit_core.common.errors import HandfitError
from handfit_core.common.skeleton import SIDES, Side
from handfit_core.geometry.similarity import align
from handfit_core.hand_model import load_model
from handfit_core.hand_model.chain import Chain
from handfit_core.interchange.formats.sam3d_body import MHR_LANDMARKS
from tests.core.interchange.known_hands import read

FOCAL, CENTRE = 1500.0, np.array([960.0, 540.0])
ORDER: dict[Side, list[int]] = {
    "right": [41, 24, 23, 22, 21, 28, 27, 26, 25, 32, 31, 30, 29, 36, 35, 34, 33, 40, 39, 38, 37],
    "left": [62, 45, 44, 43, 42, 49, 48, 47, 46, 53, 52, 51, 50, 57, 56, 55, 54, 61, 60, 59, 58],
}
"""MHR70's numbers of our 21 keypoints, counted on Meta's list of names"""


def posed(side: Side, at: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """A hand's pose (45,), and where MHR's joints are on it (21, 3), metres, camera frame."""
    chain = Chain(load_model(None, side), MHR_LANDMARKS)
    pose = np.random.default_rng(3).normal(0.0, 0.05, 45)
    sign = 1.0 if side == "right" else -1.0
    pose[2:36:3] += sign * 0.5
    place = np.array([[at - sign * 0.25, -0.1, 2.5]])
    turned = np.array([[0.2, sign * 0.3, sign * -1.4]])
    return pose, chain.points(chain.state(np.zeros((1, 10)), turned, pose[None], place, place[:, 2]))[0]


def person(at: float = 0.0) -> dict[str, Any]:
    """What the estimator gives of one person, as far as hands and camera go."""
    body = np.random.default_rng(0).normal(0.0, 0.3, (70, 3)) + [at, 0.0, 2.5]
    for side in SIDES:
        body[ORDER[side]] = posed(side, at)[1]
    place = np.array([at, 0.4, 2.0])
    return {
        "bbox": np.zeros(4, np.float32),
        "pred_keypoints_3d": (body - place).astype(np.float32),
        "pred_keypoints_2d": (body[:, :2] / body[:, 2:] * FOCAL + CENTRE).astype(np.float32),
        "pred_cam_t": place.astype(np.float32),
        "mhr_model_params": np.zeros(204, np.float32),
    }


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for name, at in (("img_subj00", -0.6), ("img_subj01", 0.5)):
        np.savez(tmp_path / f"{name}.npz", **person(at))
    return tmp_path


def test_people_of_one_picture_and_its_camera(folder: Path) -> None:
    found = read(folder)
    assert (found.frame_numbers.tolist(), found.size) == ([1], (1920, 1080))
    assert [hand.side for hand in found.points] == ["left", "right"] * 2
    for hand, at in zip(found.points, (-0.6, -0.6, 0.5, 0.5), strict=True):
        np.testing.assert_allclose(hand.points[0], posed(hand.side, at)[1], atol=1e-5)
    camera = [getattr(found.intrinsics, name) for name in ("fx", "cx", "cy")]
    assert camera == pytest.approx([FOCAL, *CENTRE], abs=0.02)
    np.testing.assert_array_equal(read(folder, person=2).points[1].points, found.points[3].points)


def test_frames_by_the_numbers_of_the_names(tmp_path: Path) -> None:
    for name in ("sam3d_0007", "sam3d_0009"):
        np.savez(tmp_path / f"{name}.npz", **person())
    assert read(tmp_path).frame_numbers.tolist() == [7, 9]


def apart(ours: np.ndarray, theirs: np.ndarray) -> float:
    """Mean metres between points (N, 3), once one is laid over the other."""
    laid = align(ours, theirs, with_scale=True)
    off = laid.scale * ours @ laid.rotation.T + laid.translation - theirs
    return float(np.linalg.norm(off, axis=-1).mean())


def test_fingers_bend_as_they_did(folder: Path) -> None:
    flat = np.zeros(3)
    for hand in capture(folder / "img_subj00.npz").hands:
        poses = posed(hand.side)[0], hand.hand_pose[0]
        true, found = (load_model(None, hand.side).keypoints(None, flat, pose, flat) for pose in poses)
        assert apart(found, true) < 0.003


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"pred_keypoints_3d": np.zeros((133, 3))}, "the shape Nx70x3, not 133x3"),
        ({"pred_cam_t": np.array([0.0, 0.0, -9.0])}, "behind the camera"),
        ({"pred_keypoints_2d": np.random.default_rng(1).normal(500, 99, (70, 2))}, "one camera"),
    ],
)
def test_bad_files_are_named_in_a_sentence(tmp_path: Path, change: dict[str, Any], words: str) -> None:
    np.savez(tmp_path / "a.npz", **(person() | change))
    with pytest.raises(HandfitError, match=words):
        read(tmp_path / "a.npz")


def test_real_files(samples: Path) -> None:
    """Four people of one picture; the points are Meta's own joints to the last digit."""
    folder = samples / "other_trackers"
    found = read(folder)
    assert (found.size, len(found.points)) == ((1920, 890), 8)
    with np.load(folder / "sam3d_body_img_subj02.npz") as arrays:
        joints = arrays["pred_joint_coords"].astype(np.float64) + arrays["pred_cam_t"]
    np.testing.assert_allclose(found.points[5].points[0][[0, 5, 1]], joints[[41, 56, 61]], atol=1e-6)
    np.testing.assert_allclose(found.points[4].points[0][[0, 5, 1]], joints[[77, 92, 97]], atol=1e-6)


def test_real_hands_lie_on_their_joints(samples: Path) -> None:
    """Four people, eight hands: Meta's joints and ours, but for the wrist and the thumb's root, once one is
    laid over the other. What is left is how the skeletons differ."""
    folder, joints = samples / "other_trackers", [k for k in range(21) if k not in (0, 1)]
    for hand, told in zip(capture(folder).hands, read(folder).points, strict=True):
        assert apart(hand.joints_3d[0][joints], told.points[0][joints]) < 0.003
