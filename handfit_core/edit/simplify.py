"""Fewer keys for a hand's motion: which frames keep theirs, and how the curves lie between them.

Each bone's channels become cubic splines through some of their dense values, so a key holds exactly what
was there. Only the slopes at keys are free. Of a segment from frame 0 to h with values a, b and slopes m, n

    x(f) = a H0(f) + m H1(f) + b H2(f) + n H3(f),    minimise  sum (x(f) - dense(f))^2 + s/h integral x''^2

over all slopes of a channel: one tridiagonal system, in which a key's slope is the same on both sides. Bezier
handles at a third of a segment make the same cubic. As in Schneider's fit ("An Algorithm for Automatically
Fitting Digitized Curves", 1990) a segment that misses the bound gets a key where it misses it most. Then keys
are thinned out, and what is missing is put back, as long as fewer are left.
"""

from __future__ import annotations

from collections.abc import Generator, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from handfit_core.common.skeleton import FINGER_JOINTS, FINGERS, NUM_JOINTS, keypoints_from_joints
from handfit_core.geometry.camera import Intrinsics
from handfit_core.geometry.rotations import channels_to_quat, quat_to_rotmat
from handfit_core.hand_model.axes import WORLD_FROM_CAMERA, RestPose
from handfit_core.retarget.transfer import SourceHand

LOCATION: Final = NUM_JOINTS
"""`Channels.joint` of the channels that hold the wrist's location"""
_BOUND_SHARE = 0.999
"""Share of a bound that is used up, since Blender rounds keys to 32 bits"""
_NEAREST = 1e-3
"""metres in front of the camera, nearer than which points are not judged in pixels"""
_SEGMENT_FRAMES = 20
"""Length, in dense frames, of the segments into which a clip is split when, for each of them, the fewer keys
of two choices are taken"""


@dataclass(frozen=True, eq=False)
class Channels:
    """The channels that one bone or control moves by, with their values on N dense frames."""

    values: np.ndarray
    """(N, C) values on the dense frames: quaternions (w, x, y, z) of length 1 and steady sign,
    (angle, x, y, z), Euler angles, or a location; radians, and the armature's units"""
    mode: str
    """The kind of these values: QUATERNION, AXIS_ANGLE, an order of Euler angles such as XYZ, or LOCATION"""
    group: int = 0
    """Number, from 0, of the group of channels that have their keys on common frames"""
    arm: float = 1.0
    """For a location the length of the lever, in the armature's units, whose end, turned by the bound in
    degrees, moves as far as the location may be off"""
    joint: int = -1
    """Number of the joint of a captured hand that these channels turn, in MANO's order, or `LOCATION`; -1 for
    none"""


@dataclass(frozen=True, eq=False)
class Sight:
    """A captured hand's dense motion as the camera that captured it sees it."""

    rest: RestPose
    source: SourceHand
    intrinsics: Intrinsics
    quats: np.ndarray
    """(N, 16, 4) the bones' rotations on the dense frames as quaternions (w, x, y, z), see `RestPose`"""
    locations: np.ndarray
    """(N, 3) metres: the wrist bone's locations on the dense frames"""

    def points(self, quats: np.ndarray, locations: np.ndarray) -> np.ndarray:
        """Return the keypoints (N, 21, 3), in metres in the camera frame, of hands whose bones have these
        quaternions (N, 16, 4) and locations (N, 3). Pose blend shapes of fingertips are left out."""
        frames = self.rest.frames
        vector = np.einsum("jab,njb->nja", frames, quats[..., 1:])
        turns = quat_to_rotmat(np.concatenate([quats[..., :1], vector], axis=-1))
        points = keypoints_from_joints(*self.source.points(turns)) - self.rest.wrist
        moved = self.rest.wrist + locations @ frames[0].T
        return (points @ np.swapaxes(turns[:, 0], -1, -2) + moved[:, None]) @ WORLD_FROM_CAMERA


