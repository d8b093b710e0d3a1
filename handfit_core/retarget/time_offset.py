"""The offset in time between a captured hand and a body that moves already: both wrists turn and move alike.

Neither where a camera stands nor how a character is turned tells in a wrist's angular velocity in its own
axes, nor in how fast it turns and moves. With r_c the correlation of each of these three at a lag, the score
of the lag is -1/2 mean log(1 - max(r_c, 0)^2).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from handfit_core.common.errors import OptionError
from handfit_core.geometry.rotations import rotmat_to_rotvec

_SMOOTHED: Final = 0.06
"""seconds: standard deviation of the Gaussian under which motion is smoothed, since captured wrists shake"""
_APART: Final = 0.5
"""seconds from the best peak of the score beyond which other peaks count as others"""
_SHORTEST: Final = 1.0
"""seconds that both wrists have to move together at least, beside half of the shorter motion"""
_STILL: Final = 0.05
"""radians and palms' lengths per second, root mean square, below which a wrist does not move"""
_LOUD: Final = 3.0
"""Multiple of its root mean square at which a velocity is cut off, as where a capture jumps"""
_FOR_SURE: Final = 0.5
"""Value of `FoundOffset.sure` from which on the offset is said to be sure"""
_SURE: Final = 0.6
"""Score from which on only other peaks leave doubt: made motions that had nothing in common had 0.17 at their
best lag, in the middle, and those that were the same 1.3"""


@dataclass(frozen=True, eq=False)
class WristMotion:
    """The motion of a wrist on T whole frames that follow each other."""

    first: int
    """The number of the first of these frames"""
    turns: np.ndarray
    """(T, 3, 3) rotations of the wrist from its rest, whose axes both motions of a pair share"""
    places: np.ndarray
    """(T, 3) the wrist's places, in palms' lengths"""


@dataclass(frozen=True)
class FoundOffset:
    """The offset in time that was found between captured motion and a character's, and how sure it is."""

    frames: int
    """The character's frame number minus the captured one"""
    sure: float
    """How sure the offset is, from 0 (not at all) to 1"""
    agreement: float
    """The correlation of how both wrists turn, -1..1"""

    @property
    def said(self) -> str:
        """A phrase that tells a user how sure the offset is."""
        doubt = "for sure" if self.sure >= _FOR_SURE else "perhaps: look whether it fits"
        return f"{self.frames} frames, {doubt} ({self.sure:.2f}; turning agrees by {self.agreement:.2f})"


def find_offset(pairs: Sequence[tuple[WristMotion, WristMotion]], fps: float) -> FoundOffset:
    """Find the offset at which captured wrists, the first of each pair, move as the character's, the second;
    both have `fps` frames per second. Raises OptionError where one of them hardly moves, or too briefly."""
    first = min(own.first - captured.first - len(captured.turns) for captured, own in pairs)
    last = max(own.first + len(own.turns) - captured.first for captured, own in pairs)
    total, turning = np.zeros(last - first), np.zeros(last - first)
    for captured, own in pairs:
        ours, theirs = _velocities(captured, fps, "captured wrist"), _velocities(own, fps, "character's hand")
        least = max(0.5 * min(len(ours), len(theirs)), _SHORTEST * fps - 1.0)
        start = own.first - captured.first - len(ours) + 1 - first
        found = []
        for part, centred in ((slice(0, 3), False), (slice(3, 4), True), (slice(4, 5), True)):
            found.append(_correlations(ours[:, part], theirs[:, part], least, centred=centred))
        at = slice(start, start + len(found[0]))
        total[at] += np.mean([-0.5 * np.log1p(-(np.clip(r, 0.0, 0.999) ** 2)) for r in found], axis=0)
        turning[at] += found[0] / len(pairs)
    score = total / len(pairs)
    best, apart = int(score.argmax()), round(_APART * fps)
    others = np.delete(score, slice(max(best - apart, 0), best + apart + 1)).max(initial=0.0)
    sure = (1.0 - others / max(score[best], 1e-9)) * min(score[best] / _SURE, 1.0)
    return FoundOffset(first + best, float(sure), float(turning[best]))


def _velocities(motion: WristMotion, fps: float, name: str) -> np.ndarray:
    """Return five velocities per frame, (T - 1, 5): the angular velocity about the wrist's own three axes,
    how fast it turns, and how fast it goes."""
    turns, places = motion.turns, motion.places
    if not (np.isfinite(turns).all() and np.isfinite(places).all()):
        raise OptionError(f"the {name} is nowhere in some frames: type the offset")
    if len(turns) <= _SHORTEST * fps:
        raise OptionError(
            f"the {name} moves for {len(turns)} frames only, too few to find an offset: type it"
        )
    turning = _cut_off(rotmat_to_rotvec(np.swapaxes(turns[:-1], 1, 2) @ turns[1:]) * fps)
    going = _cut_off(np.diff(_smoothed(places, _SMOOTHED * fps), axis=0) * fps)
    turning = _smoothed(turning, _SMOOTHED * fps)
    speeds = [np.linalg.norm(each, axis=1) for each in (turning, going)]
    if max(np.sqrt(np.mean(speed**2)) for speed in speeds) < _STILL:
        raise OptionError(f"the {name} does not move, so that no offset can be found: type it")
    return np.column_stack([turning, *speeds])


def _cut_off(velocities: np.ndarray) -> np.ndarray:
    """Return velocities (T, 3) in which those that are far too large are cut off."""
    sizes = np.linalg.norm(velocities, axis=1)
    most = _LOUD * np.sqrt(np.mean(sizes**2))
    return velocities * np.minimum(1.0, most / np.maximum(sizes, 1e-12))[:, None]


def _smoothed(values: np.ndarray, sigma: float) -> np.ndarray:
    """Smooth columns (T, C) over time under a Gaussian whose standard deviation is `sigma` frames."""
    reach = min(int(np.ceil(3.0 * sigma)), (len(values) - 1) // 2)
    kernel = np.exp(-0.5 * (np.arange(-reach, reach + 1) / sigma) ** 2)
    weights = np.convolve(np.ones(len(values)), kernel, "same")
    return np.stack([np.convolve(column, kernel, "same") / weights for column in values.T], axis=1)


def _correlations(a: np.ndarray, b: np.ndarray, least: float, *, centred: bool) -> np.ndarray:
    """Correlate a[t] (N, C) with b[t + lag] (M, C) over the rows that both have, for lags 1 - N to M - 1; 0
    where these are fewer than `least`. `centred`: about the means of these rows."""
    size = 1 << int(np.ceil(np.log2(len(a) + len(b))))

    def lagged(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        spectrum = np.conj(np.fft.rfft(x, size, axis=0)) * np.fft.rfft(y, size, axis=0)
        return np.fft.irfft(spectrum, size, axis=0).sum(axis=1)

    ones = np.ones((len(a), 1)), np.ones((len(b), 1))
    count = np.maximum(lagged(*ones), 1.0)
    of_a, of_b, of_both = lagged(a * a, ones[1]), lagged(ones[0], b * b), lagged(a, b)
    if centred:
        sum_a, sum_b = lagged(a, ones[1]), lagged(ones[0], b)
        of_a, of_b = of_a - sum_a**2 / count, of_b - sum_b**2 / count
        of_both = of_both - sum_a * sum_b / count
    found = of_both / np.sqrt(np.maximum(of_a, 1e-9) * np.maximum(of_b, 1e-9))
    return np.where(count > least - 0.5, found, 0.0)[np.arange(1 - len(a), len(b))]
