"""Where captured fingertips touch, the character's touch: every frame on its own, in slices.

Fingers that point as captured ones do, but are longer or begin elsewhere, do not meet where those meet. Let v be
the way from one captured fingertip to another, u the character's in metres of the captured hand, and x what its
joints turn beyond what was captured. Then x is least for

    x^T M x + sum over touches of rho |u(x) - v|^2,    rho = w / (S (1 - w + e))

within the joints' ranges. M says how unwelcome a turn is, w in 0..1 how much the two touch, and S, the mean of
the diagonal of J M^-1 J^T, how far u gives way to a turn (J = du/dx). A gap alone is then closed by about the
share w, touches that begin or end beside others pull softly, and without touch x is exactly zero. As w is smooth
in time, so is x, though no frame is told of its neighbours.
"""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import dataclass
from itertools import combinations
from typing import Final

import numpy as np

from handfit_core.geometry.rotations import euler_to_rotmat, rotmat_to_euler
from handfit_core.hand_model.anatomy import axes_of, joint_limits
from handfit_core.hand_model.axes import MIRROR_X, REST_FROM_MODEL, points_to_rest
from handfit_core.hand_model.data import HandModel
from handfit_core.hand_model.surface import cross, gaps_along, nearest_along, surface_of
from handfit_core.retarget.transfer import SourceHand, TargetHand, globally
from handfit_core.skeleton import FINGER_JOINTS, FINGERS, JOINTS_BY_FINGER, PARENTS

PAIRS: Final = np.array(list(combinations(range(len(FINGERS)), 2)))
"""(10, 2) fingers that can touch each other, those with the thumb first"""
_WITH_THUMB: Final = PAIRS[:, 0] == 0

TOUCHING: Final = (0.004, 0.012)
"""metres between skins: what is nearer than the first touches; what is farther than the second does not"""
_CROSSED: Final = (0.5, 0.8)
"""Fingers beside each other are no touch to keep. This much of the way between two fingers' skins, and more,
lies across the palm where they are beside each other; up to the first, one lies over the other"""
BLEND: Final = 0.1
"""seconds: a touch is kept for as long before and after, and fades in and out for twice as long"""

_UNWELCOME: Final = {"thumb": ((6.0, 1.0, 1.0), (6.0, 4.0, 1.0), (6.0, 4.0, 1.0))}
"""Diagonal of M of a finger's three joints: twist, spread and bend"""
_OF_FINGERS: Final = ((np.inf, 3.0, 1.0), (np.inf, np.inf, 1.0), (np.inf, np.inf, 1.5))
"""The same of the other fingers. Infinite: they do not turn so"""
_LEFT_OPEN: Final = 0.002
"""e: the share of a gap that stays open where both touch"""
import os
_P=float(os.environ.get("P_","1"))
_MOST_STEPS: Final = 30
_SMALL: Final = 1e-7
"""radians: steps that are smaller end the search"""
_AT_ONCE: Final = 64
"""frames that a slice solves"""


@dataclass(frozen=True, eq=False)
class Fingertips:
    """The last bones of a captured hand's fingers with their skins, at rest, in rest space and metres."""

    ends: np.ndarray
    """(5, 2, 3) both ends of each one's axis"""
    radii: np.ndarray
    """(5, 2) of the skin around these"""

    @classmethod
    def of(cls, model: HandModel, betas: np.ndarray) -> Fingertips:
        """Those of a hand model of shape betas (10,)."""
        flat = surface_of(model).of(betas[None], np.zeros((1, 45)))
        return cls(points_to_rest(flat.ends[0, 2:15:3]), flat.radii[0, 2:15:3])

    def mirrored(self) -> Fingertips:
        """The other hand's."""
        return Fingertips(self.ends @ MIRROR_X, self.radii)


@dataclass(frozen=True, eq=False)
class Touches:
    """Which fingertips of a captured hand touch in each of T frames."""

    weights: np.ndarray
    """(T, 10) 0..1 by `PAIRS`: how much each touch is to be kept, smooth in time; exactly 0 where none is"""
    now: np.ndarray
    """(T, 10) bool: whether the two touch in this very frame"""
    along: np.ndarray
    """(T, 10, 2) where on the axes of the two last bones, 0..1, they are nearest to each other"""
    ways: np.ndarray
    """(T, 10, 3) metres from that place of the second to the first's, in rest space, the wrist at rest"""

    def some(self, rows: np.ndarray, pairs: np.ndarray) -> Touches:
        """Some frames and pairs alone."""
        return Touches(*(getattr(self, name)[rows][:, pairs] for name in self.__dataclass_fields__))


