"""The arm of a captured hand: an upper arm from the shoulder, and a forearm that ends at the wrist.

Both have keys of their own, and so has the hand, which does not hang on them: all that corrects a hand works
with an arm as without. What moves the hand takes the arm along instead: an inverse kinematics constraint has
the forearm end at the wrist, and turning the upper arm swings the elbow. Where the keys bring it there
already, the constraint changes nothing.

The skin behind the wrist points to the elbow and is twisted as the hand is, since a forearm's skin does not
wring at the wrist: a third bone hangs on the hand and tracks the elbow.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, Final

import bpy
import numpy as np
from mathutils import Vector

from handfit_core.common.errors import HandModelError
from handfit_core.geometry.rotations import rotmat_to_quat, unflip_quats
from handfit_core.hand_model.arm import ArmMotion
from handfit_core.hand_model.axes import points_to_world

from .rig import PosedBones

MARK: Final = "arm_bone"
"""Custom property of a bone with its role: one of `NAMES`, or `_SKIN`. The artist may give the bone another
name"""
NAMES: Final = ("upper_arm", "forearm")
_SKIN: Final = "wrist_twist"
_COLLECTION: Final = "Arm"
TO_WRIST: Final = "To Wrist"
TO_ELBOW: Final = "To Elbow"
_STEADY: Final = 5
"""How many frames before and after a straight arm takes its roll from"""


class ArmBones(PosedBones):
    """The two bones of an armature's arm."""

    @property
    def bones(self) -> list[str]:
        """Return the names of the upper arm and the forearm. Raises HandModelError where one is missing."""
        marked = {bone.get(MARK): bone.name for bone in self.armature.data.bones}
        missing = next((name for name in NAMES if name not in marked), None)
        if missing is not None:
            raise HandModelError(
                f"{self.armature.name!r} has no {missing.replace('_', ' ')}: add its arms first"
            )
        return [marked[name] for name in NAMES]

    def to_bones(self, arm: ArmMotion, origin: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the poses in the N frames with an arm: quaternions (N, 2, 4) relative to rest and parent,
        and the upper arm's locations (N, 3) in metres along its own axes.

        `origin` (3,), metres, is where the armature's space lies, as in `RestPose`. The elbow is a hinge: the
        forearm turns about the upper arm's X."""
        bones = [self.armature.data.bones[name] for name in self.bones]
        rest_upper, rest_fore = (np.array(bone.matrix_local.to_3x3(), dtype=np.float64) for bone in bones)
        shoulder, elbow, wrist = (
            points_to_world(points[arm.present]) - origin for points in (arm.shoulder, arm.elbow, arm.wrist)
        )
        upper, fore = _unit(elbow - shoulder), _unit(wrist - elbow)
        hinge = _steady(np.cross(upper, fore))
        hinge -= upper * np.sum(hinge * upper, axis=-1, keepdims=True)
        posed_upper = _frames(hinge, upper)
        posed_fore = _frames(posed_upper[..., 0], fore)
        below = posed_upper @ rest_upper.T @ rest_fore
        turned = np.stack([rest_upper.T @ posed_upper, np.swapaxes(below, -1, -2) @ posed_fore], axis=1)
        at_rest = np.array(bones[0].head_local, dtype=np.float64)
        return unflip_quats(rotmat_to_quat(turned)), (shoulder - at_rest) @ rest_upper


def has_arm(armature: bpy.types.Object) -> bool:
    """True if an armature has the bones of an arm."""
    return set(NAMES) <= {bone.get(MARK) for bone in armature.data.bones}


def skin_bone(armature: bpy.types.Object) -> bpy.types.Bone | None:
    """Return the bone that moves the skin behind the wrist, where an arm was added; None elsewhere."""
    return next((bone for bone in armature.data.bones if bone.get(MARK) == _SKIN), None)


def make_bones(edit_bones: Any, wrist: str, lengths: np.ndarray) -> dict[str, str]:
    """Make the bones of an arm, straight behind the wrist's bone and with its axes; lengths (2,) in metres.

    Return their names, by those of `NAMES` and `_SKIN`. What an arm that was deleted left behind is
    replaced."""
    hand = edit_bones[wrist]
    for left in [bone for bone in edit_bones if bone.get(MARK)]:
        edit_bones.remove(left)
    along = (hand.tail - hand.head).normalized()
    made = {name: edit_bones.new(name + wrist[-2:]) for name in NAMES}
    end = Vector(hand.head)
    for name, length in zip(reversed(NAMES), reversed(lengths.tolist()), strict=True):
        made[name].tail, made[name].head = end, end - along * length
        made[name].roll = hand.roll
        end = made[name].head
    made["forearm"].parent = made["upper_arm"]
    made["forearm"].use_connect = True
    skin = made[_SKIN] = edit_bones.new(_SKIN + wrist[-2:])
    skin.head, skin.tail, skin.parent = hand.head, hand.head - along * (hand.tail - hand.head).length, hand
    return {name: bone.name for name, bone in made.items()}


def set_up(armature: bpy.types.Object, wrist: str, names: dict[str, str]) -> None:
    """Have bones that `make_bones` made be the arm of a hand."""
    collection = armature.data.collections.new(_COLLECTION)
    for name, bone in names.items():
        armature.data.bones[bone][MARK] = name
        armature.pose.bones[bone].rotation_mode = "QUATERNION"
        collection.assign(armature.data.bones[bone])
    reach: Any = armature.pose.bones[names["forearm"]].constraints.new("IK")
    reach.name, reach.target, reach.subtarget, reach.chain_count = TO_WRIST, armature, wrist, len(NAMES)
    reach.use_stretch = False
    track: Any = armature.pose.bones[names[_SKIN]].constraints.new("DAMPED_TRACK")
    track.name, track.track_axis = TO_ELBOW, "TRACK_Y"
    track.target, track.subtarget = armature, names["forearm"]


def tree_with_arm(armature: bpy.types.Object, wrist: str, names: Iterable[str]) -> dict[str, str]:
    """Return the parent of each of the bones `names`, empty for a root, with the wrist hung on the
    forearm."""
    bones = armature.data.bones
    tree = {name: parent.name if (parent := bones[name].parent) is not None else "" for name in names}
    return tree | {wrist: ArmBones(armature).bones[1]}


def _frames(across: np.ndarray, along: np.ndarray) -> np.ndarray:
    """Return (N, 3, 3) the axes of bones that lie along (N, 3), X as near as can be to `across` (N, 3)."""
    back = _unit(np.cross(across, along))
    return np.stack([np.cross(along, back), along, back], axis=-1)


def _steady(normals: np.ndarray) -> np.ndarray:
    """Return (N, 3) normals of the arm's plane, whose length tells how far it is bent, smoothed over the
    frames around: that of a straight arm is noise."""
    weights = np.hanning(2 * _STEADY + 3)[1:-1]
    padded = np.pad(normals, ((_STEADY, _STEADY), (0, 0)), mode="edge")
    return np.stack([np.convolve(column, weights, mode="valid") for column in padded.T], axis=-1)


def _unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-12)
