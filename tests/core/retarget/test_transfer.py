"""From captured rotations to a character's bones and back."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from handfit_core.common.errors import HandModelError
from handfit_core.common.skeleton import (
    FINGER_JOINTS,
    FINGERS,
    JOINT_NAMES,
    NUM_JOINTS,
    PARENTS,
    SIDES,
    Side,
    other_side,
)
from handfit_core.geometry.rotations import rotmat_to_rotvec, rotvec_to_rotmat
from handfit_core.hand_model import axes, load_model
from handfit_core.retarget.bones import Bones
from handfit_core.retarget.hand_map import PALM_FINGERS, HandMap
from handfit_core.retarget.transfer import (
    TargetHand,
    finger_end,
    globally,
    mirrored_turns,
    smoothed_travel,
    target_hand,
)
from tests.core.retarget.rigs import Built, add_hand, source

NAMES = {**{j: f"b{j}" for j in range(NUM_JOINTS)}, **{16 + i: f"palm{i}" for i in range(4)}}


def poses(count: int = 20, seed: int = 0) -> np.ndarray:
    """(count, 16, 3, 3) joints turned by 40 degrees or so about any axis, the wrist too."""
    rng = np.random.default_rng(seed)
    return rotvec_to_rotmat(rng.normal(scale=0.4, size=(count, NUM_JOINTS, 3)))


def rig(side: Side, seed: int, *, palms: bool = False, **how) -> Bones:
    """Random proportions, rest bends, rolls, units, and way to lie in the armature."""
    rng = np.random.default_rng(seed)
    built = Built()
    names = NAMES if palms else {j: NAMES[j] for j in range(NUM_JOINTS)}
    add_hand(built, side, names, rng, **{"bend": 0.7, "stretch": 0.4, "tips": True, **how})
    bones = built.bones()
    turn, place = rotvec_to_rotmat(rng.normal(size=3)), rng.normal(size=3)
    scale = 10.0 ** rng.uniform(-2.0, 2.0)
    return replace(
        bones,
        heads=scale * (bones.heads @ turn.T) + place,
        tails=scale * (bones.tails @ turn.T) + place,
        frames=rotvec_to_rotmat(rng.normal(size=(len(bones.names), 3))),
    )


def table(bones: Bones, side: Side, **fields) -> HandMap:
    names = tuple(NAMES[j] if NAMES[j] in bones.index else "" for j in range(NUM_JOINTS))
    palms = (NAMES[16], NAMES[17], NAMES[18], NAMES[19]) if NAMES[16] in bones.index else ("", "", "", "")
    return HandMap(side, names, palms, **fields)


def target(side: Side, seed: int, *, fields: dict | None = None, **how) -> TargetHand:
    bones = rig(side, seed, **how)
    return target_hand(bones, table(bones, side, **(fields or {})), source(side))


def own_hand(side: Side) -> TargetHand:
    """The captured hand as the add-on itself builds it."""
    shaped = load_model(None, side).shaped()
    bones = Bones(
        JOINT_NAMES,
        np.array(PARENTS),
        axes.points_to_rest(shaped.joints),
        axes.points_to_rest(axes.bone_tails(shaped)),
        axes.bone_frames(shaped, side),
        np.ones(NUM_JOINTS, dtype=bool),
    )
    return target_hand(bones, HandMap(side, JOINT_NAMES), source(side))


def segments(joints: np.ndarray, tips: np.ndarray) -> np.ndarray:
    """(T, 5, 3, 3) unit vectors along the three bones of each finger."""
    points = np.stack(
        [[joints[:, j] for j in FINGER_JOINTS[f]] + [tips[:, i]] for i, f in enumerate(FINGERS)]
    )  # (5, 4, T, 3)
    along = np.diff(points, axis=1).transpose(2, 0, 1, 3)
    return along / np.linalg.norm(along, axis=-1, keepdims=True)


def joints_of(hand: TargetHand, standing: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Where the bones of all joints begin (T, 16, 3), and the tips, in the captured hand's own axes."""
    heads, tips = hand.points(standing)
    joints = np.full((len(heads), NUM_JOINTS, 3), np.nan)
    for k, own in enumerate(hand.joints):
        joints[:, list(own)] = heads[:, k, None]
    return joints @ hand.aligned, tips @ hand.aligned


