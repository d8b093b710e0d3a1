"""A layer for changes by hand: the motion lies below as an NLA strip, and keys of an empty action on top are
added to it. Blender's *Combine* turns by the layer's rotations after the motion's and adds locations."""

from __future__ import annotations

from typing import Any

import bpy
import numpy as np

from handfit_core.common.errors import OptionError
from handfit_core.common.slices import run_to_completion
from handfit_core.edit.simplify import Channels, simplifying
from handfit_core.geometry.rotations import channels_to_quat, quat_multiply, unflip_quats

from ..common.blender_versions import action_slot, assign_action, channels
from ..common.wording import with_note
from ..rigs.character import CharacterBones
from ..rigs.rig import bone_path
from .actions import BELOW, channels_of, curves_in, is_tweaked, own_action, push_down, strip_below, use_action
from .corrections import adding_to_keys
from .editable import check_keyable
from .keys import (
    PoseKeys,
    check_unlocked,
    frames_between,
    is_smooth,
    read_pose_keys,
    replace_keys,
    write_pose_keys,
)
from .simplify import all_actions, changed_alike, own_kept_actions, remove_unused

_DEGREES = 0.5
"""How exactly a layer is merged into motion that was simplified"""


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
    """Make the motion the active action again: with the layer's changes in its keys, or without them.

    Where motion has a key, it gets the changed value; where the layer has keys, motion gets keys. Motion that
    was simplified gets fitted anew, with more keys where half a degree asks for them; the action with all its
    keys, which is kept behind it, gets the changes too. Raises OptionError where there is no layer, and where
    it cannot be merged, before anything is changed.
    """
    data, strip = armature.animation_data, strip_below(armature)
    if strip is None or is_tweaked(armature):
        raise OptionError(
            f"{armature.name!r} has no layer on top of a motion: leave the NLA's tweak mode, or make the "
            "layer's action the active one"
        )
    layer, motion, slot, layer_slot = data.action, strip.action, action_slot(strip), action_slot(data)
    bones = _changed_bones(armature, strip) if merge else []
    below, on_top = (channels_of(user, make=True) for user in (strip, data))
    found = [_merged(armature, bone, below, on_top) for bone in bones]
    for rig, keys, _ in found:
        check_unlocked(
            rig, joints=[0] if keys.rotation_keyed.any() else [], location=bool(keys.location_keyed.any())
        )
    for track in data.nla_tracks:
        if strip in list(track.strips):
            track.strips.remove(strip)
            if not len(track.strips):
                data.nla_tracks.remove(track)
            break
    data.action_blend_type = "REPLACE"
    use_action(data, motion, slot)
    if found:
        own_action(armature)
        on_top = channels(layer, layer_slot)
        with changed_alike(armature), adding_to_keys(armature, all_actions(armature)):
            for one in found:
                _write(*one)
            for holder in [channels(*kept) for kept in own_kept_actions(armature)]:
                for bone in bones if holder is not None else ():
                    _write(*_merged(armature, bone, holder, on_top), holder=holder)
    remove_unused(layer)


def _changed_bones(armature: bpy.types.Object, strip: Any) -> list[str]:
    """The bones that the layer on a strip has keys for. Raises OptionError where it cannot be merged."""
    data = armature.animation_data
    moved = abs(strip.frame_start - strip.action_frame_start) > 1e-3
    if moved or abs(strip.scale - 1.0) > 1e-6 or abs(strip.repeat - 1.0) > 1e-6 or strip.use_reverse:
        raise OptionError(f"the strip {strip.name!r} lies at another time than its keys: put it back first")
    if any(strip in list(track.strips) and track.mute for track in data.nla_tracks) or not _whole(strip):
        raise OptionError(
            f"the strip {strip.name!r} is not shown as its keys are: it is muted, trimmed, faded, or not "
            "blended by Replace. Undo that, or bake the motion (Pose > Animation > Bake Action)"
        )
    if data.action_blend_type != "COMBINE" or data.action_influence < 1.0 or strip.use_animated_influence:
        raise OptionError(
            f"the layer of {armature.name!r} is not added as it was made: set its blending to Combine and "
            "the whole influence of both, or bake it (Pose > Animation > Bake Action)"
        )
    names = {f"{bone_path(bone.name)}.": bone.name for bone in armature.pose.bones}
    bones: dict[str, None] = {}
    for curve in curves_in(channels_of(data)):
        start, dot, attribute = curve.data_path.partition("].")
        bone = names.get(start + dot)
        if attribute == "scale" and all(abs(key.co[1] - 1.0) < 1e-5 for key in curve.keyframe_points):
            continue  # keyed along with the rest
        if bone is None or not attribute.startswith(("rotation", "location")):
            raise OptionError(
                f"the layer animates {curve.data_path}, which is neither a bone's rotation nor its location: "
                "bake it (Pose > Animation > Bake Action), or delete that channel"
            )
        bones[bone] = None
    return list(bones)


