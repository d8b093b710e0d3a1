"""Ranges of frames: the one that is likely meant, and the one on which a pose is to stand.

A hand may have a key on every frame, so that the next one is not what an artist calls the next key. What
counts is where something of the artist's own begins: a correction, a pose, a key that was made by hand.
Frames that go on with what began before are no new key.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import bpy
import numpy as np

from handfit_core.common.errors import OptionError
from handfit_core.edit.corrections import CorrectionField, fade

from .confidence import doubtful_ranges
from .corrections import corrections_of
from .keys import SAME_FRAME
from .own_keys import keyed_by_hand
from .store import CapturedHand, scene_frames, timing_of
from .timing import frame_rate, span_of

_AROUND = 0.5
"""Seconds before and after the current frame that are suggested where nothing else tells"""
_ADJACENT = 1.5
"""Frames between keys below which they belong to one motion"""

Scope = Literal["HERE", "RANGE", "HOLD"]

SCOPES: Any = {
    "name": "Frames",
    "description": "The frames that get the pose",
    "items": (
        ("HERE", "Here", "The current frame"),
        ("RANGE", "Range", "All frames from the first to the last. Other frames blend over Spread"),
        (
            "HOLD",
            "Hold",
            "From the current frame to your next key, into which it blends over Spread: the next frame where "
            "a correction, a pose or a key of yours begins. Captured frames are no keys of yours: where none "
            "follows, the pose stands to the end of the motion",
        ),
    ),
    "default": "HERE",
}


@dataclass(frozen=True)
class RequestedFrames:
    """The frames that the artist chose for a pose."""

    scope: Scope = "HERE"
    first: float = 1.0
    last: float = 1.0
    spread: float = 0.0

    def check(self) -> None:
        """Raise OptionError where a range runs backwards."""
        if self.scope == "RANGE" and self.first > self.last:
            raise OptionError(
                f"the range runs backwards, from frame {self.first:g} to {self.last:g}: put the earlier "
                "frame first"
            )


@dataclass(frozen=True)
class Span:
    """The scene frames on which a pose stands, and over which it blends in and out."""

    first: float
    last: float
    spread: float
    """The scene frames before and after over which the pose blends with what is there"""
    is_open: bool = False
    """True if nothing comes after `last`"""

    def weights(self, frames: np.ndarray) -> np.ndarray:
        """Return how much of the pose scene frames (N,) have, 0..1 each."""
        away = np.maximum(self.first - frames, 0.0 if self.is_open else frames - self.last)
        return fade(np.maximum(away, 0.0) / max(self.spread, 1.0))


def requested_span(requested: RequestedFrames, now: float, upcoming: float | None, last: float) -> Span:
    """Return the span of frames that were asked for, RANGE or HOLD, at the frame `now` of a motion whose next
    key is `upcoming`; where there is none it ends at `last`. Raises OptionError."""
    requested.check()
    if requested.scope == "RANGE":
        return Span(requested.first, requested.last, requested.spread)
    if upcoming is None:
        return Span(now, max(last, now), requested.spread, is_open=True)
    end = max(now, upcoming - max(requested.spread, 1.0))
    return Span(now, end, min(requested.spread, upcoming - end))


def next_key(hand: CapturedHand, now: float) -> float | None:
    """Return the scene frame after `now` where the next correction, pose or key of the artist's own begins on
    a captured hand; None for none. Raises TakeError and HandModelError."""
    numbers = np.asarray(hand.take.frame_numbers)
    step = float(np.diff(numbers).min(initial=1 << 30)) if len(numbers) > 1 else 1.0
    begun = correction_starts(corrections_of(hand.armature), _ADJACENT * max(step, 1.0))
    own = np.any(keyed_by_hand(hand, np.arange(len(numbers))), axis=1).astype(bool)
    follows = np.concatenate([[False], own])[:-1]
    begun += np.extract(own & ~follows, numbers).tolist()
    places = timing_of(hand.collection).scene_frames(np.array(begun, dtype=np.float64))
    return _next(places, now)


def correction_starts(field: CorrectionField, adjacent: float) -> list[float]:
    """Return the source frames of corrections that do not go on with those of frames at most `adjacent`
    before."""
    found, before, posed = [], -np.inf, False
    for frame in field.corrected:
        one = field.corrections[frame]
        if frame - before > adjacent or one.begins or one.posed != posed:
            found.append(frame)
        before, posed = frame, one.posed
    return found


def next_run_start(keyed: np.ndarray, now: float) -> float | None:
    """Return the first of these scene frames (N,) of keys, increasing, after `now` that does not follow on
    another key at once; None for none."""
    return _next(keyed[np.append(True, np.diff(keyed) > _ADJACENT)[: len(keyed)]], now)


def _next(places: np.ndarray, now: float) -> float | None:
    after = places[places > now + SAME_FRAME]
    return float(after.min()) if len(after) else None


def suggested_range(scene: bpy.types.Scene, hand: CapturedHand | None) -> tuple[int, int]:
    """Return the first and last scene frame that are likely meant.

    They are the preview range; else the doubtful range, or the reach of the correction, that the current
    frame is in; else half a second around it. Raises HandfitError."""
    now, around = scene.frame_current, max(1, round(_AROUND * frame_rate(scene)))
    if hand is None:
        return span_of(scene) if scene.use_preview_range else (now - around, now + around)
    frames = scene_frames(hand.collection, hand.take)
    now = min(max(now, int(np.ceil(frames[0]))), int(frames[-1]))
    wanted = now - around, now + around
    timing, field = timing_of(hand.collection), corrections_of(hand.armature)
    reach = {g: max(1.0, field.corrections[g].spread) for g in field.corrected}
    near = [tuple(timing.scene_frames(np.array([g - s, g + s])).tolist()) for g, s in reach.items()]
    for first, last in [*near, *doubtful_ranges(hand)]:
        if first <= now <= last:
            wanted = round(first), round(last)
    if scene.use_preview_range:
        wanted = span_of(scene)
    first, last = max(wanted[0], int(np.ceil(frames[0]))), min(wanted[1], int(frames[-1]))
    return (first, last) if first <= last else (now, now)