@pytest.mark.parametrize("side", SIDES)
def test_captured_hand_as_target(side):
    hand, turns = own_hand(side), poses()
    np.testing.assert_allclose(hand.aligned, np.eye(3), atol=1e-10)
    assert hand.scale == pytest.approx(1.0, abs=1e-10)
    own = axes.bone_frames(load_model(None, side).shaped(), side)
    expected = np.swapaxes(own, -1, -2) @ turns @ own
    at = [JOINT_NAMES.index(name) for name in hand.bones]
    local = hand.local(turns)
    np.testing.assert_allclose(local, expected[:, at], atol=1e-10)
    np.testing.assert_allclose(hand.turns(local)[:, 1:], turns[:, 1:], atol=1e-10)
    joints, tips = joints_of(hand, hand.standing(turns))
    ours = source(side).points(turns)
    np.testing.assert_allclose(joints[:, 1:], ours[0][:, 1:], atol=1e-10)
    np.testing.assert_allclose(tips, ours[1], atol=1e-10)


@pytest.mark.parametrize("side", SIDES)
@pytest.mark.parametrize("fields", [{}, {"thumb_roll": 35.0}])
def test_every_segment_points_as_captured(side, fields):
    turns = poses()
    ours = segments(*source(side).points(turns))
    for seed in range(20):
        hand = target(side, seed, fields=fields, palms=seed % 2 == 0)
        found = segments(*joints_of(hand, hand.standing(turns)))
        cosines = np.clip((found * ours).sum(axis=-1), -1.0, 1.0)
        assert np.degrees(np.arccos(cosines)).max() < 1e-5


@pytest.mark.parametrize("side", SIDES)
def test_turns_is_the_inverse_of_local(side):
    turns = poses()
    for seed in range(10):
        hand = target(side, seed, fields={"thumb_roll": 20.0})
        np.testing.assert_allclose(hand.turns(hand.local(turns))[:, 1:], turns[:, 1:], atol=1e-10)
        lacking = target(side, seed, without=(2, 5, 14, 7, 8, 9))
        local = lacking.local(turns)
        back = lacking.turns(local)
        np.testing.assert_allclose(lacking.local(back), local, atol=1e-10)
        still = back[:, [2, 5, 14, 7, 8, 9]]
        np.testing.assert_allclose(still, np.broadcast_to(np.eye(3), still.shape), atol=1e-12)


@pytest.mark.parametrize("side", SIDES)
def test_channels(side):
    """Put together again as Blender does: the parent's pose, the rest relative to it, the channel."""
    hand = target(side, 3, palms=True, fields={"fold": 0.6})
    standing = hand.standing(poses())
    channels = hand.channels(standing)
    built = np.empty_like(standing)
    for k, parent in enumerate(hand.parents):
        above, rest = (np.eye(3), np.eye(3)) if parent < 0 else (built[:, parent], hand.rest[parent])
        built[:, k] = above @ rest.T @ hand.rest[k] @ channels[:, k]
    np.testing.assert_allclose(built, standing, atol=1e-10)


def test_mirrored_hand():
    turns = poses()
    for side in SIDES:
        own = source(side)
        joints, tips = own.mirrored().points(mirrored_turns(turns))
        ours = own.points(turns)
        np.testing.assert_allclose(joints, ours[0] @ axes.MIRROR_X, atol=1e-12)
        np.testing.assert_allclose(tips, ours[1] @ axes.MIRROR_X, atol=1e-12)
        assert own.mirrored().side == other_side(side)
        # What is captured on one side shows on a character's other one, in its own axes.
        bones = rig(other_side(side), 5)
        hand = target_hand(bones, table(bones, other_side(side)), own.mirrored())
        found = segments(*joints_of(hand, hand.standing(mirrored_turns(turns))))
        np.testing.assert_allclose(found @ axes.MIRROR_X, segments(*ours), atol=1e-9)


@pytest.mark.parametrize("side", SIDES)
def test_bone_of_two_fingers(side):
    bones = rig(side, 6, without=FINGER_JOINTS["little"])
    plain = table(bones, side)
    names = list(plain.bones)
    for little, ring in zip(FINGER_JOINTS["little"], FINGER_JOINTS["ring"], strict=True):
        names[little] = names[ring]
    shared = target_hand(bones, replace(plain, bones=tuple(names)), source(side))
    turns = poses()
    # Where both do the same, so does the bone.
    turns[:, FINGER_JOINTS["little"]] = turns[:, FINGER_JOINTS["ring"]]
    k = shared.bones.index(names[FINGER_JOINTS["ring"][2]])
    whole = globally(turns)[:, FINGER_JOINTS["ring"][2]]
    expected = shared.aligned @ whole @ shared.aligned.T @ shared.corrected[k] @ shared.rest[k]
    np.testing.assert_allclose(shared.standing(turns)[:, k], expected, atol=1e-10)
    tips = shared.points(shared.standing(turns))[1]
    np.testing.assert_allclose(tips[:, 3], tips[:, 4])
    # Else it is as far from one as from the other.
    turns = poses(seed=1)
    turned = shared.standing(turns)[:, k] @ (shared.corrected[k] @ shared.rest[k]).T
    turned = shared.aligned.T @ turned @ shared.aligned
    ring, little = (
        rotmat_to_rotvec(np.swapaxes(globally(turns)[:, FINGER_JOINTS[finger][2]], -1, -2) @ turned)
        for finger in ("ring", "little")
    )
    np.testing.assert_allclose(np.linalg.norm(ring, axis=-1), np.linalg.norm(little, axis=-1), atol=1e-9)


