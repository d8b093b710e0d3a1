"""A captured arm on arms of other proportions and rest poses, and what keeps a hand out of a body."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from handfit_core.common.skeleton import SIDES, Side
from handfit_core.geometry.camera import Intrinsics
from handfit_core.geometry.rotations import rotmat_to_rotvec, rotvec_to_rotmat, swings
from handfit_core.retarget.arms import (
    Capsules,
    CapturedArm,
    TargetArm,
    kept_outside,
    swivel_angles,
    target_arm,
)
from handfit_core.retarget.bones import Bones
from handfit_core.retarget.recognition import named_arm
from tests.takes import take_of, track_of, with_arms

DOWN = {"T": 0.0, "A": 45.0, "bent": 30.0}
"""degrees below the horizontal of arms at rest"""


def body(pose: str = "T", twists: bool = False, turn: np.ndarray | None = None, scale: float = 1.0) -> Bones:
    """A character that faces -Y, with clavicles, perhaps twist bones in the arms' own line."""
    names, parents, heads = ["root", "spine", "chest"], [-1, 0, 1], [[0, 0, 0], [0, 0, 1.0], [0, 0, 1.3]]

    def add(name: str, parent: int, head) -> int:
        names.append(name)
        parents.append(parent)
        heads.append(head)
        return len(names) - 1

    for side in SIDES:
        sign = 1.0 if side == "left" else -1.0
        down = np.radians(DOWN[pose])
        upper = np.array([sign * np.cos(down), 0.0, -np.sin(down)])
        fore = upper + (np.array([0.0, -0.6, 0.1]) if pose == "bent" else 0.0)
        fore = fore / np.linalg.norm(fore)
        shoulder = np.array([sign * 0.18, 0.02, 1.4])
        elbow = shoulder + 0.31 * upper
        last = add(f"{side} arm", add(f"{side} clavicle", 2, [sign * 0.03, 0.0, 1.38]), shoulder)
        last = add(f"{side} arm twist", last, 0.5 * (shoulder + elbow)) if twists else last
        last = add(f"{side} forearm", last, elbow)
        last = add(f"{side} forearm twist", last, elbow + 0.12 * fore) if twists else last
        add(f"{side} hand", last, elbow + 0.22 * fore)
    turn = np.eye(3) if turn is None else turn
    points = scale * np.array(heads, dtype=float) @ turn.T
    count, rng = len(names), np.random.default_rng(3)
    frames = rotvec_to_rotmat(rng.normal(size=(count, 3)))
    return Bones(tuple(names), np.array(parents), points, points + 0.01, frames, np.ones(count, dtype=bool))


def arm(side: Side, *args, **fields) -> TargetArm:
    other = "right" if side == "left" else "left"
    found = target_arm(body(*args, **fields), side, f"{side} hand", f"{other} hand", np.eye(3))
    assert found is not None
    return found


