"""The offset in time between two views: how fingers move does not depend on where a camera stands.

A hand's channels are five curls and 15 distances of fingertips of the fitted hand, and 15 distances of the
detector's world landmarks. With r_c the correlation of channel c at a lag, the score of the lag is
-1/2 mean log(1 - r_c^2).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from handfit_core.capturing.views.cameras import HandPair
from handfit_core.capturing.views.hands import ViewedHand
from handfit_core.fit.settings import VIEWS

_TIPS = (4, 8, 12, 16, 20)
_LEFT, _RIGHT = np.triu_indices(5, 1)
_STEPS = 2
"""Samples a frame of the slower view"""


@dataclass(frozen=True)
class OffsetScore:
    """An offset that is likely, and how well the fingers' motions agree at it."""

    offset: float
    """seconds from the first view's start to the second one's"""
    score: float


def channels(hand: ViewedHand) -> np.ndarray:
    """(N, 35) what tells the time of a hand's detections, each without a unit."""
    return np.concatenate(
        [
            hand.state.angles.reshape(-1, 5, 3, 3)[..., 2].sum(axis=2),
            _distances(hand.points),
            _distances(hand.world),
        ],
        axis=1,
    )


def _distances(points: np.ndarray) -> np.ndarray:
    """(N, 15) distances of tips from the wrist and each other, in parts of the palm's length (N, 21, 3)."""
    tips = points[:, _TIPS]
    of_wrist = np.linalg.norm(tips - points[:, :1], axis=2)
    of_pairs = np.linalg.norm(tips[:, _LEFT] - tips[:, _RIGHT], axis=2)
    palm = np.linalg.norm(points[:, 9] - points[:, 0], axis=1)
    return np.concatenate([of_wrist, of_pairs], axis=1) / np.maximum(palm, 1e-6)[:, None]


def offset_scores(pairs: Sequence[HandPair]) -> list[OffsetScore]:
    """The likeliest offsets of hands seen in both views, the best first; empty where too little is common."""
    from scipy.fft import next_fast_len  # slow to load

    rate = _STEPS * min(pairs[0].first.fps, pairs[0].second.fps)
    views = [pair.first for pair in pairs], [pair.second for pair in pairs]
    count = [1 + max(int(np.ceil(hand.times[-1] * rate)) for hand in view) for view in views]
    size: int = next_fast_len(sum(count), real=True)  # type: ignore[assignment]
    total, channel_count, common = np.zeros(size), 0, np.zeros(size)
    least = 0.0
    for pair in pairs:
        a, known_a = _sampled(pair.first, rate, size)
        b, known_b = _sampled(pair.second, rate, size)
        least += VIEWS.least_overlap * min(known_a.sum(), known_b.sum())
        moments = [_lagged(x, y) for x, y in (
            (known_a, known_b), (a, known_b), (known_a, b), (a * a, known_b), (known_a, b * b), (a, b),
        )]  # fmt: skip
        n, of_a, of_b, of_aa, of_bb, of_ab = moments
        common += n[:, 0]
        n = np.maximum(n, 1.0)
        variance = np.maximum(of_aa / n - (of_a / n) ** 2, 0.0) * np.maximum(of_bb / n - (of_b / n) ** 2, 0.0)
        r = (of_ab / n - of_a * of_b / n**2) / np.sqrt(variance + 1e-12)
        total += -0.5 * np.log1p(-(np.clip(r, 0.0, 0.999) ** 2)).sum(axis=1)
        channel_count += r.shape[1]
    score = np.where(common >= max(least, _STEPS * 5), total / channel_count, -1.0)
    # Lags beyond the first view's length are those before its start.
    lags = np.arange(size)
    lags = np.where(lags < count[0], lags, lags - size)
    order = np.argsort(lags)
    return _peaks(lags[order] / rate, score[order], VIEWS.peaks_apart * _STEPS)


def _sampled(hand: ViewedHand, rate: float, size: int) -> tuple[np.ndarray, np.ndarray]:
    """(size, C) channels, centred, smoothed and in even steps, and (size, 1) where they are known."""
    from scipy.ndimage import gaussian_filter1d

    values = channels(hand)
    values = gaussian_filter1d(values - values.mean(axis=0), 1.0, axis=0)
    times = np.arange(size) / rate
    known = hand.seen_at(times)[:, None].astype(float)
    sampled = np.stack([np.interp(times, hand.times, column) for column in values.T], axis=1)
    return sampled * known, known


def _lagged(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """(L, C) sum over t of a[t] b[t - lag], for lags modulo L."""
    spectrum = np.fft.rfft(a, axis=0) * np.conj(np.fft.rfft(b, axis=0))
    return np.fft.irfft(spectrum, len(a), axis=0)


def _peaks(lags: np.ndarray, score: np.ndarray, apart: float) -> list[OffsetScore]:
    """The best peaks, each at the vertex of a parabola."""
    left, found = score.copy(), []
    step = lags[1] - lags[0]
    for _ in range(VIEWS.peaks):
        k = int(left.argmax())
        if left[k] < 0.0:
            break
        shift = 0.0
        if 0 < k < len(score) - 1 and min(score[k - 1], score[k + 1]) >= 0.0:
            bend = score[k - 1] - 2.0 * score[k] + score[k + 1]
            if bend < 0.0:
                shift = float(np.clip(0.5 * (score[k - 1] - score[k + 1]) / bend, -0.5, 0.5))
        found.append(OffsetScore(float(lags[k] + shift * step), float(score[k])))
        left[max(k - int(apart), 0) : k + int(apart) + 1] = -1.0
    return found
