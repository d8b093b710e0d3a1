"""What one dragged point may move, by a table of all points: other fingers only where the palm must follow.

Whether a finger can reach a pin by itself is found out here by another way than the product's: bounded
Gauss-Newton steps on the finger's nine anatomical angles from many starts, by the pin alone.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache

import numpy as np
import pytest

from handfit_core.detect.keypoints import HandDetection
from handfit_core.edit import landmark_points, refit_each
from handfit_core.edit.settings import PINS
from handfit_core.fit.settings import TERMS
from handfit_core.geometry.rotations import rotmat_to_rotvec, rotvec_to_rotmat
from handfit_core.hand_model.anatomy import (
    anatomical_angles,
    anatomical_axes,
    joint_limits,
    rotmats_from_angles,
)
from handfit_core.hand_model.motion import HandMotion
from handfit_core.hand_model.surface import FINGER_OF_BONE, PAIRS, surface_of
from handfit_core.hand_model.surface import PALM as PALM_BONES
from handfit_core.skeleton import FINGER_JOINTS, FINGERS, SIDES, Side
from tests.core.edit.test_refit import captured, distance, handles, make_hand, no_pins, shown, true_hands
from tests.core.fit.detections import CAMERA, landmarks_of, model_of, seen

Pose = tuple[np.ndarray, ...]
"""betas (1, 10), global_orient (1, 3), hand_pose (1, 45), transl (1, 3)"""
PALM = (0, 1, 5, 9, 13, 17)
FAR = (0.02, 0.1, 0.3, 0.9)
"""of the hand's size"""
LEAST = 0.01
"""of the hand's size: what other fingers may always move by"""
MOST_PER_SHORTFALL = 2.0
"""What they may move by where the palm follows, in parts of what the finger falls short of its pin. Points
nearer to the camera than the pinned one move farther in the picture."""


@dataclass(frozen=True, eq=False)
class Hand:
    """A hand seen with noise, and its capture."""

    side: Side
    detection: HandDetection
    pose: Pose

    @property
    def before(self) -> np.ndarray:
        """(21, 2) pixels"""
        return handles(self.side, self.pose)[0]

    @property
    def size(self) -> float:
        """pixels, as `handfit_core.edit.pins` measures it"""
        return float(np.ptp(self.before, axis=0).max())

    def dragged(self, keypoint: int, by: np.ndarray, guess: HandMotion | None = None) -> HandMotion:
        pins = no_pins(1)
        pins[0, keypoint] = self.before[keypoint] + by
        hand = make_hand(self.side, [self.detection], self.pose, pins)
        return refit_each(hand, guess, draft=guess is not None)


@cache
def hands() -> tuple[Hand, ...]:
    """Two of each side, bent, spread and turned at random."""
    made = []
    for side in SIDES:
        for seed, row in ((1, 1), (8, 2)):
            true = true_hands(side, 3, seed=seed)
            detection = seen(landmarks_of(side, *true)[row], side, noise=2.0, seed=seed)
            made.append(Hand(side, detection, captured(side, [detection])))
    return tuple(made)


