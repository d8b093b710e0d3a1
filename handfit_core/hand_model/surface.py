"""A hand's skin as tapered capsules around its bones: how deep its parts stand in each other, and where.

A tapered capsule is what spheres cover that move along a bone while their radius changes evenly. Of two of
them, with unit axes a and b and radii that grow by k and m along these, the signed gap |p - q| - r - s is
convex in the places of p and q along the axes. Where it is least within both, the direction n from q to p
has n . a = k and n . b = -m; else it is least at an end of one of them.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import numpy as np

from handfit_core.hand_model.chain import Chain, Posed
from handfit_core.hand_model.data import HandModel
from handfit_core.hand_model.landmarks import NO_OFFSETS, bone_axes
from handfit_core.skeleton import FINGER_JOINTS, FINGERS, JOINTS_BY_FINGER, NUM_BETAS

NUM_BONES: Final = 19
"""15 bones of the fingers, three each as in `skeleton.FINGERS`, the thumb's metacarpal among them; then the
metacarpals of index, middle, ring and little finger"""
PALM: Final = 15
"""The first of those that move with the wrist"""
FINGER_OF_BONE: Final = np.array([*(b // 3 for b in range(PALM)), 1, 2, 3, 4])
LEVEL_OF_BONE: Final = np.array([*(b % 3 for b in range(PALM)), 3, 3, 3, 3])
"""Which of `chain.Posed`'s frames carries each bone: the finger's joints, and 3 for the root"""


def _may_touch(first: int, second: int) -> bool:
    """Whether parts count; those that grow together do not."""
    if second >= PALM:
        # The thumb's root and the fingers' first bones meet the palm in the flat hand, too.
        return first < PALM and (first % 3 == 2 or (first % 3 == 1 and first != 1))
    # So do the thumb's root and the next two fingers' first bones, through the web between them.
    return first // 3 != second // 3 and (first, second) not in ((0, 3), (0, 6))


PAIRS: Final = np.array(
    [(i, j) for i in range(NUM_BONES) for j in range(i + 1, NUM_BONES) if _may_touch(i, j)]
)
"""(P, 2) bones that can touch, the lower first"""


@dataclass(frozen=True, eq=False)
class Capsules:
    """Tapered capsules of B hands. Metres, in the frame that the hands are in."""

    ends: np.ndarray
    """(B, 19, 2, 3) both ends of the axes, the nearer to the wrist first"""
    radii: np.ndarray
    """(B, 19, 2) at these ends"""
    grown: np.ndarray
    """(B, P) metres, 0 or less: gaps of `PAIRS` in the flat hand, where fingers side by side grow out of
    the palm. So much does not count"""


@dataclass(frozen=True, eq=False)
class Near:
    """K pairs of parts, each where they are nearest to each other."""

    hand: np.ndarray
    """(K,) rows of the batch"""
    pair: np.ndarray
    """(K,) which of `PAIRS`"""
    places: np.ndarray
    """(K, 2, 3) metres, on the two axes: centres of the spheres that are nearest"""
    towards: np.ndarray
    """(K, 3) unit vectors from the second's to the first's"""
    gap: np.ndarray
    """(K,) metres between the skins; negative where they overlap"""

    @property
    def bones(self) -> np.ndarray:
        """(K, 2)"""
        return PAIRS[self.pair]


class Surface:
    """The collision shape of a hand model, measured on its own mesh; it follows the shape (betas)."""

    def __init__(self, model: HandModel) -> None:
        self._chain = Chain(model, NO_OFFSETS)
        mean = _measured(model, np.zeros(NUM_BETAS))
        steps = [_measured(model, beta) for beta in np.eye(NUM_BETAS)]
        # All but linear in the shape, since joints and skin are linear in it.
        self._ends, self._radii = mean
        self._end_dirs = np.stack([ends - mean[0] for ends, _ in steps], axis=-1)  # (19, 2, 3, 10)
        self._radius_dirs = np.stack([radii - mean[1] for _, radii in steps], axis=-1)  # (19, 2, 10)
        self._flat, self._flat_dirs = np.zeros(len(PAIRS)), np.zeros((len(PAIRS), NUM_BETAS))
        betas = np.concatenate([np.zeros((1, NUM_BETAS)), np.eye(NUM_BETAS)])
        flat = self.of(betas, np.zeros((len(betas), 45)))
        gaps = self.near(flat, np.inf).gap.reshape(len(betas), -1)
        self._flat, self._flat_dirs = gaps[0], (gaps[1:] - gaps[0]).T

    def of(self, betas: np.ndarray, hand_pose: np.ndarray) -> Capsules:
        """The capsules of B hands whose wrist does not turn: betas (B, 10), hand_pose (B, 45) radians."""
        zero = np.zeros((len(betas), 3))
        return self.capsules(self._chain.pose(self._chain.state(betas, zero, hand_pose, zero, zero[:, 0])))

    def capsules(self, posed: Posed) -> Capsules:
        """The capsules of B posed hands."""
        betas = posed.state.betas
        batch = len(betas)
        # Frames' columns are those of three joints and the root.
        frames = posed.frames.reshape(batch, 5, 3, 4, 3)[:, FINGER_OF_BONE, :, LEVEL_OF_BONE]  # (19, B, 3, 3)
        origins = posed.origins[:, FINGER_OF_BONE, LEVEL_OF_BONE]  # (B, 19, 3)
        local = self._ends + (self._end_dirs.reshape(-1, NUM_BETAS) @ betas.T).T.reshape(
            batch, NUM_BONES, 2, 3
        )
        ends = origins[:, :, None] + local @ frames.transpose(1, 0, 3, 2)
        radii = self._radii + (self._radius_dirs @ betas.T).transpose(2, 0, 1)
        return Capsules(ends, radii, np.minimum(self._flat + betas @ self._flat_dirs.T, 0.0))

    def depths(self, capsules: Capsules) -> np.ndarray:
        """(B,) metres: how deep the deepest two parts of each hand stand in each other; 0 where none do."""
        near = self.near(capsules)
        deepest = np.zeros(len(capsules.ends))
        np.maximum.at(deepest, near.hand, -near.gap)
        return deepest

    def near(self, capsules: Capsules, within: float = 0.0) -> Near:
        """The pairs whose skins are no farther apart than `within` metres. How deep parts stand in each other
        in the flat hand, where fingers grow out of the palm side by side, does not count."""
        ends, radii = capsules.ends, capsules.radii
        middle, half = ends.mean(axis=2), np.linalg.norm(ends[:, :, 1] - ends[:, :, 0], axis=-1) / 2.0
        reach = half + radii.max(axis=2)
        first, second = PAIRS.T
        apart = np.linalg.norm(middle[:, first] - middle[:, second], axis=-1)
        hand, pair = np.nonzero(apart < reach[:, first] + reach[:, second] + within)
        near = self.gaps(capsules, hand, pair)
        kept = near.gap < within
        return Near(*(getattr(near, name)[kept] for name in Near.__dataclass_fields__))

    def gaps(self, capsules: Capsules, hand: np.ndarray, pair: np.ndarray) -> Near:
        """Those pairs (K,), as numbered in `PAIRS`, of those hands (K,), however far they are apart."""
        ends, radii = capsules.ends, capsules.radii
        a, b = PAIRS[pair].T
        parts = ends[hand, a], radii[hand, a], ends[hand, b], radii[hand, b]
        places, gap = gaps_along(*parts, _nearest(*parts))
        towards = places[:, 0] - places[:, 1]
        towards /= np.maximum(np.linalg.norm(towards, axis=1, keepdims=True), 1e-9)
        return Near(hand, pair, places, towards, gap - capsules.grown[hand, pair])


@lru_cache(maxsize=8)
def surface_of(model: HandModel) -> Surface:
    """Kept between calls, as fitters are."""
    return Surface(model)


def _nearest(ends_a: np.ndarray, radii_a: np.ndarray, ends_b: np.ndarray, radii_b: np.ndarray) -> np.ndarray:
    """(K, 2) how far along their axes, 0..1, capsules are nearest to each other: ends (K, 2, 3) and radii
    (K, 2) of both."""
    starts = ends_a[:, 0], ends_b[:, 0]
    lengths, axes, tapers = [], [], []
    for ends, radii in ((ends_a, radii_a), (ends_b, radii_b)):
        axis = ends[:, 1] - ends[:, 0]
        length = np.linalg.norm(axis, axis=1)
        lengths.append(length)
        axes.append(axis / length[:, None])
        tapers.append((radii[:, 1] - radii[:, 0]) / length)

    def along(which: int, point: np.ndarray) -> np.ndarray:
        """Metres along one axis to where its skin is nearest to a point (K, 3)."""
        off = point - starts[which]
        foot = (off * axes[which]).sum(axis=1)
        height = np.sqrt(np.maximum((off * off).sum(axis=1) - foot**2, 0.0))
        taper = tapers[which]
        return np.clip(foot + height * taper / np.sqrt(1.0 - taper**2), 0.0, lengths[which])

    tried = []
    for end in (0, 1):
        tried.append((lengths[0] * end, along(1, ends_a[:, end])))
        tried.append((along(0, ends_b[:, end]), lengths[1] * end))
    tried.append(_within(starts[0] - starts[1], axes[0], axes[1], tapers[0], tapers[1]))
    best, least = np.zeros((len(ends_a), 2)), np.full(len(ends_a), np.inf)
    for s, t in tried:
        inside = (s >= 0.0) & (s <= lengths[0]) & (t >= 0.0) & (t <= lengths[1])
        there = np.stack([s / lengths[0], t / lengths[1]], axis=1)
        there[~inside] = 0.0
        _, gap = gaps_along(ends_a, radii_a, ends_b, radii_b, there)
        better = inside & (gap < least)
        best[better], least[better] = there[better], gap[better]
    return best


@np.errstate(all="ignore")
def _within(
    off: np.ndarray, a: np.ndarray, b: np.ndarray, k: np.ndarray, m: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Metres along two axes, from starts that are `off` (K, 3) apart, where the gap is least if they had no
    ends; NaN where it is least nowhere, as along parallel ones."""
    cos = (a * b).sum(axis=1)
    sin2 = 1.0 - cos**2
    normal = np.cross(a, b)
    # n = x a + y b + z a x b, with n . a = k, n . b = -m and |n| = 1.
    x, y = (k + m * cos) / sin2, (-m - k * cos) / sin2
    z = np.sqrt((1.0 - k * x + m * y) / sin2) * np.sign((off * normal).sum(axis=1))
    n = x[:, None] * a + y[:, None] * b + z[:, None] * normal
    # off + s a - t b = d n
    d = (off * normal).sum(axis=1) / (n * normal).sum(axis=1)
    rest = d[:, None] * n - off
    of_a, of_b = (rest * a).sum(axis=1), (rest * b).sum(axis=1)
    return (of_a - cos * of_b) / sin2, (cos * of_a - of_b) / sin2


