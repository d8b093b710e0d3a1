"""Characters on which the VRM add-on has noted which bone is what."""

from __future__ import annotations

import bpy

from handfit_core.common.skeleton import FINGER_JOINTS, NUM_JOINTS, Side
from handfit_core.retarget.bones import Bones
from handfit_core.retarget.hand_map import USUAL_THUMB_ROLL, HandMap
from handfit_core.retarget.recognition import Found

from .character import Character

_PARTS = ("proximal", "intermediate", "distal")


class VrmCharacter(Character):
    """VRM 0.x and 1.0, whatever the bones are called."""

    label = "VRM"

    @classmethod
    def find(cls, armature: bpy.types.Object, bones: Bones, side: Side) -> Found | None:
        """Return the hand by the VRM add-on's humanoid, if the add-on is there; else None."""
        noted = getattr(armature.data, "vrm_addon_extension", None)
        if noted is None:
            return None
        newer = str(noted.spec_version).startswith("1")
        if newer:
            humanoid = noted.vrm1.humanoid.human_bones
            nodes = {name: getattr(humanoid, name).node.bone_name for name in _humanoid(side, newer)}
        else:
            nodes = {human.bone: human.node.bone_name for human in noted.vrm0.humanoid.human_bones}
        there = [nodes.get(name, "") for name in _humanoid(side, newer)]
        there = [name if name in bones.index else "" for name in there]
        hand_map = HandMap(side, tuple(there), rig=cls.label, thumb_roll=USUAL_THUMB_ROLL)
        return Found(hand_map, 1.0) if there[0] and len(hand_map.fingers) > 1 else None


def _humanoid(side: Side, newer: bool) -> list[str]:
    """Return VRM's names for a hand's bones, by MANO's joints: as the add-on has them as properties from 1.0
    on, or as they stand in older files."""
    names = [f"{side}_hand"] * NUM_JOINTS
    for finger, joints in FINGER_JOINTS.items():
        parts = ("metacarpal", "proximal", "distal") if newer and finger == "thumb" else _PARTS
        for joint, part in zip(joints, parts, strict=True):
            names[joint] = f"{side}_{finger}_{part}"
    return names if newer else [f"{side}{name.title().replace('_', '')[len(side) :]}" for name in names]
