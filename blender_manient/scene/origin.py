"""A captured hand's object with its origin at the wrist, while everything stays where it is in every frame.

The object moves to where the wrist is, and the wrist's keys lose as much. Rest bones, mesh, take and camera
stay what they are: `Object.manient.origin` tells where the armature's space now lies in that of the capture,
and `Rig.rest` takes it into account for all that compares bones with the picture.
"""

from __future__ import annotations

from dataclasses import replace

import bpy
import numpy as np
from mathutils import Matrix

from ..common.blender_versions import channels, used_actions
from ..rigs.arm import ArmBones, has_arm
from ..rigs.rig import bone_path
from .actions import curves_in, is_layered, is_tweaked, own_action, strips_of
from .corrections import change_corrections, corrections_of
from .editable import check, check_editable
from .keys import change_places
from .own_scene import object_mode
from .sampling import shown_now
from .simplify import all_actions, keeping_simplified
from .store import CapturedHand, is_deformed_by

_MOVING = ("location", "rotation", "scale", "delta_")
"""The beginnings of the data paths that move an object"""


def origin_to_wrist(hand: CapturedHand) -> None:
    """Put the origin of the hand's object where its wrist is now. Raises OptionError and TakeError, and then
    changes nothing."""
    armature, wrist = hand.armature, hand.rig.bones[0]
    check_editable(armature)
    check(armature, why_not_at_wrist(armature))
    corrections_of(armature)  # before anything is changed: they may not be readable
    with object_mode():
        bpy.context.view_layer.update()
        shown = shown_now(armature)
        place = shown.pose[0, shown.names.index(wrist), :3, 3]
        own_action(armature, nla=True)
        along = hand.rig.rest.frames[0].T @ place
        with keeping_simplified(armature):
            _shift_keys(armature, wrist, along)
            if has_arm(armature):
                shoulder = ArmBones(armature).bones[0]
                turn = np.array(armature.data.bones[shoulder].matrix_local.to_3x3())
                _shift_keys(armature, shoulder, turn.T @ place)
        armature.manient.origin = np.array(armature.manient.origin) + place
        _move_origin(armature, Matrix.Translation(place))
    change_corrections(
        all_actions(armature), lambda c: replace(c, place=c.place - along) if np.any(c.place) else c
    )
    armature.update_tag()


def why_not_at_wrist(armature: bpy.types.Object) -> str | None:
    """Return why the origin of a hand's object cannot go to the wrist, in a sentence for a tooltip; None
    where it can."""
    data = armature.animation_data
    if is_tweaked(armature):  # Blender hides the action on top, whose keys would have to follow
        return "A strip of the NLA is being edited: leave tweak mode first"
    curves = [] if data is None else list(data.drivers)
    for used in used_actions(armature):
        curves += curves_in(channels(*used))
    if any(c.data_path.startswith(_MOVING) for c in curves) or any(c.enabled for c in armature.constraints):
        return "The object itself is animated, driven or constrained: give that to a parent first"
    return None


def _shift_keys(armature: bpy.types.Object, name: str, along: np.ndarray) -> None:
    """Take `along` (3,), in metres along a bone's own axes, from its location and all keys of that."""
    bone = armature.pose.bones[name]
    bone.location = np.array(bone.location) - along
    added = {strip.action for strip in strips_of(armature) if strip.blend_type != "REPLACE"}
    if is_layered(armature):
        added.add(armature.animation_data.action)
    for action, slot in all_actions(armature):
        for curve in curves_in(channels(action, slot)) if action not in added else ():
            if curve.data_path == f"{bone_path(name)}.location":
                change_places(curve, [1.0, 1.0], [0.0, -float(along[curve.array_index])])
        action.update_tag()


def _move_origin(armature: bpy.types.Object, moved: Matrix) -> None:
    """Move the object, in its own space, and keep what hangs on it where it is."""
    before = armature.matrix_world.copy()
    kept = {path: tuple(getattr(armature, path)) for path in _TURNS}
    armature.matrix_world = before @ moved
    for path, values in kept.items():  # which only rounding would change
        setattr(armature, path, values)
    for other in bpy.data.objects:
        deformed = is_deformed_by(other, armature)
        if other.parent == armature and other.parent_type == "OBJECT" and not deformed:
            other.matrix_parent_inverse = moved.inverted() @ other.matrix_parent_inverse
        elif deformed and other.parent != armature:  # it has to lie about the bones as before
            other.matrix_world = before @ moved @ before.inverted() @ other.matrix_world


_TURNS = ("rotation_euler", "rotation_quaternion", "rotation_axis_angle", "scale")
