"""Captured fingertips that touch do so on characters of other proportions."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from handfit_core.common.skeleton import FINGER_JOINTS, FINGERS, NUM_JOINTS, SIDES, Side
from handfit_core.common.slices import run_to_completion
from handfit_core.geometry.rotations import rotmat_to_rotvec
from handfit_core.hand_model import load_model
from handfit_core.hand_model.anatomy import anatomical_angles, anatomical_axes, joint_limits
from handfit_core.hand_model.axes import MIRROR_X, REST_FROM_MODEL
from handfit_core.hand_model.surface import PAIRS as PARTS
from handfit_core.hand_model.surface import surface_of
from handfit_core.retarget import contacts
from handfit_core.retarget.contacts import (
    PAIRS,
    TOUCHES,
    ContactResult,
    Fingertips,
    HeldObject,
    Touches,
    finding_touches,
    keeping_contacts,
)
from handfit_core.retarget.hand_map import HandMap
from handfit_core.retarget.transfer import TargetHand, globally, mirrored_turns, target_hand
from tests.core.fit.differences import by_each
from tests.core.retarget.pinches import HELD, PINCHES, bends, pinching, turns_of
from tests.core.retarget.rigs import Built, add_hand, source

FPS = 30.0
SEEDS = range(6)

every_day_one = pytest.mark.parametrize(
    ("finger", "side"),
    [
        ("index", "right"),
        *(
            pytest.param(finger, side, marks=pytest.mark.slow)
            for finger in PINCHES
            for side in SIDES
            if (finger, side) != ("index", "right")
        ),
    ],
)


@cache
def skins(side: Side) -> Fingertips:
    return Fingertips.of(load_model(None, side), np.zeros(10))


def character(side: Side, seed: int, stretch: float = 0.25, bend: float = 0.3, **without) -> TargetHand:
    """Other proportions, bends at rest and tips."""
    built = Built()
    names = {joint: f"{side}{joint}" for joint in range(NUM_JOINTS)}
    add_hand(
        *(built, side, names, np.random.default_rng(seed)), stretch=stretch, bend=bend, tips=True, **without
    )
    there = tuple(name if name in built.names else "" for name in names.values())
    return target_hand(built.bones(), HandMap(side, there), source(side))


def kept_on(target: TargetHand, turns: np.ndarray, *keyed: np.ndarray) -> ContactResult:
    side = target.hand_map.side
    times = np.arange(len(turns)) / FPS
    return run_to_completion(keeping_contacts(target, source(side), skins(side), turns, times, *keyed))


def touches(side: Side, turns: np.ndarray) -> Touches:
    times = np.arange(len(turns)) / FPS
    return run_to_completion(finding_touches(source(side), skins(side), turns, times))


def spheres(target: TargetHand, standing: np.ndarray, f: int) -> tuple[np.ndarray, np.ndarray]:
    """(T, 200, 3) metres of the captured hand: spheres that fill a finger's tip, and their radii (200, 1)."""
    side, bone = target.hand_map.side, target.last(FINGERS[f])
    assert bone is not None
    tips = (target.points(standing)[1] - target.wrist) @ target.aligned / target.scale
    turned = target.aligned.T @ standing[:, bone] @ target.rest[bone].T @ target.corrected[bone].T
    share = np.linspace(0.0, 1.0, 200)[:, None]
    ends, radii = skins(side).ends[f] - source(side).tips[f], skins(side).radii[f]
    centres = (1.0 - share) * ends[0] + share * ends[1]
    places = tips[:, f, None] + np.einsum("tab,cb->tca", turned @ target.aligned, centres)
    return places, (1.0 - share) * radii[0] + share * radii[1]


def gaps(target: TargetHand, standing: np.ndarray, finger: str) -> np.ndarray:
    """(T,) metres of the captured hand between the skins of the thumb and a finger, by many spheres."""
    (a, r), (b, s) = (spheres(target, standing, f) for f in (0, FINGERS.index(finger)))
    away = np.linalg.norm(a[:, :, None] - b[:, None], axis=-1) - r - s[:, 0]
    return away.min(axis=(1, 2))


def off_by(target: TargetHand, standing: np.ndarray, turns: np.ndarray, finger: str) -> np.ndarray:
    """(10,) metres by which the gap differs from the captured one while tips touch."""
    return np.abs(gaps(target, standing, finger) - captured_gaps(target.hand_map.side, turns, finger))[HELD]


