"""GRAB, ARCTIC, InterHand2.6M, HOT3D and DexYCB: with the user's own MANO, whose mean and basis they need."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from handfit_core.errors import InputError, OptionError
from handfit_core.geometry.rotations import rotmat_to_quat, rotmat_to_rotvec, rotvec_to_rotmat
from handfit_core.interchange.skeletons import UP_AXES
from handfit_core.pipeline import capture
from handfit_core.skeleton import SIDES, Side
from tests.core.interchange.known_hands import (
    FRAMES,
    HANDS,
    KnownHand,
    assert_same_hand,
    assert_same_turns,
    coefficients_of,
    hand_of,
    mean_of,
    own_mano,
    read,
    says,
    wrist_of,
)
from tests.imitation_mano import imitation_arrays


@pytest.fixture(scope="module")
def model(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return own_mano(tmp_path_factory.mktemp("models") / "mano")


def in_world(hand: KnownHand, wrist: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Orientation and place in a z-up world, with a wrist at rest at `wrist`."""
    orient = rotmat_to_rotvec(UP_AXES["z"].T @ rotvec_to_rotmat(hand.global_orient))
    return orient, (hand.transl + wrist) @ UP_AXES["z"] - wrist


def few_directions(side: Side, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Coefficients (T, count) and the poses (T, 45), without mean, that they stand for."""
    coefficients = coefficients_of(HANDS[side].hand_pose, side)[:, :count]
    return coefficients, coefficients @ imitation_arrays(side)["hands_components"][:count]


def assert_asks_for_mano(path: Path, needed: str) -> None:
    with pytest.raises(OptionError, match=f"{needed}.*give your own MANO folder or file") as caught:
        read(path)
    assert "\n" not in str(caught.value)


# GRAB


def grab(path: Path, *, full: bool) -> Path:
    def hand(side: Side) -> dict[str, Any]:
        orient, transl = in_world(HANDS[side], wrist_of(side))
        params = {"global_orient": orient, "hand_pose": few_directions(side, 24)[0], "transl": transl}
        if full:
            params["fullpose"] = HANDS[side].hand_pose
        return {"params": params, "vtemp": "tools/s1.ply"}

    upright = np.tile([np.pi / 2, 0.0, 0.0], (FRAMES, 1))
    arrays = {
        "gender": "male",
        "n_comps": 24,
        "framerate": 120.0,
        "body": {"params": {"global_orient": upright, "transl": np.zeros((FRAMES, 3))}, "vtemp": "x"},
        "lhand": hand("left"),
        "rhand": hand("right"),
        "contact": {"object": np.zeros((FRAMES, 5))},
    }
    np.savez(path, **{name: np.array(value, dtype=object) for name, value in arrays.items()})
    return path


def test_grabs_full_poses_need_no_model(tmp_path: Path) -> None:
    recording = read(grab(tmp_path / "mug_pass_1.npz", full=True))
    assert (recording.format, recording.fps) == ("grab", 120.0)
    for side in SIDES:
        assert_same_hand(hand_of(recording, side), HANDS[side])
    assert says(recording, "z-up, as the body stands so")


def test_grabs_coefficients(tmp_path: Path, model: Path) -> None:
    path = grab(tmp_path / "mug_pass_1.npz", full=False)
    assert_asks_for_mano(path, "coefficients of MANO's principal directions")
    recording = read(path, model=str(model))
    for side in SIDES:
        assert_same_turns(hand_of(recording, side).hand_pose, few_directions(side, 24)[1])


def test_grab_without_hands(tmp_path: Path) -> None:
    path = tmp_path / "a.npz"
    np.savez(path, **{name: np.array({"params": 1}, dtype=object) for name in ("body", "lhand", "rhand")})
    with pytest.raises(InputError, match="body must hold params"):
        read(path)


# ARCTIC


def arctic(path: Path, model: Path | None = None) -> Path:
    content = {}
    for side in SIDES:
        wrist = wrist_of(side, model, HANDS[side].betas if model else None)
        orient, transl = in_world(HANDS[side], wrist)
        content[side] = {
            "rot": orient,
            "pose": HANDS[side].hand_pose - mean_of(side),
            "trans": transl,
            "shape": np.tile(HANDS[side].betas, (FRAMES, 1)),
            "fitting_err": np.zeros(FRAMES),
        }
    np.save(path, content, allow_pickle=True)
    return path


def test_arctics_hands(tmp_path: Path, model: Path) -> None:
    path = arctic(tmp_path / "box_grab_01.mano.npy", model)
    assert_asks_for_mano(path, "mean pose")
    recording = read(path, model=str(model))
    assert recording.format == "arctic"
    for side in SIDES:
        assert_same_hand(hand_of(recording, side), HANDS[side])
        np.testing.assert_allclose(hand_of(recording, side).betas, HANDS[side].betas)
    path.write_bytes(path.read_bytes()[:-50])
    with pytest.raises(InputError):
        read(path)


def test_arctic_without_mean_is_noticed(tmp_path: Path) -> None:
    """Where it is read as flat although it is not, and its hands are open."""
    from handfit_core.hand_model import load_model
    from tests.core.interchange.known_hands import known_hand

    hand = known_hand("left", bend=(0.0, 8.0))
    pose = hand.hand_pose - load_model(None, "left").hands_mean
    path = tmp_path / "a.mano.npy"
    np.save(
        path, {"left": {"rot": hand.global_orient, "pose": pose, "trans": hand.transl}}, allow_pickle=True
    )
    recording = read(path, hand_mean="flat")
    assert says(recording, "further back than fingers can")
    assert says(recording, "--hand-mean mean")


# InterHand2.6M


def interhand(path: Path, **changes: Any) -> Path:
    def hand(side: Side, frame: int) -> dict[str, Any]:
        known = HANDS[side]
        pose = np.concatenate([known.global_orient[frame], known.hand_pose[frame] - mean_of(side)])
        one = {"pose": pose.tolist(), "shape": known.betas.tolist(), "trans": known.transl[frame].tolist()}
        return {**one, **changes}

    content = {
        "13": {
            str(1000 + 3 * frame): {
                "right": hand("right", frame),
                "left": None if frame == 1 else hand("left", frame),
            }
            for frame in range(FRAMES)
        },
        "14": {"7": {"right": hand("right", 0), "left": None}},
    }
    path.write_text(json.dumps(content), encoding="utf-8")
    return path


def test_interhand(tmp_path: Path, model: Path) -> None:
    path = interhand(tmp_path / "InterHand2.6M_val_MANO_NeuralAnnot.json")
    assert_asks_for_mano(path, "mean pose")
    recording = read(path, model=str(model))
    assert recording.format == "interhand"
    assert recording.frame_numbers.tolist() == [1000 + 3 * frame for frame in range(FRAMES)]
    assert_same_hand(hand_of(recording, "right"), HANDS["right"])
    left = hand_of(recording, "left")
    assert left.present.tolist() == [frame != 1 for frame in range(FRAMES)]
    assert_same_turns(left.hand_pose[left.present], HANDS["left"].hand_pose[left.present])
    assert says(recording, "capture 13, the first of 2")
    assert read(path, model=str(model), person=2).frame_numbers.tolist() == [7]
    with pytest.raises(InputError, match="2 captures"):
        read(path, model=str(model), person=3)


@pytest.mark.parametrize(
    "changes", [{"pose": [0.0] * 45}, {"trans": "here"}, {"shape": [1.0]}, {"pose": None}]
)
def test_interhand_that_is_damaged(tmp_path: Path, model: Path, changes: dict[str, Any]) -> None:
    with pytest.raises(InputError, match=f"InterHand2.6M.*{next(iter(changes))}") as caught:
        read(interhand(tmp_path / "a.json", **changes), model=str(model))
    assert "\n" not in str(caught.value)


# HOT3D


def hot3d(path: Path, cameras: int = 1) -> Path:
    """Hand 0, the left one, is missing in the second line."""
    lines = []
    for frame in range(FRAMES):
        poses = {}
        for index, side in enumerate(SIDES):
            orient, transl = in_world(HANDS[side], wrist_of(side, None))
            poses[str(index)] = {
                "pose": few_directions(side, 15)[0][frame].tolist(),
                "wrist_xform": {
                    "t_xyz": transl[frame].tolist(),
                    "q_wxyz": rotmat_to_quat(rotvec_to_rotmat(orient[frame])).tolist(),
                },
                "betas": [0.0] * 10,
            }
        if frame == 1:
            del poses["0"]
        for camera in range(cameras):
            time = 5_000_000_000 + frame * 33_333_333 + camera * 90_000
            lines.append(json.dumps({"timestamp_ns": time, "hand_poses": poses}))
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


@pytest.mark.parametrize("cameras", [1, 2], ids=["Quest 3", "Aria"])
def test_hot3d(tmp_path: Path, model: Path, cameras: int) -> None:
    path = hot3d(tmp_path / "mano_hand_pose_trajectory.jsonl", cameras)
    assert_asks_for_mano(path, "coefficients of MANO's principal directions")
    recording = read(path, model=str(model))
    assert recording.format == "hot3d"
    assert recording.fps == pytest.approx(30.0, abs=1e-3)
    for side in SIDES:
        found = hand_of(recording, side)
        there = found.present
        assert there.tolist() == [side == "right" or frame != 1 for frame in range(FRAMES)]
        assert_same_turns(found.global_orient[there], HANDS[side].global_orient[there])
        wanted = few_directions(side, 15)[1] + mean_of(side)
        assert_same_turns(found.hand_pose[there], wanted[there])
        off = np.asarray(found.transl)[there] - HANDS[side].transl[there]
        assert np.abs(off).max() < 1e-3  # the imitation's wrist is a hair's breadth off the open hand's
    assert len(capture(path, model=str(model)).hands) == 2


def test_hot3ds_clips(tmp_path: Path, model: Path) -> None:
    for frame in range(FRAMES):
        hands = {}
        for side in SIDES:
            orient, transl = in_world(HANDS[side], wrist_of(side, model))
            pose = {
                "thetas": few_directions(side, 15)[0][frame].tolist(),
                "wrist_xform": [*orient[frame].tolist(), *transl[frame].tolist()],
            }
            hands[side] = {"mano_pose": pose, "boxes_amodal": {}}
        (tmp_path / f"{frame:06}.hands.json").write_text(json.dumps(hands), encoding="utf-8")
    recording = read(tmp_path, model=str(model))
    for side in SIDES:
        found = hand_of(recording, side)
        assert_same_turns(found.global_orient, HANDS[side].global_orient)
        np.testing.assert_allclose(found.transl, HANDS[side].transl, atol=1e-6)


def test_hot3ds_other_hands(tmp_path: Path, model: Path) -> None:
    line = {"timestamp_ns": 1, "hand_poses": {"0": {"wrist_xform": {}, "joint_angles": [0.0] * 22}}}
    path = tmp_path / "umetrack_hand_pose_trajectory.jsonl"
    path.write_text(json.dumps(line), encoding="utf-8")
    with pytest.raises(InputError, match="UmeTrack"):
        read(path, model=str(model))


# DexYCB


def dex_ycb(folder: Path, side: Side) -> Path:
    """One camera's labels under a sequence, with the calibration where it is in the data set; no hand in the
    first frame."""
    labels = folder / "20200709-subject-01" / "20200709_141841" / "932122060861"
    labels.mkdir(parents=True)
    coefficients = coefficients_of(HANDS[side].hand_pose - mean_of(side), side)
    for frame in range(FRAMES + 1):
        row = np.zeros((1, 51), dtype=np.float32)
        if frame:
            hand = HANDS[side]
            row[0] = [*hand.global_orient[frame - 1], *coefficients[frame - 1], *hand.transl[frame - 1]]
        np.savez_compressed(
            labels / f"labels_{frame:06}.npz",
            pose_m=row,
            seg=np.zeros((48, 64), np.uint8),
            pose_y=np.zeros((2, 3, 4)),
        )
    meta = f"serials:\n- '932122060861'\nmano_sides:\n- {side}\nmano_calib:\n- 20200709-subject-01_{side}\n"
    (labels.parent / "meta.yml").write_text(meta, encoding="utf-8")
    calibration = folder / "calibration"
    (calibration / "intrinsics").mkdir(parents=True)
    (calibration / "intrinsics" / "932122060861_640x480.yml").write_text(
        "color:\n  fx: 613.5\n  fy: 612.5\n  ppx: 313.0\n  ppy: 245.0\ndepth:\n  fx: 1.0\n  fy: 1.0\n",
        encoding="utf-8",
    )
    mano = calibration / f"mano_20200709-subject-01_{side}"
    mano.mkdir()
    betas = "".join(f"- {value!r}\n" for value in HANDS[side].betas.tolist())
    (mano / "mano.yml").write_text(f"betas:\n{betas}", encoding="utf-8")
    return labels


@pytest.mark.parametrize("side", SIDES)
def test_dex_ycb(tmp_path: Path, model: Path, side: Side) -> None:
    labels = dex_ycb(tmp_path, side)
    assert_asks_for_mano(labels, "coefficients of MANO's principal directions")
    recording = read(labels, model=str(model))
    assert recording.format == "dex-ycb"
    found = hand_of(recording, side)
    assert found.present.tolist() == [False] + [True] * FRAMES
    assert_same_turns(found.hand_pose[1:], HANDS[side].hand_pose)
    assert_same_turns(found.global_orient[1:], HANDS[side].global_orient)
    np.testing.assert_allclose(np.asarray(found.transl)[1:], HANDS[side].transl, atol=1e-6)
    np.testing.assert_allclose(found.betas, HANDS[side].betas)
    assert recording.size == (640, 480)
    assert recording.intrinsics is not None
    assert (recording.intrinsics.fx, recording.intrinsics.cy) == (613.5, 245.0)


def test_dex_ycb_without_a_side(tmp_path: Path, model: Path) -> None:
    labels = dex_ycb(tmp_path, "left")
    (labels.parent / "meta.yml").unlink()
    with pytest.raises(InputError, match=r"do not tell which hand.*meta\.yml"):
        read(labels, model=str(model))
