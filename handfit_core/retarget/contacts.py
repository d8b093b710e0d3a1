"""Where captured fingertips touch, the character's touch: thumb and finger both move, in slices of frames.

Fingers that point as captured ones do, but are longer or begin elsewhere, do not meet where those meet. Let v
lead from one captured fingertip to another, where their skins are nearest to each other, let u do so on the
character, in metres of the captured hand, and let x be what its joints turn beyond what was captured. Then x
is least for

    x^T M x + sum over touches of (u(x) - v)^T R (u(x) - v)

within the joints' ranges. M says how unwelcome a turn is. R is rho = w / (S (1 - w + e)) between two skins,
and less along them: w in 0..1 is how much they touch, and S, of J M^-1 J^T with J = du/dx, how far u gives
way to a turn. A gap alone is thus closed by about the share w, touches that begin or end beside others pull
softly, and where nothing touches x is exactly zero.

An object that the character's hand holds is one more thing to touch: there u leads to the fingertip from the
wrist, and v to where that lies on the place of the surface that is nearest to it.

As w is smooth in time, so is x, mostly. Where several fingers touch at once, the best turns can jump from one
frame to the next. So x is found for every frame on its own, the mean of frames near each other is taken, and
from there each frame closes again, by small turns, what the mean opened.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Generator
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Final

import numpy as np

from handfit_core.common.batch import Batch
from handfit_core.common.skeleton import FINGER_JOINTS, FINGERS, JOINTS_BY_FINGER, PARENTS
from handfit_core.common.slices import map_yields
from handfit_core.fit.levenberg import LeastSquares, solve
from handfit_core.geometry.rotations import euler_to_rotmat, rotmat_to_euler, smoothstep, units
from handfit_core.hand_model.anatomy import axes_of, joint_limits
from handfit_core.hand_model.axes import MIRROR_X, REST_FROM_MODEL, points_to_rest
from handfit_core.hand_model.data import HandModel
from handfit_core.hand_model.surface import cross, gaps_along, nearest_along, surface_of
from handfit_core.retarget.transfer import SourceHand, TargetHand, globally

PAIRS: Final = np.array(list(combinations(range(len(FINGERS)), 2)))
"""(10, 2) pairs of fingers that can touch each other, pairs with the thumb first"""
_HELD: Final = len(FINGERS)
"""The number that stands in a pair for the object that the hand holds"""
_ALL_PAIRS: Final = np.concatenate([PAIRS, [(finger, _HELD) for finger in range(len(FINGERS))]])
"""(15, 2) `PAIRS`, then each finger with what the hand holds"""


@dataclass(frozen=True)
class TouchSettings:
    """Settings of which touches of a character are met, how far its joints turn for them, and how much is
    solved in one step of work."""

    touch_gap: tuple[float, float] = (0.004, 0.012)
    """metres between skins up to which they touch, and from which on they do not"""
    crossed_share: tuple[float, float] = (0.5, 0.8)
    """Share of the way between two fingers' skins that leads across the palm: up to the first, one finger
    lies over the other; from the second on they lie side by side, which is no touch to keep"""
    blend_seconds: float = 0.1
    """seconds before and after a touch for which it is kept; it fades in and out for twice as long"""
    thumb_turn_cost: tuple[tuple[float, float, float], ...] = (
        (6.0, 1.0, 1.0),
        (6.0, 4.0, 1.0),
        (6.0, 4.0, 1.0),
    )
    """Cost of a radian squared, on the diagonal of M, for twist, spread and bend of each of the thumb's three
    joints"""
    finger_turn_cost: tuple[tuple[float, float, float], ...] = (
        (math.inf, 4.0, 2.0),
        (math.inf, math.inf, 2.0),
        (math.inf, math.inf, 3.0),
    )
    """Cost of a radian squared, on the diagonal of M, for twist, spread and bend of each of the other
    fingers' joints; infinite: the angle is fixed"""
    held_reach: tuple[float, float] = (0.008, 0.016)
    """metres from a held object up to which a fingertip is laid on it, and from which on it is not"""
    held_sliding: float = 0.3
    """Share of `sliding_share` with which a fingertip keeps its place along a held object"""
    open_share: float = 0.02
    """The number e of the module's formula: the share of a gap that stays open where both skins touch"""
    sliding_share: tuple[float, float] = (0.9, 0.5)
    """Largest share of a distance along the skins that is closed, in the first pass and in the second:
    touches of several fingers with one thumb cannot all be met in the very same places"""
    max_turn: tuple[float, float] = (math.radians(30.0), math.radians(4.0))
    """radians by which an angle turns at most, from the captured pose in the first pass and from the mean in
    the second: touches that need more are no grip, or would make a jump, and stay open"""
    max_steps: int = 20
    """Most steps of the search for the joints' angles"""
    tolerance: float = 1e-11
    """Relative decrease of the cost at which the search for the joints' angles ends"""
    solve_frames: int = 32
    """Number of frames that are solved in one step of work"""
    detect_frames: int = 256
    """Number of frames in which touches are detected in one step of work"""


