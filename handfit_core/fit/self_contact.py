"""Self-contact of hands as their landmarks show it: which of two parts is in front where they cross, and
which touch."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from handfit_core.common.batch import slices
from handfit_core.common.skeleton import TIP_KEYPOINTS
from handfit_core.fit.gaps import Times
from handfit_core.fit.observation import Observation, SelfContact
from handfit_core.geometry.crossing import CROSSING, CROSSING_STARTS, Crossing
from handfit_core.hand_model.anatomy import MIDDLE_BEND
from handfit_core.hand_model.chain import State
from handfit_core.hand_model.surface import Surface

PINCH_BONES: Final = np.array([(2, b) for b in (5, 8, 11, 14)])
"""(P, 2) the last bones of the thumb and of each other finger, whose tips can pinch, as `Surface` numbers
bones"""


@dataclass(frozen=True)
class ContactSettings:
    """Settings of when parts of a hand are taken to lie over each other, or to touch."""

    vote_seconds: float = 0.12
    """seconds: standard deviation of the weights with which neighbouring frames vote on the order"""
    min_order_sigmas: float = 0.3
    """Depth difference of crossing parts, in expected errors of both depths, below which no order is given"""
    pinch_distance: tuple[float, float] = (0.10, 0.13)
    """Distance of two tips in the picture, in parts of the hand's size, up to which they touch, and from
    which they do not"""
    pinch_depth_sigmas: tuple[float, float] = (2.0, 3.0)
    """Distances of two tips along the line of sight, in expected errors of both depths, up to which they
    touch, and from which they do not"""
    gap: tuple[float, float] = (0.10, 0.20)
    """Gap between the skins of the thumb and of what it crosses, along the line of sight, in parts of the
    hand's size, up to which they are in contact, and from which they are not"""
    gap_sigmas: tuple[float, float] = (1.5, 2.0)
    """Gaps between the thumb's skin and that of what it crosses, in expected errors of both depths, up to
    which they are in contact, and from which they are not"""
    lifted_gap: float = 0.15
    """Gap of the thumb to a bent finger, in parts of the hand's size, beyond which the thumb is likely seen
    wrongly"""
    bent_finger: float = math.radians(60.0)
    """radians at a finger's middle joint from which it counts as bent"""


CONTACT: Final = ContactSettings()


def find_self_contact(
    surface: Surface, seen: Observation, state: State, times: Times | None = None
) -> SelfContact:
    """Find the self-contact of B observed hands, whose approximate poses are `state`.

    `times`: when the frames of a clip were seen, whose neighbours then vote; None: pictures are independent.
    """
    chunks = (_per_frame(surface, seen.select(rows), state.select(rows)) for rows in slices(len(state)))
    each = SelfContact.collect(len(state), chunks)
    crosses = each.front != 0.0
    evidence = [np.nan_to_num(values) for values in (each.front, each.in_contact, each.pinch)]
    if times is not None:
        radius = times.radius(3.0 * CONTACT.vote_seconds)
        weights = np.exp(-0.5 * (np.arange(-radius, radius + 1) / (CONTACT.vote_seconds * times.fps)) ** 2)
        evidence = [times.mean(values, weights) for values in evidence]
    order_sigmas, in_contact, pinch = evidence
    front = np.where(crosses & (np.abs(order_sigmas) > CONTACT.min_order_sigmas), np.sign(order_sigmas), 0.0)
    return replace(each, front=front, in_contact=np.where(front != 0.0, in_contact, 0.0), pinch=pinch)


def _per_frame(surface: Surface, seen: Observation, state: State) -> SelfContact:
    """Find the self-contact of each frame by itself. Here `front` is the signed depth order of each pair, in
    sigmas."""
    size = np.maximum(np.ptp(seen.pixels, axis=1).max(axis=1), 1e-9)
    crossing = Crossing.of(seen.pixels)
    along, across = crossing.along, crossing.across
    sigma = np.maximum(seen.depth_sigma[:, CROSSING_STARTS], seen.depth_sigma[:, CROSSING_STARTS + 1])
    pair_sigma = np.hypot(sigma[..., 0], sigma[..., 1])
    order_sigmas = np.clip(crossing.deeper(seen.depth) / pair_sigma, -3.0, 3.0)
    order_sigmas[~crossing.crossed] = 0.0
    share = np.stack([1.0 - along, along], axis=-1)  # (B, Q, 2 bones, 2 ends)
    radii = (surface.radii(state.betas)[:, CROSSING] * share).sum(axis=(2, 3))  # of both parts, metres
    scale = (state.depth_zero / seen.focal.mean(axis=1))[:, None]  # metres of a pixel
    separation = np.sqrt(np.maximum(radii**2 - np.square(across * scale), 0.0))
    # (Q,) bool: pairs with a finger's first bone, which a thumb in front of it need not touch
    gap = np.where(
        crossing.crossed & ~(CROSSING[:, 1] % 3 == 0),
        np.abs(crossing.deeper(seen.depth)) - separation / scale,
        np.inf,
    )
    of_finger = gap.reshape(len(gap), 2, 4, 3)
    nearest = (of_finger == of_finger.min(axis=3, keepdims=True)).reshape(gap.shape)
    in_contact = (
        nearest * _falling(gap / pair_sigma, CONTACT.gap_sigmas) * _falling(gap / size[:, None], CONTACT.gap)
    )
    tips = np.array(TIP_KEYPOINTS)[[0, *PINCH_BONES[:, 1] // 3]]
    off = seen.pixels[:, tips[1:]] - seen.pixels[:, tips[:1]]
    behind = np.abs(seen.depth[:, tips[1:]] - seen.depth[:, tips[:1]])
    behind /= np.hypot(seen.depth_sigma[:, tips[1:]], seen.depth_sigma[:, tips[:1]])
    pinch = _falling(np.linalg.norm(off, axis=-1) / size[:, None], CONTACT.pinch_distance) * _falling(
        behind, CONTACT.pinch_depth_sigmas
    )
    bent = state.angles[:, 1:, MIDDLE_BEND] > CONTACT.bent_finger
    off_finger = of_finger.min(axis=(1, 3)) / size[:, None]
    lifted = (bent & (off_finger > CONTACT.lifted_gap) & np.isfinite(off_finger)).any(axis=1)
    return SelfContact(along, order_sigmas, separation, in_contact, lifted, pinch)


def _falling(value: np.ndarray, range_: tuple[float, float]) -> np.ndarray:
    """Return 1 up to the first bound of `range_`, 0 from the second on, and linear values between."""
    first, second = range_
    return np.clip((second - value) / (second - first), 0.0, 1.0)