def captured_gaps(side: Side, turns: np.ndarray, finger: str) -> np.ndarray:
    """(T,) metres, by the surface that fits are solved with."""
    surface = surface_of(load_model(None, side))
    pose = rotmat_to_rotvec(REST_FROM_MODEL.T @ turns[:, 1:] @ REST_FROM_MODEL).reshape(-1, 45)
    pair = PARTS.tolist().index([2, 3 * FINGERS.index(finger) + 2])
    capsules = surface.of(np.zeros((len(turns), 10)), pose)
    return surface.gaps(capsules, np.arange(len(turns)), np.full(len(turns), pair)).gap


def chain_angles(turns: np.ndarray, side: Side) -> np.ndarray:
    return anatomical_angles(
        REST_FROM_MODEL.T @ turns[:, 1:] @ REST_FROM_MODEL, anatomical_axes(load_model(None, side))
    )


@every_day_one
def test_gaps_on_other_proportions(side, finger):
    turns = pinching(side, finger)
    assert np.abs(captured_gaps(side, turns, finger)[HELD]).max() < 0.001
    before, after = [], []
    for seed in SEEDS:
        target = character(side, seed)
        kept = kept_on(target, turns)
        before.append(off_by(target, target.standing(turns), turns, finger).max())
        off = off_by(target, kept.standing, turns, finger)
        after.append(off.max())
        # By spheres half a tenth of a millimetre apart.
        np.testing.assert_allclose(kept.apart[HELD], off, atol=1e-4)
        assert kept.turned.max() < np.radians(30.0)
    assert max(before) > 0.009
    assert max(after) < 0.002


@pytest.mark.parametrize("side", SIDES)
def test_nothing_else_moves(side):
    turns, target = pinching(side, "middle"), character(side, 1)
    plain, kept = target.standing(turns), kept_on(target, turns)
    moved = (kept.standing != plain).any(axis=(2, 3))
    others = [k for k, joints in enumerate(target.joints) if joints[0] in (1, 2, 3, 7, 8, 9, 10, 11, 12)]
    assert not moved[:, others].any()
    own = [k for k in range(len(target.bones)) if k not in others]
    assert moved[HELD][:, own].all()
    near = np.flatnonzero(captured_gaps(side, turns, "middle") < TOUCHES.touch_gap[1])
    # Weights reach twice as far as blend_seconds, and their mean once more.
    far = (np.arange(len(turns)) < near[0] - 3 * TOUCHES.blend_seconds * FPS) | (
        np.arange(len(turns)) > near[-1] + 3 * TOUCHES.blend_seconds * FPS
    )
    assert far.sum() > 20
    assert not moved[far].any()
    assert (kept.turned[far] == 0.0).all()
    assert (kept.apart[far] == 0.0).all()


@pytest.mark.parametrize("side", SIDES)
def test_what_needs_nothing_stays(side):
    """Where nothing touches, and where a hand has the captured proportions."""
    angles = np.zeros((40, NUM_JOINTS - 1, 3))
    angles[..., 2] = np.random.default_rng(3).uniform(-0.1, 0.3, (40, NUM_JOINTS - 1))
    alike = character(side, 0, stretch=0.0)
    for target, turns in (
        (character(side, 2), turns_of(side, angles)),
        *((alike, pinching(side, finger)) for finger in PINCHES),
    ):
        kept = kept_on(target, turns)
        np.testing.assert_allclose(kept.standing, target.standing(turns), atol=1e-12)
        assert np.abs(kept.turned).max() < 1e-12
        assert np.abs(kept.apart).max() < 1e-12


@every_day_one
def test_turns_are_a_hands(side, finger):
    """Joints stay within their ranges, fingers never twist, and turns come and go without a jump."""
    turns, limits = pinching(side, finger), joint_limits(side)
    before = chain_angles(turns, side)
    hinges = np.delete(np.arange(NUM_JOINTS - 1), [j - 1 for j in FINGER_JOINTS["thumb"]])
    for seed in SEEDS:
        target = character(side, seed, stretch=0.4)
        found = target.channels(kept_on(target, turns).standing)
        after = chain_angles(target.turns(found), side)
        assert (after > np.minimum(before, limits.lower) - 1e-6).all()
        assert (after < np.maximum(before, limits.upper) + 1e-6).all()
        np.testing.assert_allclose(after[:, hinges, 0], before[:, hinges, 0], atol=1e-6)
        extra = rotmat_to_rotvec(np.swapaxes(target.local(turns), -1, -2) @ found)
        size = np.linalg.norm(extra, axis=-1).max()
        for order, most in ((1, 0.45), (2, 0.5)):
            assert np.linalg.norm(np.diff(extra, n=order, axis=0), axis=-1).max() < most * size


