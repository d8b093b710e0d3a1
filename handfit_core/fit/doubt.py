"""How far off a fitted hand is likely to be, finger by finger, in metres.

The error is the mean distance of a finger's four keypoints from the true ones, once all 21 are laid over
these by a similarity; the mean over the fingers is, but for the wrist, PA-MPJPE. Its logarithm is linear in
`evidence`: what can be seen without knowing the truth. The weights come from painted hands that no network
was trained on (scripts/train_doubt.py).
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import Final

import numpy as np

from handfit_core.detect.keypoints import HandDetection
from handfit_core.fit.gaps import Times
from handfit_core.fit.observation import Observation
from handfit_core.fit.terms.reprojection import NEAREST
from handfit_core.skeleton import Side

FILE: Final = Path(__file__).parent / "data" / "doubt.npz"

DOUBTFUL_ERROR: Final = 0.012
"""metres; of rendered hands that err by less than 15 mm, one in eight is expected to err by more than this"""
WRONG: Final = 0.015
"""metres; hands that err by more than this are what doubt is for"""
MOST: Final = 0.2
"""metres: no hand is farther off than its own length"""
AROUND: Final = 0.12
"""seconds before and after that tell of a frame's error too: where a tenth of the others is doubted, so are
73 % of painted clips' frames that are wrong by more than 15 mm, and by a frame alone 68 %"""

FITS_ARE_BETTER: Final = 0.87
"""times what the weights expect: they were found for fits to one landmark network"""
STEADY: Final = 0.0081
"""spread of the looks at a clean hand, in parts of its size"""
BY_SPREAD: Final = 0.25
"""Power with which the expected error grows with it. How far both landmark networks differ counts already, in
the expected errors of the points"""
BY_STANDING_OFF: Final = 1.4
"""times the error that is expected of a hand whose thumb seems to stand off a bent finger that it crosses"""

_LEAST: Final = 5e-4
"""metres; what is less than this tells nothing more"""
STEADIEST: Final = 0.3
"""of `STEADY`; looks that differ less tell nothing more"""
_SUREST: Final = 6.0
"""Logit of a side that counts as certain"""
_ACROSS, _ALONG = (17, 5), (0, 9)
"""Keypoints between which the palm lies"""


@np.errstate(all="ignore")
def side_logits(detections: Sequence[HandDetection], side: Side) -> np.ndarray:
    """(B,) logits of each being a hand of that side, as sure as can be where a person has said so, or nobody
    judged."""
    judged = [d.given_side is None and d.right_side is not None for d in detections]
    right = np.array([d.right_side for d in detections], dtype=np.float64)
    right = np.where(judged, np.where([d.side == side for d in detections], right, 1.0 - right), 1.0)
    return np.clip(np.log(right / (1.0 - right)), -_SUREST, _SUREST)


@np.errstate(all="ignore")
def evidence(seen: Observation, points: np.ndarray, sure: np.ndarray) -> np.ndarray:
    """(B, 5, 6) what tells of each finger's error: the logarithms of what the landmark network expects of its
    points and of all, and of how far these project from where they were seen, in metres at the hand's
    distance; whether the palm is seen from the front (1) or edge on (0); the logit of the hand's side.

    `points`: (B, 21, 3) metres, the fitted landmarks. `sure`: (B,) that logit.
    """
    metres = np.maximum(points[..., 2].mean(axis=1), NEAREST) / seen.focal.mean(axis=1)
    slope = points[..., :2] / np.maximum(points[..., 2:], NEAREST)
    projected = slope * seen.focal[:, None] + seen.centre[:, None]
    off = np.linalg.norm(projected - seen.pixels, axis=-1) * metres[:, None]
    expected = seen.pixel_sigma.mean(axis=-1) * metres[:, None]
    across, along = (points[:, b] - points[:, a] for a, b in (_ACROSS, _ALONG))
    normal = np.cross(across, along)
    facing = np.abs((normal * seen.ray).sum(axis=1)) / np.maximum(np.linalg.norm(normal, axis=1), 1e-12)

    def of_fingers(values: np.ndarray) -> list[np.ndarray]:
        fingers, hand = values[:, 1:].reshape(-1, 5, 4).mean(axis=2), values.mean(axis=1)
        return [np.log(fingers + _LEAST), np.log(hand + _LEAST)[:, None]]

    told = [*of_fingers(expected), *of_fingers(off), facing[:, None], sure[:, None]]
    return np.stack([np.broadcast_to(values, (len(points), 5)) for values in told], axis=-1)


@lru_cache(maxsize=1)
def _weights() -> tuple[np.ndarray, np.ndarray]:
    with np.load(FILE, allow_pickle=False) as arrays:
        return arrays["weights"], arrays["constants"]


@np.errstate(all="ignore")
def expected_error(told: np.ndarray, times: np.ndarray | float = 1.0) -> np.ndarray:
    """(B, 5) metres that each finger is likely to be off, of `evidence` (B, 5, 6) and what else counts so
    many `times` (B,); `MOST` where that has no numbers."""
    weights, constants = _weights()
    expected = np.exp(told @ weights + constants) * np.reshape(times, (-1, 1))
    return np.nan_to_num(np.minimum(expected, MOST), nan=MOST)


@np.errstate(all="ignore")
def doubted(detections: Sequence[HandDetection]) -> np.ndarray:
    """(B,) times the error that the evidence of each hand expects: by how far the looks at it differ."""
    times = np.full(len(detections), FITS_ARE_BETTER)
    for row, d in enumerate(detections):
        if d.spread is not None:
            spread = np.linalg.norm(d.spread[:, :2], axis=1).mean() / max(d.extent, 1e-9)
            times[row] *= max(spread / STEADY, STEADIEST) ** BY_SPREAD
    return times


def doubted_thumb(seen: Observation) -> np.ndarray:
    """(B,) times the error that is expected of hands whose meeting parts were asked for."""
    off = False if seen.meeting is None else seen.meeting.standing_off
    return np.where(np.broadcast_to(off, len(seen)), BY_STANDING_OFF, 1.0)


def among_neighbours(expected: np.ndarray, times: Times) -> np.ndarray:
    """(N, 5) expected errors of a clip's detections, as geometric means over those around in the same shot:
    errors outlast a frame, and evidence flickers."""
    return np.exp(times.mean(np.log(expected), np.ones(2 * times.reach(AROUND) + 1)))


def doubtful(expected: np.ndarray) -> np.ndarray:
    """(B,) bool: hands that may well be wrong, by their fingers' expected errors (B, 5)."""
    return expected.mean(axis=1) > DOUBTFUL_ERROR
