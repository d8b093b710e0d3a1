"""A layer for changes by hand: the motion lies below as an NLA strip, and keys of an empty action on top are
added to it. Blender's *Combine* turns by the layer's rotations after the motion's and adds locations."""

from __future__ import annotations

from typing import Any

import bpy
import numpy as np

from handfit_core.common.errors import OptionError
from handfit_core.common.slices import run_to_completion
from handfit_core.edit.corrections import correction_between
from handfit_core.edit.simplify import Channels, simplifying
from handfit_core.geometry.rotations import channels_to_quat, unflip_quats

from ..common.blender_versions import action_slot, assign_action, channels
from ..common.wording import with_note
from ..rigs.character import CharacterBones
from ..rigs.rig import bone_path
from .actions import BELOW, channels_of, curves_in, is_tweaked, own_action, push_down, strip_below, use_action
from .corrections import adding_to_keys
from .editable import check_keyable
from .keys import (
    PoseKeys,
    channel_values,
    check_unlocked,
    frames_between,
    frames_of,
    is_smooth,
    nearest,
    replace_keys,
    rotation_path,
    union,
    write_pose_keys,
)
from .own_scene import object_mode, shown_in_pose, unseen_scene
from .sampling import stepped
from .simplify import keeping_simplified, own_kept_actions, remove_unused

_Merged = tuple[CharacterBones, PoseKeys, list[Channels]]
"""A bone, its keys, and the values of its channels on all frames"""
_DEGREES = 0.5
"""Degrees within which a layer is merged into motion that was simplified"""
_SAME = 1e-5
"""Radians and metres within which shown motion counts as that of the keys"""


def add_layer(armature: bpy.types.Object) -> bpy.types.Action:
    """Put the present action below and give an empty one on top. Returns the empty one.

    Raises OptionError where there is no motion, or where it cannot be changed.
    """
    check_keyable(armature)
    data = armature.animation_data
    if not curves_in(channels_of(data)):
        raise OptionError(f"{armature.name!r} has no motion that changes could lie on")
    own_action(armature)
    motion, name = data.action, data.action.name
    push_down(data)
    layer = bpy.data.actions.new(with_note(name, "changes"))
    assign_action(armature, layer)
    layer[BELOW] = motion
    data.action_blend_type, data.action_extrapolation, data.action_influence = "COMBINE", "HOLD", 1.0
    return layer


def end_layer(armature: bpy.types.Object, *, merge: bool) -> None:
    """Make the motion the active action again: with what Blender shows of both in its keys, or as it was.

    Where motion or layer has a key, motion gets the shown value. Motion that was simplified gets fitted anew,
    with more keys where half a degree asks for them; the action with all its keys, which is kept behind it,
    gets the changes too. Raises OptionError where there is no layer, and where it cannot be merged, before
    anything is changed.
    """
    data, strip = armature.animation_data, strip_below(armature)
    if strip is None or is_tweaked(armature):
        raise OptionError(
            f"{armature.name!r} has no layer on top of a motion: leave the NLA's tweak mode, or make the "
            "layer's action the active one"
        )
    layer, motion, slot = data.action, strip.action, action_slot(strip)
    if merge:
        _check_mergeable(armature, strip)
    merged = _merged(armature, strip) if merge else []
    for rig, keys, _ in merged:
        check_unlocked(rig, **keys.channels)
    written: list[tuple[Any, list[_Merged]]] = []
    try:
        for kept in own_kept_actions(armature) if merged else ():
            use_action(strip, *kept)
            written.append((kept, _merged(armature, strip)))
    finally:
        use_action(strip, motion, slot)
    for track in data.nla_tracks:
        if strip in list(track.strips):
            track.strips.remove(strip)
            if not len(track.strips):
                data.nla_tracks.remove(track)
            break
    data.action_blend_type, data.action_influence = "REPLACE", 1.0
    use_action(data, motion, slot)
    if merged:
        own_action(armature)
        written.append(((data.action, action_slot(data)), merged))
        with keeping_simplified(armature), adding_to_keys(armature, [user for user, _ in written]):
            for user, parts in written:
                for part in parts:
                    _write(*part, channels(*user))
    remove_unused(layer)


