"""Closed hands: finger spelling, fists, grips and fingertips that touch, as data for one solver.

A recipe says how far fingers are bent and what touches what. `reach` brings it together from a hand that is
still open where parts come last, so that a thumb gets under fingers before they close. Angles are a right
hand's.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from handfit_core.hand_model.surface import PAIRS, PALM, surface_of
from handfit_core.skeleton import FINGER_JOINTS, FINGERS

from .contact import capsules, overlaps
from .kinematics import RightHand, hand_pose_from_angles, model_of, right_limits, within_limits
from .poses import FAN, LONG, bent, with_play
from .reach import fingers_mask, reach

NEAR: Final = 0.004
"""metres within which skins touch that are to touch"""
DEEPEST: Final = 0.004
"""metres by which skin may give"""
_THUMBS_TRIED: Final = 300
_TRIES: Final = 8
_PLACE: Final = 0.2
"""What it counts to touch at the right place, against touching at all"""
_IN_PALM: Final = np.flatnonzero((PAIRS[:, 0] == 1) & (PAIRS[:, 1] >= PALM))
"""Of `PAIRS`: the thumb's first bone and the palm, which `contact.overlaps` does not see"""
_STILL_OPEN: Final = 0.3
"""Of the bends of the parts that close last, where the solver starts"""

_BENDS: Final = {
    "s": ((-4, 10), (0, 10)),  # straight
    "b": ((20, 45), (0, 12)),  # straight, bent at the knuckle
    "f": ((50, 70), (0, 15)),  # straight, bent so far forward that a thumb gets beside its first bone
    "r": ((30, 50), (35, 55)),  # round
    "l": ((50, 66), (60, 80)),  # loosely curled
    "c": ((70, 86), (86, 100)),  # curled
    "d": ((70, 86), (55, 80)),  # draped over the thumb
    "u": ((76, 86), (55, 80)),  # the same, bent farther at the knuckle, so that the thumb stays under it
    "e": ((25, 45), (88, 100)),  # claws, the tips at the knuckles
    "o": ((58, 74), (92, 102)),  # curled, with room for a thumb before it
    "x": ((8, 18), (2, 12)),  # in front of a crossed finger
    "y": ((-14, -4), (10, 25)),  # behind it
    "h": ((0, 25), (75, 98)),  # a hook
}
"""Least and most degrees of knuckle and middle joint"""
_THUMBS: Final = {
    "out": ((-16, 4), (-4, 14), (-5, 12), (-8, 12)),
    "beside": ((0, 8), (-4, 8), (0, 20), (0, 30)),
    "across": ((24, 44), (4, 14), (30, 50), (25, 55)),
    "over": ((0, 30), (10, 28), (45, 54), (60, 80)),
    "up": ((0, 25), (12, 28), (0, 25), (0, 25)),
    "opposed": ((14, 26), (-12, 0), (10, 30), (15, 45)),
}
"""Least and most degrees of the thumb's first bend, its spread, and the other bends"""


@dataclass(frozen=True)
class Touch:
    """The end of a finger on a bone's skin."""

    finger: str
    bone: int
    """Of `contact.SEGMENTS`"""
    side: str | None = None
    """"palm", "back", "thumb" or "little": of the bone. None: wherever it is nearest"""
    along: float | None = None
    """Where on the bone, 0 to 1; None: anywhere"""


@dataclass(frozen=True)
class Recipe:
    """One closed hand."""

    fingers: str
    """A letter of `_BENDS` for each of index, middle, ring and little finger"""
    thumb: str
    touches: tuple[Touch, ...] = ()
    last: tuple[str, ...] = ("thumb",)
    """What closes last"""
    giving: tuple[str, ...] = ()
    """Other fingers that make room"""
    fan: tuple[float, float] = (0.0, 0.1)
    """Least and most of the fingers' spread"""
    spreads: tuple[float, ...] = ()
    """Degrees of the four fingers' spread instead"""


def _bone(finger: str, part: int) -> int:
    return 3 * FINGERS.index(finger) + part


def _tips(*fingers: str) -> tuple[Touch, ...]:
    """These fingers' ends and the thumb's."""
    return tuple(Touch(finger, _bone("thumb", 2)) for finger in fingers)


def _thumb_on(finger: str, part: int, side: str, along: float = 0.5) -> tuple[Touch, ...]:
    return (Touch("thumb", _bone(finger, part), side, along),)


_BESIDE, _OVER = _thumb_on("index", 1, "thumb", 0.3), _thumb_on("middle", 1, "back", 0.5)

_PAIR: Final = ("index", "middle")

