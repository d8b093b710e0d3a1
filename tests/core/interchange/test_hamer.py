"""HaMeR's, WiLoR's and WiLoR-mini's hands: matrices of mirrored crops, axis-angle that is mirrored back."""

from __future__ import annotations

import json
import os
import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from handfit_core.errors import InputError, OptionError
from handfit_core.geometry.camera import Intrinsics
from handfit_core.pipeline import capture
from handfit_core.skeleton import SIDES, Side
from handfit_core.take import Take
from tests.conftest import ROOT
from tests.core.interchange.known_hands import (
    FRAMES,
    HANDS,
    assert_same_hand,
    assert_same_turns,
    hand_of,
    known_hand,
    matrices,
    own_mano,
    read,
    says,
)

FOCAL = 5000.0 / 256.0 * 1280.0


def network(frame: int, sides: tuple[Side, ...] = SIDES) -> dict[str, Any]:
    """What HaMeR's network gives for the hands of one picture, and what its demo works out of it."""
    rows = []
    for side in sides:
        hand = HANDS[side]
        orient, pose = hand.mirrored if side == "left" else (hand.global_orient, hand.hand_pose)
        rows.append((matrices(orient)[frame], matrices(pose)[frame], hand.betas, hand.transl[frame]))
    orient, pose, betas, transl = (np.stack(column) for column in zip(*rows, strict=True))
    return {
        "pred_mano_params": {"global_orient": orient, "hand_pose": pose, "betas": betas},
        "pred_cam_t_full": transl,
        "right": np.array([float(side == "right") for side in sides]),
        "pred_cam_t": np.full((len(sides), 3), 9.0),
    }


def mini(frame: int) -> list[dict[str, Any]]:
    """What WiLoR-mini's pipeline gives for one picture."""
    return [
        {
            "hand_bbox": [0.0, 0.0, 10.0, 10.0],
            "is_right": float(side == "right"),
            "wilor_preds": {
                "global_orient": hand.global_orient[frame].reshape(1, 1, 3),
                "hand_pose": hand.hand_pose[frame].reshape(1, 15, 3),
                "betas": hand.betas.reshape(1, 10),
                "pred_cam_t_full": hand.transl[frame].reshape(1, 3),
                "scaled_focal_length": FOCAL,
                "pred_keypoints_2d": np.zeros((1, 21, 2)),
            },
        }
        for side, hand in HANDS.items()
    ]


def listed(value: Any) -> Any:
    """With lists instead of arrays."""
    if isinstance(value, dict):
        return {key: listed(each) for key, each in value.items()}
    if isinstance(value, list):
        return [listed(each) for each in value]
    return value.tolist() if isinstance(value, np.ndarray) else value


def in_files(folder: Path, kind: str) -> Path:
    """HaMeR's hands of all frames, as users keep them."""
    frames = [network(frame) for frame in range(FRAMES)]
    folder.mkdir()
    if kind == "npz a picture":
        for number, values in enumerate(frames, 1):
            plain = {key: value for key, value in values.items() if key != "pred_mano_params"}
            np.savez(folder / f"frame_{number:05}.npz", **values["pred_mano_params"], **plain)
    elif kind == "npz of objects a hand":
        for number, values in enumerate(frames, 1):
            for row in range(2):
                one = {k: v[row] for k, v in values.items() if isinstance(v, np.ndarray)}
                one["pred_mano_params"] = {k: v[row] for k, v in values["pred_mano_params"].items()}
                np.savez(folder / f"{number:06}_{row}.npz", **one)
    elif kind == "JSON by picture":
        content = {f"img_{number:04}.jpg": listed(values) for number, values in enumerate(frames, 1)}
        (folder / "hamer.json").write_text(json.dumps(content), encoding="utf-8")
        return folder / "hamer.json"
    elif kind == "pickle by frame":
        content = dict(enumerate(frames, 1))
        (folder / "hamer.pkl").write_bytes(pickle.dumps(content))
        return folder / "hamer.pkl"
    elif kind == "npy of a dictionary":
        np.save(folder / "hamer.npy", {f"{n:05}": v for n, v in enumerate(frames, 1)}, allow_pickle=True)
        return folder / "hamer.npy"
    elif kind == "rows with frames":
        joined = {key: np.concatenate([v[key] for v in frames]) for key in ("right", "pred_cam_t_full")}
        for key in ("global_orient", "hand_pose", "betas"):
            joined[f"pred_mano_params.{key}"] = np.concatenate([v["pred_mano_params"][key] for v in frames])
        joined["frame"] = np.repeat(np.arange(1, FRAMES + 1), 2)
        np.savez(folder / "hamer.npz", **joined)
        return folder / "hamer.npz"
    return folder


