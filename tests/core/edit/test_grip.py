"""Fingers laid on a prop: made grasps come back from noise, and what is out of reach stays to the last bit.

The grasps are made of the skin's mesh and exact distances, which the solver does not know.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pytest

from handfit_core.common.arrays import packed
from handfit_core.common.errors import HandfitError, OptionError
from handfit_core.common.skeleton import JOINTS_BY_FINGER, NUM_JOINTS, SIDES, Side
from handfit_core.detect.keypoints import Detections
from handfit_core.edit import Prop, RefineHand, answer, refit_grip, result_from_message, to_message
from handfit_core.edit.pins import landmarks_of_pose
from handfit_core.fit.fast import fitter_of
from handfit_core.fit.grip import Grip, GripPoints
from handfit_core.fit.observation import observation_of
from handfit_core.fit.problem import Problem
from handfit_core.fit.prop import PropSurface, outward
from handfit_core.fit.solvers import never
from handfit_core.fit.terms import grip, near_wrist, reprojection
from handfit_core.geometry.rotations import rotmat_to_rotvec
from handfit_core.hand_model.anatomy import anatomical_axes, rotmats_from_angles
from handfit_core.hand_model.chain import State
from handfit_core.hand_model.motion import POSE_ARRAYS
from tests.core.edit.hands import joints_of, locked, shown
from tests.core.fit.detections import CAMERA, model_of

PLACE = np.array([-0.05, 0.02, 0.5])
DISTAL = JOINTS_BY_FINGER[:, 2]
KINDS = ("cylinder", "box", "ball")


@dataclass(frozen=True)
class Shape:
    """An object in the hand's frame, which is the camera's but for `PLACE`."""

    distances: Callable[[np.ndarray], np.ndarray]
    vertices: np.ndarray
    triangles: np.ndarray


def box(half: tuple[float, float, float], centre: np.ndarray) -> Shape:
    corners = np.stack(np.meshgrid(*[[-1.0, 1.0]] * 3, indexing="ij"), axis=-1).reshape(8, 3) * half
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    triangles = np.array([t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))])

    def distances(points: np.ndarray) -> np.ndarray:
        off = np.abs(points - centre) - half
        return np.linalg.norm(np.maximum(off, 0.0), axis=-1) + np.minimum(off.max(axis=-1), 0.0)

    return Shape(distances, corners + centre, triangles)


def turned_body(
    profile: np.ndarray, centre: np.ndarray, distances: Callable[[np.ndarray], np.ndarray]
) -> Shape:
    """A body about z, of rings of radius and z in `profile` (N, 2), closed by a point at either end."""
    count = 48
    turn = 2 * np.pi * np.arange(count) / count
    rings = [np.stack([r * np.cos(turn), r * np.sin(turn), np.full(count, z)], axis=1) for r, z in profile]
    ends = [[0.0, 0.0, profile[0, 1]], [0.0, 0.0, profile[-1, 1]]]
    first, last = count * len(profile), count * len(profile) + 1
    triangles = []
    for i, j in zip(range(count), np.roll(np.arange(count), -1), strict=True):
        triangles += [(first, j, i), (last, last - 1 - count + i, last - 1 - count + j)]
        for k in range(0, count * (len(profile) - 1), count):
            triangles += [(k + i, k + j, k + count + j), (k + i, k + count + j, k + count + i)]
    return Shape(distances, np.concatenate([*rings, ends]) + centre, np.array(triangles))


def shape_of(kind: str, centre: np.ndarray) -> Shape:
    if kind == "box":
        return box((0.018, 0.02, 0.07), centre)
    if kind == "cylinder":
        profile = np.array([(0.025, -0.07), (0.025, 0.07)])

        def distances(points: np.ndarray) -> np.ndarray:
            off = points - centre
            outside = np.stack([np.hypot(off[..., 0], off[..., 1]) - 0.025, np.abs(off[..., 2]) - 0.07], -1)
            return np.linalg.norm(np.maximum(outside, 0.0), axis=-1) + np.minimum(outside.max(axis=-1), 0.0)

        return turned_body(profile, centre, distances)
    heights = np.linspace(0.02, np.pi - 0.02, 24)
    profile = 0.034 * np.stack([np.sin(heights), -np.cos(heights)], axis=1)
    return turned_body(profile, centre, lambda points: np.linalg.norm(points - centre, axis=-1) - 0.034)


def pose_of(side: Side, angles: np.ndarray) -> np.ndarray:
    """(N, 45) from (N, 5, 3, 3) angles of a right hand, finger by finger."""
    angles = angles * (np.array([-1.0, -1.0, 1.0]) if side == "left" else 1.0)
    by_joint = np.empty((len(angles), 15, 3))
    by_joint[:, JOINTS_BY_FINGER - 1] = angles
    return rotmat_to_rotvec(rotmats_from_angles(by_joint, anatomical_axes(model_of(side)))).reshape(-1, 45)


def skin_of(side: Side, betas: np.ndarray, pose: np.ndarray) -> np.ndarray:
    return model_of(side).posed(betas, np.zeros(3), pose, np.zeros(3)).vertices


def grasp(kind: str, side: Side, betas: np.ndarray) -> tuple[Shape, np.ndarray]:
    """A shape in the palm, and the angles (5, 3, 3) of fingers that close until their skin touches it."""
    owner = model_of(side).weights.argmax(axis=1)
    opened, closed = np.zeros((5, 3, 3)), np.zeros((5, 3, 3))
    opened[0, 0], closed[0, :, 2] = np.radians([0.0, 38.0, -15.0]), np.radians([45.0, 50.0, 60.0])
    closed[0, 0, 1] = opened[0, 0, 1]
    closed[1:, :, 2] = np.radians([80.0, 95.0, 60.0])
    mirror = np.array([-1.0, 1.0, 1.0]) if side == "left" else np.ones(3)
    angles, height = opened.copy(), -0.12
    shape = shape_of(kind, mirror * np.array([0.012, height, 0.008]))
    for _ in range(3):  # The palm's flesh rises as the fingers bend.
        skin = skin_of(side, betas, pose_of(side, angles[None])[0])[owner == 0]
        low, high = -0.12, 0.0  # metres: the shape rises to 0.5 mm below the palm
        for _ in range(14):
            height = 0.5 * (low + high)
            shape = shape_of(kind, mirror * np.array([0.012, height, 0.008]))
            low, high = (height, high) if shape.distances(skin).min() > 0.0005 else (low, height)
        for finger in range(5):
            least, most = 0.0, 1.0
            for _ in range(12):
                share = 0.5 * (least + most)
                angles[finger] = opened[finger] + share * (closed[finger] - opened[finger])
                skin = skin_of(side, betas, pose_of(side, angles[None])[0])
                touched = shape.distances(skin[np.isin(owner, JOINTS_BY_FINGER[finger])]).min() < 0.0
                least, most = (least, share) if touched else (share, most)
            angles[finger] = opened[finger] + least * (closed[finger] - opened[finger])
    skin = skin_of(side, betas, pose_of(side, angles[None])[0])
    assert abs(shape.distances(skin).min()) < 0.001
    return shape, angles


def hand_of(side: Side, betas: np.ndarray, pose: np.ndarray) -> RefineHand:
    count = len(pose)
    none, place = Detections.of([]), np.tile(PLACE, (count, 1))
    pins, free = np.full((count, 21, 2), np.nan), np.zeros(NUM_JOINTS, dtype=bool)
    return RefineHand(side, betas, np.zeros((count, 3)), pose, place, CAMERA, none, pins, free)


def prop_of(shape: Shape, count: int, **fields: np.ndarray) -> Prop:
    placed = np.tile(np.column_stack([np.eye(3), PLACE]), (count, 1, 1))
    return Prop(shape.vertices, shape.triangles, placed, **fields)


def noisy(angles: np.ndarray, count: int, seed: int) -> np.ndarray:
    """(N, 5, 3, 3) angles as far off as captures': 8 to 10 mm, mostly by bends."""
    noise = np.random.default_rng(seed).normal(size=(count, 5, 3, 3))
    return angles + noise * np.radians([1.0, 3.0, 13.0])