def others(keypoint: int) -> list[int]:
    """The points of other fingers."""
    return [p for p in range(1, 21) if (p - 1) // 4 != (keypoint - 1) // 4]


def ways(keypoint: int) -> Iterator[tuple[Hand, np.ndarray]]:
    """Hands, and pixels by which to drag: near and far, in directions that differ from hand to hand."""
    for number, hand in enumerate(hands()):
        for step, far in enumerate(FAR):
            angle = 1.57 * number + 0.4 * step + keypoint
            yield hand, far * hand.size * np.array([np.cos(angle), np.sin(angle)])


def pressed(hand: Hand, keypoint: int, result: HandMotion) -> bool:
    """Whether the finger lies on another part of the hand, which keeps it from its pin: a sigma deeper than
    flesh gives, and than in the capture, where fingers that are side by side may press each other."""
    before, now = (depths_of(hand, keypoint, pose) for pose in (hand.pose[2], result.hand_pose))
    return bool((now > np.maximum(before, TERMS.compression) + TERMS.edit_penetration_sigma).any())


def depths_of(hand: Hand, keypoint: int, pose: np.ndarray) -> np.ndarray:
    """(P,) metres by which the finger stands in other parts, of all pairs; 0 of those of other fingers."""
    surface = surface_of(model_of(hand.side))
    gap = surface.near(surface.of(hand.pose[0], pose), within=np.inf).gap
    own = (FINGER_OF_BONE[PAIRS] == (keypoint - 1) // 4) & (PAIRS < PALM_BONES)
    return np.where(own.any(axis=1), -gap, 0.0)


def shortfall(hand: Hand, keypoint: int, pin: np.ndarray) -> float:
    """Pixels by which the point misses the pin (2,) at the least while the palm stays, and no joint of its
    finger leaves its range farther than it has already."""
    model = model_of(hand.side)
    betas, orient, pose, transl = hand.pose
    finger = FINGERS[(keypoint - 1) // 4]
    joints = np.array(FINGER_JOINTS[finger]) - 1
    axes, ranges = anatomical_axes(model), joint_limits(hand.side)
    own = anatomical_angles(rotvec_to_rotmat(pose.reshape(15, 3)), axes)[joints].reshape(9)
    lower, upper = ranges.lower[joints].reshape(9), ranges.upper[joints].reshape(9)

    def bounds(bend: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """A bent knuckle spreads less (docs of `residuals.limits`)."""
        narrow = np.ones((len(bend), 9))
        if finger != "thumb":
            narrow[:, 1] -= 0.7 * np.clip(bend, 0.0, np.pi / 2) / (np.pi / 2)
        return lower * narrow, upper * narrow

    least, most = (b[0] for b in bounds(own[None, 2]))
    already = np.maximum(np.maximum(own - most, least - own), 0.0)

    def clamped(angles: np.ndarray) -> np.ndarray:
        angles = np.clip(angles, lower - already, upper + already)
        least, most = bounds(angles[:, 2])
        return np.clip(angles, least - already, most + already)

    def missed(angles: np.ndarray) -> np.ndarray:
        """(N, 9) -> (N, 2) pixels"""
        poses = np.repeat(pose.reshape(1, 15, 3), len(angles), axis=0)
        poses[:, joints] = rotmat_to_rotvec(rotmats_from_angles(angles.reshape(-1, 3, 3), axes[joints]))
        first, place = (np.repeat(a, len(angles), axis=0) for a in (orient, transl))
        points = landmark_points(model, betas[0], first, poses.reshape(-1, 45), place)
        return CAMERA.project(points)[:, keypoint] - pin

    shares = np.array([(a, b) for a in (0.0, 0.3, 0.6, 0.9) for b in (0.0, 0.4, 0.8)])
    starts = np.zeros((len(shares), 9))
    starts[:, 2], starts[:, [5, 8]] = shares[:, 0] * upper[2], shares[:, 1:] * upper[[5, 8]]
    angles = clamped(np.concatenate([own[None], starts]))
    best = np.inf
    for _ in range(25):
        off = missed(angles)
        best = min(best, float(np.linalg.norm(off, axis=1).min()))
        if best < 0.1:
            break
        nudged = (angles[:, None] + 1e-4 * np.eye(9)).reshape(-1, 9)
        slope = (missed(nudged).reshape(-1, 9, 2) - off[:, None]) / 1e-4
        # Angles that are at an end of their range and are pulled beyond it stay there.
        pulled = -np.einsum("nac,nc->na", slope, off)
        stuck = clamped(angles + 1e-6 * np.sign(pulled)) == angles
        slope = np.where(stuck[..., None], 0.0, slope)
        square = np.einsum("nac,nad->ncd", slope, slope) + 1e-3 * np.eye(2)
        step = -np.einsum("nac,nc->na", slope, np.linalg.solve(square, off[..., None])[..., 0])
        angles = clamped(angles + np.clip(step, -0.3, 0.3))
    return best


@pytest.mark.parametrize("keypoint", [k for k in range(21) if k not in PALM])
def test_other_fingers_stay(keypoint: int) -> None:
    """And where it must, they move by about as much as the finger falls short, riding on it unbent. How far a
    finger gets that is pressed on another one is not known by another way; they are few."""
    stayed, on_others = 0, 0
    for hand, by in ways(keypoint):
        result = hand.dragged(keypoint, by)
        found = shown(result)[0]
        bent = (result.hand_pose != hand.pose[2]).reshape(5, 9).any(axis=1)  # fingers in MANO's order
        assert bent.sum() <= 1, (hand.side, by)
        pin = hand.before[keypoint] + by
        moved = distance(found, hand.before)[others(keypoint)].max()
        if pressed(hand, keypoint, result):
            on_others += 1
            continue
        short = shortfall(hand, keypoint, pin) if moved > LEAST * hand.size else 0.0
        assert moved <= LEAST * hand.size + MOST_PER_SHORTFALL * short, (hand.side, by)
        assert distance(found[keypoint], pin) < (1.0 if short < 1.0 else 0.03 * hand.size), (hand.side, by)
        stayed += moved < LEAST * hand.size
    assert stayed >= len(hands()), "those of the nearest drags, and more"
    assert on_others <= 2 * len(hands())  # of 16


@pytest.mark.parametrize("keypoint", PALM)
def test_points_of_the_palm_move_it(keypoint: int) -> None:
    """No finger can bring them nearer to their pins, so that all fingers ride along as they are."""
    for hand, by in ways(keypoint):
        if np.linalg.norm(by) < 0.3 * hand.size:
            found = hand.dragged(keypoint, by)
            missed = distance(shown(found)[0, keypoint], hand.before[keypoint] + by)
            assert missed < 1.0, (hand.side, by)


@pytest.mark.parametrize("keypoint", range(21))
def test_answers_do_not_hang_on_rounding(keypoint: int) -> None:
    """A pin that is moved by less than any picture shows changes no more than that, near or far; but for what
    is dragged out of its place altogether: a palm has several to turn to, and a finger that is pressed on
    another may slip to one side of it or the other. Nor where the finger hardly reaches its pin or not."""
    for hand, by in list(ways(keypoint))[keypoint % 3 :: 3]:
        if keypoint in PALM and np.linalg.norm(by) > 0.5 * hand.size:
            continue
        one, other = (hand.dragged(keypoint, by + nudge) for nudge in (0.0, 1e-4))
        if np.linalg.norm(by) > 0.5 * hand.size and pressed(hand, keypoint, one):
            continue
        missed = distance(shown(one)[0, keypoint], hand.before[keypoint] + by)
        if abs(missed - PINS.reached_pixels) < 0.1:  # the palm moves, or it does not
            continue
        between = distance(shown(one), shown(other)).max()
        assert between < max(1.0, 0.01 * hand.size), (hand.side, by)


@pytest.mark.parametrize("keypoint", [4, 8, 11, 18])
def test_drafts_hold_other_fingers_too(keypoint: int) -> None:
    """Each goes on from the one before, with few iterations."""
    for hand in hands():
        along = hand.before[keypoint] - hand.before[keypoint - 1]
        by = -0.6 * along  # towards its own finger, which bends for it
        last = None
        for share in np.linspace(0.1, 1.0, 10):
            start = hand.dragged(keypoint, 0.0 * by) if last is None else last
            last = hand.dragged(keypoint, share * by, start)
        assert last is not None
        moved = distance(shown(last)[0], hand.before)[others(keypoint)].max()
        short = shortfall(hand, keypoint, hand.before[keypoint] + by) if moved > LEAST * hand.size else 0.0
        assert moved <= LEAST * hand.size + MOST_PER_SHORTFALL * short, hand.side


@pytest.mark.parametrize("onto", [2, 3, 4])
def test_drag_over_thumb(onto: int) -> None:
    for hand in hands():
        surface = surface_of(model_of(hand.side))
        way = hand.before[onto] - hand.before[8]
        for share in (0.8, 1.0, 1.2):
            found = hand.dragged(8, share * way)
            assert surface.depths(surface.of(hand.pose[0], found.hand_pose))[0] < 0.003
            assert distance(shown(found)[0, 8], hand.before[8] + share * way) < 0.02 * hand.size
