"""The offset in time between two views: how fingers move does not depend on where a camera stands.

A hand's channels are five curls and 15 distances of fingertips of the fitted hand, and 15 distances of the
detector's world landmarks. With r_c the correlation of channel c at a lag, the score of the lag is
-1/2 mean log(1 - r_c^2).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

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

    pairs, gaps = _without_gaps(pairs)
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
        n = _lagged(known_a, known_b)
        common += n
        n = np.maximum(n, 1.0)
        for x, y in zip(a, b, strict=True):  # one by one: films are long
            of_a, of_b = _lagged(x, known_b) / n, _lagged(known_a, y) / n
            of_aa, of_bb = _lagged(x * x, known_b) / n, _lagged(known_a, y * y) / n
            variance = np.maximum(of_aa - of_a**2, 0.0) * np.maximum(of_bb - of_b**2, 0.0)
            r = (_lagged(x, y) / n - of_a * of_b) / np.sqrt(variance + 1e-12)
            total += -0.5 * np.log1p(-(np.clip(r, 0.0, 0.999) ** 2))
        channel_count += len(a)
    score = np.where(common >= max(least, _STEPS * 5), total / channel_count, -1.0)
    # Lags beyond the first view's length are those before its start.
    lags = np.arange(size)
    lags = np.where(lags < count[0], lags, lags - size)
    order = np.argsort(lags)
    found = _peaks(lags[order] / rate, score[order], VIEWS.peaks_apart * _STEPS)
    return [replace(each, offset=gaps.longer(each.offset)) for each in found]


@dataclass(frozen=True, eq=False)
class _Gaps:
    """Stretches without a hand, of which parts were left out: those that are longer than all of the other
    view, whose hands are seen either before or behind them."""

    first: np.ndarray
    """(G, 2) seconds of the first view: where a gap begins once it and those before are shortened, and what
    it has lost"""
    second: np.ndarray
    """The same of the second view"""
    starts: tuple[float, float]
    """seconds at which the first hand of each view is seen"""

    def longer(self, offset: float) -> float:
        """The offset of the views as they were, of those without the gaps."""
        begun = [self.first[:, 0] < offset + self.starts[1], self.second[:, 0] < self.starts[0] - offset]
        return float(offset + self.first[begun[0], 1].sum() - self.second[begun[1], 1].sum())


def _without_gaps(pairs: Sequence[HandPair]) -> tuple[list[HandPair], _Gaps]:
    """Pairs whose views have no gaps of which the length costs anything."""
    views = [pair.first for pair in pairs], [pair.second for pair in pairs]
    times = [np.unique(np.concatenate([hand.times for hand in view])) for view in views]
    spans = [float(np.ptp(each)) + 1.0 for each in times]
    gaps, shortened = [], []
    for view, seen, span in zip(views, times, spans[::-1], strict=True):
        lost = np.maximum(np.diff(seen) - span, 0.0)
        before = np.append(0.0, np.cumsum(lost))
        rows = np.flatnonzero(lost)
        gaps.append(np.stack([(seen - before)[rows], lost[rows]], axis=1))
        shortened.append(
            [replace(hand, times=hand.times - np.interp(hand.times, seen, before)) for hand in view]
        )
    made = [replace(pair, first=a, second=b) for pair, a, b in zip(pairs, *shortened, strict=True)]
    return made, _Gaps(gaps[0], gaps[1], (float(times[0][0]), float(times[1][0])))


def _sampled(hand: ViewedHand, rate: float, size: int) -> tuple[np.ndarray, np.ndarray]:
    """(C, size) channels, centred, smoothed and in even steps, and (size,) 1 where they are known, else 0."""
    from scipy.ndimage import gaussian_filter1d

    values = channels(hand)
    values = gaussian_filter1d(values - values.mean(axis=0), 1.0, axis=0)
    times = np.arange(size) / rate
    known = hand.seen_at(times).astype(float)
    return np.stack([known * np.interp(times, hand.times, column) for column in values.T]), known


def _lagged(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """(L,) sum over t of a[t] b[t - lag], for lags modulo L."""
    return np.fft.irfft(np.fft.rfft(a) * np.conj(np.fft.rfft(b)), len(a))


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
