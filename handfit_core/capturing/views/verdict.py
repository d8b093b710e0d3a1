"""How well two views belong together, in words for an artist."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from handfit_core.fit.settings import VIEWS
from handfit_core.take.views import Verdict


@dataclass(frozen=True)
class Evidence:
    """What a verdict is made of."""

    offset_frames: float
    """of the first view"""
    error: float
    """pixels: the larger median distance of landmarks in a view"""
    residual: float
    """Root mean square of residuals in sigmas"""
    common: int
    """Frames of the slower view in which both have a hand"""
    apart: float
    """degrees between the lines of sight to the hand"""
    halves: float
    """degrees between the cameras that both halves of the frames give; NaN: not asked"""
    score: float
    """Agreement of fingers' motions at the offset; NaN: the offset was given"""
    dropped: float = 0.0
    """Share of common frames in which the views show different hands"""
    cameras_known: bool = False
    left_open: tuple[float, float] = (0.0, 0.0)
    """`Adjusted.left_open`"""


def verdict_of(evidence: Evidence) -> Verdict:
    """One verdict; where it is `failed`, the sentence lacks its full stop and what was used instead."""
    e = evidence
    facts = (
        f"Offset {e.offset_frames:.2f} frames, {e.common} frames in common, cameras {e.apart:.0f} degrees "
        f"apart, views agree to {e.error:.1f} px"
    )
    wrong = _failures(e)
    if wrong:
        return Verdict("failed", wrong)
    doubts = _doubts(e)
    if doubts:
        return Verdict("doubtful", f"{facts}: doubtful. {' '.join(doubts)}")
    return Verdict("good", f"{facts}: good.")


def _failures(e: Evidence) -> str:
    if e.apart < VIEWS.same_place:
        return (
            f"Both views look from the same place ({e.apart:.0f} degrees apart), as one clip given twice "
            "would: film from two places, 40 to 90 degrees apart"
        )
    # Few frames, or those that are left where others disagree, may fit by chance.
    chances = (
        e.common < VIEWS.enough_frames,
        e.dropped > VIEWS.many_dropped,
        e.score < VIEWS.weak_score,
        e.halves > VIEWS.halves_apart,
    )
    most = VIEWS.good_residual if any(chances) else VIEWS.doubtful_residual
    if e.residual > most or e.halves > VIEWS.most_halves_apart or sum(chances) > 1:
        return (
            f"The views do not agree ({e.error:.1f} px): they show different moments or hands, or a camera "
            "was moved"
        )
    if e.common < VIEWS.least_frames:
        return (
            f"Both views show the hand in only {e.common} frames at the same time, and {VIEWS.least_frames} "
            "are needed: film longer, or give the offset"
        )
    return ""


def _doubts(e: Evidence) -> list[str]:
    found = []
    if e.residual > VIEWS.good_residual:
        found.append("The views agree badly: keep both cameras still, and the whole hand in both pictures.")
    if e.common < VIEWS.enough_frames:
        found.append(f"Only {e.common} frames are in common: film longer.")
    if e.apart < VIEWS.least_apart and not e.cameras_known:
        found.append(f"The cameras stand too close together ({e.apart:.0f} degrees): 40 to 90 are good.")
    open_rotation, open_direction = e.left_open
    if not e.cameras_known and (open_rotation > VIEWS.open_rotation or open_direction > VIEWS.open_direction):
        found.append(
            "Where the second camera stands is uncertain: measure both lenses, film longer, or turn the palm "
            "more."
        )
    if e.score < VIEWS.weak_score:
        found.append(
            "The fingers hardly move, which leaves the offset open: open and close the hand, or give it."
        )
    if e.halves > VIEWS.halves_apart:
        found.append("The cameras seem to have moved: film with both standing still.")
    if e.dropped > VIEWS.many_dropped:
        found.append(
            f"In {e.dropped:.0%} of the frames the views follow different hands; these were left out."
        )
    return found


def degrees_apart(rotation: np.ndarray, translation: np.ndarray, points: np.ndarray) -> float:
    """Median angle in degrees under which hands at `points` (N, 3), in the first camera's frame, see both
    cameras."""
    to_first, to_second = -points, -rotation.T @ translation - points
    cosine = (to_first * to_second).sum(axis=1)
    cosine /= np.linalg.norm(to_first, axis=1) * np.linalg.norm(to_second, axis=1)
    return float(np.degrees(np.median(np.arccos(np.clip(cosine, -1.0, 1.0)))))


def rotation_between(first: np.ndarray, second: np.ndarray) -> float:
    """degrees between two rotations (3, 3)."""
    cosine = (np.trace(first.T @ second) - 1.0) / 2.0
    return float(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))))
