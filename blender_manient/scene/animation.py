"""Keys: the take's rotations and placement as an action on the armature, written in bulk."""

from __future__ import annotations

from collections.abc import Generator, Iterator

import bpy
import numpy as np

from handfit_core.geometry.rotations import unflip_quats
from handfit_core.hand_model import ShapedHand
from handfit_core.hand_model.axes import RestPose
from handfit_core.hand_model.motion import HandMotion
from handfit_core.skeleton import NUM_JOINTS

from ..blender_versions import assign_action, channels, first_slot
from ..rigs.rig import Rig
from .keys import PoseKeys, new_curve

CURVES = NUM_JOINTS * 4 + 3
"""How many curves a hand's action has"""

_CHUNK = 250
"""frames that are computed at once, in some milliseconds"""


def computing_keys(
    motion: HandMotion, shaped: ShapedHand, rest: RestPose, frames: np.ndarray
) -> Generator[int, None, PoseKeys]:
    """Compute a hand's keys, some frames at a time: yields how many, returns the keys.

    `rest` is how the rig's bones lie at rest, `frames` (T,) where the motion lies in the scene. Frames
    without a hand get no keys; filled ones do.
    """
    rows = np.flatnonzero(motion.present)
    quats, locations = np.empty((len(rows), NUM_JOINTS, 4)), np.empty((len(rows), 3))
    for start in range(0, len(rows), _CHUNK):
        some = slice(start, start + _CHUNK)
        quats[some], locations[some] = rest.to_bones(shaped, *(values[rows[some]] for values in motion.pose))
        # The sign goes on from that of the frames before.
        signed = slice(max(start - 1, 0), start + _CHUNK)
        quats[signed] = unflip_quats(quats[signed])
        yield len(quats[some])
    return PoseKeys.everywhere(frames[rows], quats, locations)


def animating(rig: Rig, keys: PoseKeys) -> Iterator[bpy.types.Action]:
    """Key a new action on the armature, a curve at a time. Yields the action each time.

    Straight lines join the keys: measured frames stay exactly as measured, and nothing overshoots in
    the gaps, as Bezier curves through noisy per-frame data would.
    """
    action = bpy.data.actions.new(rig.armature.name)
    assign_action(rig.armature, action)
    yield action
    parts = [(name, "rotation_quaternion", keys.quats[:, joint]) for joint, name in enumerate(rig.bones)]
    for bone, attribute, values in (*parts, (rig.bones[0], "location", keys.locations)):
        for index in range(values.shape[1]):
            # Asked for each curve: an undo may have moved what holds them.
            holder = channels(action, first_slot(action))
            new_curve(holder, bone, attribute, index, keys.frames, values[:, index])
            yield action