def gaps_along(
    ends_a: np.ndarray, radii_a: np.ndarray, ends_b: np.ndarray, radii_b: np.ndarray, along: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Places (K, 2, 3) on both axes, `along` (K, 2) of them, and the gaps (K,) between the spheres there."""
    share = np.stack([1.0 - along, along], axis=-1)  # (K, 2 capsules, 2 ends)
    places = np.stack(
        [(ends_a * share[:, 0, :, None]).sum(axis=1), (ends_b * share[:, 1, :, None]).sum(axis=1)], axis=1
    )
    radii = (radii_a * share[:, 0]).sum(axis=1) + (radii_b * share[:, 1]).sum(axis=1)
    return places, np.linalg.norm(places[:, 0] - places[:, 1], axis=1) - radii


_SECTIONS: Final = np.array([(0.1, 0.5), (0.5, 0.9)])
"""Between which parts of a bone its skin is measured; what the two say is carried on to its ends"""
_OF_PALM: Final = np.array([(0.3, 0.65), (0.65, 0.95)])
"""The same of metacarpals, from the wrist on"""
_ROOT_OF_THUMB: Final = 1.1
"""How much thicker the thumb is where it leaves the palm, of which its skin there is a part"""
_METACARPAL: Final = np.array([0.25, 0.85])
"""Parts of the way from the wrist to a knuckle between which the palm's capsules lie: their round ends reach
farther"""
_PALM_STRIP: Final = 0.006
"""metres to both sides of a metacarpal in which the palm's thickness is measured"""


def _measured(model: HandModel, betas: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Ends (19, 2, 3) in the axes of the bones' frames, from the joint that each starts at (metacarpals: the
    wrist), and radii (19, 2), metres, of the flat hand's mesh."""
    shaped, axes = model.shaped(betas), bone_axes(model)
    owner = model.weights.argmax(axis=1)
    ends, radii = np.zeros((NUM_BONES, 2, 3)), np.empty((NUM_BONES, 2))
    for f, joints in enumerate(JOINTS_BY_FINGER):
        beyond = [*shaped.joints[joints[1:]], shaped.tips[f]]
        for bone, joint, end in zip(range(3 * f, 3 * f + 3), joints, beyond, strict=True):
            here = shaped.joints[joint]
            length = np.linalg.norm(end - here)
            skin = (shaped.vertices[owner == joint] - here) @ axes[joint]
            middle, radius = _sections(skin[:, 1:], -skin[:, 0] / length, _SECTIONS)
            # A fingertip lies on the skin, so that the axis ends before it.
            at = np.array([0.0, 1.0 if bone % 3 < 2 else 1.0 - radius.mean() / length])
            ends[bone, :, 0] = -at * length
            ends[bone, :, 1:], radii[bone] = (_carried_on(part, _SECTIONS, at) for part in (middle, radius))
    ends[0, :, 1:], radii[0] = ends[1, 0, 1:], radii[1, 0] * np.array([_ROOT_OF_THUMB, 1.0])
    palm = shaped.vertices[owner == 0] - shaped.joints[0]
    for bone, finger in enumerate(FINGERS[1:], PALM):
        knuckle = shaped.joints[FINGER_JOINTS[finger][0]] - shaped.joints[0]
        across = np.cross(knuckle, [0.0, 1.0, 0.0])
        back = np.cross(across, knuckle)
        across, back = across / np.linalg.norm(across), back / np.linalg.norm(back)
        strip = palm[np.abs(palm @ across) < _PALM_STRIP]
        along = strip @ knuckle / (knuckle @ knuckle)
        middle, radius = _sections((strip @ back)[:, None], along, _OF_PALM)
        off, radii[bone] = (_carried_on(part, _OF_PALM, _METACARPAL) for part in (middle, radius))
        ends[bone] = np.outer(_METACARPAL, knuckle) + off * back
    return ends, radii


def _sections(across: np.ndarray, along: np.ndarray, spans: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Middles (2, d) and mean radii (2,) of the skin (N, d) in two spans of a bone, `along` (N,) of its
    length."""
    parts = [across[(along >= first) & (along < last)] for first, last in spans]
    low, high = (np.array([pick(part, axis=0) for part in parts]) for pick in (np.min, np.max))
    return (low + high) / 2.0, (high - low).mean(axis=1) / 2.0


def _carried_on(values: np.ndarray, spans: np.ndarray, to: np.ndarray) -> np.ndarray:
    """Values (2, ...) of the middles of two spans, at other places (2,)."""
    first, second = spans.mean(axis=1)
    slope = ((to - first) / (second - first)).reshape(2, *[1] * (values.ndim - 1))
    return values[0] + slope * (values[1] - values[0])
