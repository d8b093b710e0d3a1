"""OpenXR's and WebXR's joints, written by the tests from our open hand: axes by the standards' own words."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from handfit_core.errors import InputError
from handfit_core.geometry.rotations import rotmat_to_quat, rotvec_to_rotmat
from handfit_core.hand_model import load_model
from handfit_core.hand_model.data import forward_kinematics
from handfit_core.interchange.opening import read_recording
from handfit_core.interchange.recording import Recording
from handfit_core.options import CaptureOptions
from handfit_core.pipeline import capture
from handfit_core.skeleton import FINGER_JOINTS, FINGERS, SIDES, Side

FRAMES = 4
FLIP = np.diag([1.0, -1.0, -1.0])
WEBXR = [
    "wrist",
    *("thumb-metacarpal", "thumb-phalanx-proximal", "thumb-phalanx-distal", "thumb-tip"),
    *(
        f"{finger}-finger-{part}"
        for finger in ("index", "middle", "ring", "pinky")
        for part in ("metacarpal", "phalanx-proximal", "phalanx-intermediate", "phalanx-distal", "tip")
    ),
]


def truth(side: Side) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(T, 3), (T, 45), (T, 3): a hand that turns and bends."""
    rng = np.random.default_rng(SIDES.index(side))
    place = rng.uniform(-0.05, 0.05, (FRAMES, 3)) + [0.1 if side == "left" else -0.1, 0.0, 0.7]
    return rng.uniform(-2.0, 2.0, (FRAMES, 3)), rng.uniform(-0.6, 0.6, (FRAMES, 45)), place


def joints(side: Side) -> tuple[np.ndarray, np.ndarray]:
    """Where a headset has the 25 joints (T, 25, 3), metres, y up, and their axes (T, 25, 3, 3)."""
    orient, pose, transl = truth(side)
    shaped = load_model(None, side).shaped()
    local = rotvec_to_rotmat(np.concatenate([orient, pose], axis=1).reshape(FRAMES, 16, 3))
    turned, places = forward_kinematics(local, shaped.joints)
    tips = np.stack(
        [
            places[:, FINGER_JOINTS[f][2]]
            + turned[:, FINGER_JOINTS[f][2]] @ (shaped.tips[i] - shaped.joints[FINGER_JOINTS[f][2]])
            for i, f in enumerate(FINGERS)
        ],
        axis=1,
    )
    sign = np.array([-1.0 if side == "left" else 1.0, 1.0, 1.0])
    where = np.empty((FRAMES, 25, 3))
    axes = np.empty((FRAMES, 25, 3, 3))

    def put(at: int, joint: int, place: np.ndarray, along: np.ndarray, up: np.ndarray) -> None:
        z = -along / np.linalg.norm(along)
        y = up - z * (up @ z)
        y /= np.linalg.norm(y)
        flat = np.stack([np.cross(y, z), y, z], axis=-1)
        where[:, at], axes[:, at] = (place + transl) @ FLIP, FLIP @ turned[:, joint] @ flat

    back = np.array([0.0, 1.0, 0.0])
    put(0, 0, places[:, 0], shaped.joints[4] - shaped.joints[0], back)
    at = 1
    for f, finger in enumerate(FINGERS):
        chain = FINGER_JOINTS[finger]
        up = sign if finger == "thumb" else back
        ends = [*(shaped.joints[j] for j in chain), shaped.tips[f]]
        if finger != "thumb":
            step = 0.7 * (ends[0] - shaped.joints[0])
            put(at, 0, places[:, 0] + 0.3 * turned[:, 0] @ step / 0.7, step, back)
            at += 1
        for n, joint in enumerate(chain):
            put(at, joint, places[:, joint], ends[n + 1] - ends[n], up)
            at += 1
        put(at, chain[2], tips[:, f], ends[3] - ends[2], up)
        at += 1
    return where, axes


def xyzw(axes: np.ndarray) -> np.ndarray:
    return np.roll(rotmat_to_quat(axes), -1, axis=-1)


def frames(kind: str = "named") -> Any:
    """Recordings as programs write them."""
    told = {side: joints(side) for side in SIDES}
    out: list[Any] = []
    for row in range(FRAMES):
        hands: dict[str, Any] = {}
        for side in SIDES:
            where, quats = told[side][0][row], xyzw(told[side][1][row])
            if kind == "wxyz":
                quats = np.roll(quats, 1, axis=-1)
            if kind == "flat":
                hands[side] = np.concatenate([where, quats], axis=1).tolist()
            elif kind == "openxr":
                palm = {
                    "pose": {"position": dict.fromkeys("xyz", 0.0), "orientation": dict.fromkeys("xyzw", 0.5)}
                }
                hands[side] = [palm] + [
                    {
                        "pose": {
                            "position": dict(zip("xyz", p, strict=True)),
                            "orientation": dict(zip("xyzw", q, strict=True)),
                        }
                    }
                    for p, q in zip(where.tolist(), quats.tolist(), strict=True)
                ]
            else:
                hands[side] = {
                    name: {"position": p, "quaternion": q, "radius": 0.01}
                    for name, p, q in zip(WEBXR, where.tolist(), quats.tolist(), strict=True)
                }
        if kind == "listed":
            out.append(
                {"hands": [{"handedness": s, "joints": j} for s, j in hands.items()], "timestamp": 20.0 * row}
            )
        else:
            out.append(hands | {"timestamp": 20.0 * row})
    return {"frames": out} if kind != "flat" else out