CLOSED: Final[dict[str, Recipe]] = {
    "A": Recipe("cccc", "beside", _BESIDE),
    "B": Recipe("ssss", "across"),
    "C": Recipe("rrrr", "opposed"),
    "D": Recipe("srrl", "opposed", _tips("middle", "ring"), LONG),
    "E": Recipe("eeee", "across", _tips("index", "middle", "ring"), LONG),
    "F": Recipe("rsss", "opposed", _tips("index"), fan=(0.2, 0.9)),
    "G": Recipe("bccc", "beside", _thumb_on("middle", 1, "thumb", 0.3)),
    "H": Recipe("sscc", "across", _thumb_on("ring", 1, "back", 0.3)),
    "I": Recipe("oocs", "over", _OVER, giving=_PAIR),
    "K": Recipe("sfcc", "up", _thumb_on("middle", 0, "thumb", 0.8), giving=_PAIR, fan=(0.2, 0.6)),
    "L": Recipe("sccc", "out"),
    "M": Recipe("dddc", "across", _thumb_on("ring", 1, "palm", 0.3), LONG),
    "N": Recipe("uucc", "across", _thumb_on("middle", 1, "palm", 0.6), LONG),
    "O": Recipe("rrrr", "opposed", _tips("index", "middle")),
    "P": Recipe("bfcc", "up", _thumb_on("middle", 0, "thumb", 0.9), giving=_PAIR, fan=(0.2, 0.6)),
    "Q": Recipe("bccc", "opposed"),
    "R": Recipe(
        "xycc", "across", _thumb_on("ring", 1, "back", 0.3), giving=_PAIR, spreads=(-14.0, 14.0, 0.0, 0.0)
    ),
    "S": Recipe("oocc", "over", _OVER, giving=_PAIR),
    "T": Recipe("dccc", "across", _thumb_on("index", 1, "palm", 0.3), LONG),
    "U": Recipe("sscc", "across", _thumb_on("ring", 1, "back", 0.4)),
    "V": Recipe("sscc", "across", _thumb_on("ring", 1, "back", 0.4), fan=(0.6, 1.0)),
    "W": Recipe("sssr", "across", _tips("little"), ("thumb", "little"), fan=(0.4, 1.0)),
    "X": Recipe("hocc", "over", _thumb_on("middle", 1, "back", 0.4), giving=("middle",)),
    "Y": Recipe("cccs", "out", fan=(0.6, 1.0)),
    "thumb over a fist": Recipe("oocc", "over", _thumb_on("index", 1, "back", 0.6), giving=_PAIR),
    "loose fist": Recipe("llll", "across", _thumb_on("index", 1, "back", 0.8)),
    "thumb in a fist": Recipe("cccc", "across", _thumb_on("middle", 1, "palm", 0.8), LONG),
    "loose over thumb": Recipe("llll", "across", (), LONG),
    "key": Recipe("lllc", "beside", _thumb_on("index", 1, "thumb", 0.6)),
    "pen": Recipe("rrll", "opposed", (*_tips("index"), *_thumb_on("middle", 2, "thumb", 0.6))),
    "thumb and middle": Recipe("srss", "opposed", _tips("middle"), fan=(0.1, 0.7)),
    "thumb and ring": Recipe("ssrs", "opposed", _tips("ring"), fan=(0.1, 0.7)),
    "three tips": Recipe("rrll", "opposed", _tips("index", "middle")),
    "thumb off a fist": Recipe("cccc", "out"),
    "middle curled": Recipe("scss", "out", fan=(0.1, 0.6)),
    "ring curled": Recipe("sscs", "out", fan=(0.1, 0.6)),
}
"""Kind of pose -> its recipe; the letters are the ASL finger alphabet's"""


def closed_pose(kind: str, hand: RightHand, rng: np.random.Generator) -> np.ndarray:
    """(15, 3) angles in radians of a pose of that `kind` (a key of `CLOSED`), within the active ranges: the
    first of several draws in which all touches and nothing cuts, else the best."""
    best, off = np.zeros((15, 3)), np.inf
    for _ in range(_TRIES):
        angles = _drawn(CLOSED[kind], hand, rng)
        found = faults(kind, hand, angles)
        if found < off:
            best, off = angles, found
        if off <= 1.0:
            break
    return best


def faults(kind: str, hand: RightHand, angles: np.ndarray) -> float:
    """What is worst about a pose: a gap where it should touch, in `NEAR`, or a cut, in `DEEPEST`; ten more
    where it touches a bone on another side."""
    points = hand.keypoints(angles)
    gaps, _, right = _misses(CLOSED[kind].touches, points[None], hand.scale)
    surface = surface_of(model_of("right"))
    depth = surface.depths(surface.of(hand.betas[None], hand_pose_from_angles(angles, "right")[None]))[0]
    return float(max(gaps.max(initial=0.0) / NEAR, depth / DEEPEST)) + 10.0 * (not right.all())


