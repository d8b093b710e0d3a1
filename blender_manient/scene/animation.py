"""Keys: the take's rotations and placement as an action on the armature, written in bulk."""

from __future__ import annotations

from collections.abc import Generator, Iterable, Iterator
from dataclasses import dataclass

import bpy
import numpy as np

from handfit_core.hand_model import ShapedHand
from handfit_core.rotations import unflip_quats
from handfit_core.skeleton import NUM_JOINTS
from handfit_core.take import HandTrack, Take

from .. import axes
from .armature import bone_names, rest_frames
from .timing import Timing

ERROR_PROPERTY = "reprojection_error_px"
"""The armature object's animated custom property: how far the fit is from the picture, in pixels"""

CURVES = NUM_JOINTS * 4 + 3 + 1
"""How many curves a hand's action has"""

_CHUNK = 250
"""frames that are computed at once, in some milliseconds"""


@dataclass(frozen=True, eq=False)
class HandKeys:
    """What a hand's action will hold: keys on N frames, and errors on the M of them that were detected."""

    frames: np.ndarray
    """(N,) scene frames"""
    quats: np.ndarray
    """(16, 4, N) w, x, y, z of each bone, relative to its rest"""
    locations: np.ndarray
    """(3, N) metres, of the wrist along its own axes"""
    error_frames: np.ndarray
    """(M,) scene frames"""
    errors: np.ndarray
    """(M,) pixels"""


def computing_keys(
    take: Take, track: HandTrack, shaped: ShapedHand, frames: np.ndarray, timing: Timing
) -> Generator[int, None, HandKeys]:
    """Compute a hand's keys, some frames at a time: yields how many, returns the keys.

    `frames` (16, 3, 3) are the bones' axes at rest (`armature.rest_frames`). Frames without a hand get no
    keys; filled ones get keys, but no error: they were not detected, so there is nothing to be measured
    against.
    """
    scene_frames = timing.scene_frames(take.frame_numbers)
    seen, measured = track.present, np.asarray(track.detected, dtype=bool)
    rows = np.flatnonzero(seen)
    quats = np.empty((NUM_JOINTS, 4, len(rows)), dtype=np.float32)
    locations = np.empty((3, len(rows)), dtype=np.float32)
    before = np.empty((0, NUM_JOINTS, 4))
    for start in range(0, len(rows), _CHUNK):
        some = rows[start : start + _CHUNK]
        turned, moved = axes.bone_pose(
            shaped, frames, track.global_orient[some], track.hand_pose[some], track.transl[some]
        )
        # The sign goes on from that of the frames before.
        turned = unflip_quats(np.concatenate([before, turned]))[len(before) :]
        before = turned[-1:]
        quats[..., start : start + _CHUNK] = np.moveaxis(turned, 0, -1)
        locations[:, start : start + _CHUNK] = moved.T
        yield len(some)
    return HandKeys(
        scene_frames[seen], quats, locations, scene_frames[measured], track.reprojection_error[measured]
    )


def hand_keys(
    take: Take, track: HandTrack, shaped: ShapedHand, frames: np.ndarray, timing: Timing
) -> HandKeys:
    """`computing_keys` at once."""
    steps = computing_keys(take, track, shaped, frames, timing)
    while True:
        try:
            next(steps)
        except StopIteration as stop:
            return stop.value


def animating(armature: bpy.types.Object, track: HandTrack, keys: HandKeys) -> Iterator[bpy.types.Action]:
    """Key a new action on the armature, a curve at a time. Yields the action each time.

    Straight lines join the keys: measured frames stay exactly as measured, and nothing overshoots in
    the gaps, as Bezier curves through noisy per-frame data would.
    """
    action = bpy.data.actions.new(armature.name)
    _give(action, armature)
    yield action
    names = bone_names(track.side)
    for joint, name in enumerate(names):
        path = f'pose.bones["{name}"].rotation_quaternion'
        for component in range(4):
            _write(action, path, component, name, keys.frames, keys.quats[joint, component])
            yield action
    path = f'pose.bones["{names[0]}"].location'
    for component in range(3):
        _write(action, path, component, names[0], keys.frames, keys.locations[component])
        yield action
    _write(action, f'["{ERROR_PROPERTY}"]', 0, "Capture", keys.error_frames, keys.errors)
    yield action


def animate(
    armature: bpy.types.Object,
    take: Take,
    track: HandTrack,
    shaped: ShapedHand,
    timing: Timing | None = None,
) -> bpy.types.Action:
    """Key the track on the armature at once; by default on the source's frame numbers. Returns the action."""
    describe(armature, take, track)
    frames = rest_frames(armature, track.side)
    *_, action = animating(armature, track, hand_keys(take, track, shaped, frames, timing or Timing()))
    return action


def describe(armature: bpy.types.Object, take: Take, track: HandTrack) -> None:
    """Custom properties that say where this hand comes from; they are exported with it."""
    armature["side"] = track.side
    armature["betas"] = [float(b) for b in track.betas]
    armature["model"] = take.model
    armature["solver"] = take.solver
    armature["source"] = take.source.files[0]
    armature[ERROR_PROPERTY] = 0.0
    armature.id_properties_ui(ERROR_PROPERTY).update(
        min=0.0, description="Mean distance from the fitted hand to the detected keypoints, in pixels"
    )


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


def _give(action: bpy.types.Action, owner: bpy.types.Object) -> None:
    """Give the action to its owner, with what holds its curves.

    Up to Blender 4.3 that is the action itself. From 4.4 on an action holds one channel bag per
    slot, and from 5.0 on that is the only way.
    """
    data = owner.animation_data_create()
    data.action = action
    if hasattr(action, "slots"):
        slot = action.slots.new(id_type="OBJECT", name=owner.name)
        data.action_slot = slot
        action.layers.new("Layer").strips.new(type="KEYFRAME").channelbag(slot, ensure=True)


def _channels_of(action: bpy.types.Action):
    """What holds the curves of an action of ours. Asked for each curve: an undo may have moved it."""
    if not hasattr(action, "slots"):
        return action
    return action.layers[0].strips[0].channelbag(action.slots[0])


def _write(
    action: bpy.types.Action, path: str, index: int, group: str, frames: np.ndarray, values: np.ndarray
) -> None:
    """One curve with a key (scene frame, value) per measured frame."""
    channels = _channels_of(action)
    curve = channels.fcurves.new(path, index=index)
    curve.group = channels.groups.get(group) or channels.groups.new(group)
    count = len(frames)
    points = curve.keyframe_points
    points.add(count)
    places = np.empty((count, 2), dtype=np.float32)
    places[:, 0], places[:, 1] = frames, values
    points.foreach_set("co", places.ravel())
    linear = bpy.types.Keyframe.bl_rna.properties["interpolation"].enum_items["LINEAR"].value
    points.foreach_set("interpolation", np.full(count, linear, dtype=np.int32))
    # Sensible handles, for users who switch a curve to Bezier.
    clamped = bpy.types.Keyframe.bl_rna.properties["handle_left_type"].enum_items["AUTO_CLAMPED"].value
    for handle in ("handle_left_type", "handle_right_type"):
        points.foreach_set(handle, np.full(count, clamped, dtype=np.int32))
    curve.update()