KINDS = [
    "npz a picture",
    "npz of objects a hand",
    "JSON by picture",
    "pickle by frame",
    "npy of a dictionary",
    "rows with frames",
]


@pytest.mark.parametrize("kind", KINDS)
def test_hamers_matrices(tmp_path: Path, kind: str) -> None:
    recording = read(in_files(tmp_path / "dump", kind), picture_size=(1280, 720))
    assert recording.format == "hamer"
    assert recording.frame_numbers.tolist() == list(range(1, FRAMES + 1))
    for side in SIDES:
        assert_same_hand(hand_of(recording, side), HANDS[side])
    assert recording.intrinsics is not None
    assert recording.intrinsics.fx == pytest.approx(FOCAL)
    assert (recording.intrinsics.cx, recording.intrinsics.cy) == (640.0, 360.0)
    assert says(recording, "mirrored crop")
    assert says(recording, "shapes (betas) are MANO's")
    assert says(recording, "frames per second")


@pytest.mark.parametrize("kind", ["json", "pkl", "folder"])
def test_wilor_minis_axis_angle(tmp_path: Path, kind: str) -> None:
    frames = [mini(frame) for frame in range(FRAMES)]
    path = tmp_path / f"wilor.{kind}"
    if kind == "json":
        path.write_text(json.dumps(listed(frames)), encoding="utf-8")
    elif kind == "pkl":
        path.write_bytes(pickle.dumps(frames))
    else:
        path.mkdir()
        for number, hands in enumerate(frames, 1):
            (path / f"{number:03}.json").write_text(json.dumps(listed(hands)), encoding="utf-8")
    recording = read(path, picture_size=(1280, 720))
    assert recording.format == "wilor-mini"
    for side in SIDES:
        assert_same_hand(hand_of(recording, side), HANDS[side])
    assert recording.intrinsics is not None
    assert recording.intrinsics.fx == pytest.approx(FOCAL)
    assert says(recording, "left ones already")


def test_a_missing_mirror_is_noticed(tmp_path: Path) -> None:
    """Left hands that are read with the other convention bend backwards, and the right reader is named."""
    dump = in_files(tmp_path / "dump", "rows with frames")
    wrong = read(dump, reader="wilor-mini")
    assert says(
        wrong, "the left hand's fingers bend further back than fingers can, as if a mirror were missing"
    )
    assert says(wrong, "--reader hamer")
    assert not says(read(dump), "bend further")
    assert_same_hand(hand_of(wrong, "right"), HANDS["right"])


def test_a_missing_mean_is_noticed(tmp_path: Path) -> None:
    """Nearly flat hands that count from the mean pose bend backwards."""
    model = own_mano(tmp_path / "mano")
    mean = strong_mean()
    flat = known_hand("right", bend=(0.0, 10.0))
    orient, pose = matrices(flat.global_orient), matrices(flat.hand_pose - mean)
    path = tmp_path / "hands.npz"
    np.savez(path, global_orient=orient, hand_pose=pose, right=np.ones(FRAMES), pred_cam_t_full=flat.transl)
    assert says(read(path), "--hand-mean mean")
    with pytest.raises(OptionError, match="give your own MANO"):
        read(path, hand_mean="mean")
    twice = tmp_path / "twice.npz"
    bent = known_hand("right", bend=(80.0, 95.0))
    np.savez(twice, global_orient=orient, hand_pose=matrices(bent.hand_pose + mean), right=np.ones(FRAMES))
    assert says(read(twice), "--hand-mean flat")
    added = read(path, hand_mean="mean", model=str(model))
    assert not np.allclose(hand_of(added, "right").hand_pose, flat.hand_pose - mean)


def strong_mean() -> np.ndarray:
    """(45,) the open hand's mean pose."""
    from handfit_core.hand_model import load_model

    return load_model(None, "right").hands_mean


def test_rows_of_one_side_are_frames(tmp_path: Path) -> None:
    hand = HANDS["right"]
    path = tmp_path / "rows.npz"
    arrays = {"global_orient": hand.matrices[:, :1], "hand_pose": hand.matrices[:, 1:]}
    np.savez(path, **arrays, right=np.ones(FRAMES), pred_cam_t_full=hand.transl)
    recording = read(path)
    assert_same_hand(hand_of(recording, "right"), hand)
    assert says(recording, "one hand's frames")


