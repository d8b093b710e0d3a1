"""Keys of a motion that was fitted anew, under what the artist has done to a hand, which stays as it is.

New keys lie under the field of corrections, whose corrections turn from the new pose to the corrected one:
so the corrected frame keeps its pose, its neighbours lead there softly, and a correction that is cleared
leaves the new motion. Keys by hand, and the frames next to a range, are led to in the same way.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from handfit_core.edit.corrections import (
    Correction,
    CorrectionField,
    changed_quats,
    correction_between,
    kept_frame,
)

from .corrections import check_writable, corrections_of, keep_field
from .keys import PoseKeys, pose_at, writing_pose_keys
from .own_keys import keyed_by_hand, note_fitted
from .store import CapturedHand, scene_frames


@dataclass(frozen=True, eq=False)
class Smoothed:
    """Keys that are not written yet."""

    keys: PoseKeys
    field: CorrectionField
    """The corrections on top of the new motion"""
    numbers: list[int]
    """The M source frames that were fitted anew"""
    quats: np.ndarray
    """(M, 16, 4) their keys without corrections; where the artist has keyed: the new motion"""
    locations: np.ndarray
    """(M, 3)"""

    @property
    def written(self) -> int:
        """How many frames get new keys on at least one bone."""
        return int((self.keys.rotation_keyed.any(axis=1) | self.keys.location_keyed).sum())


def smoothed(
    hand: CapturedHand,
    rows: np.ndarray,
    wanted: np.ndarray,
    quats: np.ndarray,
    locations: np.ndarray,
    spread: float,
) -> Smoothed:
    """What becomes of the keys on the take's `rows` (N,), increasing, where the motion is fitted anew.

    `wanted` (N,) bool: the rows that get it; the others are fitted to lead there. quats (N, 16, 4) and
    locations (N, 3) are the motion about the bones' rest, NaN without a hand. What stays is led to over
    `spread` source frames. Raises TakeError and HandModelError.
    """
    places = scene_frames(hand.collection, hand.take)[rows]
    numbers = np.asarray(hand.take.frame_numbers, dtype=np.float64)[rows]
    there = np.asarray(np.isfinite(locations).all(axis=1))
    shown, shown_at = pose_at(hand.rig, places)
    quats, locations = (
        np.where(there[:, None, None], quats, shown),
        np.where(there[:, None], locations, shown_at),
    )
    own = keyed_by_hand(hand, rows)
    old = corrections_of(hand.armature)
    new: dict[float, Correction] = {}
    corrected = np.zeros(len(rows), dtype=bool)
    for at in range(len(rows)):
        one = old.corrections.get(kept_frame(numbers[at]))
        if one is None or one.is_anchor:
            continue
        corrected[at] = True
        if there[at] and wanted[at]:
            new[numbers[at]] = _on_top(one, quats[at], locations[at], shown[at], shown_at[at])
    field = old.having(new)
    turned, moved = field.at(numbers)
    plain, plain_at = quats, locations
    quats, locations = changed_quats(quats, np.zeros_like(turned), turned), locations + moved

    # What stays beside corrections: all of the frames around the range, of others what was keyed by hand.
    stays = own & wanted[:, None]
    around = np.flatnonzero(wanted)[[0, -1]] + [-1, 1]
    stays[around[(around >= 0) & (around < len(rows))]] = True
    turns = np.where(stays[:, :-1, None], correction_between(quats, shown), 0.0)
    moves = np.where(stays[:, -1:], shown_at - locations, 0.0)
    led = {
        numbers[at]: Correction({})
        if corrected[at]
        else Correction({}, rotation=turns[at], location=moves[at], spread=spread)
        for at in np.flatnonzero((corrected & wanted) | (stays.any(axis=1) & there))
    }
    turns, moves = CorrectionField(led).at(numbers)
    quats, locations = changed_quats(quats, np.zeros_like(turns), turns), locations + moves
    free = wanted & there & ~corrected
    keys = PoseKeys(places, quats, locations, free[:, None] & ~own[:, :-1], free & ~own[:, -1])
    quats = np.where(own[:, :-1, None], plain, changed_quats(quats, turned, np.zeros_like(turned)))
    locations = np.where(own[:, -1:], plain_at, locations - moved)
    new_rows = wanted & there
    return Smoothed(keys, field, numbers[new_rows].astype(int).tolist(), quats[new_rows], locations[new_rows])


def _on_top(
    one: Correction, quats: np.ndarray, location: np.ndarray, shown: np.ndarray, shown_at: np.ndarray
) -> Correction:
    """A correction that leads from another pose, (16, 4) and (3,), to the frame's present one."""
    start = one.start_rotation, one.start_location
    if one.posed:  # pins are measured against the pose that the artist gave, which is the same as before
        posed = changed_quats(shown, one.rotation, one.start_rotation)
        start = correction_between(quats, posed), shown_at - one.location + one.start_location - location
    return replace(
        one,
        rotation=correction_between(quats, shown),
        location=shown_at - location,
        start_rotation=start[0],
        start_location=start[1],
    )


def writing(find: Callable[[], CapturedHand], smoothed: Smoothed) -> Iterator[float]:
    """Write the keys bone by bone, and keep the corrections; yields how much is done, 0..1. `find` gives the
    hand, which may have gone between two steps. Raises what it raises, and `corrections.check_writable`."""
    check_writable(find().armature)
    keep_field(find().armature, smoothed.field)
    yield from writing_pose_keys(lambda: find().rig, smoothed.keys)
    # For whoever asks next they are no keys by hand.
    note_fitted(find().armature, smoothed.numbers, smoothed.quats, smoothed.locations)