def directions(count: int = 40, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Upper arms and forearms that are bent by 30 to 130 degrees."""
    rng = np.random.default_rng(seed)
    upper = rng.normal(size=(count, 3))
    upper /= np.linalg.norm(upper, axis=-1, keepdims=True)
    axis = np.cross(upper, rng.normal(size=(count, 3)))
    axis /= np.linalg.norm(axis, axis=-1, keepdims=True)
    turn = rotvec_to_rotmat(np.radians(rng.uniform(30, 130, (count, 1))) * axis)
    return upper, (turn @ upper[..., None])[..., 0]


@pytest.mark.parametrize(
    ("chain", "wanted"),
    [
        ("mixamorig:LeftForeArm mixamorig:LeftArm mixamorig:LeftShoulder mixamorig:Spine2", (1, 0)),
        ("DEF-forearm.L.001 DEF-forearm.L DEF-upper_arm.L.001 DEF-upper_arm.L ORG-shoulder.L", (3, 1)),
        ("lowerarm_l upperarm_l clavicle_l spine_05", (1, 0)),
        ("lowerarm02.L lowerarm01.L upperarm02.L upperarm01.L shoulder01.L clavicle.L", (3, 1)),
        ("J_Bip_L_LowerArm J_Bip_L_UpperArm J_Bip_L_Shoulder", (1, 0)),
        ("左手捩 左ひじ 左腕捩 左腕 左肩 上半身2", (3, 1)),
        ("lForearmTwist lForearmBend lShldrTwist lShldrBend lCollar", (3, 1)),
        ("left_elbow left_shoulder left_collar spine3", (1, 0)),
        ("Left_elbow Left_arm Left_shoulder Chest", (1, 0)),
        ("Bip01_L_ForeTwist Bip01_L_Forearm Bip01_L_UpperArm Bip01_L_Clavicle", (2, 1)),
        ("Elbow_L Shoulder_L Scapula_L Chest_M", (1, 0)),
        ("spine hips", None),
    ],
)
def test_arms_are_known_by_their_names(chain, wanted):
    assert named_arm(chain.split()) == wanted


def test_an_arm_without_names_is_found_by_its_lengths():
    plain = body("A")
    nameless = replace(plain, names=tuple(f"b{i}" for i in range(len(plain.names))))
    hand, other = (f"b{plain.index[f'{side} hand']}" for side in SIDES)
    found = target_arm(nameless, "left", hand, other, np.eye(3))
    assert found is not None
    wanted = [f"b{plain.index[name]}" for name in ("left arm", "left forearm")]
    assert list(found.bones) == wanted


TURN = rotvec_to_rotmat(np.array([np.pi / 2, 0.0, 0.0]))


@pytest.mark.parametrize("side", SIDES)
@pytest.mark.parametrize("pose", DOWN)
@pytest.mark.parametrize("fields", [{}, {"twists": True}, {"turn": TURN, "scale": 100.0}])
def test_an_arm_is_found_and_points_as_captured(side, pose, fields):
    """Whatever the rest pose, and also where the armature's own Y is up."""
    found = arm(side, pose, **fields)
    assert found.bones == (f"{side} arm", f"{side} forearm")
    assert found.chest == "chest"
    np.testing.assert_allclose(found.body, fields.get("turn", np.eye(3)), atol=1e-9)
    upper, fore = directions()
    hands = rotvec_to_rotmat(np.random.default_rng(1).normal(size=(len(upper), 3)))
    turns = found.turned(upper, fore, hands)
    for part, wanted in enumerate((upper, fore)):
        np.testing.assert_allclose(turns[:, part] @ found.rest[part], wanted, atol=1e-9)
    # The elbow bends about the axis that it has at rest: it is no ball joint.
    hinge = turns[:, 0] @ found.hinge
    np.testing.assert_allclose(np.sum(hinge * upper, axis=-1), 0.0, atol=1e-9)
    np.testing.assert_allclose(np.abs(np.sum(hinge * fore, axis=-1)), 0.0, atol=1e-9)
    assert (np.sum(np.cross(upper, fore) * hinge, axis=-1) > 0.0).all()


def test_the_forearm_takes_a_part_of_the_hands_twist():
    found, (upper, fore) = arm("left"), directions(1)
    plain = found.turned(upper, fore, np.eye(3)[None])[:, 1]
    for degrees in (-80.0, 60.0):
        # Relative to the forearm without any twist of the hand.
        level = found.turned(upper, fore, plain)[:, 1]
        level = found.turned(upper, fore, level)[:, 1]
        twisted = found.turned(upper, fore, rotvec_to_rotmat(np.radians(degrees) * fore) @ level)[:, 1]
        share = np.degrees(rotmat_to_rotvec(twisted @ np.swapaxes(level, -1, -2)) @ fore[0])[0] / degrees
        assert 0.2 < share < 0.55


def test_straight_arms_turn_smoothly():
    """An elbow that passes through straight does not flip over."""
    found, bends = arm("left"), np.radians(np.linspace(40.0, 0.0, 200))
    upper = np.tile(found.rest[0], (200, 1))
    fore = np.stack([np.cos(bends), -0.6 * np.sin(bends), 0.8 * np.sin(bends)], axis=-1)
    turns = found.turned(upper, fore, np.tile(np.eye(3), (200, 1, 1)))[:, 0]
    steps = np.linalg.norm(rotmat_to_rotvec(turns[1:] @ np.swapaxes(turns[:-1], -1, -2)), axis=-1)
    assert np.degrees(steps.max()) < 3.0


def test_a_wrist_is_reached_with_the_elbow_on_its_side():
    found, (upper, fore) = arm("right", "bent"), directions()
    wrist, normals = found.wrist_at(upper, fore), found.normals(upper, fore)
    for ours, wanted in zip(found.reaching(wrist, normals), (upper, fore), strict=True):
        np.testing.assert_allclose(ours, wanted, atol=1e-6)
    moved = wrist + 0.05 * np.random.default_rng(2).normal(size=wrist.shape)
    new = found.reaching(moved, normals)
    reached = np.linalg.norm(moved, axis=-1) < 0.99 * found.lengths.sum()
    reached &= np.linalg.norm(moved, axis=-1) > 1.02 * abs(np.subtract(*found.lengths))
    assert reached.sum() > 20
    np.testing.assert_allclose(found.wrist_at(*new)[reached], moved[reached], atol=1e-6)
    assert (np.sum(found.normals(*new) * normals, axis=-1)[reached] > 0.5).all()
    far = found.reaching(10.0 * wrist, normals)
    assert np.abs(far[0] - far[1]).max() < 0.05
    assert np.isfinite(far).all()


def test_ik_that_goes_the_shortest_way_ends_with_the_wanted_elbow():
    found, (upper, fore) = arm("left", "bent"), directions()
    along = found.wrist_at(upper, fore)
    along /= np.linalg.norm(along, axis=-1, keepdims=True)
    rest = found.joints[2] - found.joints[0]
    start = swings(rest / np.linalg.norm(rest), along)
    normals = found.normals(upper, fore)
    # The bone's own Y is along the upper arm.
    axes = swings(np.array([0.0, 1.0, 0.0]), found.rest[:1])[0]
    angles = swivel_angles(start @ axes, axes.T @ found.hinge, axes.T @ rest, along, normals)
    turned = start @ axes @ rotvec_to_rotmat(angles[:, None] * [0.0, 1.0, 0.0]) @ axes.T
    wrist = (turned @ rest)[:] / np.linalg.norm(rest)
    back = swings(wrist, along)
    np.testing.assert_allclose((back @ turned) @ found.hinge, normals, atol=1e-5)


def test_a_hand_on_no_arm_has_none():
    bones = body()
    lone = replace(bones, parents=np.where(np.array(bones.names) == "left hand", -1, bones.parents))
    assert target_arm(lone, "left", "left hand", "right hand", np.eye(3)) is None
    one = target_arm(lone, "right", "right hand", "left hand", TURN)
    assert one is not None
    np.testing.assert_allclose(one.body, TURN)


def test_directions_are_those_of_the_take_seen_from_a_body_that_faces_the_camera():
    camera, count, rng = Intrinsics(500.0, 500.0, 320.0, 240.0), 6, np.random.default_rng(0)
    hands = [
        track_of(
            side,
            rng.normal(size=(count, 3)),
            np.zeros((count, 45)),
            np.array([x, 0.0, 0.5]) + 0.1 * rng.normal(size=(count, 3)),
            camera,
        )
        for side, x in zip(SIDES, (0.3, -0.1), strict=True)
    ]
    take = with_arms(take_of(hands, camera, 640, 480))
    track = take.hands[0]
    numbers = take.frame_numbers.astype(float)
    found = CapturedArm.of(take, track, numbers)
    assert found is not None
    assert track.arm is not None
    own = (track.arm.elbow - track.arm.shoulder)[track.arm.present]
    world = own[:, [0, 2, 1]] * [1.0, 1.0, -1.0] / np.linalg.norm(own, axis=-1, keepdims=True)
    np.testing.assert_allclose(found.upper[found.present], world @ found.facing.T, atol=1e-6)
    left, right = (hand.arm.shoulder for hand in take.hands if hand.arm is not None)
    line = (left - right).mean(axis=0)
    line = found.facing @ (line[[0, 2, 1]] * [1.0, 1.0, -1.0])
    assert abs(np.degrees(np.arctan2(line[1], line[0]))) == pytest.approx(20.0)
    mirror = found.mirrored()
    np.testing.assert_allclose(mirror.upper, found.upper * [-1.0, 1.0, 1.0])
    np.testing.assert_allclose(mirror.facing, found.facing.T)
    lone = replace(take, hands=take.hands[:1])
    alone = CapturedArm.of(lone, lone.hands[0], numbers)
    assert alone is not None
    np.testing.assert_allclose(alone.facing, np.eye(3))
    assert CapturedArm.of(take, replace(track, arm=None), numbers) is None


@pytest.mark.parametrize(
    ("present", "ease", "wanted"),
    [
        ([1] * 9, 2.0, [0, 0.5, 1, 1, 1, 1, 1, 0.5, 0]),
        ([0, 0, 1, 1, 1, 1, 1, 0, 0], 1.0, [0, 0, 0, 1, 1, 1, 0, 0, 0]),
        ([1, 1, 1, 1, 0, 1, 1, 1, 1], 2.0, [0, 0.5, 1, 1, 1, 1, 1, 0.5, 0]),
        ([1, 1, 0, 0, 0, 0, 0, 1, 1], 0.0, [1, 1, 0, 0, 0, 0, 0, 1, 1]),
        ([0] * 9, 2.0, [0] * 9),
        ([0, 0, 0, 0, 1, 0, 0, 0, 0], 2.0, [0, 0, 0, 0, 1, 0, 0, 0, 0]),
    ],
)
def test_an_arm_comes_and_goes(present, ease, wanted):
    there = np.array(present, dtype=bool)
    captured = CapturedArm(np.ones((9, 3)), np.ones((9, 3)), there, np.eye(3))
    np.testing.assert_allclose(captured.weights(np.arange(9.0), ease), wanted, atol=1e-9)


def test_capsules_are_as_deep_as_the_body_and_pass_over_what_is_aside():
    bones, rng = body(), np.random.default_rng(0)
    chest = rng.uniform(-1.0, 1.0, (2000, 3)) * [0.18, 0.11, 0.12] + [0.0, 0.0, 1.3]
    arm_skin = rng.uniform(-0.05, 0.05, (500, 3)) + [0.3, 0.0, 1.4]
    points, owners = np.concatenate([chest, arm_skin]), np.repeat([2, bones.index["left arm"]], [2000, 500])
    found = Capsules.of(bones, points, owners, arm("left"))
    assert found.bones == ("chest",)
    assert found.radii[0] == pytest.approx(0.1, abs=0.01)
    np.testing.assert_allclose(found.ends[0, :, 1:], [[0.0, 1.3]] * 2, atol=0.02)
    np.testing.assert_allclose(np.abs(found.ends[0, :, 0]), 0.06, atol=0.02)


def test_hands_are_kept_outside_smoothly():
    frames = 90
    ends = np.tile([[[-0.06, 0.0, 0.0], [0.06, 0.0, 0.0]]], (frames, 1, 1, 1))
    seconds = np.arange(frames) / 30.0
    depth = np.where(abs(np.arange(frames) - 45) < 10, -0.05, -0.3)
    points = np.stack([0.0 * depth, depth, 0.0 * depth], axis=-1)[:, None] + [[[0, 0, 0], [0.02, 0.0, 0.01]]]
    camera = np.array([0.0, -1.0, 0.0])
    moved = kept_outside(points, ends, np.array([0.11]), seconds, camera)
    after = points + moved[:, None]
    axis = np.clip(after[..., 0], -0.06, 0.06)
    gap = np.linalg.norm(after - np.stack([axis, 0 * axis, 0 * axis], axis=-1), axis=-1)
    assert gap.min() > 0.11 - 1e-4
    assert (moved[:, 1] <= 1e-9).all()
    assert np.abs(moved[:30]).max() == 0.0
    far = np.linalg.norm(moved, axis=-1)
    assert np.abs(np.diff(far)).max() < 0.5 * far.max()
    still = kept_outside(points - [0.0, 0.5, 0.0], ends, np.array([0.11]), seconds, camera)
    assert not still.any()
    hidden = kept_outside(points + [0.0, 0.15, 0.0], ends, np.array([0.11]), seconds, camera)
    assert (points + [0.0, 0.15, 0.0] + hidden[:, None])[..., 1].max() < -0.1