def test_slices_do_not_show(monkeypatch):
    turns, target = pinching("right", "index"), character("right", 4)
    whole = kept_on(target, turns)
    monkeypatch.setattr(contacts, "TOUCHES", replace(contacts.TOUCHES, solve_frames=5, detect_frames=9))
    small = kept_on(target, turns)
    np.testing.assert_allclose(small.standing, whole.standing, atol=1e-9)
    steps = list(
        keeping_contacts(target, source("right"), skins("right"), turns, np.arange(len(turns)) / FPS)
    )
    assert len(steps) > 10
    assert steps == sorted(steps)
    assert steps[-1] == 1.0


def test_mirrored_hand():
    built, names = Built(), tuple(f"b{joint}" for joint in range(NUM_JOINTS))
    how = {"bend": 0.3, "stretch": 0.25, "tips": True}
    add_hand(built, "right", dict(enumerate(names)), np.random.default_rng(6), **how)
    bones, own, tips, turns = built.bones(), source("right"), skins("right"), pinching("right", "ring")
    other = replace(bones, heads=bones.heads @ MIRROR_X, tails=bones.tails @ MIRROR_X)
    found = []
    for hand in ((bones, own, tips, turns), (other, own.mirrored(), tips.mirrored(), mirrored_turns(turns))):
        its, captured, skin, does = hand
        target = target_hand(its, HandMap(captured.side, names), captured)
        kept = run_to_completion(keeping_contacts(target, captured, skin, does, np.arange(len(does)) / FPS))
        found.append((target.points(kept.standing)[1], kept.apart))
    np.testing.assert_allclose(found[1][0], found[0][0] @ MIRROR_X, atol=1e-9)
    np.testing.assert_allclose(found[1][1], found[0][1], atol=1e-9)


@pytest.mark.parametrize("side", SIDES)
def test_fewer_bones_and_fingers_touch_too(side):
    for joints in ((14, 2, 5, 8, 11), (3, 6, 9, 12, 15), (7, 8, 9, 10, 11, 12)):
        turns, target = pinching(side, "index"), character(side, 3, without=joints)
        kept = kept_on(target, turns)
        before = off_by(target, target.standing(turns), turns, "index").max()
        assert off_by(target, kept.standing, turns, "index").max() < min(0.002, before)


def test_bones_that_are_left_alone_stay():
    turns, target = pinching("right", "index"), character("right", 4)
    plain = target.standing(turns)
    thumb = np.array([joints[0] in FINGER_JOINTS["thumb"] for joints in target.joints])
    apart = []
    for keyed in (~thumb, thumb):
        kept = kept_on(target, turns, keyed)
        assert (kept.standing[:, ~keyed] == plain[:, ~keyed]).all()
        assert (kept.standing[HELD][:, keyed] != plain[HELD][:, keyed]).any()
        apart.append(kept.apart[HELD].max())
    assert max(apart) < 0.001
    assert (kept_on(target, turns, np.zeros(15, dtype=bool)).standing == plain).all()


def test_unreachable_touch_is_reported():
    built, side, finger = Built(), "right", "ring"
    names = tuple(f"b{joint}" for joint in range(NUM_JOINTS))
    add_hand(built, side, dict(enumerate(names)), np.random.default_rng(0), tips=True)
    bones = built.bones()
    thumb = [bones.index[name] for name in ("b13", "b14", "b15", "b15_tip")]
    bones.heads[thumb] = bones.heads[thumb[0]] + 0.4 * (bones.heads[thumb] - bones.heads[thumb[0]])
    target = target_hand(bones, HandMap(side, names), source(side))
    turns = pinching(side, finger)
    kept = kept_on(target, turns)
    off = off_by(target, kept.standing, turns, finger)
    assert off.min() > 0.005
    np.testing.assert_allclose(kept.apart[HELD], off, atol=1e-4)
    # It is nearer all the same.
    assert off.max() < off_by(target, target.standing(turns), turns, finger).max()


def test_side_by_side_is_no_touch():
    """But a middle finger that lies over the index finger's back is one."""
    pair = PAIRS.tolist().index([1, 2])
    for spread, bend, low, high in ((6.0, 0.0, 0.0, 0.0), (12.0, 8.0, 0.9, 1.0)):
        angles = np.zeros((1, NUM_JOINTS - 1, 3))
        angles[0, [0, 3], 1], angles[0, 0, 2] = np.radians([-spread, spread]), np.radians(bend)
        found = touches("right", turns_of("right", angles))
        assert found.gap[0, pair] < TOUCHES.touch_gap[0]
        assert low <= found.weights[0, pair] <= high


def closing(side: Side) -> np.ndarray:
    """(40, 16, 3, 3) a hand that closes around a ball, and from frame 20 on holds it."""
    grasp = bends(side, "middle")
    grasp[np.array(FINGER_JOINTS["thumb"]) - 1, 2] = np.radians([0.0, 5.0, 10.0])
    for finger in FINGERS[1:]:
        grasp[np.array(FINGER_JOINTS[finger]) - 1, 2] = np.radians([40.0, 40.0, 25.0])
    share = np.clip(np.arange(40) / 20.0, 0.0, 1.0)[:, None, None]
    return turns_of(side, share * grasp)


