"""Which keys of a character's hand itself were written, so that they can be rewritten.

An action notes the keys of the bone that moves the whole hand, and the offset that is in them. Keys that are
not as they were written are the artist's own by now: they stay, and those that were moved or deleted stay so.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import bpy
import numpy as np

from handfit_core.common.skeleton import Side

from ..common.blender_versions import action_slot, channels, property_group, slot_key, users_of
from ..rigs.character import CharacterBones
from .keys import PoseKeys, nearest, read_pose_keys, read_table, table_text

MARK = "manient_hand_motion"
"""An action's custom property: slot handle (0 before Blender 4.4) and side -> bone, keys and offset"""
_SAME = 1e-4
"""Parts of quaternions, and of locations as shares of the largest, that differ by less count as equal"""


@dataclass(frozen=True, eq=False)
class BoneKeys:
    """Keys that are to be written."""

    rig: CharacterBones
    keys: PoseKeys
    side: Side | None = None
    """The side of the hand that the only bone moves as a whole; None for fingers"""
    offset: np.ndarray | None = None
    """(3,) the offset that is added to where the hand is, in the armature's space and units; None where there
    is none"""
    settings: tuple[float, ...] = ()
    """Travel, smoothing, marked frame and offset in time of that hand"""
    arm: bool = False
    """True if the only bone is one of an arm"""

    @property
    def keyed(self) -> np.ndarray:
        """Return (B,) bool: the bones that get the keys."""
        return np.asarray(self.keys.rotation_keyed.any(axis=0))


@dataclass(frozen=True, eq=False)
class WrittenKeys:
    """Keys that were written for the bone that moves a whole hand."""

    action: bpy.types.Action
    slot: Any
    bone: str
    table: np.ndarray
    """(N, 8) scene frame, increasing, rotation (w, x, y, z), location; NaN where no location was written"""
    offset: np.ndarray
    """(3,) what was added to the hand's location, in the armature's space and units"""
    settings: tuple[float, ...]
    """the travel, smoothing, marked frame and offset in time with which the keys were made; files of earlier
    versions lack the last"""

    @property
    def time_offset(self) -> int:
        """Return the scene frames by which the motion was put later."""
        return int(self.settings[3]) if len(self.settings) > 3 else 0

    @property
    def placed(self) -> bool:
        """True if the hand was moved, and not only turned."""
        return bool(np.isfinite(self.table[:, 5:]).all())

    def unchanged_mask(self, rig: CharacterBones) -> np.ndarray:
        """Return (N,) bool: the frames whose keys are as they were written."""
        present = read_pose_keys(rig, holder=channels(self.action, self.slot))
        if len(present.frames) == 0:
            return np.zeros(len(self.table), dtype=bool)
        at, there = nearest(present.frames, self.table[:, 0])
        keyed = present.rotation_keyed[at, 0] & (present.location_keyed[at] | (not self.placed))
        quats, written = present.quats[at, 0], self.table[:, 1:5]
        turned = np.min([np.abs(quats - sign * written).max(axis=-1) for sign in (1.0, -1.0)], axis=0)
        size = max(float(np.abs(np.nan_to_num(self.table[:, 5:])).max(initial=0.0)), _SAME)
        moved = np.abs(present.locations[at] - self.table[:, 5:]).max(axis=-1) / size
        return there & keyed & (turned < _SAME) & (~(moved >= _SAME) | (not self.placed))


def written_keys(armature: bpy.types.Object, side: Side) -> WrittenKeys | None:
    """Return the keys that were written for a hand into the topmost action that has any of it; None for none,
    and for what a damaged file holds."""
    for user in users_of(armature):
        action, slot = user.action, action_slot(user)
        content = property_group(action, MARK).get(f"{slot_key(slot)}/{side}")
        if content is None:
            continue
        try:
            table = read_table(content["keys"], 8)
            offset = np.array([float(value) for value in content["offset"]])
            settings = tuple(float(value) for value in content["settings"])
        except (LookupError, TypeError, ValueError):
            return None
        if len(table) == 0 or offset.shape != (3,) or content.get("bone") not in armature.pose.bones:
            return None
        return WrittenKeys(action, slot, content["bone"], table, offset, settings)
    return None


def record_written_keys(
    armature: bpy.types.Object, action: bpy.types.Action, slot: Any, one: BoneKeys
) -> None:
    """Note on an action what was just written into it for a hand itself; nothing for fingers. What was noted
    of frames that were not written stays."""
    if one.side is None or one.offset is None:
        return
    rows, keys = one.keys.rotation_keyed[:, 0] | one.keys.location_keyed, one.keys
    locations = np.where(keys.location_keyed[:, None], keys.locations, np.nan)
    table = np.column_stack([keys.frames, keys.quats[:, 0], locations])[rows]
    before = written_keys(armature, one.side)
    if before is not None and before.action == action and before.bone == one.rig.bones[0] and len(table):
        old = before.table
        old = old[~nearest(table[:, 0], old[:, 0])[1]]
        table = np.concatenate([old, table])
        table = table[np.argsort(table[:, 0])]
    content = {
        "bone": one.rig.bones[0],
        "keys": table_text(table),
        "offset": one.offset.tolist(),
        "settings": list(one.settings),
    }
    action[MARK] = {**property_group(action, MARK), f"{slot_key(slot)}/{one.side}": content}


def without_artist_keys(armature: bpy.types.Object, one: BoneKeys) -> BoneKeys:
    """Return the keys of a hand itself without those of frames on which the artist has changed, moved or
    deleted what was written; keys of fingers as they are."""
    found = written_keys(armature, one.side) if one.side is not None else None
    if found is None or found.bone != one.rig.bones[0]:
        return one
    own = found.table[~found.unchanged_mask(one.rig), 0]
    if len(own) == 0:
        return one
    changes = ~nearest(own, one.keys.frames)[1]
    return replace(one, keys=one.keys.only(changes[:, None], changes))