TOUCHES: Final = TouchSettings()


@dataclass(frozen=True, eq=False)
class Fingertips:
    """The last bones of a captured hand's fingers with their skins, at rest, in rest space and metres."""

    ends: np.ndarray
    """(5, 2, 3) metres: both ends of the axis of each finger's last bone, thumb first"""
    radii: np.ndarray
    """(5, 2) metres: the radii of the skin around these ends"""

    @classmethod
    def of(cls, model: HandModel, betas: np.ndarray) -> Fingertips:
        """Return the fingertips of a hand model of shape `betas` (10,)."""
        flat = surface_of(model).of(betas[None], np.zeros((1, 45)))
        return cls(points_to_rest(flat.ends[0, 2:15:3]), flat.radii[0, 2:15:3])

    def mirrored(self) -> Fingertips:
        """Return the fingertips of a hand of the other side, mirrored at x = 0 of rest space."""
        return Fingertips(self.ends @ MIRROR_X, self.radii)


@dataclass(frozen=True, eq=False)
class HeldObject:
    """An object that keeps its place in a character's hand."""

    nearest: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]
    """Given points (N, 3) in the armature's space while the hand is at rest, returns how far they are from
    the object (N,), in the armature's units and negative inside it, and unit vectors (N, 3) out of it"""
    share: np.ndarray
    """(T,) 0..1: how much the hand holds it in each frame"""


@dataclass(frozen=True, eq=False)
class Touches(Batch):
    """The touches between fingertips in T frames, by the pairs of `PAIRS`; behind these may follow those with
    what the hand holds."""

    weights: np.ndarray
    """(T, 10) 0..1 by `PAIRS`: how much each touch is to be kept, smooth in time; exactly 0 where none is"""
    gap: np.ndarray
    """(T, 10) metres between the two skins; negative where they overlap"""
    now: np.ndarray
    """(T, 10) bool: true where the two fingers touch in this very frame"""
    along: np.ndarray
    """(T, 10, 2) where, on the axes of the two last bones, 0..1, the fingers are nearest to each other"""
    ways: np.ndarray
    """(T, 10, 3) metres, in rest space with the wrist at rest: from that place on the second finger to that
    on the first; with what the hand holds, from the wrist to where that place is to be"""
    towards: np.ndarray
    """(T, 10, 3) unit vectors from one skin to the other"""

    def of(self, pairs: np.ndarray) -> Touches:
        """Return only the touches of the pairs that `pairs` (P,) names by their rows in `PAIRS`."""
        return Touches(*(values[:, pairs] for _, values in self._rows()))

    def beside(self, others: Touches) -> Touches:
        """Return these touches, and behind them those of other pairs in the same frames."""
        rows = zip(self._rows(), others._rows(), strict=True)
        return Touches(*(np.concatenate([own, other], axis=1) for (_, own), (_, other) in rows))


@dataclass(frozen=True, eq=False)
class ContactResult:
    """A character's hand whose fingertips touch where the captured ones do, over T frames."""

    standing: np.ndarray
    """(T, K, 3, 3) how the bones stand in the armature's space while the hand is at rest; where a finger
    touches nothing, exactly as `TargetHand.standing` gives it"""
    apart: np.ndarray
    """(T,) metres, at the captured hand's scale, by which the gap between skins that touch now differs from
    the captured one, at the worst; 0 where none touch"""
    turned: np.ndarray
    """(T,) radians: the largest of the angles by which joints turn beyond what was captured"""


