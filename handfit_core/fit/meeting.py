"""What landmarks say of parts of a hand that meet: which lies in front where they cross, and which touch."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np

from handfit_core.batch import slices
from handfit_core.fit.gaps import Times
from handfit_core.fit.observation import Meeting, Observation
from handfit_core.hand_model.chain import State
from handfit_core.hand_model.surface import Surface
from handfit_core.skeleton import TIP_KEYPOINTS

CROSSING: Final = np.array([(a, b) for a in (1, 2) for b in range(3, 15)])
"""(Q, 2) bones of the thumb and of the fingers, as `surface` numbers them, that can lie over each other"""
TIPS: Final = np.array([(2, b) for b in (5, 8, 11, 14)])
"""(T, 2) last bones that can pinch"""

CROSSED: Final = 0.08
"""Of the hand's size in the picture: bones that are nearer there lie over each other"""
MEMORY: Final = 0.12
"""seconds: what is in front is told by neighbours in time as well, with weights that fall like a bell of that
width"""
UNSURE: Final = 0.3
"""times the expected error of both depths: below this, nothing is said of what is in front"""

PINCHED: Final = (0.10, 0.13)
"""Of the hand's size in the picture: tips that are nearer than the first touch, as far as that tells; those
that are farther than the second do not"""
PINCHED_DEPTH: Final = (2.0, 3.0)
"""The same along the line of sight, times the expected error of both depths"""


def meeting(surface: Surface, seen: Observation, state: State, times: Times | None = None) -> Meeting:
    """What is seen of hands that are roughly where `state` has them. `times`: when they were seen in a clip,
    of which neighbours agree; None: they know nothing of each other."""
    parts = (_alone(surface, seen.select(part), state.select(part)) for part in slices(len(state)))
    each = Meeting.filled(len(state), parts)
    crosses = each.front != 0.0
    says, touching = np.nan_to_num(each.front), np.nan_to_num(each.touching)
    if times is not None:
        reach = times.reach(3.0 * MEMORY)
        bell = np.exp(-0.5 * (np.arange(-reach, reach + 1) / (MEMORY * times.fps)) ** 2)
        says, touching = times.mean(says, bell), times.mean(touching, bell)
    front = np.where(crosses & (np.abs(says) > UNSURE), np.sign(says), 0.0)
    return replace(each, front=front, touching=touching)


def _alone(surface: Surface, seen: Observation, state: State) -> Meeting:
    """The same of hands that know nothing of each other; `front` is by how many expected errors the first of
    a pair lies before the second."""
    size = np.maximum(np.ptp(seen.pixels, axis=1).max(axis=1), 1e-9)
    starts = _first_point(CROSSING)
    ends = [seen.pixels[:, starts[:, k]] for k in (0, 1)], [seen.pixels[:, starts[:, k] + 1] for k in (0, 1)]
    along, across = _nearest(ends[0][0], ends[1][0], ends[0][1], ends[1][1])
    depth, sigma = [], []
    for k in (0, 1):
        share, point = along[..., k], starts[:, k]
        depth.append(seen.depth[:, point] * (1.0 - share) + seen.depth[:, point + 1] * share)
        sigma.append(np.maximum(seen.depth_sigma[:, point], seen.depth_sigma[:, point + 1]))
    says = np.clip((depth[1] - depth[0]) / np.hypot(*sigma), -3.0, 3.0)
    says[across > CROSSED * size[:, None]] = 0.0
    tips = np.array(TIP_KEYPOINTS)[[0, *TIPS[:, 1] // 3]]
    off = seen.pixels[:, tips[1:]] - seen.pixels[:, tips[:1]]
    behind = np.abs(seen.depth[:, tips[1:]] - seen.depth[:, tips[:1]])
    behind /= np.hypot(seen.depth_sigma[:, tips[1:]], seen.depth_sigma[:, tips[:1]])
    touching = _within(np.linalg.norm(off, axis=-1) / size[:, None], PINCHED) * _within(behind, PINCHED_DEPTH)
    share = np.stack([1.0 - along, along], axis=-1)  # (B, Q, 2 bones, 2 ends)
    reach = (surface.radii(state.betas)[:, CROSSING] * share).sum(axis=(2, 3))
    metres = across * (state.depth_zero / seen.focal.mean(axis=1))[:, None]
    apart = np.sqrt(np.maximum(reach**2 - metres**2, 0.0))
    return Meeting(along, says, apart, touching)


def _first_point(bones: np.ndarray) -> np.ndarray:
    """The keypoint at which a bone of a finger begins."""
    return 1 + 4 * (bones // 3) + bones % 3


def _within(value: np.ndarray, range_: tuple[float, float]) -> np.ndarray:
    """1 up to the first, 0 from the second on."""
    first, second = range_
    return np.clip((second - value) / (second - first), 0.0, 1.0)


@np.errstate(all="ignore")
def _nearest(a: np.ndarray, b: np.ndarray, c: np.ndarray, d: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """How far along segments a-b and c-d (..., 2) they are nearest to each other, (..., 2), and how near."""
    ab, cd, off = b - a, d - c, c - a

    def foot(point: np.ndarray, start: np.ndarray, axis: np.ndarray) -> np.ndarray:
        return np.clip(((point - start) * axis).sum(axis=-1) / np.square(axis).sum(axis=-1), 0.0, 1.0)

    zero, one = np.zeros(a.shape[:-1]), np.ones(a.shape[:-1])
    tried = [(zero, foot(a, c, cd)), (one, foot(b, c, cd)), (foot(c, a, ab), zero), (foot(d, a, ab), one)]
    turn = ab[..., 0] * cd[..., 1] - ab[..., 1] * cd[..., 0]
    s = (off[..., 0] * cd[..., 1] - off[..., 1] * cd[..., 0]) / turn
    t = (off[..., 0] * ab[..., 1] - off[..., 1] * ab[..., 0]) / turn
    inside = (s >= 0.0) & (s <= 1.0) & (t >= 0.0) & (t <= 1.0)
    tried.append((np.where(inside, s, 0.0), np.where(inside, t, foot(a, c, cd))))
    shares = np.stack([np.stack(pair, axis=-1) for pair in tried])
    there = a + shares[..., :1] * ab - c - shares[..., 1:] * cd
    distance = np.linalg.norm(there, axis=-1)
    best = distance.argmin(axis=0)[None]
    return np.take_along_axis(shares, best[..., None], axis=0)[0], np.take_along_axis(distance, best, axis=0)[
        0
    ]
