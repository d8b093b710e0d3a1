"""A hand's skin as tapered capsules around its bones: how deep its parts penetrate each other, and where.

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

from handfit_core.common.batch import Batch
from handfit_core.common.skeleton import FINGER_JOINTS, FINGERS, JOINTS_BY_FINGER, NUM_BETAS
from handfit_core.geometry.rotations import rotmat_to_rotvec, units
from handfit_core.hand_model.anatomy import anatomical_axes, rotmats_from_angles
from handfit_core.hand_model.chain import Chain, Posed
from handfit_core.hand_model.data import HandModel
from handfit_core.hand_model.landmarks import NO_OFFSETS, bone_axes

NUM_BONES: Final = 19
"""15 bones of the fingers, three each as in `skeleton.FINGERS`, the thumb's metacarpal among them; then the
metacarpals of index, middle, ring and little finger"""
PALM: Final = 15
"""Number of the first of the bones that move with the wrist"""
FINGER_OF_BONE: Final = np.array([*(b // 3 for b in range(PALM)), 1, 2, 3, 4])
LEVEL_OF_BONE: Final = np.array([*(b % 3 for b in range(PALM)), 3, 3, 3, 3])
"""(19,) the index, among the frames of `chain.Posed`, of the one that carries each bone: 0 to 2 for the
finger's joints, and 3 for the root"""


def _may_touch(first: int, second: int) -> bool:
    """Tell whether two parts can come into contact; parts that are joined cannot."""
    if second >= PALM:
        # The thumb's root and the fingers' first bones are joined to the palm.
        return first < PALM and first % 3 > 0
    # The web joins the thumb's root to the next two fingers' first bones.
    return first // 3 != second // 3 and (first, second) not in ((0, 3), (0, 6))


PAIRS: Final = np.array(
    [(i, j) for i in range(NUM_BONES) for j in range(i + 1, NUM_BONES) if _may_touch(i, j)]
)
"""(P, 2) the pairs of bones that can touch, the lower number first"""
_COMPRESSION: Final = np.select(
    [(PAIRS == (1, PALM)).all(axis=1), (PAIRS[:, 0] == 1) & (PAIRS[:, 1] > PALM)],
    # How the web between thumb and index finger, and the palm in a fist around the thumb, are compressed
    [-0.0085, -0.006],
    0.0,
)
"""(P,) metres, negative as gaps of overlapping skins are: the compression of each pair that counts as no
overlap"""