def _drawn(recipe: Recipe, hand: RightHand, rng: np.random.Generator) -> np.ndarray:
    def between(low: float, high: float) -> float:
        return float(rng.uniform(low, high))

    bends = {}
    for finger, letter in zip(LONG, recipe.fingers, strict=True):
        knuckle, middle = (between(*ends) for ends in _BENDS[letter])
        bends[finger] = bent(finger, knuckle, middle, rng)
    first, spread, second, third = (between(*ends) for ends in _THUMBS[recipe.thumb])
    fan = 17.0 * between(*recipe.fan)
    spreads = {f: fan * FAN[f] + rng.normal(0, 1.0) for f in LONG}
    spreads |= dict(zip(LONG, recipe.spreads, strict=False))
    wanted = within_limits(
        with_play({**bends, "thumb": (first, second, third)}, {**spreads, "thumb": spread}, rng),
        right_limits(),
    )
    gap = between(-0.001, 0.002)
    touches = tuple(
        replace(t, along=None if t.along is None else t.along + between(-0.15, 0.15)) for t in recipe.touches
    )

    def miss(points: np.ndarray) -> np.ndarray:
        gaps, places, _ = _misses(touches, points, hand.scale)
        return np.concatenate([gaps - gap, _PLACE * places.reshape(len(points), -1)], axis=1)

    start = wanted.copy()
    if recipe.last == ("thumb",):
        start = _thumb_anywhere(hand, start, miss, rng)
    else:
        start[[j - 1 for f in recipe.last for j in FINGER_JOINTS[f]], 2] *= _STILL_OPEN
    moving = {*recipe.last, *recipe.giving, "thumb", *(t.finger for t in touches)}
    return reach(
        hand, start, fingers_mask(*moving), miss, wanted, right_limits(), lambda a: _in_palm(hand, a)
    )


def _in_palm(hand: RightHand, angles: np.ndarray) -> np.ndarray:
    """How deep the thumb's first bone stands in each of the palm's, (B, 4) metres; angles (B, 15, 3)."""
    surface, batch = surface_of(model_of("right")), len(angles)
    capsules = surface.of(np.repeat(hand.betas[None], batch, axis=0), hand_pose_from_angles(angles, "right"))
    rows, pairs = np.repeat(np.arange(batch), len(_IN_PALM)), np.tile(_IN_PALM, batch)
    return -surface.gaps(capsules, rows, pairs).gap.reshape(batch, -1)


def _thumb_anywhere(
    hand: RightHand,
    angles: np.ndarray,
    miss: Callable[[np.ndarray], np.ndarray],
    rng: np.random.Generator,
) -> np.ndarray:
    """Of many thumbs the one that misses and cuts least: none gets around a finger by small steps."""
    rows, limits = [j - 1 for j in FINGER_JOINTS["thumb"]], right_limits()
    trials = np.repeat(angles[None], _THUMBS_TRIED, axis=0)
    trials[1:, rows] = rng.uniform(limits.lower[rows], limits.upper[rows], (_THUMBS_TRIED - 1, 3, 3))
    points = hand.keypoints(trials)
    cut = np.concatenate([overlaps(points, hand.scale), _in_palm(hand, trials)], axis=1)
    deep = np.maximum(cut - 0.001, 0.0)
    return trials[np.argmin(np.sum(miss(points) ** 2, axis=1) + np.sum(deep**2, axis=1))]


def _misses(
    touches: tuple[Touch, ...], points: np.ndarray, scale: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of hands (B, 21, 3): the gaps between skins (B, touches) in metres, negative where they cut; how far
    ends are from where on the bone they belong (B, touches, 3); and whether they are on the right side."""
    starts, ends, radii = capsules(points, scale)
    across = points[:, 5] - points[:, 17]
    gaps = np.zeros((len(points), len(touches)))
    places, right = np.zeros((*gaps.shape, 3)), np.ones(gaps.shape, dtype=bool)
    for row, touch in enumerate(touches):
        tip, bone = _bone(touch.finger, 2), touch.bone
        along = ends[:, bone] - starts[:, bone]
        to_tip = ends[:, tip] - starts[:, bone]
        part = np.clip(np.sum(to_tip * along, -1, keepdims=True) / np.sum(along**2, -1, keepdims=True), 0, 1)
        gaps[:, row] = np.linalg.norm(to_tip - part * along, axis=-1) - radii[tip] - radii[bone]
        if touch.side is None:
            continue
        axis = along / np.linalg.norm(along, axis=-1, keepdims=True)
        away = across - axis * np.sum(across * axis, axis=-1, keepdims=True)
        away /= np.linalg.norm(away, axis=-1, keepdims=True)
        if touch.side in ("palm", "back"):
            away = np.cross(axis, away)
        away = away * (1.0 if touch.side in ("thumb", "back") else -1.0)
        on_skin = (radii[tip] + radii[bone]) * away
        places[:, row] = to_tip - (part if touch.along is None else touch.along) * along - on_skin
        right[:, row] = np.sum(to_tip * away, axis=-1) > 0.0
    return gaps, places, right