def test_two_persons_are_followed(tmp_path: Path) -> None:
    """Rows in another order in each picture; hands are told apart by where they are."""
    first, second = HANDS["right"], known_hand("right", 5)
    away = second.transl + [0.5, 0.0, 0.2]
    folder = tmp_path / "two"
    folder.mkdir()
    for frame in range(FRAMES):
        rows = [(first, first.transl), (second, away)]
        rows = rows[:: 1 if frame % 2 else -1]
        np.savez(
            folder / f"{frame + 1}.npz",
            global_orient=np.stack([hand.matrices[frame, :1] for hand, _ in rows]),
            hand_pose=np.stack([hand.matrices[frame, 1:] for hand, _ in rows]),
            pred_cam_t_full=np.stack([place[frame] for _, place in rows]),
            right=np.ones(2),
        )
    recording = read(folder)
    assert len(recording.posed) == 2
    by_x = sorted(recording.posed, key=lambda hand: float(np.asarray(hand.transl)[0, 0]))
    for found, hand in zip(by_x, (first, second), strict=True):
        assert_same_turns(found.hand_pose, hand.hand_pose)
    (one,) = read(folder, person=2).posed
    assert one.hand_pose.shape == (FRAMES, 45)
    with pytest.raises(InputError, match="no person 3: it has 2"):
        read(folder, person=3)


NAMED: list[tuple[str, list[int], str]] = [
    ("take2_{frame:04}", [1, 2, 3], ""),
    ("frame_{frame:04}_hand_{hand}", [1, 2, 3], "the hands', as in frame_0001_hand_0"),
    ("2024-05-17_{frame}", [1, 2, 3], "the frames', as in 2024-05-17_1"),
    ("img_{frame:03}_{hand}_mano2", [], "several clips"),
    ("img_{frame:03}_mano2", [1, 2, 3], "the hands'"),
    (
        "take{hand}_{frame:04}",
        [],
        r"several clips \(take0_\.\. and take1_\.\., for example\).*frame_0001_0 with",
    ),
]


@pytest.mark.parametrize("kind", ["folder", "keys"])
@pytest.mark.parametrize(("name", "frames", "said"), NAMED, ids=[each[0] for each in NAMED])
def test_frames_by_their_names(tmp_path: Path, kind: str, name: str, frames: list[int], said: str) -> None:
    """The last number is the frame's, or the hand's where the names differ in the one before it, too."""
    content: dict[str, Any] = {}
    for frame in range(3):
        values = network(frame)
        for row in range(2):
            one: dict[str, Any] = {
                k: v[row : row + 1] for k, v in values.items() if isinstance(v, np.ndarray)
            }
            one["pred_mano_params"] = {k: v[row : row + 1] for k, v in values["pred_mano_params"].items()}
            content.setdefault(name.format(frame=frame + 1, hand=row), []).append(one)
    if kind == "keys":
        path = tmp_path / "hands.json"
        path.write_text(json.dumps(listed(content)), encoding="utf-8")
    else:
        path = tmp_path / "folder"
        path.mkdir()
        for called, hands in content.items():
            (path / f"{called}.json").write_text(json.dumps(listed(hands)), encoding="utf-8")
    if not frames:
        with pytest.raises(InputError, match=said):
            read(path)
        return
    recording = read(path)
    assert recording.frame_numbers.tolist() == frames
    assert [hand.present.tolist() for hand in recording.posed] == [[True] * 3] * 2
    assert any("the last numbers" in phrase for phrase in recording.assumed) == bool(said)
    assert said in " ".join(recording.assumed)


def test_points_beside_hands_are_passed_over(tmp_path: Path) -> None:
    """HaMeR's demo keeps such arrays beside its pictures."""
    folder = in_files(tmp_path / "dump", "npz of objects a hand")
    np.save(folder / "000001_0_3dkeypoints.npy", np.zeros((1, 21, 3)))
    assert read(folder).frame_numbers.tolist() == list(range(1, FRAMES + 1))