def _check_mergeable(armature: bpy.types.Object, strip: Any) -> None:
    moved = abs(strip.frame_start - strip.action_frame_start) > 1e-3
    if moved or abs(strip.scale - 1.0) > 1e-6 or abs(strip.repeat - 1.0) > 1e-6 or strip.use_reverse:
        raise OptionError(f"the strip {strip.name!r} lies at another time than its keys: put it back first")
    starts = tuple(f"{bone_path(bone.name)}." for bone in armature.pose.bones)
    for curve in curves_in(channels_of(armature.animation_data)):
        attribute = curve.data_path.rpartition(".")[2]
        if attribute == "scale" and all(abs(key.co[1] - 1.0) < 1e-5 for key in curve.keyframe_points):
            continue  # keyed along with the rest
        if not curve.data_path.startswith(starts) or not attribute.startswith(("rotation", "location")):
            raise OptionError(
                f"the layer animates {curve.data_path}, which is neither a bone's rotation nor its location: "
                "bake it (Pose > Animation > Bake Action), or delete that channel"
            )


def _merged(armature: bpy.types.Object, strip: Any) -> list[_Merged]:
    """Return the keys of the bones that Blender shows otherwise than the strip's action alone has them."""
    names = {bone_path(bone.name): bone.name for bone in armature.pose.bones}
    below, top = (channels_of(user) for user in (strip, armature.animation_data))
    curves: dict[str, list[Any]] = {}
    for curve in (*curves_in(below), *curves_in(top)):
        path, _, attribute = curve.data_path.rpartition(".")
        if path in names and attribute.startswith(("rotation", "location")):
            curves.setdefault(names[path], []).append(curve)
    keyed = {bone: found for bone, own in curves.items() if len(found := frames_of(own))}
    frames = frames_between(union(list(keyed.values())))
    found = []
    for bone, (turned, placed) in _shown(armature, list(keyed), frames).items():
        rig, mode = CharacterBones(armature, [bone]), armature.pose.bones[bone].rotation_mode
        (values,), places = channel_values(rig, frames, holder=below)
        quats = channels_to_quat(turned, mode)
        rotated = np.abs(correction_between(channels_to_quat(values, mode), quats)).max() > _SAME
        located = np.abs(placed - places).max() > _SAME
        tracks, own = [], nearest(keyed[bone], frames)[1]
        if rotated:
            tracks.append(Channels(unflip_quats(turned) if mode == "QUATERNION" else turned, mode))
        if located:
            arm = max(float(armature.data.bones[bone].length), 1e-6)
            tracks.append(Channels(placed, "LOCATION", arm=arm))
        if tracks:
            keys = PoseKeys(frames, quats[:, None], placed, (own & rotated)[:, None], own & located)
            found.append((rig, keys, tracks))
    return found


def _shown(
    armature: bpy.types.Object, bones: list[str], frames: np.ndarray
) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Return what Blender shows of bones' own channels: by bone, rotations (N, 3 or 4) in its rotation mode
    and locations (N, 3)."""
    paths = {name: rotation_path(armature.pose.bones[name]) for name in bones}
    found: dict[str, list[tuple[Any, Any]]] = {name: [] for name in bones}
    with object_mode(), unseen_scene("merged") as scene, shown_in_pose([armature]):
        scene.collection.objects.link(armature)
        for depsgraph in stepped(scene, frames):
            pose = armature.evaluated_get(depsgraph).pose.bones
            for name, path in paths.items():
                found[name].append((tuple(getattr(pose[name], path)), tuple(pose[name].location)))
    return {
        name: (np.array([r for r, _ in rows]), np.array([p for _, p in rows])) for name, rows in found.items()
    }


def _write(rig: CharacterBones, keys: PoseKeys, tracks: list[Channels], holder: Any) -> None:
    if not is_smooth(rig, holder=holder):
        write_pose_keys(rig, keys, holder=holder)
        return
    kept = np.flatnonzero(keys.rotation_keyed[:, 0] | keys.location_keyed)
    result = run_to_completion(simplifying(keys.frames, tracks, _DEGREES, kept=kept.tolist()))
    for track, spline in zip(tracks, result.splines, strict=True):
        joint = None if track.mode == "LOCATION" else 0
        handles = spline.handles(keys.frames)
        replace_keys(rig, joint, keys.frames[spline.rows], spline.values, *handles, holder=holder)
