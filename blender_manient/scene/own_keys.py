"""Which of a captured hand's keys are the artist's own: neither a capture nor Re-fit Range put them there.

What the capture found is in the take; what Re-fit Range found is kept on the armature. A key with another
pose than either, after corrections are taken out of it, was made by hand: keyed, moved, applied.
"""

from __future__ import annotations

import base64
import binascii
from collections.abc import Sequence

import bpy
import numpy as np

from handfit_core.edit.corrections import correction_between
from handfit_core.hand_model.motion import HandMotion
from handfit_core.skeleton import NUM_JOINTS
from handfit_core.take import at_rows

from .corrections import without_field
from .keys import PoseKeys, nearest, read_pose_keys
from .store import CapturedHand, hand_of, scene_frames

_SAME_TURN = 0.01
"""radians. Rotations that are nearer than this are the same"""
_SAME_PLACE = 0.001
"""metres"""
_POSE = 3 + 45 + 3
"""Numbers of a pose: global_orient and hand_pose as axis-angle in radians, and where the wrist is in the
camera frame, metres. They stay true when the hand's proportions change"""


def keyed_by_hand(hand: CapturedHand, rows: np.ndarray) -> np.ndarray:
    """(N, 17) bool: whether the 16 bones' rotations and the wrist's location have a key of the artist's own
    on the scene frames of the take's `rows` (N,), increasing. Raises TakeError and HandModelError."""
    frames = scene_frames(hand.collection, hand.take)[rows]
    found = np.zeros((len(rows), NUM_JOINTS + 1), dtype=bool)
    if len(rows) == 0:
        return found
    keys = without_field(hand.armature, read_pose_keys(hand.rig, float(frames[0]), float(frames[-1])))
    at, on = nearest(frames, keys.frames)
    keyed = np.column_stack([keys.rotation_keyed, keys.location_keyed])
    own = keyed & ~_holds(keys, *captured_poses(hand, rows[at])) & ~_holds(keys, *_fitted(hand, rows[at]))
    found[at[on]] = own[on]
    return found


def captured_poses(hand: CapturedHand, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """What the capture found in the take's `rows` (N,): quaternions (N, 16, 4) and wrist locations (N, 3)
    about the bones as they are now; NaN where there is no hand. Raises HandModelError."""
    return hand.to_bones(at_rows(hand.track, rows))


def note_fitted(
    armature: bpy.types.Object, frames: Sequence[int], quats: np.ndarray, locations: np.ndarray
) -> None:
    """Remember poses that Re-fit Range has keyed: (N,) source frames, quats (N, 16, 4) and wrist locations
    (N, 3) in metres, relative to the bones' rest."""
    hand = hand_of(armature)
    if hand is None or len(frames) == 0:
        return
    shaped = hand.shaped()
    orient, pose, transl = hand.rig.from_bones(shaped, quats, locations)
    new = np.column_stack([frames, orient, np.reshape(pose, (-1, 45)), shaped.joints[0] + transl])
    old = _noted(armature)
    table = np.concatenate([old[~np.isin(old[:, 0], new[:, 0])], new])
    table = table[np.argsort(table[:, 0])].astype("<f4")
    armature.manient.fitted = base64.b64encode(table.tobytes()).decode("ascii")


def _fitted(hand: CapturedHand, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The noted poses of the take's `rows` (N,), as `captured_poses`; NaN for those that were not fitted
    again."""
    noted, poses = _noted(hand.armature), np.full((len(rows), _POSE), np.nan)
    if len(noted):
        at, on = nearest(noted[:, 0], np.asarray(hand.take.frame_numbers, dtype=np.float64)[rows])
        poses[on] = noted[at[on], 1:]
    pose = poses[:, :3], poses[:, 3:48], poses[:, 48:] - hand.shaped().joints[0]
    return hand.to_bones(HandMotion(hand.side, hand.betas, *pose))


def _holds(keys: PoseKeys, quats: np.ndarray, locations: np.ndarray) -> np.ndarray:
    """(N, 17) bool: whether keys (N) hold these poses, (N, 16, 4) and (N, 3); never where one is NaN."""
    turned = np.linalg.norm(correction_between(keys.quats, quats), axis=-1)
    moved = np.linalg.norm(keys.locations - locations, axis=-1)
    return np.column_stack([turned < _SAME_TURN, moved < _SAME_PLACE])


def _noted(armature: bpy.types.Object) -> np.ndarray:
    """(N, 52) what `note_fitted` has kept: source frame, increasing, and pose. Nothing where that cannot be
    read: then keys count as made by hand."""
    try:
        data = base64.b64decode(armature.manient.fitted, validate=True)
        return np.frombuffer(data, dtype="<f4").reshape(-1, 1 + _POSE).astype(np.float64)
    except (ValueError, binascii.Error):
        return np.empty((0, 1 + _POSE))