@pytest.mark.parametrize("side", SIDES)
def test_missing_fingers_have_no_tips(side):
    hand = target(side, 7, without=(*FINGER_JOINTS["index"], *FINGER_JOINTS["thumb"]))
    tips = hand.points(hand.standing(poses()))[1]
    assert np.isnan(tips[:, :2]).all()
    assert np.isfinite(tips[:, 2:]).all()
    assert hand.last("thumb") is None
    assert hand.last("ring") == hand.bones.index("b12")


@pytest.mark.parametrize("side", SIDES)
def test_folded_metacarpals(side):
    turns = poses()
    flat, folded = (target(side, 8, palms=True, fields={"fold": fold}) for fold in (0.0, 1.0))
    assert set(folded.bones) - set(flat.bones) == {NAMES[18], NAMES[19]}
    found = [segments(*joints_of(hand, hand.standing(turns))) for hand in (flat, folded)]
    np.testing.assert_allclose(found[1], found[0], atol=1e-9)
    # The palm is cupped by a share of what the finger's first joint turns; the little finger's more.
    channels, shares = folded.channels(folded.standing(turns)), []
    for i, finger in enumerate(PALM_FINGERS[2:], start=2):
        k = folded.bones.index(NAMES[16 + i])
        bend = np.linalg.norm(rotmat_to_rotvec(turns[:, FINGER_JOINTS[finger][0]]), axis=-1)
        share = np.linalg.norm(rotmat_to_rotvec(channels[:, k]), axis=-1) / bend
        assert np.ptp(share) < 1e-9
        shares.append(share[0])
    assert 0.0 < shares[0] < shares[1] < 0.5
    still = np.broadcast_to(np.eye(3), (1, NUM_JOINTS, 3, 3))
    np.testing.assert_allclose(folded.local(still)[:, :2], flat.local(still)[:, :2], atol=1e-10)


@pytest.mark.parametrize("side", SIDES)
def test_keep_rest(side):
    hand = target(side, 9, fields={"keep_rest": True})
    still = np.broadcast_to(np.eye(3), (1, NUM_JOINTS, 3, 3))
    local = hand.local(still)
    np.testing.assert_allclose(local, np.broadcast_to(np.eye(3), local.shape), atol=1e-12)
    assert np.abs(target(side, 9).local(still) - np.eye(3)).max() > 0.1


def test_size_is_that_of_the_palm():
    own = source("right")
    names = tuple(JOINT_NAMES)
    for factor in (0.01, 1.0, 250.0):
        heads = factor * own.joints
        frames, inherits = np.tile(np.eye(3), (NUM_JOINTS, 1, 1)), np.ones(NUM_JOINTS, dtype=bool)
        bones = Bones(names, np.array(PARENTS), heads, heads + 0.01 * factor, frames, inherits)
        hand = target_hand(bones, HandMap("right", names), own)
        assert hand.scale == pytest.approx(factor)
        np.testing.assert_allclose(hand.wrist, heads[0])


def test_refuses_degenerate_palms():
    bones, good = rig("right", 10), table(rig("right", 10), "right")
    knuckles = [bones.index[NAMES[j]] for j in (1, 4, 7, 10)]
    line, place, same = bones.heads.copy(), bones.heads.copy(), bones.heads.copy()
    line[knuckles] = bones.heads[0] + np.array([1.0, 2.0, 3.0]) * np.arange(1, 5)[:, None]
    place[knuckles] = bones.heads[0]
    same[bones.index[NAMES[5]]] = same[bones.index[NAMES[4]]]
    index, thumb = (
        HandMap("right", tuple(NAMES[j] if j in (0, *joints) else "" for j in range(NUM_JOINTS)))
        for joints in ((1, 2, 3), (13, 14, 15))
    )
    for heads, hand_map, sentence in (
        (line, good, "on one line or in one place"),
        (place, good, "on one line or in one place"),
        (bones.heads, index, "two fingers or more"),
        (bones.heads, thumb, "two fingers or more"),
        (same, good, "begin in the same place"),
        (bones.heads, replace(good, bones=("elsewhere", *good.bones[1:])), "no bone 'elsewhere'"),
    ):
        with pytest.raises(HandModelError, match=sentence):
            target_hand(replace(bones, heads=heads), hand_map, source("right"))


