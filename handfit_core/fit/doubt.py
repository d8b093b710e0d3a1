"""Expected error of a fitted hand, finger by finger, in metres.

The error is the mean distance of a finger's four keypoints from the true ones, once all 21 are laid over
these by a similarity; the mean over the fingers is PA-MPJPE without the wrist. Its logarithm is linear in
`evidence`, which needs no truth. The weights come from painted hands that no network was trained on
(scripts/train_doubt.py at commit 2ca2c99).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Final

import numpy as np

from handfit_core.common.skeleton import SIDES, Side
from handfit_core.detect.keypoints import Detections
from handfit_core.fit.gaps import Times
from handfit_core.fit.observation import Observation
from handfit_core.fit.settings import TERMS

FILE: Final = Path(__file__).parent / "data" / "doubt.npz"


@dataclass(frozen=True)
class DoubtSettings:
    """Settings that turn the network's weights into an expected error, and that say from which error on a
    hand is doubtful."""

    doubtful_error: float = 0.012
    """metres of expected error from which a hand is doubtful: that marks one in eight of the rendered hands
    that err by less than 15 mm"""
    wrong_error: float = 0.015
    """metres of true error from which a hand is wrong, and should be marked as doubtful"""
    max_error: float = 0.2
    """metres: no hand is farther off than its own length"""
    window_seconds: float = 0.12
    """seconds before and after over which errors are averaged: where a tenth of the right frames of painted
    clips is doubtful, so are 73 % of those that are wrong by more than 15 mm; 68 % without the average"""
    calibration_factor: float = 0.87
    """Factor of the error that the weights give: they were found for fits to one landmark network"""
    clean_crop_spread: float = 0.0081
    """Spread of the landmarks over several crops of a clean hand, in parts of its size"""
    crop_spread_power: float = 0.25
    """Power of the landmarks' spread over several crops, relative to `clean_crop_spread`, with which the
    expected error grows. How far both landmark networks differ counts already, in the expected errors of the
    points"""
    lifted_thumb_factor: float = 1.4
    """Factor of the expected error of a hand whose thumb seems to be lifted off a bent finger that it
    crosses"""
    log_floor: float = 5e-4
    """metres, added to lengths before their logarithm is taken: smaller ones carry no information"""
    min_crop_spread: float = 0.3
    """Least spread, in parts of `clean_crop_spread`: a smaller one carries no information"""
    max_side_logit: float = 6.0
    """Logit of a side that counts as certain"""


DOUBT: Final = DoubtSettings()


_ACROSS, _ALONG = (17, 5), (0, 9)
"""Pairs of keypoints whose connecting lines span the palm: index and little finger's knuckle, wrist and
middle finger's knuckle"""


@np.errstate(all="ignore")
def side_logits(hands: Detections, side: Side) -> np.ndarray:
    """(B,) logits of each detected hand being one of that side; the highest logit where a person has said so,
    or where the side was not judged."""
    judged = (hands.given_side < 0) & np.isfinite(hands.right_side)
    named = hands.side == SIDES.index(side)
    right = np.where(judged, np.where(named, hands.right_side, 1.0 - hands.right_side), 1.0)
    return np.clip(np.log(right / (1.0 - right)), -DOUBT.max_side_logit, DOUBT.max_side_logit)


@np.errstate(all="ignore")
def evidence(seen: Observation, points: np.ndarray, side_logit: np.ndarray) -> np.ndarray:
    """(B, 5, 6) features of each finger's error.

    0, 1: the landmark network's expected error of the finger's points and of the whole hand's; 2, 3: their
    reprojection errors. All four are logarithms of metres at the hand's distance. 4: 1 where the palm is seen
    from the front, 0 edge on. 5: the logit of the hand's side.

    `points`: (B, 21, 3) metres, camera frame, the fitted landmarks. `side_logit`: (B,).
    """
    metres = np.maximum(points[..., 2].mean(axis=1), TERMS.nearest) / seen.focal.mean(axis=1)
    slope = points[..., :2] / np.maximum(points[..., 2:], TERMS.nearest)
    projected = slope * seen.focal[:, None] + seen.centre[:, None]
    off = np.linalg.norm(projected - seen.pixels, axis=-1) * metres[:, None]
    expected = seen.pixel_sigma.mean(axis=-1) * metres[:, None]
    across, along = (points[:, b] - points[:, a] for a, b in (_ACROSS, _ALONG))
    normal = np.cross(across, along)
    facing = np.abs((normal * seen.ray).sum(axis=1)) / np.maximum(np.linalg.norm(normal, axis=1), 1e-12)

    def of_fingers(values: np.ndarray) -> list[np.ndarray]:
        fingers, hand = values[:, 1:].reshape(-1, 5, 4).mean(axis=2), values.mean(axis=1)
        return [np.log(fingers + DOUBT.log_floor), np.log(hand + DOUBT.log_floor)[:, None]]

    features = [*of_fingers(expected), *of_fingers(off), facing[:, None], side_logit[:, None]]
    return np.stack([np.broadcast_to(values, (len(points), 5)) for values in features], axis=-1)


@lru_cache(maxsize=1)
def _weights() -> tuple[np.ndarray, np.ndarray]:
    with np.load(FILE, allow_pickle=False) as arrays:
        return arrays["weights"], arrays["constants"]


@np.errstate(all="ignore")
def expected_error(features: np.ndarray, factor: np.ndarray | float = 1.0) -> np.ndarray:
    """Return the metres (B, 5) that each finger is likely to be off.

    `features`: (B, 5, 6), see `evidence`. `factor`: one number or (B,) that multiply the errors, see
    `crop_spread_factor` and `lifted_thumb_factor`. The result is `max_error` where features are not finite.
    """
    weights, constants = _weights()
    expected = np.exp(features @ weights + constants) * np.reshape(factor, (-1, 1))
    return np.nan_to_num(np.minimum(expected, DOUBT.max_error), nan=DOUBT.max_error)


@np.errstate(all="ignore")
def crop_spread_factor(hands: Detections) -> np.ndarray:
    """(B,) factors of the expected error of B hands, larger the more the landmarks of several crops of a hand
    differ."""
    if hands.spread is None:
        return np.full(len(hands), DOUBT.calibration_factor)
    spread = np.linalg.norm(hands.spread[..., :2], axis=2).mean(axis=1) / np.maximum(hands.extent, 1e-9)
    factor = np.maximum(spread / DOUBT.clean_crop_spread, DOUBT.min_crop_spread) ** DOUBT.crop_spread_power
    return DOUBT.calibration_factor * np.where(np.isfinite(spread), factor, 1.0)


def lifted_thumb_factor(seen: Observation) -> np.ndarray:
    """(B,) factors of the expected error of B hands: above 1 where the thumb seems to be lifted off a finger
    that it crosses."""
    lifted = False if seen.self_contact is None else seen.self_contact.lifted
    return np.where(np.broadcast_to(lifted, len(seen)), DOUBT.lifted_thumb_factor, 1.0)


def temporal_mean(expected: np.ndarray, times: Times) -> np.ndarray:
    """Return geometric means (N, 5) of expected errors (N, 5) in metres over the neighbouring frames in the
    same shot: errors outlast a frame, and evidence flickers."""
    return np.exp(times.mean(np.log(expected), np.ones(2 * times.radius(DOUBT.window_seconds) + 1)))


def doubtful(expected: np.ndarray) -> np.ndarray:
    """Tell which hands are doubtful, (B,) bool: those whose fingers' expected errors (B, 5) in metres exceed
    `doubtful_error` on average."""
    return expected.mean(axis=1) > DOUBT.doubtful_error
