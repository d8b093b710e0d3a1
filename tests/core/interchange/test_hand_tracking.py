"""OpenXR's and WebXR's joints, written by the tests from our open hand: axes by the standards' own words."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from handfit_core.errors import InputError
from handfit_core.geometry.rotations import quat_to_rotmat, rotmat_to_quat, rotvec_to_rotmat
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


def frames(kind: str = "named") -> Any:
    """Recordings as programs write them."""
    told = {side: joints(side) for side in SIDES}
    out: list[Any] = []
    for row in range(FRAMES):
        hands: dict[str, Any] = {}
        for side, (places, axes) in told.items():
            where, quats = (
                places[row],
                np.roll(rotmat_to_quat(axes[row]), 0 if kind == "wxyz" else -1, axis=-1),
            )
            each = list(zip(where.tolist(), quats.tolist(), strict=True))
            if kind == "flat":
                hands[side] = [[*p, *q] for p, q in each]
            elif kind == "openxr":
                palm = [0.0] * 3, [0.5] * 4
                hands[side] = [
                    {"pose": {"position": dict(zip("xyz", p)), "orientation": dict(zip("xyzw", q))}}  # noqa: B905
                    for p, q in [palm, *each]
                ]
            else:
                values = [{"position": p, "quaternion": q, "radius": 0.01} for p, q in each]
                hands[side] = dict(zip(WEBXR, values, strict=True))
        if kind == "listed":
            hands = {"hands": [{"handedness": s, "joints": j} for s, j in hands.items()]}
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
    assert sorted(hand.side for hand in capture(tmp_path / "a.json").hands) == ["left", "right"]


def test_frames_without_a_hand_and_untracked_joints(tmp_path: Path) -> None:
    content = frames()
    del content["frames"][1]["left"]
    content["frames"][2]["left"]["index-finger-phalanx-distal"] = None
    left = next(hand for hand in read(tmp_path, content).posed if hand.side == "left")
    assert left.present.tolist() == [True, False, False, True]


QUARTER = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
"""Turns the bones of a hand along +X, as some programs have them"""


def turned(joint: dict[str, Any]) -> dict[str, Any]:
    x, y, z, w = joint["quaternion"]
    axes = rotmat_to_quat(quat_to_rotmat(np.array([w, x, y, z])) @ QUARTER)
    return joint | {"quaternion": np.roll(axes, -1).tolist()}


@pytest.mark.parametrize(
    ("which", "change", "words"),
    [
        ("thumb-tip", lambda _: [1.0, 2.0], "x, y, z and a quaternion"),
        ("thumb-tip", lambda joint: joint | {"position": [0, 0, "a"]}, "thumbtip"),
        ("thumb-tip", lambda joint: joint | {"position": [0, 0, 1e300]}, "beyond"),
        ("ring-finger-phalanx-distal", lambda _: None, "lacks joints"),
        ("middle-finger-phalanx-proximal", None, "lacks joints"),
        ("", lambda joint: joint | {"position": [1000.0 * x for x in joint["position"]]}, "expected metres"),
        ("", turned, "past the next joint"),
    ],
)
def test_bad_files_are_named_in_a_sentence(tmp_path: Path, which: str, change: Any, words: str) -> None:
    content = frames()
    for hand in (frame[side] for frame in content["frames"] for side in SIDES):
        for name in [name for name in hand if which in name]:
            joint = hand.pop(name)
            if change is not None:
                hand[name] = change(joint)
    with pytest.raises(InputError, match=words):
        read(tmp_path, content)


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