def ball(target: TargetHand, turns: np.ndarray) -> HeldObject:
    """A ball on which the captured fingertips lie at last, and that the character holds from frame 10 on."""
    side, own = target.hand_map.side, source(target.hand_map.side)
    last = [joints[2] for joints in FINGER_JOINTS.values()]
    turned, joints = globally(turns[-1:])[0, last], own.points(turns[-1:])[0][0, last]
    tips = joints + np.einsum("fab,fb->fa", turned, skins(side).ends.mean(axis=1) - own.joints[last])
    tips, flesh = tips - own.joints[0], skins(side).radii.mean()
    rows = np.column_stack([2.0 * tips, np.ones(5)])
    *middle, rest = np.linalg.lstsq(rows, (tips**2).sum(axis=1), rcond=None)[0]
    centre = target.wrist + target.scale * target.aligned @ middle
    radius = target.scale * (np.sqrt(rest + np.square(middle).sum()) - flesh)

    def nearest(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        away = points - centre
        far = np.linalg.norm(away, axis=1)
        return far - radius, away / far[:, None]

    return HeldObject(nearest, (np.arange(len(turns)) >= 10.0) * 1.0)


def holding(target: TargetHand, turns: np.ndarray, held: HeldObject | None) -> np.ndarray:
    side, times = target.hand_map.side, np.arange(len(turns)) / FPS
    steps = keeping_contacts(target, source(side), skins(side), turns, times, held=held)
    return run_to_completion(steps).standing


def gaps_to(target: TargetHand, standing: np.ndarray, held: HeldObject) -> np.ndarray:
    """(5, T) metres of the captured hand between fingertips and what the hand holds, by many spheres."""
    found = []
    for f in range(len(FINGERS)):
        places, radii = spheres(target, standing, f)
        asked = target.wrist + target.scale * places.reshape(-1, 3) @ target.aligned.T
        away = held.nearest(asked)[0].reshape(places.shape[:2]) / target.scale
        found.append((away - radii[:, 0]).min(axis=1))
    return np.array(found)


@pytest.mark.parametrize("side", SIDES)
def test_fingertips_lie_on_what_the_hand_holds(side):
    turns, before, after = closing(side), [], []
    for seed in SEEDS:
        target = character(side, seed, stretch=0.15)
        held, plain = ball(target, turns), target.standing(turns)
        standing = holding(target, turns, held)
        np.testing.assert_array_equal(standing[:5], plain[:5])
        gaps = gaps_to(target, plain[-10:], held)
        near = np.abs(gaps) < TOUCHES.held_reach[0]
        before.append(np.abs(gaps[near]))
        after.append(np.abs(gaps_to(target, standing[-10:], held)[near]))
    assert np.median(np.concatenate(before)) > 0.003
    assert np.concatenate(after).max() < 0.001


def test_what_is_not_held_or_out_of_reach_changes_nothing():
    turns, target = closing("right"), character("right", 2)
    held, alone = ball(target, turns), holding(target, turns, None)
    assert not np.array_equal(holding(target, turns, held), alone)
    np.testing.assert_array_equal(holding(target, turns, replace(held, share=0.0 * held.share)), alone)
    far = replace(held, nearest=lambda points: (held.nearest(points)[0] + 1.0, held.nearest(points)[1]))
    np.testing.assert_array_equal(holding(target, turns, far), alone)


@pytest.mark.parametrize("finger", PINCHES)
def test_slopes_are_those_of_differences(finger):
    rng = np.random.default_rng(9)
    turns, target = pinching("right", finger)[[25, 33]], character("right", 5)
    found, standing = touches("right", turns), target.standing(turns)
    chains = contacts._Chains.of(
        *(target, source("right"), skins("right"), np.ones(15, dtype=bool)), holds=True
    )
    plane = HeldObject(lambda points: (0.0 * points[:, 0], points / 3.0), np.ones(2))
    still = np.zeros((2, len(chains.bones)))
    on_held = run_to_completion(chains.finding_held(standing, still, plane, np.arange(2) / FPS))
    problem = chains.problem(standing, found.beside(on_held))
    assert problem.forward(still)[0].shape[1] > 5
    x = rng.normal(scale=0.2, size=(2, len(chains.bones)))
    _, slopes = problem.forward(x)
    every = by_each(lambda at: problem.forward(at)[0], x).reshape(*slopes.shape[:3], 2, -1)
    for row in range(2):
        np.testing.assert_allclose(slopes[row], every[row, :, :, row], atol=1e-8)