def figures(kind: str, side: Side) -> dict[str, np.floating]:
    """What a grip makes of eight noisy grasps of a shape: millimetres and shares, as the table names them."""
    betas = 0.8 * np.random.default_rng(len(kind)).normal(size=10)
    shape, angles = grasp(kind, side, betas)
    true = hand_of(side, betas, pose_of(side, angles[None].repeat(8, axis=0)))
    hand = replace(true, hand_pose=pose_of(side, noisy(angles, 8, seed=3)))
    found = refit_grip(hand, prop_of(shape, 8))
    before, after = (
        np.array([
            shape.distances(skin_of(side, betas, pose) + place - PLACE)
            for pose, place in zip(one.hand_pose, one.transl, strict=True)
        ])
        for one in (hand, found)
    )  # fmt: skip
    owner = model_of(side).weights.argmax(axis=1)
    began, pads = (np.stack([d[:, owner == j].min(axis=1) for j in DISTAL], axis=1) for d in (before, after))
    errors = [np.linalg.norm(joints_of(one) - joints_of(true), axis=-1).mean(axis=1) for one in (hand, found)]
    moved = np.linalg.norm(shown(found) - shown(hand), axis=-1).mean(axis=1)
    return {
        "sunk before": 1000.0 * np.median(-before.min(axis=1)),
        "sunk": 1000.0 * np.median(-after.min(axis=1)),
        "deepest": 1000.0 * np.max(-after.min(axis=1)),
        "open pads": np.mean(np.abs(pads[began < 0.015]) > 0.002),
        "error": errors[1].mean() / errors[0].mean(),
        "farther": np.mean(errors[1] > errors[0]),
        "in the picture": np.mean(moved / np.ptp(shown(true), axis=1).max(axis=1)),
        "place": 1000.0 * np.abs(found.transl - hand.transl).max(),
    }