@dataclass(frozen=True, eq=False)
class Spline:
    """The K keys that are left of some channels on N dense frames, and the curves' slopes at them."""

    rows: np.ndarray
    """(K,) the indices of the dense frames that have keys, increasing"""
    values: np.ndarray
    """(K, C) the channels' values on these frames"""
    slopes: np.ndarray
    """(K, C) slopes of the curves at the keys, in values per frame, equal before and behind a key"""

    def handles(self, frames: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return where the Bezier handles before and behind each key lie, (K, C, 2) frame and value each,
        when the dense frames have the numbers `frames` (N,). At the ends they are as long as on the other
        side."""
        places = np.asarray(frames, dtype=np.float64)[self.rows]
        gaps = np.diff(places) / 3.0 if len(places) > 1 else np.full(1, 1.0 / 3.0)
        before, behind = np.concatenate([gaps[:1], gaps]), np.concatenate([gaps, gaps[-1:]])
        ends = []
        for step in (-before[: len(places)], behind[: len(places)]):
            place = np.broadcast_to((places + step)[:, None], self.values.shape)
            ends.append(np.stack([place, self.values + self.slopes * step[:, None]], axis=-1))
        return ends[0], ends[1]


@dataclass(frozen=True, eq=False)
class Simplified:
    """A motion with fewer keys."""

    splines: tuple[Spline, ...]
    """One spline for each of the given `Channels`, in their order"""
    degrees: float
    """degrees: the largest rotation between a bone and its dense one, relative to its parent"""
    pixels: float | None
    """pixels: the largest distance of a keypoint from where it was in the picture; None where no camera sees
    the hand"""


def simplifying(
    frames: np.ndarray,
    channels: Sequence[Channels],
    degrees: float,
    pixels: float = np.inf,
    *,
    sight: Sight | None = None,
    kept: Sequence[int] = (),
) -> Generator[int, None, Simplified]:
    """Find the few keys that keep to the bounds on every dense frame, in steps: yields how many keys there
    are so far, counted once per channel.

    `frames` (N,), increasing; `kept`: rows that keep their keys in any case, as the first and the last one
    do. `pixels` counts with a `sight` only. Locations have to keep to `degrees`, too, by their `arm`.
    """
    fit = _Fit(
        np.asarray(frames, dtype=np.float64),
        channels,
        _BOUND_SHARE * np.radians(degrees),
        _BOUND_SHARE * pixels,
        sight,
    )
    needed = np.zeros(len(frames), dtype=bool)
    needed[[0, -1, *kept]] = True
    best = yield from fit.refined(np.broadcast_to(needed, (fit.groups, len(frames))))
    # Every n-th key, from which one on, is taken away in turn
    for turn, (every, first) in enumerate(((2, 0), (2, 1), (3, 0), (3, 1), (3, 2)) * 2):
        thinned = best.keys.copy()
        for keys in thinned:
            spare = np.flatnonzero(keys & ~needed)
            keys[spare[first::every]] = False
        found = yield from fit.refined(thinned)
        merged = yield from fit.refined(_fewer(best.keys, found.keys, turn * _SEGMENT_FRAMES // 3) | needed)
        best = min(best, found, merged, key=lambda state: state.cost)
    return best.simplified()


@dataclass(frozen=True, eq=False)
class _State:
    """One choice of keys, (G, N) bool for G groups on N frames, with the splines through them and how far
    these are off."""

    fit: _Fit
    keys: np.ndarray
    values: np.ndarray
    """(T, N, 4) the values of the T tracks' splines on the dense frames"""
    slopes: np.ndarray
    """(K, 4) the slopes at the keys of all tracks, one track after the other"""
    turned: np.ndarray
    """(T, N) radians by which the splines' rotations are off; for locations the angle at the end of their
    arms"""
    missed: np.ndarray
    """(N, 21) pixels by which keypoints are off in the picture; zeros where no bound asks for them"""

    @property
    def cost(self) -> int:
        """Number of the keys, each counted once per channel."""
        return int(self.keys.sum(axis=1) @ self.fit.widths)

    def simplified(self) -> Simplified:
        splines, first = [], 0
        for track in self.fit.channels:
            rows = np.flatnonzero(self.keys[track.group])
            slopes = self.slopes[first : first + len(rows), : track.values.shape[1]]
            splines.append(Spline(rows, track.values[rows], slopes))
            first += len(rows)
        turning = [i for i, track in enumerate(self.fit.channels) if track.mode != "LOCATION"]
        return Simplified(
            tuple(splines),
            float(np.degrees(self.turned[turning].max(initial=0.0))),
            None if self.fit.sight is None else float(self.fit.missed(self.values).max(initial=0.0)),
        )


class _Fit:
    """The fit of splines to the channels within their bounds: T tracks of 4 numbers, padded with zeros, all
    fitted at once."""

    def __init__(
        self,
        frames: np.ndarray,
        channels: Sequence[Channels],
        radians: float,
        pixels: float,
        sight: Sight | None,
    ) -> None:
        self.frames, self.channels, self.sight = frames, channels, sight
        self.radians, self.pixels = radians, pixels
        self.of_group = np.array([track.group for track in channels])
        self.groups = int(self.of_group.max()) + 1
        widths = [track.values.shape[1] for track in channels]
        self.widths = np.bincount(self.of_group, weights=widths, minlength=self.groups)
        self.dense = np.zeros((len(channels), len(frames), 4))
        for values, track in zip(self.dense, channels, strict=True):
            values[:, : track.values.shape[1]] = track.values
        self._rotations = [
            None if track.mode == "LOCATION" else channels_to_quat(track.values, track.mode)
            for track in channels
        ]
        if sight is not None:
            points = sight.points(sight.quats, sight.locations)
            self._seen = points[..., 2].min(axis=1) > _NEAREST
            self._picture = sight.intrinsics.project(points)
            self._levers = _levers(points, sight.intrinsics)[[track.joint for track in channels]]

    def refined(self, keys: np.ndarray) -> Generator[int, None, _State]:
        """Add keys to those of `keys` (G, N) bool until the splines keep to the bounds; yields the cost after
        each round, and returns the state reached."""
        keys = keys.copy()
        while True:
            state = self._fitted(keys)
            yield state.cost
            more = _worst(keys, self._excess(state))
            if len(more) == 0:
                return state
            keys.ravel()[more] = True

    def _fitted(self, keys: np.ndarray) -> _State:
        values, slopes = _splines(self.frames, self.dense, keys[self.of_group])
        turned = np.zeros(values.shape[:2])
        for i, track in enumerate(self.channels):
            rotations = self._rotations[i]
            if rotations is None:
                off = np.linalg.norm(values[i] - self.dense[i], axis=-1)
                turned[i] = off / track.arm
            else:
                found = channels_to_quat(values[i, :, : track.values.shape[1]], track.mode)
                turned[i] = _between(rotations, found)
        judged = self.sight is not None and np.isfinite(self.pixels)
        missed = self.missed(values) if judged else np.zeros((len(self.frames), 1))
        return _State(self, keys.copy(), values, slopes, turned, missed)

    def missed(self, values: np.ndarray) -> np.ndarray:
        """Return the pixels (N, 21) by which keypoints of a captured hand with these values are seen at the
        wrong place."""
        assert self.sight is not None
        quats, locations = self.sight.quats.copy(), self.sight.locations
        for own, track in zip(values, self.channels, strict=True):
            if track.joint == LOCATION:
                locations = own[:, :3]
            else:
                quats[:, track.joint] = channels_to_quat(own[:, : track.values.shape[1]], track.mode)
        points = self.sight.points(quats, locations)
        off = np.linalg.norm(self.sight.intrinsics.project(points) - self._picture, axis=-1)
        return np.where(self._seen[:, None], np.nan_to_num(off, nan=np.inf), 0.0)

    def _excess(self, state: _State) -> np.ndarray:
        """Return how many times its bound each group is off on each frame, (G, N), where that is more than
        once; else zero. Keypoints seen at the wrong place are put to the group that turns or moves them
        farthest there."""
        excess = np.zeros((self.groups, len(self.frames)))
        off = state.turned / self.radians
        np.maximum.at(excess, self.of_group, np.where(off > 1.0, off, 0.0))
        worst = state.missed.argmax(axis=1)
        rows = np.flatnonzero(state.missed.max(axis=1) > self.pixels)
        if len(rows):
            arms = np.array([[track.arm if track.joint == LOCATION else 1.0] for track in self.channels])
            moved = state.turned[:, rows] * arms * self._levers[:, rows, worst[rows]]
            group = self.of_group[moved.argmax(axis=0)]
            np.maximum.at(excess, (group, rows), state.missed[rows, worst[rows]] / self.pixels)
        return excess


def _levers(points: np.ndarray, intrinsics: Intrinsics) -> np.ndarray:
    """Return the pixels (17, N, 21) by which keypoints (N, 21, 3) in metres move at most per radian of each
    of the 16 joints, and per metre of the location."""
    per_metre = max(intrinsics.fx, intrinsics.fy) / np.maximum(points[..., 2], _NEAREST)
    levers = np.zeros((NUM_JOINTS + 1, *points.shape[:2]))
    levers[0] = np.linalg.norm(points - points[:, :1], axis=-1) * per_metre
    levers[NUM_JOINTS] = per_metre
    for f, finger in enumerate(FINGERS):
        for i, joint in enumerate(FINGER_JOINTS[finger]):
            own, beyond = 1 + 4 * f + i, slice(2 + 4 * f + i, 5 + 4 * f)
            away = np.linalg.norm(points[:, beyond] - points[:, [own]], axis=-1)
            levers[joint, :, beyond] = away * per_metre[:, beyond]
    return levers


def _between(quats: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Return the angles (N,), in radians, between unit quaternions (N, 4) and others (N, 4); exact for small
    ones."""
    chord = np.minimum(np.linalg.norm(quats - other, axis=-1), np.linalg.norm(quats + other, axis=-1))
    return 4.0 * np.arcsin(np.minimum(chord / 2.0, 1.0))


def _worst(keys: np.ndarray, excess: np.ndarray) -> np.ndarray:
    """Find in each segment between keys the frame at which the bounds are exceeded most, as indices into the
    raveled (G, N); none for a segment that exceeds no bound."""
    excess = np.where(keys, 0.0, excess).ravel()
    starts = np.flatnonzero(keys)
    segments = np.cumsum(keys.ravel()) - 1
    most = np.maximum.reduceat(excess, starts)
    rows = np.flatnonzero((excess > 0.0) & (excess == most[segments]))
    return rows[np.unique(segments[rows], return_index=True)[1]]


def _fewer(keys: np.ndarray, others: np.ndarray, first: int) -> np.ndarray:
    """Take, segment by segment, the fewer keys of two choices (G, N) bool. `first`: at which frame of a
    segment the clip begins."""
    segment = (np.arange(keys.shape[1]) + first) // _SEGMENT_FRAMES
    starts = np.flatnonzero(np.diff(segment, prepend=-1))
    counts = [np.add.reduceat(choice, starts, axis=1, dtype=int) for choice in (keys, others)]
    return np.where((counts[1] < counts[0])[:, segment - segment[0]], others, keys)


def _splines(frames: np.ndarray, dense: np.ndarray, keys: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the values (T, N, 4) and the keys' slopes (K, 4) of the splines through dense values (T, N, 4)
    at keys (T, N) bool, among which are each track's first and last frame."""
    tracks, count = keys.shape
    at = np.flatnonzero(keys)
    if count == 1:
        return dense.copy(), np.zeros((len(at), 4))
    ends = at % count == count - 1
    left = np.flatnonzero(~ends)  # where segments begin, among the keys
    right = left + 1
    place, value = frames[at % count], dense.reshape(-1, 4)[at]
    h = (place[right] - place[left])[:, None]

    segment = np.cumsum(keys.ravel()) - 1 - np.repeat(np.arange(tracks), count)
    segment[count - 1 :: count] -= 1  # the last frame ends the segment before it
    u = (np.tile(frames, tracks) - place[left][segment])[:, None] / h[segment]
    v = 1.0 - u
    rise, fall = u * v * v * h[segment], -u * u * v * h[segment]
    base = value[left][segment] * (v * v * (1.0 + 2.0 * u)) + value[right][segment] * (
        u * u * (1.0 + 2.0 * v)
    )
    rest = dense.reshape(-1, 4) - base

    total = lambda rows: np.add.reduceat(rows, at[left], axis=0)  # noqa: E731
    # s above, which decides the slopes where no dense frame lies between two keys, and keeps jumps from
    # swinging
    weight = 0.03 / h
    pull = 6.0 * weight * (value[right] - value[left]) / h
    diagonal, beside, wanted = np.zeros((len(at), 1)), np.zeros((len(at), 1)), np.zeros((len(at), 4))
    diagonal[left] += total(rise * rise) + 4.0 * weight
    diagonal[right] += total(fall * fall) + 4.0 * weight
    beside[left] = total(rise * fall) + 2.0 * weight
    wanted[left] += total(rise * rest) + pull
    wanted[right] += total(fall * rest) + pull
    slopes = _solved(diagonal, beside[:-1], wanted)
    fitted = base + rise * slopes[left][segment] + fall * slopes[right][segment]
    return fitted.reshape(dense.shape), slopes


def _solved(diagonal: np.ndarray, beside: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """Solve a symmetric tridiagonal system for (K, 4) unknowns: `diagonal` (K, 1), what stands `beside` it (K
    - 1, 1), and the right side `wanted` (K, 4).

    By cyclic reduction, all rows at once: each row is eliminated from those 1, 2, 4, ... rows away, until
    none is coupled.
    """
    step = 1
    while len(beside) and np.any(beside):
        by_before, by_behind = beside / diagonal[:-step], beside / diagonal[step:]
        farther = -by_behind[:-step] * beside[step:]
        less, known = diagonal.copy(), wanted.copy()
        less[step:] -= by_before * beside
        less[:-step] -= by_behind * beside
        known[step:] -= by_before * wanted[:-step]
        known[:-step] -= by_behind * wanted[step:]
        diagonal, wanted, beside, step = less, known, farther, 2 * step
    return wanted / diagonal