def finding_touches(
    source: SourceHand, skins: Fingertips, turns: np.ndarray, times: np.ndarray
) -> Generator[None, None, Touches]:
    """Detect the touches of a captured hand in T frames, in steps of work.

    `turns`: (T, 16, 3, 3) the joints' rotations, see `TargetHand.local`; `times`: (T,) seconds, rising.
    """
    last = JOINTS_BY_FINGER[:, 2]
    across = source.joints[FINGER_JOINTS["index"][0]] - source.joints[FINGER_JOINTS["little"][0]]
    count = len(turns)
    ends, beside = np.empty((count, len(FINGERS), 2, 3)), np.empty((count, len(FINGERS), 3))
    along, gap = np.empty((count, len(PAIRS), 2)), np.empty((count, len(PAIRS)))
    for start in range(0, count, TOUCHES.detect_frames):
        some = slice(start, start + TOUCHES.detect_frames)
        whole, joints = globally(turns[some])[:, last], source.points(turns[some])[0][:, last, None]
        ends[some] = joints + np.einsum("tfab,feb->tfea", whole, skins.ends - source.joints[last, None])
        beside[some] = whole @ across
        along[some], gap[some] = _nearest(ends[some], skins.radii, PAIRS)
        yield
    # Where fingers lie side by side, the nearest places jump from end to end between frames.
    along = _mean(along, times)
    places = ends[:, PAIRS, 0] + along[..., None] * (ends[:, PAIRS, 1] - ends[:, PAIRS, 0])
    ways = places[:, :, 0] - places[:, :, 1]
    beside = np.abs((units(ways) * units(beside[:, PAIRS].sum(axis=2))).sum(axis=-1))
    near = _falling(gap, TOUCHES.touch_gap) * np.where(
        PAIRS[:, 0] == 0, 1.0, _falling(beside, TOUCHES.crossed_share)
    )
    most = near.copy()
    for first, second, _ in _neighbours(times):
        most[first] = np.maximum(most[first], near[second])
        most[second] = np.maximum(most[second], near[first])
    # However it is rounded, a mean of ones is one.
    weights = np.maximum(near, np.minimum(_mean(most, times), 1.0))
    return Touches(weights, gap, near == 1.0, along, ways, units(ways))


def keeping_contacts(
    target: TargetHand,
    source: SourceHand,
    skins: Fingertips,
    turns: np.ndarray,
    times: np.ndarray,
    keyed: np.ndarray | None = None,
    held: HeldObject | None = None,
) -> Generator[float, None, ContactResult]:
    """Have a character's fingertips touch where captured fingertips do, and lie on what the hand holds where
    they come near it, in steps that yield the share done, 0..1.

    `source`, `skins` and `turns` (T, 16, 3, 3) are the captured hand's, of the target's side; `times` (T,) in
    seconds, rising. `keyed` (K,) bool: true for bones that may turn more than captured; None: all.
    """
    standing, apart = np.empty((len(turns), len(target.bones), 3, 3)), np.zeros(len(turns))
    for start in range(0, len(turns), TOUCHES.detect_frames):
        standing[start : start + TOUCHES.detect_frames] = target.standing(
            turns[start : start + TOUCHES.detect_frames]
        )
        yield 0.0
    times = np.asarray(times, dtype=np.float64)
    found = yield from map_yields(finding_touches(source, skins, turns, times), lambda: 0.0)
    keyed = np.ones(len(target.bones), dtype=bool) if keyed is None else keyed
    chains = _Chains.of(target, source, skins, keyed, holds=held is not None)
    x, on_held, both = np.zeros((len(turns), len(chains.bones))), None, found
    if held is not None:
        on_held = yield from map_yields(chains.finding_held(standing, x, held, times), lambda: 0.0)
        both = found.beside(on_held)
    for some, done in _slices(both.weights[:, chains.pairs].max(axis=1, initial=0.0)):
        x[some] = chains.problem(standing[some], both.select(some)).solved(x[some], 0)
        yield 0.5 * done
    x = _mean(x, times)
    if held is not None and on_held is not None:
        again = yield from map_yields(chains.finding_held(standing, x, held, times), lambda: 0.5)
        both = found.beside(replace(again, weights=on_held.weights))
    for some, done in _slices(np.abs(x).max(axis=1, initial=0.0)):
        problem = chains.problem(standing[some], both.select(some))
        x[some] = problem.solved(x[some], 1)
        standing[some], apart[some] = problem.turned(standing[some], x[some]), problem.apart(x[some])
        yield 0.5 + 0.5 * done
    return ContactResult(standing, apart, np.abs(x).max(axis=1, initial=0.0))