@dataclass(frozen=True, eq=False)
class Capsules:
    """Tapered capsules around the bones of B hands, in metres, in the frame that the hands are in."""

    ends: np.ndarray
    """(B, 19, 2, 3) metres: both ends of the capsules' axes, the end nearer to the wrist first"""
    radii: np.ndarray
    """(B, 19, 2) metres: the radii at both ends"""
    rest_gap: np.ndarray
    """(B, P) metres, 0 or less: gaps of `PAIRS` that count as 0. Fingers side by side overlap in the flat
    hand, too, where they leave the palm"""

    def of(
        self, hand: np.ndarray, bones: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Return the capsules of pairs of bones (K, 2) of the hands `hand` (K,): ends (K, 2, 3) and radii
        (K, 2) of the first bones, then of the second ones, in metres."""
        a, b = bones.T
        return self.ends[hand, a], self.radii[hand, a], self.ends[hand, b], self.radii[hand, b]


@dataclass(frozen=True, eq=False)
class Near(Batch):
    """Pairs of parts of hands, K in all, each with the places where the two are nearest to each other."""

    hand: np.ndarray
    """(K,) the row of the batch in which each pair's hand stands"""
    bones: np.ndarray
    """(K, 2) the numbers of the two bones"""
    places: np.ndarray
    """(K, 2, 3) metres: the places on the two bones' axes, which are the centres of the spheres that are
    nearest"""
    towards: np.ndarray
    """(K, 3) unit vectors from the second bone's place to the first one's"""
    gap: np.ndarray
    """(K,) metres between the skins; negative where they overlap"""


class Surface:
    """The collision shape of a hand model, measured on its own mesh; it follows the shape (betas)."""

    def __init__(self, model: HandModel) -> None:
        self._chain = Chain(model, NO_OFFSETS)
        mean = _measured(model, np.zeros(NUM_BETAS))
        steps = [_measured(model, beta) for beta in np.eye(NUM_BETAS)]
        # Almost linear in the shape, since joints and skin are linear in it.
        self._ends, self._radii = mean
        self._end_dirs = np.stack([ends - mean[0] for ends, _ in steps], axis=-1)  # (19, 2, 3, 10)
        self._radius_dirs = np.stack([radii - mean[1] for _, radii in steps], axis=-1)  # (19, 2, 10)
        self._flat, self._flat_dirs = np.zeros(len(PAIRS)), np.zeros((len(PAIRS), NUM_BETAS))
        self._last: tuple[Posed, Capsules] | None = None
        betas = np.concatenate([np.zeros((1, NUM_BETAS)), np.eye(NUM_BETAS)])
        flat = self.of(betas, np.zeros((len(betas), 45)))
        gaps = self.near(flat, np.inf).gap.reshape(len(betas), -1)
        self._flat, self._flat_dirs = gaps[0], (gaps[1:] - gaps[0]).T

    def of(self, betas: np.ndarray, hand_pose: np.ndarray) -> Capsules:
        """Return the capsules of B hands whose wrist does not turn, of betas (B, 10) and hand_pose (B, 45) in
        radians."""
        zero = np.zeros((len(betas), 3))
        return self.capsules(self._chain.pose(self._chain.state(betas, zero, hand_pose, zero, zero[:, 0])))

    def radii(self, betas: np.ndarray) -> np.ndarray:
        """Return the radii (B, 19, 2) in metres, at both ends of the capsules, of hands of betas (B, 10)."""
        return self._radii + (self._radius_dirs @ betas.T).transpose(2, 0, 1)

    def capsules(self, posed: Posed) -> Capsules:
        """Return the capsules of B posed hands; the last ones are cached, as several terms need them."""
        last = self._last  # which another thread may replace
        if last is not None and last[0] is posed:
            return last[1]
        betas = posed.state.betas
        batch = len(betas)
        # Frames' columns are those of three joints and the root.
        frames = posed.frames.reshape(batch, 5, 3, 4, 3)[:, FINGER_OF_BONE, :, LEVEL_OF_BONE]  # (19, B, 3, 3)
        origins = posed.origins[:, FINGER_OF_BONE, LEVEL_OF_BONE]  # (B, 19, 3)
        local = self._ends + (self._end_dirs.reshape(-1, NUM_BETAS) @ betas.T).T.reshape(
            batch, NUM_BONES, 2, 3
        )
        ends = origins[:, :, None] + local @ frames.transpose(1, 0, 3, 2)
        radii = self.radii(betas)
        found = Capsules(ends, radii, np.minimum(self._flat + betas @ self._flat_dirs.T, _COMPRESSION))
        self._last = posed, found
        return found

    def depths(self, capsules: Capsules) -> np.ndarray:
        """Return the metres (B,) by which two parts of each hand penetrate each other at the deepest; 0 where
        none overlap."""
        near = self.near(capsules)
        deepest = np.zeros(len(capsules.ends))
        np.maximum.at(deepest, near.hand, -near.gap)
        return deepest

    def near(self, capsules: Capsules, within: float = 0.0) -> Near:
        """Find the pairs of parts whose skins are no farther apart than `within` metres; gaps are measured
        beyond `rest_gap`."""
        ends, thick = capsules.ends, capsules.radii.max(axis=-1)
        axis = (ends[:, :, 1] - ends[:, :, 0]) / 2.0
        middle = ends[:, :, 0] + axis
        reach = np.sqrt(dot(axis, axis)) + thick + within / 2.0
        first, second = PAIRS.T
        apart = middle[:, first] - middle[:, second]
        square = dot(apart, apart)
        hand, pair = np.nonzero(square < np.square(reach[:, first] + reach[:, second]))
        # The gap along the line through their middles is no larger than the nearest one.
        distance, both = np.sqrt(square[hand, pair]), PAIRS[pair]
        towards = apart[hand, pair] / np.maximum(distance, 1e-9)[:, None]
        along = np.abs(axis[hand[:, None], both] @ towards[..., None])[..., 0]
        least = distance - (along + thick[hand[:, None], both]).sum(axis=1)
        close = least < within + capsules.rest_gap[hand, pair] + 1e-9
        hand, pair = hand[close], pair[close]
        near = self.gaps(capsules, hand, pair)
        return near.select(near.gap < within)

    def gaps(self, capsules: Capsules, hand: np.ndarray, pair: np.ndarray) -> Near:
        """Return the gaps of the pairs `pair` (K,), as numbered in `PAIRS`, of the hands `hand` (K,), however
        far apart they are."""
        if not len(hand):
            return Near(hand, PAIRS[pair], np.empty((0, 2, 3)), np.empty((0, 3)), np.empty(0))
        parts = capsules.of(hand, PAIRS[pair])
        places, gap = gaps_along(*parts, nearest_along(*parts))
        return Near(hand, PAIRS[pair], places, _towards(places), gap - capsules.rest_gap[hand, pair])

    def gaps_at(self, capsules: Capsules, hand: np.ndarray, points: np.ndarray) -> Near:
        """Return the gaps between pairs of keypoints (K, 2) of the hands `hand` (K,), where keypoints are
        spheres around joints and in fingertips.

        As the second keypoint, 0 is the palm where it is nearest to the first. A negative one means the gap
        between the bones that end at both keypoints, where they are nearest to each other.
        """
        palm, whole = points[:, 1] == 0, points[:, 1] < 0
        points = np.abs(points)
        level = (points - 1) % 4
        bones, along = 3 * ((points - 1) // 4) + np.minimum(level, 2), (level == 3) * 1.0
        bones[whole] = (3 * ((points - 1) // 4) + level - 1)[whole]
        least = np.full(len(hand), np.inf)
        best, places = bones.copy(), np.empty((len(hand), 2, 3))
        for metacarpal in range(PALM, NUM_BONES) if palm.any() else (PALM,):
            bones[palm, 1] = metacarpal
            ends_a, _, ends_b, radii_b = parts = capsules.of(hand, bones)
            centre = ends_a[:, 0] + along[:, :1] * (ends_a[:, 1] - ends_a[:, 0])
            along[palm, 1] = _Axis.of(ends_b, radii_b).nearest(centre)[palm]
            along[whole] = nearest_along(*(each[whole] for each in parts))
            there, gap = gaps_along(*parts, along)
            nearer = gap < least
            least[nearer], best[nearer], places[nearer] = gap[nearer], bones[nearer], there[nearer]
        return Near(hand, best, places, _towards(places), least)


def _towards(places: np.ndarray) -> np.ndarray:
    """Return the unit vectors (K, 3) from the second of two places (K, 2, 3) to the first."""
    return units(places[:, 0] - places[:, 1])


@lru_cache(maxsize=8)
def surface_of(model: HandModel) -> Surface:
    """Return the surface of a model, which is cached."""
    return Surface(model)


def nearest_along(
    ends_a: np.ndarray, radii_a: np.ndarray, ends_b: np.ndarray, radii_b: np.ndarray
) -> np.ndarray:
    """Return how far along their axes, 0..1, pairs of capsules with these ends (K, 2, 3) and radii (K, 2) are
    nearest to each other: (K, 2)."""
    a, b = _Axis.of(ends_a, radii_a), _Axis.of(ends_b, radii_b)
    tried = np.empty((5, len(ends_a), 2))
    tried[:2, :, 0], tried[2:4, :, 1] = ((0.0,), (1.0,)), ((0.0,), (1.0,))
    tried[:2, :, 1] = b.nearest(ends_a.swapaxes(0, 1))
    tried[2:4, :, 0] = a.nearest(ends_b.swapaxes(0, 1))
    tried[4] = _inner_minimum(a, b)
    outside = ~((tried[4] >= 0.0) & (tried[4] <= 1.0)).all(axis=1)
    tried[4, outside] = tried[0, outside]
    _, gaps = gaps_along(ends_a, radii_a, ends_b, radii_b, tried)
    return tried[gaps.argmin(axis=0), np.arange(len(ends_a))]


@dataclass(frozen=True, eq=False)
class _Axis:
    """The axes of K capsules: where they begin, and how the radius changes along them."""

    start: np.ndarray
    """(K, 3) metres: the beginning of each axis"""
    unit: np.ndarray
    """(K, 3) unit vectors along the axes"""
    length: np.ndarray
    """(K,) metres: the length of each axis"""
    taper: np.ndarray
    """(K,) metres by which the radius grows per metre along the axis"""

    @classmethod
    def of(cls, ends: np.ndarray, radii: np.ndarray) -> _Axis:
        axis = ends[:, 1] - ends[:, 0]
        length = np.maximum(np.sqrt(dot(axis, axis)), 1e-9)
        taper = np.clip((radii[:, 1] - radii[:, 0]) / length, -MAX_TAPER, MAX_TAPER)
        return cls(ends[:, 0], axis / length[:, None], length, taper)

    def nearest(self, points: np.ndarray) -> np.ndarray:
        """Return how far along the axes, 0..1, the skin is nearest to points (..., K, 3): (..., K)."""
        off = points - self.start
        foot = dot(off, self.unit)
        height = np.sqrt(np.maximum(dot(off, off) - foot**2, 0.0))
        along = (foot + height * self.taper / np.sqrt(1.0 - self.taper**2)) / self.length
        return np.minimum(np.maximum(along, 0.0), 1.0)


@np.errstate(all="ignore")
def _inner_minimum(first: _Axis, second: _Axis) -> np.ndarray:
    """Return how far along both axes the gap would be least if they had no ends, (K, 2); NaN where it is
    least nowhere, as along parallel ones."""
    a, b, k, m = first.unit, second.unit, first.taper, second.taper
    off = first.start - second.start
    cos = dot(a, b)
    sin2 = 1.0 - cos**2
    normal = cross(a, b)
    # n = x a + y b + z a x b, with n . a = k, n . b = -m and |n| = 1.
    x, y = (k + m * cos) / sin2, (-m - k * cos) / sin2
    beside = dot(off, normal)
    z = np.sqrt((1.0 - k * x + m * y) / sin2) * np.sign(beside)
    # off + s a - t b = d n
    d = beside / (z * sin2)
    rest = d[:, None] * (x[:, None] * a + y[:, None] * b) - off
    of_a, of_b = dot(rest, a), dot(rest, b)
    s, t = (of_a - cos * of_b) / sin2, (cos * of_a - of_b) / sin2
    return np.stack([s / first.length, t / second.length], axis=1)


def gaps_along(
    ends_a: np.ndarray, radii_a: np.ndarray, ends_b: np.ndarray, radii_b: np.ndarray, along: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the places (..., K, 2, 3) that lie `along` (..., K, 2), 0..1, both axes, and the gaps (..., K)
    in metres between the spheres there."""
    places = np.empty((*along.shape, 3))
    for k, ends in enumerate((ends_a, ends_b)):
        places[..., k, :] = ends[:, 0] + along[..., k, None] * (ends[:, 1] - ends[:, 0])
    radii = radii_a[:, 0] + along[..., 0] * (radii_a[:, 1] - radii_a[:, 0])
    radii = radii + radii_b[:, 0] + along[..., 1] * (radii_b[:, 1] - radii_b[:, 0])
    off = places[..., 0, :] - places[..., 1, :]
    return places, np.sqrt(dot(off, off)) - radii


def dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the dot products (...,) of vectors (..., 3): NumPy's sums along so short an axis take several
    times as long."""
    return a[..., 0] * b[..., 0] + a[..., 1] * b[..., 1] + a[..., 2] * b[..., 2]


def cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the cross products a x b of vectors (..., 3): NumPy's own takes several times as long for a
    few."""
    x, y, z = (a[..., i] for i in range(3))
    u, v, w = (b[..., i] for i in range(3))
    return np.stack([y * w - z * v, z * u - x * w, x * v - y * u], axis=-1)


MAX_TAPER: Final = 0.9
"""Largest taper of a capsule: at 1, one end's sphere would contain the other's"""
_BONE_SECTIONS: Final = np.array([(0.1, 0.5), (0.5, 0.9)])
"""Two sections of a finger's bone, in parts of its length, whose skin is measured and extrapolated to its
ends"""
_PALM_SECTIONS: Final = np.array([(0.3, 0.65), (0.65, 0.95)])
"""Two sections of a metacarpal, in parts of its length from the wrist on, whose skin is measured and
extrapolated"""
_METACARPAL: Final = np.array([0.25, 0.85])
"""Parts of the way from the wrist to a knuckle between which the palm's capsules lie: their round ends reach
farther"""


def _measured(model: HandModel, betas: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Measure a model's mesh: return the ends (19, 2, 3) of all bones' capsules in the axes of the bones'
    frames, from the joint that each starts at (metacarpals: the wrist), and the radii (19, 2), in metres, of
    the flat hand's fingers, and of the palm of a fist, where its flesh rises, and where it is touched."""
    shaped, axes = model.shaped(betas), bone_axes(model)
    owner = model.weights.argmax(axis=1)
    ends, radii = np.zeros((NUM_BONES, 2, 3)), np.empty((NUM_BONES, 2))
    for f, joints in enumerate(JOINTS_BY_FINGER):
        beyond = [*shaped.joints[joints[1:]], shaped.tips[f]]
        for bone, joint, end in zip(range(3 * f, 3 * f + 3), joints, beyond, strict=True):
            here = shaped.joints[joint]
            length = np.linalg.norm(end - here)
            skin = (shaped.vertices[owner == joint] - here) @ axes[joint]
            middle, radius = _sections(skin[:, 1:], -skin[:, 0] / length, _BONE_SECTIONS)
            # A fingertip lies on the skin, so that the axis ends before it.
            at = np.array([0.0, 1.0 if bone % 3 < 2 else 1.0 - radius.mean() / length])
            ends[bone, :, 0] = -at * length
            ends[bone, :, 1:], radii[bone] = (
                _carried_on(part, _BONE_SECTIONS, at) for part in (middle, radius)
            )
    # Where the thumb leaves the palm its skin is the palm's: its radius is taken from that at its knuckle.
    ends[0, :, 1:], radii[0] = ends[1, 0, 1:], radii[1, 0] * np.array([1.1, 1.0])
    # The palm is measured on a fist with a flat thumb.
    bent = np.radians([[0.0, 0.0, bend] for _ in range(5) for bend in (75.0, 90.0, 55.0)])
    fist = rotmats_from_angles(np.where(np.arange(15)[:, None] < 12, bent, 0.0), anatomical_axes(model))
    closed = model.posed(betas, np.zeros(3), rotmat_to_rotvec(fist).reshape(45), np.zeros(3))
    palm = closed.vertices[owner == 0] - shaped.joints[0]
    for bone, finger in enumerate(FINGERS[1:], PALM):
        knuckle = shaped.joints[FINGER_JOINTS[finger][0]] - shaped.joints[0]
        across = np.cross(knuckle, [0.0, 1.0, 0.0])
        back = np.cross(across, knuckle)
        across, back = across / np.linalg.norm(across), back / np.linalg.norm(back)
        # Metres to either side of a metacarpal in which the palm's thickness is measured
        strip = palm[np.abs(palm @ across) < 0.006]
        along = strip @ knuckle / (knuckle @ knuckle)
        middle, radius = _sections((strip @ back)[:, None], along, _PALM_SECTIONS)
        off, radii[bone] = (_carried_on(part, _PALM_SECTIONS, _METACARPAL) for part in (middle, radius))
        ends[bone] = np.outer(_METACARPAL, knuckle) + off * back
    return ends, radii


def _sections(across: np.ndarray, along: np.ndarray, spans: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the middles (2, d) and the mean radii (2,) of the skin in two `spans` of a bone, from its
    vertices `across` (N, d) and how far `along` (N,) the bone they lie, in parts of its length."""
    # A model with few vertices may have none there; a bone without any skin gets a line.
    every = across if len(across) else np.zeros((1, across.shape[1]))
    parts = [across[(along >= first) & (along < last)] for first, last in spans]
    parts = [part if len(part) else every for part in parts]
    low, high = (np.array([pick(part, axis=0) for part in parts]) for pick in (np.min, np.max))
    return (low + high) / 2.0, (high - low).mean(axis=1) / 2.0


def _carried_on(values: np.ndarray, spans: np.ndarray, to: np.ndarray) -> np.ndarray:
    """Extrapolate values (2, ...), which belong to the middles of two spans, to the places `to` (2,) along
    the bone."""
    first, second = spans.mean(axis=1)
    slope = ((to - first) / (second - first)).reshape(2, *[1] * (values.ndim - 1))
    return values[0] + slope * (values[1] - values[0])