@pytest.mark.parametrize("side", SIDES)
def test_refuses_hand_bone_as_finger(side):
    """Nor an arm, which the hand hangs from."""
    bones = rig(side, 10, palms=True)
    bones = Bones(
        ("arm", *bones.names),
        np.array([-1, *(bones.parents + 1)]),
        np.concatenate([bones.heads[:1] - 1.0, bones.heads]),
        np.concatenate([bones.heads[:1], bones.tails]),
        np.concatenate([bones.frames[:1], bones.frames]),
        np.array([True, *bones.inherits]),
    )
    good = table(bones, side, fold=0.5)
    target_hand(bones, good, source(side))
    wrong = [(replace(good, control=good.bones[5]), good.bones[5])]
    for bone in ("arm", NAMES[0]):
        wrong.append((replace(good, bones=(NAMES[0], bone, *good.bones[2:])), bone))
        wrong.append((replace(good, palm=(*good.palm[:3], bone)), bone))
    for hand_map, bone in wrong:
        with pytest.raises(HandModelError, match=f"the bone '?{bone}'? moves the whole {side} hand"):
            target_hand(bones, hand_map, source(side))


def test_where_fingers_end():
    """A bone behind the last one says it. Two of them say nothing: then tails do, where they mean something,
    else the bone before."""
    chain, tip, other = [[0, 0, 0], [3, 0, 0], [5, 0, 0]], [6, 0, 1], [6, 1, 1]
    good, junk = [[3, 0, 0], [5, 0, 0], [6, 1, 0]], [[370, 0, 0], [0, 370, 0], [0, 0, 370]]
    for heads, tails, parents, end in (
        ([*chain, tip], [*junk, [9, 9, 9]], [-1, 0, 1, 2], [6, 0, 1]),
        ([*chain, tip, other], [*good, tip, other], [-1, 0, 1, 2, 2], [6, 1, 0]),
        (chain, good, [-1, 0, 1], [6, 1, 0]),
        (chain, junk, [-1, 0, 1], [6.6, 0, 0]),
    ):
        count, (at, ends) = len(heads), np.array([heads, tails], dtype=float)
        names, frames = tuple(map(str, range(count))), np.tile(np.eye(3), (count, 1, 1))
        bones = Bones(names, np.array(parents), at, ends, frames, np.ones(count, dtype=bool))
        np.testing.assert_allclose(finger_end(bones, [0, 1, 2]), end)


def test_smoothed_travel():
    """Even motion stays, noise falls, a bump stays where it was; quaternions of both signs are one turn."""
    frames = np.concatenate([np.arange(30.0), [30.4, 33.0, 34.5]])
    even = frames[:, None] * [0.01, -0.02, 0.005]
    turns = rotvec_to_rotmat(frames[:, None] * [0.0, 0.03, 0.0])
    places, turned = smoothed_travel(frames, even, turns, 4.0)
    np.testing.assert_allclose(places, even, atol=1e-12)
    np.testing.assert_allclose(turned, turns, atol=1e-3)
    shaken = even + np.random.default_rng(2).normal(scale=0.01, size=even.shape)
    noise = smoothed_travel(frames, shaken, turns, 6.0)[0] - even
    assert np.abs(noise[3:-3]).mean() < 0.5 * np.abs(shaken - even)[3:-3].mean()
    assert smoothed_travel(frames, shaken, turns, 0.0)[0] is shaken
    frames = np.arange(61.0)
    bump = np.exp(-0.5 * ((frames - 30) / 3) ** 2)[:, None] * [1.0, 0.0, 0.0]
    turns = rotvec_to_rotmat(frames[:, None] * [0.12, 0.0, 0.0])
    places, turned = smoothed_travel(frames, bump, turns, 3.0)
    np.testing.assert_allclose(places[:, 0], places[::-1, 0], atol=1e-12)
    assert np.argmax(places[:, 0]) == 30
    np.testing.assert_allclose(turned, turns, atol=2e-2)