def read(tmp_path: Path, content: Any) -> Recording:
    path = tmp_path / "hands.json"
    path.write_text(json.dumps(content), encoding="utf-8")
    return read_recording(path, CaptureOptions())


@pytest.mark.parametrize("kind", ["named", "listed", "flat", "openxr", "wxyz"])
def test_angles_come_back(tmp_path: Path, kind: str) -> None:
    recording = read(tmp_path, frames(kind))
    assert recording.format == "hand-tracking"
    assert recording.fps == pytest.approx(50.0)
    assert any("w, x, y, z" in phrase for phrase in recording.assumed) == (kind == "wxyz")
    for hand in recording.posed:
        orient, pose, transl = truth(hand.side)
        for found, true in ((hand.hand_pose, pose), (hand.global_orient, orient)):
            ours, theirs = (rotvec_to_rotmat(np.reshape(x, (-1, 3))) for x in (found, true))
            np.testing.assert_allclose(ours, theirs, atol=1e-5)
        assert np.abs(hand.transl - transl).max() < 1e-4


def test_a_take_of_them(tmp_path: Path) -> None:
    (tmp_path / "a.json").write_text(json.dumps(frames()), encoding="utf-8")
    take = capture(tmp_path / "a.json")
    assert sorted(hand.side for hand in take.hands) == ["left", "right"]


def test_frames_without_a_hand_and_untracked_joints(tmp_path: Path) -> None:
    content = frames()
    del content["frames"][1]["left"]
    content["frames"][2]["left"]["index-finger-phalanx-distal"] = None
    left = next(hand for hand in read(tmp_path, content).posed if hand.side == "left")
    assert left.present.tolist() == [True, False, False, True]


def changed(name: str, joint: Any) -> Any:
    content = frames()
    for frame in content["frames"]:
        frame["right"][name] = joint
    return content


def without(name: str) -> Any:
    content = frames()
    for frame in content["frames"]:
        for side in SIDES:
            del frame[side][name]
    return content


def in_millimetres() -> Any:
    content = frames()
    for frame in content["frames"]:
        for side in SIDES:
            for joint in frame[side].values():
                joint["position"] = [1000.0 * x for x in joint["position"]]
    return content


def turned_by_a_quarter() -> Any:
    """As of a program whose bones lie along +X."""
    content = frames()
    quarter = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
    for side in SIDES:
        for row, axes in enumerate(xyzw(joints(side)[1] @ quarter).tolist()):
            for name, quat in zip(WEBXR, axes, strict=True):
                content["frames"][row][side][name]["quaternion"] = quat
    return content


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (lambda: changed("thumb-tip", [1.0, 2.0]), "x, y, z and a quaternion"),
        (lambda: changed("thumb-tip", {"position": [0, 0, "a"], "quaternion": [0, 0, 0, 1]}), "thumbtip"),
        (lambda: changed("thumb-tip", {"position": [0, 0, 1e300], "quaternion": [0, 0, 0, 1]}), "beyond"),
        (lambda: changed("ring-finger-phalanx-distal", None), None),
        (lambda: without("middle-finger-phalanx-proximal"), "lacks joints"),
        (in_millimetres, "expected metres"),
        (turned_by_a_quarter, "past the next joint"),
    ],
)
def test_bad_files_are_named_in_a_sentence(tmp_path: Path, content: Any, words: str | None) -> None:
    with pytest.raises(InputError, match=words or "lacks joints"):
        read(tmp_path, content())


def test_a_second_hand_of_a_side_is_left_out_and_said(tmp_path: Path) -> None:
    """Not a joint of it gets into the first one's."""
    content = frames("listed")
    told = read(tmp_path, content)
    assert not any("several" in phrase for phrase in told.assumed)
    for frame in content["frames"][:2]:
        frame["hands"].append({"handedness": "right", "joints": frame["hands"][0]["joints"]})
    recording = read(tmp_path, content)
    assert "2 frames have several right hands: the first was taken" in recording.assumed
    for hand, alone in zip(recording.posed, told.posed, strict=True):
        np.testing.assert_array_equal(hand.hand_pose, alone.hand_pose)
