"""Control rigs that Rigify has generated. Metarigs and game rigs are called alike and are plain bones."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import bpy
import numpy as np

from handfit_core.common.skeleton import FINGER_JOINTS, Side
from handfit_core.retarget.bones import Bones
from handfit_core.retarget.hand_map import HandMap
from handfit_core.retarget.recognition import Found

from ..common.blender_versions import channels, used_actions
from .by_bones import AnyCharacter
from .character import ArmControls, Character
from .rig import bone_path

_AT_REST = {
    "location": (0.0, 0.0, 0.0),
    "rotation_euler": (0.0, 0.0, 0.0),
    "rotation_quaternion": (1.0, 0.0, 0.0, 0.0),
    "rotation_axis_angle": (0.0,),  # no angle about any axis
    "scale": (1.0, 1.0, 1.0),
}
"""The values of a bone's channels at rest, by the channel"""


class RigifyCharacter(Character):
    """Fingers are driven by their controls, the hand by that of IK or FK, whichever acts."""

    label = "Rigify"

    @classmethod
    def find(cls, armature: bpy.types.Object, bones: Bones, side: Side) -> Found | None:
        """Return the hand that is recognised by what Rigify leaves in armatures that it generates; None where
        it has left nothing."""
        if "rig_id" not in armature.data or not any(name.startswith("ORG-") for name in bones.names):
            return None
        found = AnyCharacter.find(armature, bones, side)
        if found is None:
            return None
        core = _core(found.hand_map)
        switch = _switch(armature, core)
        by_fk = switch is not None and switch["IK_FK"] >= 0.5
        controls = (_derived(core, "_fk" if by_fk else "_ik"), core)
        acting = next((name for name in controls if name in bones.index), "")
        return Found(replace(found.hand_map, rig=cls.label, control=acting), 1.0)

    @classmethod
    def arm_controls(
        cls, armature: bpy.types.Object, hand_map: HandMap, bones: tuple[str, str]
    ) -> ArmControls:
        """Return the controls of FK or IK, whichever acts; of a limb with neither, the bones themselves."""
        core = _core(hand_map)
        switch = _switch(armature, core)
        chain = armature.data.bones.get(f"ORG-{core}")
        if switch is None or chain is None:
            return super().arm_controls(armature, hand_map, bones)
        above = [bone.name.removeprefix("ORG-") for bone in chain.parent_recursive[:2]]
        if switch["IK_FK"] >= 0.5:
            return ArmControls(_derived(core, "_fk"), *(_derived(name, "_fk") for name in reversed(above)))
        swivel = _derived(above[1], "_ik")
        pole = _derived(above[1], "_ik_target") if switch.get("pole_vector") else ""
        return ArmControls(_derived(core, "_ik"), swivel=swivel, pole=pole)

    @classmethod
    def troubles(cls, armature: bpy.types.Object, hand_map: HandMap) -> list[str]:
        """Return a sentence for each master and finger IK that turns the fingers on top of their controls,
        and for a hand whose control does not act."""
        pose, core, curves = armature.pose.bones, _core(hand_map), _curves(armature)
        fingers = [[hand_map.bones[joint] for joint in FINGER_JOINTS[finger]] for finger in hand_map.fingers]
        firsts = [next(filter(None, names)) for names in fingers]

        def turned(master: bpy.types.PoseBone) -> bool:
            paths = {f"{bone_path(master.name)}.{channel}": still for channel, still in _AT_REST.items()}
            at_rest = np.allclose(master.matrix_basis, np.eye(4), rtol=0.0, atol=1e-4)
            return not at_rest or any(_moving(curves, path, still) for path, still in paths.items())

        def by_ik(chain: bpy.types.PoseBone) -> bool:
            return bool(chain.get("FK_IK")) or _moving(curves, f'{bone_path(chain.name)}["FK_IK"]', [0.0])

        def spoiling(suffix: str, spoils: Callable[[bpy.types.PoseBone], bool]) -> str:
            names = (_derived(first, suffix) for first in firsts)
            return ", ".join(name for name in names if name in pose and spoils(pose[name]))

        said = []
        if masters := spoiling("_master", turned):
            said.append(
                f"{masters} would bend the fingers on top of their motion: clear the pose of these masters "
                "(Alt+G, Alt+R, Alt+S), and delete their keys and drivers"
            )
        if chains := spoiling("_ik", by_ik):
            said.append(
                f"fingers follow IK by {chains}: set Finger IK (FK_IK) to 0 there, and delete its keys"
            )
        switch = _switch(armature, core) if hand_map.control else None
        if switch is not None:
            value = float(switch["IK_FK"])
            acting, idle = (_derived(core, end) for end in (("_fk", "_ik") if value else ("_ik", "_fk")))
            if 0.0 < value < 1.0 or _moving(curves, f'{bone_path(switch.name)}["IK_FK"]', [value]):
                said.append(
                    f"the arm changes between IK and FK: set IK-FK of {switch.name} to 0 (IK) or 1 (FK), and "
                    "delete its keys"
                )
            elif hand_map.control == idle:
                said.append(
                    f"{idle} does not move the hand while IK-FK of {switch.name} is {value:.0f}: choose "
                    f"{acting} in the table, or set it to {1.0 - value:.0f}"
                )
        return said


def _derived(name: str, suffix: str) -> str:
    """Return Rigify's name for a control that it makes of a bone: the suffix stands before the side."""
    return re.sub(r"((?:[._](?:[lLrR]|left|right))?(?:\.\d+)?)$", rf"{suffix}\1", name, count=1)


def _core(hand_map: HandMap) -> str:
    """Return the metarig's name for the hand."""
    return hand_map.bones[0].removeprefix("DEF-").removeprefix("ORG-")


def _switch(armature: bpy.types.Object, core: str) -> bpy.types.PoseBone | None:
    """Return the control of the hand's own arm that has the property IK_FK (0 IK, 1 FK); None where there is
    none."""
    bone = armature.data.bones.get(f"ORG-{core}")
    for above in bone.parent_recursive if bone is not None else ():
        control = armature.pose.bones.get(_derived(above.name.removeprefix("ORG-"), "_parent"))
        if control is not None and "IK_FK" in control:
            return control
    return None


def _curves(armature: bpy.types.Object) -> list[Any]:
    """Return what holds the curves that move an armature: its drivers, and its actions that are not muted."""
    data = armature.animation_data
    holders = [channels(action, slot) for action, slot in used_actions(armature, acting=True)]
    return [*([data.drivers] if data else []), *(holder.fcurves for holder in holders if holder is not None)]


def _moving(curves: list[Any], path: str, still: Sequence[float]) -> bool:
    """True if a driver, or keys with other values than `still`, move a channel of that many parts.

    Panels ask at every redraw: Blender looks curves up faster than we read the paths of a body's thousand.
    """
    found = ((held.find(path, index=i), value) for held in curves for i, value in enumerate(still))
    return any(
        curve is not None
        and (curve.driver is not None or any(abs(key.co[1] - value) > 1e-4 for key in curve.keyframe_points))
        for curve, value in found
    )