def _merged(
    armature: bpy.types.Object, bone: str, below: Any, top: Any
) -> tuple[CharacterBones, PoseKeys, list[Channels]]:
    """What the channels `top` of a layer make of a bone with those of the motion below: which frames have
    keys, and the values on all frames that count."""
    rig = CharacterBones(armature, [bone])
    first, second = (read_pose_keys(rig, holder=holder) for holder in (below, top))
    both = np.union1d(first.frames, second.frames)
    frames = frames_between(both)
    mode = armature.pose.bones[bone].rotation_mode
    keyed = np.isin(frames, both)
    rotated, located = bool(second.rotation_keyed.any()), bool(second.location_keyed.any())
    path = f"{bone_path(bone)}."
    tracks = []
    if rotated:
        kind = {"QUATERNION": "rotation_quaternion", "AXIS_ANGLE": "rotation_axis_angle"}
        attribute = path + kind.get(mode, "rotation_euler")
        values, change = (_evaluated(h, attribute, mode, frames) for h in (below, top))
        if mode == "QUATERNION":
            both_turned = quat_multiply(*(channels_to_quat(v, mode) for v in (values, change)))
            tracks.append(Channels(unflip_quats(both_turned), mode))
        else:
            tracks.append(Channels(values + change, mode))
    values, change = (_evaluated(h, path + "location", "LOCATION", frames) for h in (below, top))
    located = located and bool(np.abs(change).max(initial=0.0) > 1e-6)
    if located:
        arm = max(float(armature.data.bones[bone].length), 1e-6)
        tracks.append(Channels(values + change, "LOCATION", arm=arm))
    quats = channels_to_quat(tracks[0].values, mode) if rotated else np.zeros((len(frames), 4))
    keys = PoseKeys(
        frames,
        quats[:, None],
        tracks[-1].values if located else np.zeros((len(frames), 3)),
        (keyed & rotated)[:, None],
        keyed & located,
    )
    return rig, keys, tracks


def _whole(strip: Any) -> bool:
    """Whether a strip shows all keys of its action."""
    first, last = strip.action.curve_frame_range
    within = strip.action_frame_start - 1e-3 <= first and last <= strip.action_frame_end + 1e-3
    faded = strip.blend_in > 0.0 or strip.blend_out > 0.0
    return within and not faded and not strip.mute and strip.blend_type == "REPLACE"


def _write(rig: CharacterBones, keys: PoseKeys, tracks: list[Channels], *, holder: Any = None) -> None:
    if not is_smooth(rig, holder=holder):
        write_pose_keys(rig, keys, holder=holder)
        return
    kept = np.flatnonzero(keys.rotation_keyed[:, 0] | keys.location_keyed)
    result = run_to_completion(simplifying(keys.frames, tracks, _DEGREES, kept=kept.tolist()))
    for track, spline in zip(tracks, result.splines, strict=True):
        joint = None if track.mode == "LOCATION" else 0
        handles = spline.handles(keys.frames)
        replace_keys(rig, joint, keys.frames[spline.rows], spline.values, *handles, holder=holder)


def _evaluated(holder: Any, path: str, mode: str, frames: np.ndarray) -> np.ndarray:
    """(N, 3 or 4) what curves say; where one is missing, what stands for no change."""
    values = np.zeros((len(frames), 4 if mode in {"QUATERNION", "AXIS_ANGLE"} else 3))
    values[:, 0] = mode == "QUATERNION"
    for i in range(values.shape[1]):
        curve = holder.fcurves.find(path, index=i)
        if curve is not None and len(curve.keyframe_points):
            values[:, i] = [curve.evaluate(frame) for frame in frames.tolist()]
    return values