def _slices(value: np.ndarray) -> Generator[tuple[np.ndarray, float], None, None]:
    """Yield the frames whose `value` (T,) is not zero, some at a time, each time with the share, 0..1, that
    is done with them."""
    rows = np.flatnonzero(value)
    for start in range(0, len(rows), TOUCHES.solve_frames):
        yield rows[start : start + TOUCHES.solve_frames], min((start + TOUCHES.solve_frames) / len(rows), 1.0)


def _nearest(ends: np.ndarray, radii: np.ndarray, pairs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Find where pairs (P, 2) of skins are nearest to each other, from their ends (N, 5, 2, 3) and radii
    (5, 2): where on both axes, (N, P, 2), and how near, (N, P) in metres."""
    first, second = (ends[:, some].reshape(-1, 2, 3) for some in pairs.T)
    radii_a, radii_b = (np.tile(radii[some], (len(ends), 1)) for some in pairs.T)
    along = nearest_along(first, radii_a, second, radii_b)
    gap = gaps_along(first, radii_a, second, radii_b, along)[1]
    return along.reshape(len(ends), -1, 2), gap.reshape(len(ends), -1)


def _falling(value: np.ndarray, range_: tuple[float, float]) -> np.ndarray:
    """Return 1 up to the first bound of `range_`, 0 from the second on, and smooth values between."""
    return smoothstep((range_[1] - value) / (range_[1] - range_[0]))


def _mean(values: np.ndarray, times: np.ndarray) -> np.ndarray:
    """Return the means (T, ...) of values (T, ...) over the frames within `blend_seconds`, nearer ones
    counting more."""
    total, count = values.copy(), np.ones(len(times))
    for first, second, share in _neighbours(times):
        shares = share.reshape(-1, *[1] * (values.ndim - 1))
        total[first] += shares * values[second]
        total[second] += shares * values[first]
        count[first] += share
        count[second] += share
    return total / count.reshape(-1, *[1] * (values.ndim - 1))


def _neighbours(times: np.ndarray) -> Generator[tuple[slice, slice, np.ndarray], None, None]:
    """Yield pairs of frames within `blend_seconds` of each other, as slices that are one, two, ... frames
    apart, and their weights: 1 at the same time, 0 from `blend_seconds` on."""
    for step in range(1, len(times)):
        share = np.maximum(1.0 - (times[step:] - times[:-step]) / TOUCHES.blend_seconds, 0.0)
        if not share.any():
            return
        yield slice(0, len(times) - step), slice(step, None), share


@dataclass(frozen=True, eq=False)
class _Chains:
    """A character's fingers, laid into the captured hand's rest space, in its metres: K bones, U angles that
    may turn, P pairs of fingertips. What the hand holds is a sixth finger, of a bone K that never turns and
    begins and ends at the wrist."""

    target: TargetHand
    axes: np.ndarray
    """(K, 3, 3) the twist, spread and bend axes of each bone's joint, as columns"""
    starts: np.ndarray
    """(K, 3) metres: from where the parent begins to where the bone begins, at rest; the parent's turn
    carries it"""
    last: np.ndarray
    """(6,) the index of each finger's last bone; -1 for fingers that are not there"""
    radii: np.ndarray
    """(6, 2) metres: the radii of the fingertips' skins at both ends"""
    skins: np.ndarray
    """(6, 2, 3) metres: from where each finger's last bone begins to both ends of the axis of its skin, which
    lie as far from the character's fingertip as the captured ones from theirs"""
    moves: np.ndarray
    """(K + 1, U) bool: true where an angle moves a bone"""
    bones: np.ndarray
    """(U,) the index of the bone that each angle turns"""
    which: np.ndarray
    """(U,) which of its bone's angles each one is: 0 twist, 1 spread, 2 bend"""
    turn_cost: np.ndarray
    """(U,) the diagonal of M"""
    lower: np.ndarray
    """(U,) radians: the least value of each angle"""
    upper: np.ndarray
    """(U,) radians: the greatest value of each angle"""
    pairs: np.ndarray
    """(P,) rows of `PAIRS`, and of those behind them, whose two fingers both have a last bone"""

    @classmethod
    def of(
        cls,
        target: TargetHand,
        source: SourceHand,
        skins: Fingertips,
        keyed: np.ndarray,
        *,
        holds: bool = False,
    ) -> _Chains:
        flat = axes_of(source.joints @ REST_FROM_MODEL, source.tips @ REST_FROM_MODEL, source.side)
        flat, limits = REST_FROM_MODEL @ flat, joint_limits(source.side, source.model)
        laid = target.aligned.T @ target.corrected  # from the character's segments to ours
        count = len(target.bones)
        axes, starts = np.broadcast_to(np.eye(3), (count, 3, 3)).copy(), np.empty((count, 3))
        angles: list[tuple[int, int, float, float, float]] = []
        for k, (joints, parent) in enumerate(zip(target.joints, target.parents, strict=True)):
            start = target.wrist if parent < 0 else target.heads[parent]
            carried = target.aligned.T if parent < 0 else laid[parent]
            starts[k] = carried @ (target.heads[k] - start) / target.scale
            if not joints:
                continue
            joint = joints[0]
            axes[k] = flat[joint - 1]
            finger = next(f for f in FINGERS if joint in FINGER_JOINTS[f])
            # Joints between that have no bone turn with this one, and lend it their ranges.
            lent, above = [joint], target.joints[parent] if parent >= 0 else ()
            while (before := PARENTS[lent[-1]]) and before not in above:
                lent.append(before)
            cost = (TOUCHES.thumb_turn_cost if finger == "thumb" else TOUCHES.finger_turn_cost)[
                FINGER_JOINTS[finger].index(lent[-1])
            ]
            rows = np.array(lent) - 1
            for axis, turn_cost in enumerate(cost):
                if keyed[k] and np.isfinite(turn_cost):
                    low, high = limits.lower[rows, axis].sum(), limits.upper[rows, axis].sum()
                    angles.append((k, axis, turn_cost, float(low), float(high)))
        bones, which, turn_cost, lower, upper = np.reshape(angles, (-1, 5)).T
        bones, which = bones.astype(int), which.astype(int)

        moves = np.arange(count + 1)[:, None] == bones
        for k, parent in enumerate(target.parents):
            moves[k] |= moves[parent] if parent >= 0 else False
        last, ends = np.append(np.full(len(FINGERS), -1), count), np.zeros((_HELD + 1, 2, 3))
        for f, finger in enumerate(FINGERS):
            bone = target.last(finger)
            if bone is not None:
                last[f] = bone
                ends[f] = laid[bone] @ (target.tips[f] - target.heads[bone]) / target.scale
                ends[f] += skins.ends[f] - source.tips[f]
        first, second = last[_ALL_PAIRS if holds else PAIRS].T
        pairs = np.flatnonzero((first >= 0) & (second >= 0) & (first != second) & (len(bones) > 0))
        return cls(
            *(target, axes, starts, last, np.append(skins.radii, [[0.0, 0.0]], axis=0), ends, moves),
            *(bones, which, turn_cost, lower, upper, pairs),
        )

    def problem(self, standing: np.ndarray, found: Touches) -> _Problem:
        """Make the problem of N frames with touches, whose bones stand as captured: `standing`
        (N, K, 3, 3)."""
        pairs = self.pairs[found.weights[:, self.pairs].any(axis=0)]
        return _Problem(replace(self, pairs=pairs), self.angles(standing), found.of(pairs))

    def angles(self, standing: np.ndarray) -> np.ndarray:
        """Return twist, spread and bend (N, K, 3), in radians, of bones that stand so (N, K, 3, 3)."""
        # How bones are turned from where ours rest, in our rest space
        laid = self.target.aligned.T @ standing @ np.swapaxes(self.target.rest, -1, -2)
        whole = laid @ np.swapaxes(self.target.corrected, -1, -2) @ self.target.aligned
        local = whole.copy()
        for k, parent in enumerate(self.target.parents):
            if parent >= 0:
                local[:, k] = np.swapaxes(whole[:, parent], -1, -2) @ whole[:, k]
        return rotmat_to_euler(np.swapaxes(self.axes, -1, -2) @ local @ self.axes)

    def turned_by(self, angles: np.ndarray, x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return how the bones are turned (N, K + 1, 3, 3), where they begin (N, K + 1, 3) in metres, and
        their angles (N, K, 3) in radians, with x (N, U) added to `angles` (N, K, 3)."""
        angles = angles.copy()
        angles[:, self.bones, self.which] += x
        local = self.axes @ euler_to_rotmat(angles) @ np.swapaxes(self.axes, -1, -2)
        whole = np.broadcast_to(np.eye(3), (len(local), len(self.moves), 3, 3)).copy()
        places = np.zeros(whole.shape[:3])
        for k, parent in enumerate(self.target.parents):
            if parent < 0:
                whole[:, k], places[:, k] = local[:, k], self.starts[k]
            else:
                whole[:, k] = whole[:, parent] @ local[:, k]
                places[:, k] = places[:, parent] + whole[:, parent] @ self.starts[k]
        return whole, places, angles

    def ends(self, whole: np.ndarray, places: np.ndarray) -> np.ndarray:
        """Return the ends (N, 6, 2, 3) of the axes of the fingertips' skins, in metres."""
        return places[:, self.last, None] + np.einsum("nfab,feb->nfea", whole[:, self.last], self.skins)

    def finding_held(
        self, standing: np.ndarray, x: np.ndarray, held: HeldObject, times: np.ndarray
    ) -> Generator[None, None, Touches]:
        """Find in T frames, in steps of work, where fingertips are to lie on what the hand holds: touches
        (T, 5) of bones that stand so (T, K, 3, 3), turned by x (T, U) radians more."""
        ends, along = np.empty((len(x), _HELD, 2, 3)), np.empty((len(x), _HELD))
        gap, places, towards = along.copy(), ends[:, :, 0].copy(), ends[:, :, 0].copy()
        shares = np.linspace(0.0, 1.0, 5)
        parts = range(0, len(x), TOUCHES.detect_frames)
        for some in (slice(start, start + TOUCHES.detect_frames) for start in parts):
            posed = self.turned_by(self.angles(standing[some]), x[some])
            ends[some] = self.ends(*posed[:2])[:, :_HELD]
            gaps = self._gaps(ends[some], np.broadcast_to(shares, (*along[some].shape, 5)), held)[1]
            along[some] = shares[gaps.argmin(axis=2)]
            yield
        along = _mean(along, times)
        for some in (slice(start, start + TOUCHES.detect_frames) for start in parts):
            found = self._gaps(ends[some], along[some, :, None], held)
            places[some], gap[some], towards[some] = (values[:, :, 0] for values in found)
            yield
        weights = _falling(gap, TOUCHES.held_reach) * held.share[:, None]
        ways, now = places - gap[..., None] * towards, np.zeros(gap.shape, dtype=bool)
        return Touches(weights, gap, now, along[..., None].repeat(2, axis=2), ways, towards)

    def _gaps(
        self, ends: np.ndarray, along: np.ndarray, held: HeldObject
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the places (N, 5, S, 3) that lie `along` (N, 5, S) axes with these ends (N, 5, 2, 3), the
        gaps (N, 5, S) between the skin around them and what the hand holds, in metres, and the ways out of
        that, unit vectors (N, 5, S, 3)."""
        target, radii = self.target, self.radii[:_HELD, :, None]
        places = ends[:, :, :1] + along[..., None] * (ends[:, :, 1:] - ends[:, :, :1])
        distances, out = held.nearest(target.wrist + target.scale * places.reshape(-1, 3) @ target.aligned.T)
        thick = radii[:, 0] + along * (radii[:, 1] - radii[:, 0])
        return (
            places,
            distances.reshape(along.shape) / target.scale - thick,
            (out @ target.aligned).reshape(places.shape),
        )


@dataclass(frozen=True, eq=False)
class _Turns(Batch):
    """The angles by which joints turn in addition to what was captured, in N frames."""

    x: np.ndarray
    """(N, U) radians: the additional turn of each angle"""

    def moved(self, step: np.ndarray) -> _Turns:
        """Return the turns after increments (N, U) in radians."""
        return _Turns(self.x + step)


@dataclass(frozen=True, eq=False)
class _System(Batch):
    """The normal equations of N frames, each by itself."""

    cost: np.ndarray
    """(N,) the cost of each frame"""
    hessian: np.ndarray
    """(N, U, U) the Gauss-Newton matrix of each frame by its angles"""
    gradient: np.ndarray
    """(N, U) the gradient of each frame's cost by its angles"""


@dataclass(frozen=True, eq=False)
class _Problem(Batch):
    """The N frames in which fingertips touch, with what their turns are solved from."""

    chains: _Chains
    """The character's fingers, with those of the P pairs that touch in any of the frames"""
    angles: np.ndarray
    """(N, K, 3) twist, spread and bend of each bone, as captured"""
    touching: Touches
    """The touches of these P pairs in the N frames"""

    def turned(self, standing: np.ndarray, x: np.ndarray) -> np.ndarray:
        """Return the bones (N, K, 3, 3) turned by x (N, U) radians more than they stand; exactly as they were
        where x is 0."""
        chains, target = self.chains, self.chains.target
        moved = (chains.moves[:-1] & (x != 0.0)[:, None]).any(axis=-1)
        stands = target.aligned @ self.posed(x)[0][:, :-1] @ target.aligned.T @ target.corrected @ target.rest
        return np.where(moved[..., None, None], stands, standing)

    def apart(self, x: np.ndarray) -> np.ndarray:
        """Return the metres (N,) by which the gap of skins that touch differs from the captured one, at the
        worst."""
        chains = self.chains
        whole, places, _ = self.posed(x)
        pairs, ends = _ALL_PAIRS[chains.pairs], chains.ends(whole, places)
        off = np.abs(_nearest(ends, chains.radii, pairs)[1] - self.touching.gap)
        return np.max(off, axis=1, where=self.touching.now, initial=0.0)

    def posed(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return what `_Chains.turned_by` does, under additional turns x (N, U) in radians."""
        return self.chains.turned_by(self.angles, x)

    def forward(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the residuals (N, P, 3), in metres, and their derivatives (N, P, 3, U) by x (N, U)."""
        chains = self.chains
        whole, places, angles = self.posed(x)
        pairs = _ALL_PAIRS[chains.pairs]
        skins, share = chains.skins[pairs], self.touching.along[..., None]
        skins = skins[:, :, 0] + share * (skins[:, :, 1] - skins[:, :, 0])
        last = chains.last[pairs]
        points = places[:, last] + (whole[:, last] @ skins[..., None])[..., 0]  # (N, P, 2, 3)
        off = points[:, :, 0] - points[:, :, 1] - self.touching.ways
        # Twist is about the joint's own axis at rest, spread about one that the twist has turned, and bend
        # about one that both have.
        own = angles[:, chains.bones]
        euler = euler_to_rotmat(own)
        twist, bend = np.broadcast_to([1.0, 0.0, 0.0], own.shape), euler[..., 2]
        spread = np.stack([0.0 * own[..., 0], np.cos(own[..., 0]), np.sin(own[..., 0])], axis=-1)
        axis = np.choose(chains.which[:, None], [twist, spread, bend])
        above = np.array(chains.target.parents)[chains.bones]
        carried = np.where((above < 0)[:, None, None], np.eye(3), whole[:, above]) @ chains.axes[chains.bones]
        axis = (carried @ axis[..., None])[..., 0]  # (N, U, 3)
        moves = np.zeros((*off.shape[:2], len(chains.bones), 3))
        for k, sign in enumerate((1.0, -1.0)):
            arms = points[:, :, k, None] - places[:, None, chains.bones]  # (N, P, U, 3)
            turned = cross(np.broadcast_to(axis[:, None], arms.shape), arms)
            moves += sign * chains.moves[last[:, k], :, None] * turned
        return off, np.swapaxes(moves, -1, -2)

    def stiffness(self, slopes: np.ndarray, along: float) -> np.ndarray:
        """Return the stiffness R (N, P, 3, 3) of touches, between the skins and along them, from the Jacobian
        (N, P, 3, U) of the captured pose. `along`: the largest share of a distance along the skins that is
        closed."""
        gives = (slopes**2 / self.chains.turn_cost).sum(axis=(-1, -2))
        towards, weights = self.touching.towards, self.touching.weights
        between = ((towards[..., None, :] @ slopes)[..., 0, :] ** 2 / self.chains.turn_cost).sum(axis=-1)
        first, second = _ALL_PAIRS[self.chains.pairs].T
        share = along * weights * np.where(second == _HELD, TOUCHES.held_sliding, first == 0)
        rho = [
            weight / (np.maximum(give, 1e-9) * (1.0 - weight + TOUCHES.open_share))
            for weight, give in ((weights, between), (share, (gives - between) / 2.0))
        ]
        normal = towards[..., :, None] * towards[..., None, :]
        return rho[0][..., None, None] * normal + rho[1][..., None, None] * (np.eye(3) - normal)

    def solved(self, about: np.ndarray, again: int) -> np.ndarray:
        """Solve for the turns x (N, U) that are least away from `about` (N, U), in radians; `again` is 0 in
        the first pass, and 1 in the second, which starts from the mean."""
        chains = self.chains
        captured = self.angles[:, chains.bones, chains.which]
        # Angles that are beyond their range already may stay there.
        low = np.clip(chains.lower - captured, -TOUCHES.max_turn[0], 0.0)
        high = np.clip(chains.upper - captured, 0.0, TOUCHES.max_turn[0])
        slopes = self.forward(np.zeros_like(about))[1]
        about = np.clip(about, low, high)
        if again:
            low = np.maximum(low, about - TOUCHES.max_turn[1])
            high = np.minimum(high, about + TOUCHES.max_turn[1])
        bounded = _Bounded(self, self.stiffness(slopes, TOUCHES.sliding_share[again]), about, low, high)
        return solve(
            bounded, _Turns(about), max_iterations=TOUCHES.max_steps, tolerance=TOUCHES.tolerance
        ).state.x


@dataclass(frozen=True, eq=False)
class _Bounded(LeastSquares):
    """The least-squares problems of N frames, whose angles stay within bounds."""

    frames: _Problem
    stiffness: np.ndarray
    """(N, P, 3, 3) the stiffness R of each touch"""
    about: np.ndarray
    """(N, U) radians: the turns from which further turning costs"""
    low: np.ndarray
    """(N, U) radians: the least turns"""
    high: np.ndarray
    """(N, U) radians: the greatest turns"""

    def blocks(self, state: _Turns) -> _System:
        """Return the normal equations of the N frames at `state`."""
        off, slopes = self.frames.forward(state.x)
        flat = slopes.reshape(len(off), -1, slopes.shape[-1])
        pull = np.swapaxes((self.stiffness @ slopes).reshape(flat.shape), -1, -2)
        turn_cost, away = self.frames.chains.turn_cost, state.x - self.about
        of_touches = ((self.stiffness @ off[..., None])[..., 0] * off).sum(axis=(-1, -2))
        return _System(
            of_touches + (turn_cost * away**2).sum(axis=-1),
            pull @ flat + np.diag(turn_cost),
            (pull @ off.reshape(len(off), -1, 1))[..., 0] + turn_cost * away,
        )

    def step(
        self, state: _Turns, blocks: _System, damping: np.ndarray
    ) -> tuple[tuple[np.ndarray], np.ndarray]:
        """Return increments (N, U), in radians, that stay within the bounds, and the predicted decrease (N,)
        of the costs."""
        x, gradient = state.x, blocks.gradient
        free = ~((x <= self.low) & (gradient > 0.0) | (x >= self.high) & (gradient < 0.0))
        own = np.eye(x.shape[1], dtype=bool)
        hessian = np.where(own | free[:, :, None] & free[:, None, :], blocks.hessian, 0.0)
        hessian[:, own] *= 1.0 + damping[:, None]
        step = np.linalg.solve(hessian, np.where(free, -gradient, 0.0)[..., None])[..., 0]
        step = np.clip(x + step, self.low, self.high) - x
        return (step,), -(gradient * step).sum(axis=1)
