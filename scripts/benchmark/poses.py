"""Random poses that a hand can take: open, relaxed, fists, points, pinches, signs, and anything.

Bends follow Bain et al. 2015's active ranges (`joint_limits`); the last joint of a finger follows the
one before it, DIP = a PIP + b (FACTS: index .87, -25; middle .79, -18; ring .73, -20.5).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import numpy as np

from handfit_core.common.skeleton import FINGER_JOINTS, FINGERS

from .contact import penetration
from .kinematics import RightHand, within_limits
from .reach import fingers_mask, pinch, reach, tip_distance

DIP: Final = {
    "index": (0.87, -25.0),
    "middle": (0.79, -18.0),
    "ring": (0.73, -20.5),
    "little": (0.73, -20.5),
}
LONG: Final = ("index", "middle", "ring", "little")
FAN: Final = {"index": 1.0, "middle": 0.25, "ring": -0.45, "little": -1.0}
"""Spread of the fingers when the hand opens, as fractions of the range; towards the thumb is positive"""
_THUMB_ACROSS: Final = ((24.0, 42.0, 40.0), 10.0)
"""Bends and spread of a thumb that lies across curled fingers, degrees"""

MEETING_TIPS: Final = 0.006
"""metres within which pinching fingertips meet"""
_DEEPEST: Final = 0.005
"""metres by which skin may give where fingers touch"""
_TRIES: Final = 30


def random_pose(kind: str, hand: RightHand, rng: np.random.Generator) -> np.ndarray:
    """(15, 3) angles in radians of a pose of that `kind` (a key of `POSES`), within the active ranges.

    Of several draws the first whose fingers do not cut through each other, else the best.
    """
    best, depth = None, np.inf
    for _ in range(_TRIES):
        angles = within_limits(POSES[kind](hand, rng))
        points = hand.keypoints(angles)
        if kind == "pinch" and min(tip_distance(points, finger) for finger in LONG) > MEETING_TIPS:
            continue
        found = float(penetration(points, hand.scale))
        if found < depth:
            best, depth = angles, found
        if depth < _DEEPEST:
            break
    if best is None:
        raise AssertionError(f"no {kind} within the joints' ranges: its recipe is wrong")
    return best


def with_play(
    bends: dict[str, tuple[float, float, float]], spreads: dict[str, float], rng: np.random.Generator
) -> np.ndarray:
    """Degrees per finger -> (15, 3) radians, with the play that no two hands share."""
    angles = np.zeros((15, 3))
    for finger, joints in FINGER_JOINTS.items():
        rows = [j - 1 for j in joints]
        angles[rows, 2] = bends[finger]
        angles[rows[0], 1] = spreads.get(finger, 0.0)
        angles[rows, 0] += rng.normal(0.0, 1.0, 3)
        angles[rows[1:], 1] += rng.normal(0.0, 1.0, 2)
    return np.radians(angles)


def bent(name: str, mcp: float, pip: float, rng: np.random.Generator) -> tuple[float, float, float]:
    """Knuckle and middle joint in degrees -> all three, the last one following."""
    slope, offset = DIP[name]
    return mcp, pip, max(slope * pip + offset, 0.03 * pip) + rng.normal(0.0, 3.0)


def _straight(name: str, rng: np.random.Generator) -> tuple[float, float, float]:
    return bent(name, rng.uniform(-8, 12), rng.uniform(-2, 12), rng)


def _curled(name: str, rng: np.random.Generator) -> tuple[float, float, float]:
    return bent(name, rng.uniform(68, 84), rng.uniform(84, 99), rng)


def _relaxed(name: str, rng: np.random.Generator, more: float = 0.0) -> tuple[float, float, float]:
    place = LONG.index(name)
    mcp, pip = 14 + 5 * place + more, 26 + 4 * place + 1.2 * more
    return bent(name, mcp + rng.normal(0, 5), pip + rng.normal(0, 6), rng)


def _thumb_out(rng: np.random.Generator) -> tuple[float, float, float]:
    return rng.uniform(-15, 4), rng.uniform(-5, 12), rng.uniform(-8, 12)


def _open(_: RightHand, rng: np.random.Generator) -> np.ndarray:
    fan, bend = rng.uniform(-0.15, 1.0), rng.uniform(-6, 14)
    bends = {f: bent(f, bend + rng.normal(0, 3), rng.uniform(-2, 14), rng) for f in LONG}
    spreads = {f: 17 * fan * FAN[f] + rng.normal(0, 1.5) for f in LONG}
    return with_play({**bends, "thumb": _thumb_out(rng)}, {**spreads, "thumb": rng.uniform(-4, 14)}, rng)


def _relaxed_hand(_: RightHand, rng: np.random.Generator) -> np.ndarray:
    more = rng.uniform(-10, 22)
    bends = {f: _relaxed(f, rng, more) for f in LONG}
    spreads = {f: rng.uniform(0, 5) * FAN[f] for f in LONG}
    thumb = (rng.uniform(-6, 12), rng.uniform(2, 24), rng.uniform(2, 28))
    return with_play({**bends, "thumb": thumb}, {**spreads, "thumb": rng.uniform(-6, 6)}, rng)


def _thumb_over(hand: RightHand, angles: np.ndarray, over: str, rng: np.random.Generator) -> np.ndarray:
    """Lay the thumb's tip on the outside of a curled finger's middle bone."""
    middle = 1 + 4 * FINGERS.index(over) + 1
    along = rng.uniform(0.3, 0.8)

    def miss(points: np.ndarray) -> np.ndarray:
        on_bone = (1 - along) * points[:, middle] + along * points[:, middle + 1]
        outside = np.cross(points[:, middle + 1] - points[:, middle], points[:, 17] - points[:, 5])
        outside /= np.linalg.norm(outside, axis=-1, keepdims=True)
        # Away from the palm.
        outside *= np.sign(np.sum(outside * (on_bone - points[:, 9]), axis=-1, keepdims=True))
        return 0.2 * (points[:, 4] - (on_bone + 0.017 * hand.scale * outside))

    return reach(hand, angles, fingers_mask("thumb"), miss)


def _fist(hand: RightHand, rng: np.random.Generator) -> np.ndarray:
    tight = rng.uniform(-12, 0) if rng.random() < 0.4 else 0.0
    bends = {f: _curled(f, rng) for f in LONG}
    bends = {f: (mcp + tight, pip + tight, dip) for f, (mcp, pip, dip) in bends.items()}
    spreads = {f: rng.normal(0, 1) - 1.5 * FAN[f] for f in LONG}
    angles = with_play({**bends, "thumb": _THUMB_ACROSS[0]}, {**spreads, "thumb": _THUMB_ACROSS[1]}, rng)
    if rng.random() < 0.2:  # the thumb beside the fist
        rows = [j - 1 for j in FINGER_JOINTS["thumb"]]
        angles[rows, 2] = np.radians([rng.uniform(-5, 8), rng.uniform(0, 20), rng.uniform(0, 30)])
        return angles
    return _thumb_over(hand, angles, "index", rng)


def _raised(hand: RightHand, up: tuple[str, ...], rng: np.random.Generator) -> np.ndarray:
    """Some fingers straight, the others curled, the thumb over them or out."""
    bends = {f: _straight(f, rng) if f in up else _curled(f, rng) for f in LONG}
    fan = rng.uniform(0.0, 0.9)
    spreads = {f: 17 * fan * FAN[f] if f in up else rng.normal(0, 1) for f in LONG}
    thumb = _thumb_out(rng) if "thumb" in up else _THUMB_ACROSS[0]
    spread = rng.uniform(-2, 12) if "thumb" in up else _THUMB_ACROSS[1]
    angles = with_play({**bends, "thumb": thumb}, {**spreads, "thumb": spread}, rng)
    curled = [f for f in ("index", "middle", "ring") if f not in up]
    if "thumb" in up or not curled:
        return angles
    return _thumb_over(hand, within_limits(angles), curled[0], rng)


def _point(hand: RightHand, rng: np.random.Generator) -> np.ndarray:
    return _raised(hand, ("index", "thumb") if rng.random() < 0.35 else ("index",), rng)


_SIGNS: Final = (
    ("index", "middle"),
    ("index", "middle", "ring"),
    ("index", "middle", "ring", "little"),
    ("thumb",),
    ("thumb", "little"),
    ("thumb", "index", "little"),
    ("index", "little"),
    ("thumb", "index", "middle"),
    ("little",),
)


def _sign(hand: RightHand, rng: np.random.Generator) -> np.ndarray:
    return _raised(hand, _SIGNS[rng.integers(len(_SIGNS))], rng)


def _pinch(hand: RightHand, rng: np.random.Generator) -> np.ndarray:
    fingers = [("index",), ("index",), ("middle",), ("ring",), ("index", "middle")][rng.integers(5)]
    more = rng.uniform(-8, 30)
    bends = {f: _relaxed(f, rng, more) for f in LONG}
    if rng.random() < 0.4:  # the O.K. sign
        bends = {f: _straight(f, rng) for f in LONG}
    for finger in fingers:
        bends[finger] = bent(finger, rng.uniform(40, 60), rng.uniform(45, 65), rng)
    fan = rng.uniform(0, 0.5)
    spreads = {f: 17 * fan * FAN[f] for f in LONG if f not in fingers}
    thumb = (20 + rng.normal(0, 4), 22 + rng.normal(0, 6), 35 + rng.normal(0, 8))
    angles = within_limits(with_play({**bends, "thumb": thumb}, {**spreads, "thumb": -6.0}, rng))
    return pinch(hand, angles, fingers, gap=rng.uniform(0.001, 0.003))


def _anything(_: RightHand, rng: np.random.Generator) -> np.ndarray:
    """Every finger for itself, though neighbours pull each other along."""
    common = rng.uniform(-10, 85)
    bends, spreads = {}, {}
    for finger in LONG:
        pulled = rng.uniform(0.2, 0.8)
        mcp = pulled * common + (1 - pulled) * rng.uniform(-12, 86)
        bends[finger] = bent(finger, mcp, rng.uniform(-3, 99), rng)
        # Bent knuckles cannot spread.
        room = 17 * max(0.0, 1 - max(mcp, 0.0) / 80)
        spreads[finger] = float(np.clip(room * FAN[finger] * rng.uniform(-0.2, 1.0), -18, 18))
    thumb = (rng.uniform(-19, 32), rng.uniform(-9, 54), rng.uniform(-14, 78))
    return with_play({**bends, "thumb": thumb}, {**spreads, "thumb": rng.uniform(-19, 19)}, rng)


POSES: Final[dict[str, Callable[[RightHand, np.random.Generator], np.ndarray]]] = {
    "open": _open,
    "relaxed": _relaxed_hand,
    "fist": _fist,
    "point": _point,
    "pinch": _pinch,
    "sign": _sign,
    "random": _anything,
}
"""Kind of pose -> its recipe: a shaped hand and a random generator to (15, 3) angles in radians"""