@pytest.mark.parametrize("side", SIDES)
@pytest.mark.parametrize("kind", KINDS)
def test_made_grasps_come_back(kind: str, side: Side) -> None:
    """A sharp edge lies between two vertices of the skin. Noise of single bends leaves more open about a ball
    than a capture's noise, which is mostly depth."""
    names = ("sunk", "deepest", "open pads", "error", "farther", "in the picture", "place")
    most = {
        "cylinder": (0.3, 1.5, 0.05, 0.70, 0.1, 0.03, 0.0),
        "box": (1.5, 2.5, 0.05, 0.90, 0.3, 0.04, 4.0),
        "ball": (0.4, 2.0, 0.05, 0.98, 0.4, 0.03, 0.0),
    }
    found = figures(kind, side)
    assert found["sunk before"] > 6.0
    for name, limit in zip(names, most[kind], strict=True):
        assert found[name] <= limit, name


def test_distances_are_the_shapes_own() -> None:
    """Also where triangles are slivers, or hundreds of metres long."""
    points = np.random.default_rng(0).uniform(-0.05, 0.05, (2000, 3))
    for shape in (shape_of("cylinder", np.zeros(3)), box((0.018, 30.0, 500.0), np.zeros(3))):
        triangles = outward(shape.vertices, shape.triangles)
        surface = PropSurface(shape.vertices, triangles, np.full(3, -0.1), np.full(3, 0.1))
        assert len(surface) < 5000
        found, out = surface.gaps(points)
        np.testing.assert_allclose(found, shape.distances(points), atol=2e-4)
        farther = surface.gaps(points + 1e-6 * out)[0]
        assert np.mean(np.abs(farther - found - 1e-6) < 1e-8) > 0.99


