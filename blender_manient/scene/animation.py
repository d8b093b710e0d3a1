"""Keys: the take's rotations and placement as an action on the armature, written in bulk."""

from __future__ import annotations

from collections.abc import Iterable

import bpy
import numpy as np

from handfit_core.hand_model import ShapedHand
from handfit_core.rotations import unflip_quats
from handfit_core.take import HandTrack, Take

from .. import axes
from .armature import bone_names, rest_frames

ERROR_PROPERTY = "reprojection_error_px"
"""The armature object's animated custom property: how far the fit is from the picture, in pixels"""


def animate(armature: bpy.types.Object, take: Take, track: HandTrack, shaped: ShapedHand) -> bpy.types.Action:
    """Key the track on the armature, on the source's frame numbers. Returns the action.

    Frames without a hand get no keys; filled ones get keys, but no error. Straight lines join the
    keys: measured frames stay exactly as measured, and nothing overshoots in the gaps, as Bezier
    curves through noisy per-frame data would.
    """
    frames = rest_frames(armature, track.side)
    seen = track.present
    numbers = np.asarray(take.frame_numbers)[seen]
    quats, locations = axes.bone_pose(
        shaped, frames, track.global_orient[seen], track.hand_pose[seen], track.transl[seen]
    )
    quats = unflip_quats(quats)

    action = bpy.data.actions.new(armature.name)
    channels = _channels_of(action, armature)
    names = bone_names(track.side)
    for joint, name in enumerate(names):
        path = f'pose.bones["{name}"].rotation_quaternion'
        for component in range(4):
            _write(channels, path, component, name, numbers, quats[:, joint, component])
    path = f'pose.bones["{names[0]}"].location'
    for component in range(3):
        _write(channels, path, component, names[0], numbers, locations[:, component])

    _describe(armature, take, track)
    # Filled frames were not detected: nothing to be measured against.
    measured = np.asarray(track.detected, dtype=bool)
    _write(
        channels,
        f'["{ERROR_PROPERTY}"]',
        0,
        "Capture",
        np.asarray(take.frame_numbers)[measured],
        track.reprojection_error[measured],
    )
    return action


def action_curves(action: bpy.types.Action) -> Iterable[bpy.types.FCurve]:
    """All curves of an action, in any version of Blender."""
    if hasattr(action, "fcurves"):
        return list(action.fcurves)
    return [
        c
        for layer in action.layers
        for strip in layer.strips
        for bag in strip.channelbags
        for c in bag.fcurves
    ]


def _channels_of(action: bpy.types.Action, owner: bpy.types.Object):
    """Give the action to its owner; returns what holds its curves and their groups.

    Up to Blender 4.3 that is the action itself. From 4.4 on an action holds one channel bag per
    slot, and from 5.0 on that is the only way.
    """
    data = owner.animation_data_create()
    data.action = action
    if not hasattr(action, "slots"):
        return action
    slot = action.slots.new(id_type="OBJECT", name=owner.name)
    data.action_slot = slot
    strip = action.layers.new("Layer").strips.new(type="KEYFRAME")
    return strip.channelbag(slot, ensure=True)


def _write(channels, path: str, index: int, group: str, numbers: np.ndarray, values: np.ndarray) -> None:
    """One curve with a key (frame number, value) per measured frame."""
    curve = channels.fcurves.new(path, index=index)
    curve.group = channels.groups.get(group) or channels.groups.new(group)
    count = len(numbers)
    points = curve.keyframe_points
    points.add(count)
    points.foreach_set("co", np.stack([numbers, values], axis=-1).astype(np.float32).ravel())
    linear = bpy.types.Keyframe.bl_rna.properties["interpolation"].enum_items["LINEAR"].value
    points.foreach_set("interpolation", np.full(count, linear, dtype=np.int32))
    # Sensible handles, for users who switch a curve to Bezier.
    clamped = bpy.types.Keyframe.bl_rna.properties["handle_left_type"].enum_items["AUTO_CLAMPED"].value
    for handle in ("handle_left_type", "handle_right_type"):
        points.foreach_set(handle, np.full(count, clamped, dtype=np.int32))
    curve.update()


def _describe(armature: bpy.types.Object, take: Take, track: HandTrack) -> None:
    """Custom properties that say where this hand comes from."""
    armature["side"] = track.side
    armature["betas"] = [float(b) for b in track.betas]
    armature["model"] = take.model
    armature["solver"] = take.solver
    armature["source"] = take.source.files[0]
    armature[ERROR_PROPERTY] = 0.0
    armature.id_properties_ui(ERROR_PROPERTY).update(
        min=0.0, description="Mean distance from the fitted hand to the detected keypoints, in pixels"
    )
