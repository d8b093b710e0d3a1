"""Doubtful and filled frames: as ranges, as timeline markers, and the way from one to the next."""

from __future__ import annotations

from typing import Literal

import bpy
import numpy as np

from .confidence import errors_of
from .store import CapturedHand, captured_hands, scene_frames

Direction = Literal["PREVIOUS", "NEXT"]

_END = " End"


def doubtful_ranges(hand: CapturedHand) -> list[tuple[int, int]]:
    """First and last scene frame of each run of frames whose pose may well be wrong, in order."""
    return _ranges(hand, errors_of(hand).doubtful)


def filled_ranges(hand: CapturedHand) -> list[tuple[int, int]]:
    """First and last scene frame of each gap that was bridged, in order."""
    return _ranges(hand, hand.track.filled)


def next_doubtful(hand: CapturedHand, frame: int, direction: Direction) -> int | None:
    """Where the nearest doubtful range after (or before) scene frame `frame` begins; None: there is none.

    From within a range, the way back leads to its own first frame.
    """
    firsts = [first for first, _ in doubtful_ranges(hand)]
    if direction == "NEXT":
        return next((first for first in firsts if first > frame), None)
    return next((first for first in reversed(firsts) if first < frame), None)


def mark_doubtful(scene: bpy.types.Scene, hand: CapturedHand, on: bool) -> int:
    """Put timeline markers where the hand's doubtful and filled ranges begin, and where longer ones end; or
    take them away. Returns how many markers there are of this hand afterwards.

    Other markers stay. Markers of a hand are known by their names; where the scene has several captured
    hands of one side, by name and frame.
    """
    wanted = _wanted(hand)
    names = _names(hand)
    rivals = [o for o in captured_hands(scene) if o.manient.side == hand.side and o != hand.armature]
    for marker in list(scene.timeline_markers):
        if marker.name not in names:
            continue
        ours = (marker.frame, marker.name) in wanted
        if (ours and not on) or (not ours and not rivals):
            scene.timeline_markers.remove(marker)
    if not on:
        return 0
    there = {(marker.frame, marker.name) for marker in scene.timeline_markers}
    for frame, name in sorted(wanted - there):
        scene.timeline_markers.new(name, frame=frame)
    return len(wanted)


def is_marked(scene: bpy.types.Scene, hand: CapturedHand) -> bool:
    """Whether the hand's ranges have their markers."""
    wanted = _wanted(hand)
    return any((marker.frame, marker.name) in wanted for marker in scene.timeline_markers)


def _wanted(hand: CapturedHand) -> set[tuple[int, str]]:
    """(scene frame, name) of the hand's markers."""
    markers = set()
    for name, ranges in zip(_names(hand)[:2], (doubtful_ranges(hand), filled_ranges(hand)), strict=True):
        for first, last in ranges:
            markers.add((first, name))
            if last > first:
                markers.add((last, name + _END))
    return markers


def _names(hand: CapturedHand) -> tuple[str, str, str, str]:
    letter = hand.side[:1].upper()
    doubtful, filled = f"Doubtful {letter}", f"Filled {letter}"
    return doubtful, filled, doubtful + _END, filled + _END


def _ranges(hand: CapturedHand, flags: np.ndarray | None) -> list[tuple[int, int]]:
    if flags is None:
        return []
    frames = np.rint(scene_frames(hand.collection, hand.take)).astype(int)
    edges = np.diff(np.concatenate([[0], np.asarray(flags, dtype=np.int8), [0]]))
    firsts, lasts = np.flatnonzero(edges > 0), np.flatnonzero(edges < 0) - 1
    return [(int(frames[a]), int(frames[b])) for a, b in zip(firsts, lasts, strict=True)]
