"""What landmarks say of parts of a hand that meet: which lies in front where they cross, and which touch."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np

from handfit_core.batch import slices
from handfit_core.fit.gaps import Times
from handfit_core.fit.observation import Meeting, Observation
from handfit_core.fit.terms.coupling import MIDDLE_BEND
from handfit_core.geometry.crossing import CROSSING, CROSSING_STARTS, Crossing
from handfit_core.hand_model.chain import State
from handfit_core.hand_model.surface import Surface
from handfit_core.skeleton import TIP_KEYPOINTS

TIPS: Final = np.array([(2, b) for b in (5, 8, 11, 14)])
"""(T, 2) last bones that can pinch"""
_ROOTS: Final = CROSSING[:, 1] % 3 == 0
"""(Q,) bool: pairs with a finger's first bone, which a thumb that covers it need not reach"""

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

LYING: Final = (0.10, 0.20)
"""Of the hand's size along the line of sight: a thumb whose skin is nearer than the first to the skin of what
it covers lies on it, as far as that tells; one that is farther than the second stands off"""
STANDING_OFF: Final = 0.15
"""Of the hand's size: a thumb that stands farther off a bent finger that it crosses is likely seen wrongly"""
BENT: Final = float(np.radians(60.0))
"""radians of a finger's middle joint"""
LYING_DEPTH: Final = (1.5, 2.0)
"""Bounds of lying and standing off, times the expected error of both depths"""


def meeting(surface: Surface, seen: Observation, state: State, times: Times | None = None) -> Meeting:
    """What is seen of hands that are roughly where `state` has them. `times`: when they were seen in a clip,
    of which neighbours agree; None: they know nothing of each other."""
    parts = (_alone(surface, seen.select(part), state.select(part)) for part in slices(len(state)))
    each = Meeting.filled(len(state), parts)
    crosses = each.front != 0.0
    said = [np.nan_to_num(values) for values in (each.front, each.lying, each.touching)]
    if times is not None:
        reach = times.reach(3.0 * MEMORY)
        bell = np.exp(-0.5 * (np.arange(-reach, reach + 1) / (MEMORY * times.fps)) ** 2)
        said = [times.mean(values, bell) for values in said]
    says, lying, touching = said
    front = np.where(crosses & (np.abs(says) > UNSURE), np.sign(says), 0.0)
    return replace(each, front=front, lying=np.where(front != 0.0, lying, 0.0), touching=touching)


def _alone(surface: Surface, seen: Observation, state: State) -> Meeting:
    """The same of hands that know nothing of each other; `front` is by how many expected errors the first of
    a pair lies before the second."""
    size = np.maximum(np.ptp(seen.pixels, axis=1).max(axis=1), 1e-9)
    crossing = Crossing.of(seen.pixels)
    along, across = crossing.along, crossing.across
    sigma = np.maximum(seen.depth_sigma[:, CROSSING_STARTS], seen.depth_sigma[:, CROSSING_STARTS + 1])
    doubt = np.hypot(sigma[..., 0], sigma[..., 1])
    says = np.clip(crossing.deeper(seen.depth) / doubt, -3.0, 3.0)
    says[~crossing.crossed] = 0.0
    share = np.stack([1.0 - along, along], axis=-1)  # (B, Q, 2 bones, 2 ends)
    reach = (surface.radii(state.betas)[:, CROSSING] * share).sum(axis=(2, 3))
    scale = (state.depth_zero / seen.focal.mean(axis=1))[:, None]  # metres of a pixel
    apart = np.sqrt(np.maximum(reach**2 - np.square(across * scale), 0.0))
    gap = np.where(crossing.crossed & ~_ROOTS, np.abs(crossing.deeper(seen.depth)) - apart / scale, np.inf)
    of_finger = gap.reshape(len(gap), 2, 4, 3)
    nearest = (of_finger == of_finger.min(axis=3, keepdims=True)).reshape(gap.shape)
    lying = nearest * _within(gap / doubt, LYING_DEPTH) * _within(gap / size[:, None], LYING)
    tips = np.array(TIP_KEYPOINTS)[[0, *TIPS[:, 1] // 3]]
    off = seen.pixels[:, tips[1:]] - seen.pixels[:, tips[:1]]
    behind = np.abs(seen.depth[:, tips[1:]] - seen.depth[:, tips[:1]])
    behind /= np.hypot(seen.depth_sigma[:, tips[1:]], seen.depth_sigma[:, tips[:1]])
    touching = _within(np.linalg.norm(off, axis=-1) / size[:, None], PINCHED) * _within(behind, PINCHED_DEPTH)
    bent = state.angles[:, 1:, MIDDLE_BEND] > BENT
    off_finger = of_finger.min(axis=(1, 3)) / size[:, None]
    standing_off = (bent & (off_finger > STANDING_OFF) & np.isfinite(off_finger)).any(axis=1)
    return Meeting(along, says, apart, lying, standing_off, touching)


def _within(value: np.ndarray, range_: tuple[float, float]) -> np.ndarray:
    """1 up to the first, 0 from the second on."""
    first, second = range_
    return np.clip((second - value) / (second - first), 0.0, 1.0)