def test_the_gradient_is_the_costs() -> None:
    """Against finite differences of the cost, by the root, the place, and all angles."""
    shape, angles = grasp("ball", "right", np.zeros(10))
    hand = hand_of("right", np.zeros(10), pose_of("right", noisy(angles, 1, seed=2)))
    fitter = fitter_of(model_of("right"))
    state = fitter.chain.state(np.zeros((1, 10)), *hand.pose, np.zeros(1))
    surface = PropSurface(shape.vertices + PLACE, shape.triangles, PLACE - 0.3, PLACE + 0.3)
    skin = GripPoints.skin(fitter.model, np.zeros(10))
    spheres = GripPoints.spheres(fitter.model, np.zeros(10))
    for points, tolerance in ((spheres, 1e-4), (skin.select(np.arange(0, 1609, 40)), 0.2)):
        drawn = np.full((1, 10), 0.5)
        aim = Grip(surface, points, np.eye(3)[None], np.zeros((1, 3)), drawn, state, within=0.02)
        seen = observation_of(landmarks_of_pose(fitter.chain.points(state), CAMERA), CAMERA)
        problem = Problem(fitter.chain, replace(seen, grip=aim), (reprojection, grip, near_wrist))
        found = problem.blocks(state)
        gradient = np.concatenate([found.hand[0, :, -1], found.finger[0, ..., -1].reshape(-1)])
        step = 1e-6 * np.concatenate([np.eye(52), -np.eye(52)])
        moved = State.concatenate([state.moved(s[None, :7], s[None, 7:].reshape(1, 5, 9)) for s in step])
        cost = problem.select(np.zeros(104, dtype=int)).blocks(moved).cost
        expected = (cost[:52] - cost[52:]) / 4e-6
        assert np.abs(expected).max() > 100.0
        assert np.linalg.norm(gradient - expected) < tolerance * np.linalg.norm(expected)


def ball() -> tuple[RefineHand, Shape]:
    shape, angles = grasp("ball", "right", np.zeros(10))
    return hand_of("right", np.zeros(10), pose_of("right", noisy(angles, 2, seed=1))), shape


def unchanged(hand: RefineHand, prop: Prop, joints: list[int] | slice = slice(None)) -> None:
    found = refit_grip(hand, prop)
    for name in POSE_ARRAYS:
        those = joints if name == "hand_pose" else slice(None)
        each, own = (getattr(one, name).reshape(len(hand), -1, 3)[:, those] for one in (found, hand))
        np.testing.assert_array_equal(each, own)


def test_what_is_out_of_reach_stays() -> None:
    hand, shape = ball()
    far = replace(shape, vertices=shape.vertices + [0.0, -0.3, 0.0])
    unchanged(hand, prop_of(far, 2))
    unchanged(hand, prop_of(replace(far, vertices=far.vertices + [0.0, 5.0, 0.0]), 2))
    unchanged(replace(hand, locked=locked(*range(16))), prop_of(shape, 2))
    only = np.array([False, True, False, False, False])
    unchanged(hand, prop_of(shape, 2, fingers=only), [j - 1 for j in range(4, 16)])
    missing = replace(hand, hand_pose=np.where([[True], [False]], hand.hand_pose, np.nan))
    found = refit_grip(missing, prop_of(shape, 2))
    assert np.isfinite(found.hand_pose[0]).all()
    assert np.isnan(found.hand_pose[1]).all()


