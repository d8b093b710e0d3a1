"""Keys: the take's rotations and placement as an action on the armature, written in bulk."""

from __future__ import annotations

from collections.abc import Generator, Iterator
from dataclasses import dataclass

import bpy
import numpy as np

from handfit_core.files import storable
from handfit_core.geometry.rotations import unflip_quats
from handfit_core.hand_model import ShapedHand
from handfit_core.hand_model.axes import RestPose
from handfit_core.skeleton import NUM_JOINTS
from handfit_core.take import HandTrack, Take

from ..blender_versions import assign_action, channels, first_slot
from ..rigs.rig import Rig
from .timing import Timing

CURVES = NUM_JOINTS * 4 + 3
"""How many curves a hand's action has"""

_CHUNK = 250
"""frames that are computed at once, in some milliseconds"""


@dataclass(frozen=True, eq=False)
class HandKeys:
    """What a hand's action will hold: keys on N frames."""

    frames: np.ndarray
    """(N,) scene frames"""
    quats: np.ndarray
    """(16, 4, N) w, x, y, z of each bone, relative to its rest"""
    locations: np.ndarray
    """(3, N) metres, of the wrist along its own axes"""


def computing_keys(
    take: Take, track: HandTrack, shaped: ShapedHand, rest: RestPose, timing: Timing
) -> Generator[int, None, HandKeys]:
    """Compute a hand's keys, some frames at a time: yields how many, returns the keys.

    `rest` is how the rig's bones lie at rest. Frames without a hand get no
    keys; filled ones do.
    """
    scene_frames = timing.scene_frames(take.frame_numbers)
    seen = track.present
    rows = np.flatnonzero(seen)
    quats = np.empty((NUM_JOINTS, 4, len(rows)), dtype=np.float32)
    locations = np.empty((3, len(rows)), dtype=np.float32)
    before = np.empty((0, NUM_JOINTS, 4))
    for start in range(0, len(rows), _CHUNK):
        some = rows[start : start + _CHUNK]
        turned, moved = rest.to_bones(
            shaped, track.global_orient[some], track.hand_pose[some], track.transl[some]
        )
        # The sign goes on from that of the frames before.
        turned = unflip_quats(np.concatenate([before, turned]))[len(before) :]
        before = turned[-1:]
        quats[..., start : start + _CHUNK] = np.moveaxis(turned, 0, -1)
        locations[:, start : start + _CHUNK] = moved.T
        yield len(some)
    return HandKeys(scene_frames[seen], quats, locations)


def animating(rig: Rig, keys: HandKeys) -> Iterator[bpy.types.Action]:
    """Key a new action on the armature, a curve at a time. Yields the action each time.

    Straight lines join the keys: measured frames stay exactly as measured, and nothing overshoots in
    the gaps, as Bezier curves through noisy per-frame data would.
    """
    action = bpy.data.actions.new(rig.armature.name)
    assign_action(rig.armature, action)
    yield action
    names = rig.bones
    for joint, name in enumerate(names):
        path = f'pose.bones["{name}"].rotation_quaternion'
        for component in range(4):
            new_curve(action, path, component, keys.frames, keys.quats[joint, component], name)
            yield action
    path = f'pose.bones["{names[0]}"].location'
    for component in range(3):
        new_curve(action, path, component, keys.frames, keys.locations[component], names[0])
        yield action


def describe(armature: bpy.types.Object, take: Take, track: HandTrack) -> None:
    """Custom properties that say where this hand comes from; they are exported with it."""
    armature["side"] = track.side
    armature["betas"] = [float(b) for b in track.betas]
    armature["model"] = storable(take.model)
    armature["solver"] = take.solver
    armature["source"] = storable(take.source.files[0])


def new_curve(
    action: bpy.types.Action, path: str, index: int, frames: np.ndarray, values: np.ndarray, group: str = ""
) -> None:
    """A new curve in an action of ours, which `assign_action` has given to its armature, with a key (scene
    frame, value) per frame and straight lines between."""
    # Asked for each curve: an undo may have moved what holds them.
    holder = channels(action, first_slot(action))
    curve = holder.fcurves.new(path, index=index)
    if group:
        curve.group = holder.groups.get(group) or holder.groups.new(group)
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
