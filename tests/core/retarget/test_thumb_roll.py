"""Which way a character's thumbnail faces, beside the captured hand's."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from handfit_core.common.skeleton import FINGER_JOINTS, JOINT_NAMES, PARENTS, SIDES, Side
from handfit_core.hand_model import load_model
from handfit_core.hand_model.axes import bone_frames
from handfit_core.retarget.bones import Bones
from handfit_core.retarget.hand_map import USUAL_THUMB_ROLL, HandMap
from handfit_core.retarget.transfer import TargetHand, target_hand

from .rigs import source

THUMB = FINGER_JOINTS["thumb"]
SIDED = {"right": np.ones(3), "left": np.array([-1.0, 1.0, 1.0])}
"""Turns a direction of a right hand into that hand's"""


def nail(side: Side) -> np.ndarray:
    """(3,) where the captured hand's thumbnail faces at rest."""
    return -bone_frames(load_model(None, side).shaped(), side)[THUMB[2]][:, 2]


def off(target: TargetHand, theirs: np.ndarray) -> float:
    """How far a character's nail, which faces `theirs` (3,) at its own rest, is turned from the captured one
    when both hands are flat: degrees, positive towards the back of the hand, on either hand."""
    side, last = target.hand_map.side, target.last("thumb")
    assert last is not None
    along = bone_frames(load_model(None, side).shaped(), side)[THUMB[2]][:, 1]
    shown = target.aligned.T @ target.corrected[last] @ theirs
    turned = np.arctan2(np.cross(nail(side), shown) @ along, nail(side) @ (shown - along * (along @ shown)))
    return float(np.degrees(turned)) * (1.0 if side == "right" else -1.0)


def own_bones(side: Side, moved: dict[int, np.ndarray] | None = None) -> tuple[Bones, HandMap]:
    """A rig with the captured hand's own joints, or others."""
    joints = source(side).joints.copy()
    for joint, place in (moved or {}).items():
        joints[joint] = place
    frames = np.broadcast_to(np.eye(3), (16, 3, 3))
    tips = joints + 0.01
    return (
        Bones(tuple(JOINT_NAMES), np.array(PARENTS), joints, tips, frames),
        HandMap(side, tuple(JOINT_NAMES)),
    )


@pytest.mark.parametrize("side", SIDES)
def test_thumb_roll_sign(side):
    bones, hand_map = own_bones(side)
    back = np.array([0.0, 0.0, 1.0])
    for degrees in (-20.0, 20.0):
        target = target_hand(bones, replace(hand_map, thumb_roll=degrees), source(side))
        assert off(target, nail(side)) == pytest.approx(degrees, abs=0.5)
        last = target.last("thumb")
        assert last is not None
        rise = (target.corrected[last] @ nail(side) - nail(side)) @ back
        assert rise * degrees > 0.0, "the back of the hand is above"
    others = target_hand(bones, replace(hand_map, thumb_roll=30.0), source(side))
    fingers = [k for k, joints in enumerate(others.joints) if not {*joints} & {*THUMB}]
    np.testing.assert_allclose(others.corrected[fingers], target.corrected[fingers])


@pytest.mark.parametrize("side", SIDES)
def test_vrm_thumbs(side):
    """VRM's T-pose has thumbs half forward in the palm's plane, nails square to them in that plane."""
    along, faces = np.array([-1.0, -1.0, 0.0]), np.array([1.0, -1.0, 0.0])
    along, faces = along / np.sqrt(2.0) * SIDED[side], faces / np.sqrt(2.0) * SIDED[side]
    own = source(side).joints
    places = {joint: own[THUMB[0]] + 0.03 * number * along for number, joint in enumerate(THUMB)}
    bones, hand_map = own_bones(side, places)
    bones = replace(bones, tails=bones.heads + 0.03 * along)
    target = target_hand(bones, replace(hand_map, thumb_roll=USUAL_THUMB_ROLL), source(side))
    assert abs(off(target, faces)) < 8.0
    plain = target_hand(bones, hand_map, source(side))
    assert off(plain, faces) < -25.0, "without a roll it would be seen"