def test_the_focal_length_of_a_crop_is_not_the_pictures(tmp_path: Path) -> None:
    """HaMeR's and WiLoR's own output has 5000 pixels for the crop of 256, whatever the picture is."""
    frames = {f"{n:04}": {**network(n), "focal_length": np.full((2, 2), 5000.0)} for n in range(FRAMES)}
    path = tmp_path / "hamer.json"
    path.write_text(json.dumps(listed(frames)), encoding="utf-8")
    camera = read(path, picture_size=(1280, 720)).intrinsics
    assert camera is not None
    assert camera.fx == pytest.approx(FOCAL)
    for values in frames.values():
        values["scaled_focal_length"] = 900.0
    path.write_text(json.dumps(listed(frames)), encoding="utf-8")
    camera = read(path, picture_size=(1280, 720)).intrinsics
    assert camera is not None
    assert camera.fx == 900.0


def test_betas_fit_the_users_mano(tmp_path: Path) -> None:
    model = own_mano(tmp_path / "mano")
    recording = read(in_files(tmp_path / "dump", "JSON by picture"), model=str(model))
    np.testing.assert_allclose(hand_of(recording, "left").betas, HANDS["left"].betas, atol=1e-6)
    assert not says(recording, "betas")


def test_a_take_is_made_of_it(tmp_path: Path) -> None:
    path = in_files(tmp_path / "dump", "rows with frames")
    take = capture(path, picture_size=(1280, 720), fps=25)
    assert [hand.side for hand in take.hands] == ["left", "right"]
    assert (take.fps, take.solver, take.width) == (25.0, "hamer", 1280)
    assert take.program == Take.from_bytes(take.to_bytes()).program == "HaMeR or WiLoR"
    assert take.intrinsics.fx == pytest.approx(FOCAL)
    np.testing.assert_allclose(take.hands[1].transl, HANDS["right"].transl, atol=1e-6)


def test_beside_its_pictures(tmp_path: Path) -> None:
    """The pictures tell the size, and the take's camera is the network's: hands lie over them so."""
    pictures = ROOT / "samples" / "rendered_hand"
    dump = in_files(tmp_path / "dump", KINDS[-1])
    take = capture(pictures, keypoints=dump)
    assert take.source.kind == "sequence"
    focal = 5000.0 / 256.0 * max(take.width, take.height)
    assert take.intrinsics == Intrinsics(focal, focal, take.width / 2.0, take.height / 2.0)
    assert [int(hand.present.sum()) for hand in take.hands] == [FRAMES, FRAMES]
    assert capture(pictures, keypoints=dump, lens=(1.0, 0.5, 0.5)).intrinsics.fx == take.width


def bad(**changes: Any) -> dict[str, Any]:
    hand = HANDS["right"]
    values = {"global_orient": hand.matrices[:, :1], "hand_pose": hand.matrices[:, 1:]}
    return {**values, "right": np.ones(FRAMES), "pred_cam_t_full": hand.transl, **changes}


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"right": np.ones(FRAMES - 1)}, "rows where 6 are expected"),
        ({"right": np.full(FRAMES, 2.0)}, "right must be 1"),
        ({"global_orient": 2.0 * HANDS["right"].matrices[:, :1]}, "no rotations"),
        ({"pred_cam_t_full": np.zeros((3, 3))}, "pred_cam_t_full has 3 rows"),
        ({"hand_pose": np.degrees(HANDS["right"].hand_pose)}, "degrees"),
        ({"hand_pose": HANDS["right"].matrices[:, :15, :2]}, "shape Nx45"),
        ({"pred_cam_t_full": np.full((FRAMES, 3), 1e12)}, "beyond"),
        ({"pred_cam_t_full": np.full((FRAMES, 3), np.nan)}, "no hand"),
        ({"frame": np.full(FRAMES, 0.5)}, "whole numbers"),
    ],
    ids=["rows", "sides", "scaled", "places", "degrees", "shape", "huge", "NaN", "frames"],
)
def test_what_is_wrong_is_said(tmp_path: Path, changes: dict[str, Any], said: str) -> None:
    path = tmp_path / "bad.npz"
    np.savez(path, **bad(**changes))
    with pytest.raises(InputError, match=said) as caught:
        read(path)
    assert "\n" not in str(caught.value)


def test_pickles_that_run_something_are_refused(tmp_path: Path) -> None:
    class Runs:
        def __reduce__(self) -> Any:
            return os.system, ("true",)

    path = tmp_path / "hamer.pkl"
    path.write_bytes(pickle.dumps({"right": Runs(), "hand_pose": 1, "global_orient": 1}))
    with pytest.raises(InputError, match=r"asks to run \w+\.system; such files are not read"):
        read(path)
