"""OpenXR's and WebXR's joints, written by the tests from our open hand: axes by the standards' own words."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from handfit_core.capturing.pipeline import capture
from handfit_core.common.errors import InputError
from handfit_core.common.skeleton import FINGER_JOINTS, FINGERS, SIDES, Side
from handfit_core.geometry.rotations import quat_to_rotmat, rotmat_to_quat
from handfit_core.hand_model import load_model
from handfit_core.hand_model.data import forward_kinematics
from tests.core.interchange.known_hands import (
    FRAMES,
    HANDS,
    assert_same_hand,
    hand_of,
    joints_turned,
    read,
    says,
)
from tests.core.interchange.point_files import saved

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


def joints(side: Side) -> tuple[np.ndarray, np.ndarray]:
    """Where a headset has the 25 joints (T, 25, 3), metres, y up, and their axes (T, 25, 3, 3)."""
    hand, shaped = HANDS[side], load_model(None, side).shaped()
    turned, places = forward_kinematics(joints_turned(hand), shaped.joints)
    last = [FINGER_JOINTS[finger][2] for finger in FINGERS]
    tips = places[:, last] + (turned[:, last] @ (shaped.tips - shaped.joints[last])[..., None])[..., 0]
    sign = np.array([-1.0 if side == "left" else 1.0, 1.0, 1.0])
    where = np.empty((FRAMES, 25, 3))
    axes = np.empty((FRAMES, 25, 3, 3))

    def put(at: int, joint: int, place: np.ndarray, along: np.ndarray, up: np.ndarray) -> None:
        z = -along / np.linalg.norm(along)
        y = up - z * (up @ z)
        y /= np.linalg.norm(y)
        flat = np.stack([np.cross(y, z), y, z], axis=-1)
        where[:, at], axes[:, at] = (place + hand.transl) @ FLIP, FLIP @ turned[:, joint] @ flat

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
            quats = np.roll(rotmat_to_quat(axes[row]), 0 if kind == "wxyz" else -1, axis=-1)
            each = list(zip(places[row].tolist(), quats.tolist(), strict=True))
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


@pytest.mark.parametrize("kind", ["named", "listed", "flat", "openxr", "wxyz"])
def test_angles_come_back(tmp_path: Path, kind: str) -> None:
    recording = read(saved(tmp_path / "a.json", frames(kind)))
    assert recording.format == "hand-tracking"
    assert recording.fps == pytest.approx(50.0)
    assert says(recording, "w, x, y, z") == (kind == "wxyz")
    for side in SIDES:
        assert_same_hand(hand_of(recording, side), HANDS[side])


def test_frames_without_a_hand_and_untracked_joints(tmp_path: Path) -> None:
    content = frames()
    del content["frames"][1]["left"]
    content["frames"][2]["left"]["index-finger-phalanx-distal"] = None
    path = saved(tmp_path / "a.json", content)
    assert hand_of(read(path), "left").present.tolist() == [True, False, False, *[True] * 4]
    assert sorted(hand.side for hand in capture(path).hands) == ["left", "right"]


QUARTER = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
"""Turns the bones of a hand along +X, as some programs have them"""


def turned(joint: dict[str, Any]) -> dict[str, Any]:
    x, y, z, w = joint["quaternion"]
    axes = rotmat_to_quat(quat_to_rotmat(np.array([w, x, y, z])) @ QUARTER)
    return joint | {"quaternion": np.roll(axes, -1).tolist()}


@pytest.mark.parametrize(
    ("which", "change", "words"),
    [
        ("thumb-tip", lambda _: [1.0, 2.0], "a point of 2 numbers; expected xyz or xyzijkw"),
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
        read(saved(tmp_path / "a.json", content))