def test_faces_may_be_reversed_or_missing() -> None:
    """A mesh with reversed faces, one that is open at one end, and a moved one of many faces do the same. A
    part that is reversed by itself is turned round."""
    hand, shape = ball()
    expected = refit_grip(hand, prop_of(shape, 2)).hand_pose
    np.testing.assert_allclose(
        refit_grip(hand, prop_of(replace(shape, triangles=shape.triangles[:, ::-1]), 2)).hand_pose,
        expected,
        atol=1e-9,
    )
    both = np.concatenate([shape.triangles, len(shape.vertices) + shape.triangles[:, ::-1]])
    twice = np.concatenate([shape.vertices, shape.vertices + 0.5])
    np.testing.assert_array_equal(
        outward(twice, both)[len(shape.triangles) :, ::-1], both[len(shape.triangles) :]
    )
    opened = replace(
        shape, triangles=shape.triangles[(shape.triangles != len(shape.vertices) - 1).all(axis=1)]
    )
    np.testing.assert_allclose(refit_grip(hand, prop_of(opened, 2)).hand_pose, expected, atol=0.02)
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    placed = np.tile(np.column_stack([turn, PLACE]), (2, 1, 1))
    moved = Prop(shape.vertices @ turn, shape.triangles, placed)
    np.testing.assert_allclose(refit_grip(hand, moved).hand_pose, expected, atol=1e-3)


def test_the_wrist_leaves_a_prop_in_the_palm() -> None:
    hand, shape = ball()
    sunk = replace(shape, vertices=shape.vertices + [0.0, 0.004, 0.0])
    found = refit_grip(hand, prop_of(sunk, 2))
    ways = np.linalg.norm(found.transl - hand.transl, axis=1)
    assert (ways > 0.0).all()
    assert (ways < 0.006).all()
    with pytest.raises(OptionError, match="inside the palm"):
        refit_grip(hand, prop_of(replace(shape, vertices=shape.vertices + [0.0, 0.02, 0.0]), 2))


def test_knuckles_do_not_bend_for_what_is_far_inside_fingers() -> None:
    hand, _ = ball()
    half, knuckles = np.array([0.06, 0.1, 0.1]), joints_of(hand)[0, [5, 9, 13, 17]] - PLACE
    for deeper, refused in ((0.0, True), (0.03, False)):
        inside = box(tuple(half), knuckles.mean(axis=0) - [half[0] + 0.005 + deeper, 0.0, 0.0])
        if refused:
            with pytest.raises(OptionError, match="inside the roots of fingers"):
                refit_grip(hand, prop_of(inside, 2))
        else:
            refit_grip(hand, prop_of(inside, 2))


def test_props_that_cannot_be_held() -> None:
    hand, shape = ball()
    random = np.random.default_rng(0).random(len(shape.triangles)) < 0.3
    mixed = np.where(random[:, None], shape.triangles[:, ::-1], shape.triangles)
    sheet = np.array([[-1.0, -0.04, -1.0], [1.0, -0.04, -1.0], [1.0, -0.04, 1.0], [-1.0, -0.04, 1.0]])
    for vertices, triangles, words in (
        (shape.vertices, shape.triangles[:0], "no faces"),
        (0.0 * shape.vertices, shape.triangles, "no faces"),
        (shape.vertices, mixed, "both ways"),
        (sheet, np.array([[0, 1, 2], [0, 2, 3]]), "open"),
    ):
        with pytest.raises(OptionError, match=words):
            refit_grip(hand, prop_of(Shape(shape.distances, vertices, triangles), 2))
    for wrong in (
        lambda: replace(prop_of(shape, 2), triangles=shape.triangles + 1),
        lambda: replace(prop_of(shape, 2), placed=2.0 * prop_of(shape, 2).placed),
        lambda: refit_grip(hand, prop_of(shape, 3)),
    ):
        with pytest.raises(OptionError, match="prop"):
            wrong()


def test_grips_are_answered() -> None:
    hand, shape = ball()
    prop = prop_of(shape, 2)
    message = {"mode": "grip", "hand": to_message(hand), "prop": packed(prop)}
    found = result_from_message(answer(json.loads(json.dumps(message)), never), 2)
    np.testing.assert_allclose(found.hand_pose, refit_grip(hand, prop).hand_pose, atol=1e-4)
    with pytest.raises(HandfitError, match="prop"):
        answer({"mode": "grip", "hand": to_message(hand)}, never)
