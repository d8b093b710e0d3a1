"""Corrections of a captured hand: kept on its armature, and carried into its keys.

`correction_field.py` has the mathematics. Only keys within reach of a changed correction are ever
touched; what they hold besides the correction, by capture or by hand, stays on them.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from functools import lru_cache

import bpy
import numpy as np

from handfit_core.errors import TakeError
from handfit_core.skeleton import NUM_JOINTS

from ..correction_field import (
    Correction,
    CorrectionField,
    Pins,
    changed_quats,
    changed_stretches,
    correction_between,
)
from . import store
from .keys import PoseKeys, pose_at, read_pose_keys, remove_pose_keys, write_pose_keys
from .timing import Timing

_IDLE = 2e-3
"""radians and metres. A key that is no further from the line between its neighbours says nothing"""


def timing_of(armature: bpy.types.Object) -> Timing:
    """Where the source frames of the hand's capture lie in the scene."""
    capture = armature.manient.capture
    return store.timing_of(capture) if capture is not None else Timing()


def source_frames(timing: Timing, frames: np.ndarray) -> np.ndarray:
    """Scene frames -> source frames, whole or not: the inverse of `Timing.scene_frames`."""
    return (np.asarray(frames, dtype=np.float64) - timing.offset) / (timing.scale or 1.0)


def corrected_frames(armature: bpy.types.Object) -> list[int]:
    """The scene frames with a correction, increasing; none where corrections cannot be read. For drawing."""
    try:
        frames = corrections_of(armature).frames
    except TakeError:
        return []
    return [round(f) for f in timing_of(armature).scene_frames(frames).tolist()]


def corrections_of(armature: bpy.types.Object) -> CorrectionField:
    """The hand's corrections. Raises TakeError where they cannot be read."""
    return _read(armature.manient.corrections)


@lru_cache(maxsize=16)
def _read(text: str) -> CorrectionField:
    # Panels ask at every redraw.
    return CorrectionField.from_json(text)


def correct_frame(
    armature: bpy.types.Object,
    frame: int,
    pins: Pins,
    quats: np.ndarray,
    location: np.ndarray,
    spread: float,
) -> None:
    """Give a source frame a pose, and its neighbours what is left of the change over `spread` frames.

    quats (16, 4) as (w, x, y, z) relative to the bones' rest; location (3,) metres along the wrist
    bone's axes. A frame without keys gets them. The correction replaces the frame's earlier one.
    """
    side = armature.manient.side
    old = corrections_of(armature)
    here = timing_of(armature).scene_frames(np.array([frame]))
    now_quats, now_location = pose_at(armature, side, here)
    present = read_pose_keys(armature, side, here[0], here[0])
    had_key = bool(present.rotation_keyed.any() or present.location_keyed.any())
    if not (present.rotation_keyed.all() and present.location_keyed.all() and had_key):
        write_pose_keys(armature, side, PoseKeys.everywhere(here, now_quats, now_location))

    turned, moved = old.at(np.array([frame]))
    base = changed_quats(now_quats[0], turned[0], np.zeros((NUM_JOINTS, 3)))
    before = old.corrections.get(frame)
    new = Correction(
        pins=pins,
        rotation=correction_between(base, quats),
        location=location - (now_location[0] - moved[0]),
        spread=spread,
        added_key=not had_key if before is None else before.added_key,
        # What the neighbours' corrections do here now is where the pins began.
        start_rotation=turned[0] if before is None else before.start_rotation,
        start_location=moved[0] if before is None else before.start_location,
    )
    change_field(armature, old.with_correction(frame, new))


def clear_corrections(armature: bpy.types.Object, frames: Iterable[int] | None = None) -> int:
    """Take the corrections of these source frames (None: all) away again. Returns how many there were.

    Keys become what they would be without them. Keys that only a correction had put there go, unless
    something else has been done to them since.
    """
    old = corrections_of(armature)
    wanted = set(old.corrections) if frames is None else {int(f) for f in frames}
    gone = sorted(wanted & set(old.corrections))
    change_field(armature, old.without(gone))
    added = [g for g in gone if old.corrections[g].added_key]
    for place in timing_of(armature).scene_frames(np.array(added)).tolist():
        _remove_idle_keys(armature, place)
    return len(gone)


def change_field(armature: bpy.types.Object, new: CorrectionField) -> None:
    """Carry a changed field into the keys within its reach, and keep it on the hand."""
    side = armature.manient.side
    old = corrections_of(armature)
    timing = timing_of(armature)
    for stretch in changed_stretches(old, new):
        first, last = sorted(timing.scene_frames(np.array(stretch)).tolist())
        keys = read_pose_keys(armature, side, first, last)
        places = source_frames(timing, keys.frames)
        (turned_old, moved_old), (turned_new, moved_new) = old.at(places), new.at(places)
        # Keys at the end of the stretch, where nothing changes, are not even written.
        turns = np.any(turned_old != turned_new, axis=-1)
        moves = np.any(moved_old != moved_new, axis=-1)
        changed = replace(
            keys,
            quats=changed_quats(keys.quats, turned_old, turned_new),
            locations=keys.locations - moved_old + moved_new,
            rotation_keyed=keys.rotation_keyed & turns,
            location_keyed=keys.location_keyed & moves,
        )
        write_pose_keys(armature, side, changed)
    keep_field(armature, new)


def keep_field(armature: bpy.types.Object, new: CorrectionField) -> None:
    """Keep the field on the hand without touching keys: they hold what changed already."""
    armature.manient.corrections = new.to_json()


def replacing_poses(
    armature_name: str, frames: Sequence[int], quats: np.ndarray, locations: np.ndarray
) -> Iterator[float]:
    """Key new poses: (N,) source frames, increasing, quats (N, 16, 4), wrist locations (N, 3) in metres.

    They contain the corrections of these frames, of which only the pins are left. All other keys stay.
    One bone per step, for a window that stays free; yields how much is done, 0..1.
    """
    count = len(frames)
    for joint in range(NUM_JOINTS):
        armature = bpy.data.objects[armature_name]
        places = timing_of(armature).scene_frames(np.asarray(frames))
        keyed = np.zeros((count, NUM_JOINTS), dtype=bool)
        keyed[:, joint] = True
        keys = PoseKeys(places, quats, locations, keyed, np.full(count, joint == 0))
        write_pose_keys(armature, armature.manient.side, keys)
        yield (joint + 1) / NUM_JOINTS
    armature = bpy.data.objects[armature_name]
    keep_field(armature, corrections_of(armature).absorbed(frames))


def _remove_idle_keys(armature: bpy.types.Object, frame: float) -> None:
    """Take the keys of a scene frame away if the pose there stays the same without them."""
    side = armature.manient.side
    place = np.array([frame])
    quats, locations = pose_at(armature, side, place)
    remove_pose_keys(armature, side, frame, frame)
    quats_without, locations_without = pose_at(armature, side, place)
    turned = np.abs(correction_between(quats, quats_without)).max()
    if max(turned, np.abs(locations - locations_without).max()) > _IDLE:
        write_pose_keys(armature, side, PoseKeys.everywhere(place, quats, locations))
