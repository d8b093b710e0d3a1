"""Dyn-HaMR's results: right parameters in a world, mirrored at the end, and a camera that moves."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from handfit_core.errors import InputError
from handfit_core.geometry.rotations import rotmat_to_rotvec, rotvec_to_rotmat
from handfit_core.hand_model import load_model
from handfit_core.pipeline import capture
from handfit_core.skeleton import SIDES
from tests.core.interchange.known_hands import (
    EXACT,
    FRAMES,
    HANDS,
    TURN,
    assert_same_hand,
    hand_of,
    own_mano,
    read,
    says,
    wrist_of,
)

MIRROR = np.array([-1.0, 1.0, 1.0])


def cameras() -> tuple[np.ndarray, np.ndarray]:
    """World to camera, of each frame: (T, 3, 3), (T, 3)."""
    rng = np.random.default_rng(7)
    return rotvec_to_rotmat(rng.uniform(-1.0, 1.0, (FRAMES, 3))), rng.uniform(-1.0, 1.0, (FRAMES, 3))


def results(path: Path, model: Path | None = None, **changes: Any) -> Path:
    """world_results of `HANDS`, which are in the camera's frame: the way back is written out."""
    turned, moved = cameras()
    back = np.swapaxes(turned, -1, -2)
    orients, poses, places = [], [], []
    for side in SIDES:
        hand = HANDS[side]
        wrist = wrist_of(side, model, hand.betas if model else None)
        orient = rotmat_to_rotvec(back @ rotvec_to_rotmat(hand.global_orient))
        place = (back @ (hand.transl + wrist - moved)[..., None])[..., 0] - wrist
        pose = hand.hand_pose
        if side == "left":
            orient, pose, place = orient * TURN, pose * np.tile(TURN, 15), place * MIRROR
        orients.append(orient)
        poses.append(pose)
        places.append(place)
    arrays: dict[str, Any] = {
        "trans": np.stack(places),
        "root_orient": np.stack(orients),
        "pose_body": np.stack(poses),
        "betas": np.stack([HANDS[side].betas for side in SIDES]),
        "is_right": np.repeat([[0.0], [1.0]], FRAMES, axis=1),
        "cam_R": np.stack([turned, turned]),
        "cam_t": np.stack([moved, moved]),
        "intrins": np.array([1400.0, 1400.0, 640.0, 360.0]),
        **changes,
    }
    np.savez(path, **{name: value for name, value in arrays.items() if value is not None})
    return path


@pytest.mark.parametrize("own", [False, True], ids=["open hand", "own MANO"])
def test_both_hands_before_the_camera(tmp_path: Path, own: bool) -> None:
    model = own_mano(tmp_path / "mano") if own else None
    recording = read(
        results(tmp_path / "a_000300_world_results.npz", model), model=str(model) if own else None
    )
    assert recording.format == "dyn-hamr"
    for side in SIDES:
        assert_same_hand(hand_of(recording, side), HANDS[side])
    assert recording.size == (1280, 720)
    assert recording.intrinsics is not None
    assert recording.intrinsics.fx == 1400.0


def test_every_point_of_it(tmp_path: Path) -> None:
    """By the other way round: Dyn-HaMR poses right hands, mirrors their points, and looks at them."""
    path = results(tmp_path / "world_results.npz")
    data = dict(np.load(path))
    take = capture(path)
    right, (turned, moved) = load_model(None, "right"), cameras()
    for track, hand in enumerate(take.hands):
        points = right.keypoints(
            None, data["root_orient"][track], data["pose_body"][track], data["trans"][track]
        )
        if hand.side == "left":
            points = points * MIRROR
        seen = (turned[:, None] @ points[..., None])[..., 0] + moved[:, None]
        np.testing.assert_allclose(hand.joints_3d, seen, atol=EXACT)


@pytest.mark.parametrize("shape", ["frames only", "latent pose", "no camera"])
def test_other_layouts(tmp_path: Path, shape: str) -> None:
    turned, moved = cameras()
    changes: dict[str, Any] = {
        "frames only": {"cam_R": turned, "cam_t": moved},
        "latent pose": {
            "pose_body": None,
            "latent_pose": np.stack(
                [h.mirrored[1] if s == "left" else h.hand_pose for s, h in HANDS.items()]
            ),
        },
        "no camera": {"cam_R": None},
    }[shape]
    recording = read(results(tmp_path / "a.npz", **changes))
    if shape == "no camera":
        assert says(recording, "the camera is not told")
    else:
        assert_same_hand(hand_of(recording, "left"), HANDS["left"])


def test_a_wrong_side_is_noticed(tmp_path: Path) -> None:
    wrong = read(results(tmp_path / "a.npz", is_right=np.zeros((2, FRAMES)), cam_R=None))
    assert [hand.side for hand in wrong.posed] == ["left", "left"]
    # The mirror of a right hand is a left one, so that its pose is sound; what is not is a left hand that is
    # stored as one: it bends backwards in the mirror.
    unmirrored = np.stack([HANDS[side].hand_pose for side in SIDES])
    assert says(read(results(tmp_path / "b.npz", pose_body=unmirrored)), "its is_right may be wrong")


def test_persons(tmp_path: Path) -> None:
    path = results(tmp_path / "a.npz")
    assert len(read(path, person=1).posed) == 2
    with pytest.raises(InputError, match="no person 2: it has 1"):
        read(path, person=2)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"is_right": np.ones(FRAMES)}, "is_right must have the shape BxT"),
        ({"trans": np.zeros((1, FRAMES, 3))}, "trans must have 2 tracks of 7 frames"),
        ({"pose_body": np.zeros((2, FRAMES, 40))}, "pose_body must have the shape Nx45"),
        ({"cam_R": np.zeros((2, FRAMES, 3, 3))}, "no rotations"),
        ({"cam_R": np.tile(np.eye(3), (3, 1, 1))}, "cam_R and cam_t must have 7 frames"),
        ({"intrins": np.array([1.0, 1.0, -5.0, 2.0])}, "intrins must be"),
    ],
    ids=["sides", "tracks", "pose", "camera", "frames", "intrinsics"],
)
def test_what_is_wrong_is_said(tmp_path: Path, changes: dict[str, Any], said: str) -> None:
    with pytest.raises(InputError, match=said):
        read(results(tmp_path / "bad.npz", **changes))