@dataclass(frozen=True, eq=False)
class Kept:
    """A character's hand whose fingertips touch where the captured ones do, over T frames."""

    standing: np.ndarray
    """(T, K, 3, 3) how the bones stand, as `TargetHand.standing` has them; the very same numbers for fingers
    that touch nothing"""
    apart: np.ndarray
    """(T,) metres of the captured hand's scale by which fingertips that touch now stay away from where they
    touch, at the worst; 0 where none do"""
    turned: np.ndarray
    """(T,) radians by which the joint that turned most beyond what was captured did so"""


def touches(source: SourceHand, skins: Fingertips, turns: np.ndarray, times: np.ndarray) -> Touches:
    """What touches in captured hands: turns (T, 16, 3, 3) as `TargetHand.local` takes them, at times (T,) in
    seconds, rising."""
    whole = globally(turns)
    last = JOINTS_BY_FINGER[:, 2]
    joints, _ = source.points(turns)
    ends = joints[:, last, None] + np.einsum(
        "tfab,feb->tfea", whole[:, last], skins.ends - source.joints[last, None]
    )
    count = len(turns)
    radii = np.broadcast_to(skins.radii, (count, *skins.radii.shape))
    parts = [
        array[:, PAIRS[:, k]].reshape(-1, *array.shape[2:]) for k in (0, 1) for array in (ends, radii)
    ]
    along = nearest_along(*parts)
    places, gap = gaps_along(*parts, along)
    ways = (places[:, 0] - places[:, 1]).reshape(count, len(PAIRS), 3)
    first, second = (whole[:, last[PAIRS[:, k]]] for k in (0, 1))
    across = source.joints[FINGER_JOINTS["index"][0]] - source.joints[FINGER_JOINTS["little"][0]]
    beside = (first + second) @ (across / np.linalg.norm(across))
    beside = np.abs((_units(ways) * _units(beside)).sum(axis=-1))
    crossed = np.where(_WITH_THUMB, 1.0, _falling(beside, _CROSSED))
    near = _falling(gap.reshape(count, -1), TOUCHING) * crossed
    weights = _blended(near, np.asarray(times, dtype=np.float64))
    return Touches(weights, near == 1.0, along.reshape(count, -1, 2), ways)


def keeping_contacts(
    target: TargetHand, source: SourceHand, skins: Fingertips, turns: np.ndarray, times: np.ndarray
) -> Generator[float, None, Kept]:
    """Have a character's fingertips touch where captured ones do, in steps that tell how much is done, 0..1.

    `source`, `skins` and `turns` (T, 16, 3, 3) are the captured hand's, of the target's side; times (T,) in
    seconds, rising.
    """
    standing = target.standing(turns)
    apart, turned = np.zeros(len(turns)), np.zeros(len(turns))
    yield 0.0
    found = touches(source, skins, turns, times)
    yield 0.0
    chains = _Chains.of(target, source, skins)
    rows = np.flatnonzero(found.weights[:, chains.told].any(axis=1))
    for start in range(0, len(rows), _AT_ONCE):
        some = rows[start : start + _AT_ONCE]
        solved = chains.solved(standing[some], found.some(some, chains.told))
        standing[some], apart[some], turned[some] = solved
        yield (start + len(some)) / len(rows)
    return Kept(standing, apart, turned)


def _units(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-9)


def _falling(value: np.ndarray, range_: tuple[float, float]) -> np.ndarray:
    """1 up to the first, 0 from the second on, smooth between."""
    share = np.clip((range_[1] - value) / (range_[1] - range_[0]), 0.0, 1.0)
    return share * share * (3.0 - 2.0 * share)


def _blended(near: np.ndarray, times: np.ndarray) -> np.ndarray:
    """The most of (T, P) within `BLEND` of each frame, then the mean of that within `BLEND`: nowhere less than
    it was."""
    most = near.copy()
    for first, second, _ in _neighbours(times):
        most[first] = np.maximum(most[first], near[second])
        most[second] = np.maximum(most[second], near[first])
    total, count = most.copy(), np.ones(len(times))
    for first, second, share in _neighbours(times):
        total[first] += share[:, None] * most[second]
        total[second] += share[:, None] * most[first]
        count[first] += share
        count[second] += share
    # A mean of ones is one, however it is rounded.
    return np.maximum(near, total / count[:, None])


