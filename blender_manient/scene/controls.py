"""Controls of a captured hand: added, written into the keys, and removed."""

from __future__ import annotations

import bpy
import numpy as np

from ..common.blender_versions import channels, used_actions
from ..rigs import controls
from ..rigs.rig import PosedBones, Rig
from .actions import own_action, own_data
from .corrections import end_corrections
from .keys import (
    SAME_FRAME,
    PoseKeys,
    align_signs,
    check_unlocked,
    displayed_pose,
    pose_at,
    read_pose_keys,
    set_pose,
    write_pose_keys,
)
from .own_scene import object_mode
from .sampling import of_bones, sampled_pose, shown_now
from .store import CapturedHand, timing_of

_SAME = 1e-5
"""Parts of a quaternion, and metres: what controls change by less they do not change"""


def add_controls(hand: CapturedHand) -> None:
    """Give a hand that has none its controls; its limits reach as far as its keys. Raises OptionError."""
    armature = hand.armature
    with object_mode():
        own_data(armature)
        hand.rig.add_controls(hand.take.model)
    for action, slot in used_actions(armature):
        hand.rig.allow(read_pose_keys(hand.rig, holder=channels(action, slot)).quats)
    controls.switch(armature)


def remove_controls(hand: CapturedHand) -> None:
    """Take the controls and their keys away: the hand does what its own keys say."""
    own_action(hand.armature, nla=True)
    _remove_curves(hand.armature)
    with object_mode():
        hand.rig.remove_controls()


def bake_controls(hand: CapturedHand) -> None:
    """Write what the controls do into the keys of the bones that they move, and put the controls at rest.

    Corrections end where keys change. Raises OptionError where channels are locked, and then changes nothing.
    """
    armature, rig = hand.armature, hand.rig
    keys, turned, moved = _shown_keys(rig)
    keys = keys.only(turned, moved)
    quats, locations = sampled_pose(rig, [bpy.context.scene.frame_current_final])
    joints = np.flatnonzero(turned).tolist()
    check_unlocked(rig, joints=joints, location=moved)
    own_action(armature, nla=True)
    _remove_curves(armature)
    controls.reset(armature)
    if len(keys.frames):
        span = timing_of(hand.collection).source_frames(keys.frames[[0, -1]])
        end_corrections(armature, span.tolist(), whole=True, joints=joints, location=moved)
        write_pose_keys(rig, keys)
        align_signs(rig)
    set_pose(rig, quats[0], locations[0])


def shown_keys(rig: Rig) -> PoseKeys:
    """Return a rig's keys with what its controls do baked in: on every frame for bones that animated or
    constrained controls move, on their own frames for all others."""
    return _shown_keys(rig)[0] if controls.in_use(rig.armature) else read_pose_keys(rig)


def shown_pose(rig: Rig, frames: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return what `pose_at` returns on these scene frames, with what the controls do added."""
    return sampled_pose(rig, frames) if controls.in_use(rig.armature) else pose_at(rig, frames)


def rotations_now(rig: PosedBones) -> np.ndarray:
    """Return the bones' present rotations, (B, 4) quaternions as (w, x, y, z), with what the controls do
    added."""
    if not controls.in_use(rig.armature):
        return displayed_pose(rig)
    return of_bones(rig, shown_now(rig.armature))[0][0]


def _shown_keys(rig: Rig) -> tuple[PoseKeys, np.ndarray, bool]:
    """Return a rig's keys with what its controls do baked in, on whole frames too where controls move; (16,)
    bool: which bones controls turn; and whether controls move the wrist."""
    keys = read_pose_keys(rig)
    frames, moving = keys.frames, controls.are_moving(rig.armature)
    if moving:
        scene = bpy.context.scene
        ends = [scene.frame_start, scene.frame_end, *frames[[0, -1] if len(frames) else []]]
        ends += [frame for _, curve in controls.keyed_curves(rig.armature) for frame in curve.range()]
        whole = np.arange(np.floor(min(ends)), np.ceil(max(ends)) + 1.0)
        near = np.abs(whole[:, None] - frames).min(axis=1, initial=1.0) <= SAME_FRAME
        frames = np.union1d(frames, whole[~near])
    quats, locations = sampled_pose(rig, frames)
    plain, places = pose_at(rig, frames)
    apart = np.minimum(np.abs(quats - plain), np.abs(quats + plain)).max(axis=-1)
    turned = (apart > _SAME).any(axis=0)
    moved = bool((np.abs(locations - places) > _SAME).any())
    rows = np.searchsorted(frames, keys.frames)
    rotated, located = np.tile(turned & moving, (len(frames), 1)), np.full(len(frames), moved and moving)
    rotated[rows] |= keys.rotation_keyed
    located[rows] |= keys.location_keyed
    return PoseKeys(frames, quats, locations, rotated, located), turned, moved


def _remove_curves(armature: bpy.types.Object) -> None:
    emptied = {}
    for holder, curve in list(controls.keyed_curves(armature)):
        if curve.group is not None:
            emptied[curve.group.name] = holder
        holder.fcurves.remove(curve)
    for name, holder in emptied.items():
        group = holder.groups.get(name)  # from Blender 4.4 on, they go with their last curve
        if group is not None and len(group.channels) == 0:
            holder.groups.remove(group)


LISTENERS = {"controls": lambda group: controls.switch(group.id_data)}