def _neighbours(times: np.ndarray) -> Generator[tuple[slice, slice, np.ndarray], None, None]:
    """Frames and those that are so many after them, for as many as lie within `BLEND` of each other anywhere,
    and how near each is: 1 at the same time, 0 from `BLEND` on."""
    for step in range(1, len(times)):
        share = np.maximum(1.0 - (times[step:] - times[:-step]) / BLEND, 0.0)
        if not share.any():
            return
        yield slice(0, len(times) - step), slice(step, None), share


@dataclass(frozen=True, eq=False)
class _Chains:
    """A character's fingers, laid into the captured hand's rest space, in its metres: K bones, U angles that may
    turn, P pairs of fingertips."""

    target: TargetHand
    axes: np.ndarray
    """(K, 3, 3) columns are each joint's twist, spread and bend axes"""
    starts: np.ndarray
    """(K, 3) from the parent's beginning to each bone's, at rest: as the parent's turn carries it"""
    last: np.ndarray
    """(5,) the last bone of each finger; -1 for those that are not there"""
    skins: np.ndarray
    """(5, 2, 3) from the beginning of these to both ends of the axes of their skins, likewise: as far from the
    character's fingertip as the captured ones are from theirs"""
    carries: np.ndarray
    """(5, U) bool: whether an angle moves a fingertip"""
    bones: np.ndarray
    """(U,) the bone of each angle"""
    which: np.ndarray
    """(U,) twist, spread or bend of it: 0, 1, 2"""
    unwelcome: np.ndarray
    """(U,) the diagonal of M"""
    lower: np.ndarray
    """(U,) radians"""
    upper: np.ndarray
    """(U,)"""
    told: np.ndarray
    """(P,) which of `PAIRS` have two last bones"""

    @classmethod
    def of(cls, target: TargetHand, source: SourceHand, skins: Fingertips) -> _Chains:
        flat = axes_of(source.joints @ REST_FROM_MODEL, source.tips @ REST_FROM_MODEL, source.side)
        flat, limits = REST_FROM_MODEL @ flat, joint_limits(source.side)
        laid = target.aligned.T @ target.corrected  # from the character's segments to ours
        count = len(target.bones)
        axes, starts = np.broadcast_to(np.eye(3), (count, 3, 3)).copy(), np.empty((count, 3))
        angles: list[tuple[int, int, float, float, float]] = []
        for k, (joints, parent) in enumerate(zip(target.joints, target.parents, strict=True)):
            from_ = target.wrist if parent < 0 else target.heads[parent]
            carried = target.aligned.T if parent < 0 else laid[parent]
            starts[k] = carried @ (target.heads[k] - from_) / target.scale
            if not joints:
                continue
            joint = joints[0]
            axes[k] = flat[joint - 1]
            finger = next(f for f in FINGERS if joint in FINGER_JOINTS[f])
            # Joints between that have no bone turn with this one, and lend it their ranges.
            lent, above = [joint], target.joints[parent] if parent >= 0 else ()
            while (before := PARENTS[lent[-1]]) and before not in above:
                lent.append(before)
            cost = _UNWELCOME.get(finger, _OF_FINGERS)[FINGER_JOINTS[finger].index(lent[-1])]
            rows = np.array(lent) - 1
            for axis, unwelcome in enumerate(cost):
                if np.isfinite(unwelcome):
                    low, high = limits.lower[rows, axis].sum(), limits.upper[rows, axis].sum()
                    angles.append((k, axis, unwelcome, float(low), float(high)))
        bones, which, unwelcome, lower, upper = (np.array(column) for column in zip(*angles, strict=True))

        last = np.full(len(FINGERS), -1)
        ends, carries = np.zeros((len(FINGERS), 2, 3)), np.zeros((len(FINGERS), len(bones)), dtype=bool)
        for f, finger in enumerate(FINGERS):
            bone = target.last(finger)
            if bone is None:
                continue
            last[f] = bone
            ends[f] = laid[bone] @ (target.tips[f] - target.heads[bone]) / target.scale
            ends[f] += skins.ends[f] - source.tips[f]
            while bone >= 0:
                carries[f] |= bones == bone
                bone = target.parents[bone]
        first, second = last[PAIRS].T
        told = np.flatnonzero((first >= 0) & (second >= 0) & (first != second))
        return cls(
            *(target, axes, starts, last, ends, carries, bones, which, unwelcome, lower, upper, told)
        )

    def solved(
        self, standing: np.ndarray, touching: Touches
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """N frames' bones (N, K, 3, 3) with fingertips where they touch, how far they stay apart (N,), and by
        how much the angle that turned most did so (N,)."""
        target = self.target
        laid = target.aligned.T @ standing @ np.swapaxes(target.rest, -1, -2)
        whole = laid @ np.swapaxes(target.corrected, -1, -2) @ target.aligned
        local = whole.copy()
        for k, parent in enumerate(target.parents):
            if parent >= 0:
                local[:, k] = np.swapaxes(whole[:, parent], -1, -2) @ whole[:, k]
        problem = _Problem(
            self,
            rotmat_to_euler(np.swapaxes(self.axes, -1, -2) @ local @ self.axes),
            touching,
        )
        x = problem.solve()
        euler = problem.angles.copy()
        euler[:, self.bones, self.which] += x
        turned = self.axes @ euler_to_rotmat(euler) @ np.swapaxes(self.axes, -1, -2)
        moved = np.zeros((len(x), len(self.axes)), dtype=bool)
        np.logical_or.at(moved, (slice(None), self.bones), x != 0.0)
        found = standing.copy()
        for k, parent in enumerate(target.parents):
            moved[:, k] |= moved[:, parent] if parent >= 0 else False
            local[moved[:, k], k] = turned[moved[:, k], k]
            above = whole[:, parent] if parent >= 0 else np.eye(3)
            whole[:, k] = above @ local[:, k]
            here = moved[:, k]
            found[here, k] = (
                target.aligned @ whole[here, k] @ target.aligned.T @ target.corrected[k] @ target.rest[k]
            )
        off = np.abs((problem.forward(x)[0] * _units(touching.ways)).sum(axis=-1))
        apart = np.max(off, axis=1, where=touching.now, initial=0.0)
        return found, apart, np.abs(x).max(axis=1)


@dataclass(frozen=True, eq=False)
class _Problem:
    """N frames to be solved."""

    chains: _Chains
    angles: np.ndarray
    """(N, K, 3) twist, spread and bend of each bone, as captured"""
    touching: Touches

    def forward(self, x: np.ndarray, jacobian: bool = False) -> tuple[np.ndarray, np.ndarray]:
        """Residuals (N, P, 3), and with `jacobian`, how they change with x: (N, P, 3, U)."""
        chains, parents = self.chains, self.chains.target.parents
        angles = self.angles.copy()
        angles[:, chains.bones, chains.which] += x
        euler = euler_to_rotmat(angles)
        local = chains.axes @ euler @ np.swapaxes(chains.axes, -1, -2)
        whole, places = np.empty_like(local), np.empty(local.shape[:3])
        for k, parent in enumerate(parents):
            if parent < 0:
                whole[:, k], places[:, k] = local[:, k], chains.starts[k]
            else:
                whole[:, k] = whole[:, parent] @ local[:, k]
                places[:, k] = places[:, parent] + whole[:, parent] @ chains.starts[k]
        pairs = PAIRS[chains.told]
        skins, share = chains.skins[pairs], self.touching.along[..., None]
        skins = skins[:, :, 0] + share * (skins[:, :, 1] - skins[:, :, 0])
        last = chains.last[pairs]
        points = places[:, last] + (whole[:, last] @ skins[..., None])[..., 0]  # (N, P, 2, 3)
        off = points[:, :, 0] - points[:, :, 1] - self.touching.ways
        if not jacobian:
            return off, np.empty(0)
        # Twist is about the joint's own axis at rest, spread about one that the twist has turned, and bend
        # about one that both have.
        sine, cosine = np.sin(angles[..., 0]), np.cos(angles[..., 0])
        spread = np.stack([np.zeros_like(sine), cosine, sine], axis=-1)
        about = np.stack([np.broadcast_to([1.0, 0.0, 0.0], spread.shape), spread, euler[..., 2]], axis=-2)
        above = np.array(parents)[chains.bones]
        carried = np.where((above < 0)[:, None, None], np.eye(3), whole[:, above]) @ chains.axes[chains.bones]
        axis = (carried @ about[:, chains.bones, chains.which, :, None])[..., 0]  # (N, U, 3)
        moves = np.zeros((*off.shape[:2], len(chains.bones), 3))
        for k, sign in enumerate((1.0, -1.0)):
            arms = points[:, :, k, None] - places[:, None, chains.bones]  # (N, P, U, 3)
            turned = cross(np.broadcast_to(axis[:, None], arms.shape), arms)
            moves += sign * chains.carries[pairs[:, k], :, None] * turned
        return off, np.swapaxes(moves, -1, -2)

    def stiffness(self, slopes: np.ndarray) -> np.ndarray:
        """(N, P, 3, 3) rho, between the skins and along them: by the Jacobian (N, P, 3, U) of the captured
        pose. Touches of several fingers share what they hold along the skins, which cannot all be met."""
        gives = (slopes**2 / self.chains.unwelcome).sum(axis=(-1, -2))
        towards, weights = _units(self.touching.ways), self.touching.weights
        between = ((towards[..., None, :] @ slopes)[..., 0, :] ** 2 / self.chains.unwelcome).sum(axis=-1)
        told = weights * _WITH_THUMB[self.chains.told]
        share = weights * (told / np.maximum(told.sum(axis=1, keepdims=True), 1e-9))**_P
        rho = [
            weight / (np.maximum(give, 1e-9) * (1.0 - weight + _LEFT_OPEN))
            for weight, give in ((weights, between), (share, (gives - between) / 2.0))
        ]
        normal = towards[..., :, None] * towards[..., None, :]
        return rho[0][..., None, None] * normal + rho[1][..., None, None] * (np.eye(3) - normal)

    def some(self, rows: np.ndarray) -> _Problem:
        """Some frames alone."""
        every = np.arange(len(self.chains.told))
        return _Problem(self.chains, self.angles[rows], self.touching.some(rows, every))

    def solve(self) -> np.ndarray:
        """x (N, U) by projected Levenberg-Marquardt."""
        chains, unwelcome = self.chains, self.chains.unwelcome
        captured = self.angles[:, chains.bones, chains.which]
        # What is beyond its range already may stay so.
        low, high = np.minimum(chains.lower - captured, 0.0), np.maximum(chains.upper - captured, 0.0)
        x = np.zeros(captured.shape)
        rho = self.stiffness(self.forward(x, jacobian=True)[1])
        left, damping, cost = np.arange(len(x)), np.full(len(x), 1e-3), np.full(len(x), np.inf)
        for _ in range(_MOST_STEPS):
            problem = self.some(left)
            off, slopes = problem.forward(x[left], jacobian=True)
            weighted = rho[left] @ slopes
            flat = slopes.reshape(len(left), -1, len(unwelcome))
            pull = np.swapaxes(weighted.reshape(flat.shape), -1, -2)
            gradient = (pull @ off.reshape(len(left), -1, 1))[..., 0] + unwelcome * x[left]
            cost[left] = _cost(off, rho[left], x[left], unwelcome)
            held = (x[left] <= low[left]) & (gradient > 0.0) | (x[left] >= high[left]) & (gradient < 0.0)
            hessian = pull @ flat
            free = ~held
            hessian *= free[:, :, None] & free[:, None, :]
            index = np.arange(len(unwelcome))
            hessian[:, index, index] += unwelcome
            hessian[:, index, index] *= 1.0 + damping[left][:, None]
            step = np.linalg.solve(hessian, np.where(held, 0.0, -gradient)[..., None])[..., 0]
            tried = np.clip(x[left] + step, low[left], high[left])
            better = _cost(problem.forward(tried)[0], rho[left], tried, unwelcome) < cost[left]
            moved = np.abs(tried - x[left]).max(axis=1)
            x[left[better]] = tried[better]
            damping[left] *= np.where(better, 0.1, 10.0)
            left = left[moved > _SMALL]
            if not len(left):
                break
        return x


def _cost(off: np.ndarray, rho: np.ndarray, x: np.ndarray, unwelcome: np.ndarray) -> np.ndarray:
    return ((rho @ off[..., None])[..., 0] * off).sum(axis=(-1, -2)) + (unwelcome * x**2).sum(axis=-1)
