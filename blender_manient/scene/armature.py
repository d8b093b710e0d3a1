"""The hand's armature: 16 bones, named so that Blender's mirror tools understand them."""

from __future__ import annotations

from collections.abc import Callable

import bpy
import numpy as np
from mathutils import Vector

from handfit_core.hand_model import ShapedHand
from handfit_core.skeleton import JOINT_NAMES, PARENTS, Side

from .. import axes


def bone_names(side: Side) -> list[str]:
    """The 16 bones of one side in MANO's order: `wrist.R`, `index_proximal.R`, ..."""
    return [name + axes.BONE_SUFFIX[side] for name in JOINT_NAMES]


def build_armature(
    name: str, shaped: ShapedHand, side: Side, link: Callable[[bpy.types.Object], object]
) -> bpy.types.Object:
    """An armature object at the world's origin whose rest pose is the shaped, flat hand.

    `link` puts the object into a collection of the current view layer: bones can only be edited
    there. Pose bones are set to quaternions. The active object and the selection are put back.
    """
    armature = bpy.data.armatures.new(name)
    obj = bpy.data.objects.new(name, armature)
    link(obj)
    heads = axes.points_to_rest(shaped.joints)
    tails = axes.points_to_rest(axes.bone_tails(shaped))
    frames = axes.bone_frames(shaped, side)
    _edit(obj, lambda: _add_bones(armature, bone_names(side), heads, tails, frames))

    armature.display_type = "OCTAHEDRAL"
    obj.show_in_front = True
    for bone in obj.pose.bones:
        bone.rotation_mode = "QUATERNION"
    return obj


def rest_frames(armature: bpy.types.Object, side: Side) -> np.ndarray:
    """Each bone's axes in rest space as Blender stored them: (16, 3, 3), columns X, Y, Z."""
    bones = armature.data.bones
    return np.array([bones[name].matrix_local.to_3x3() for name in bone_names(side)], dtype=np.float64)


def _add_bones(
    armature: bpy.types.Armature,
    names: list[str],
    heads: np.ndarray,
    tails: np.ndarray,
    frames: np.ndarray,
) -> None:
    for i, name in enumerate(names):
        bone = armature.edit_bones.new(name)
        bone.head, bone.tail = Vector(heads[i]), Vector(tails[i])
        bone.align_roll(Vector(frames[i][:, 2]))
        if PARENTS[i] >= 0:
            bone.parent = armature.edit_bones[names[PARENTS[i]]]
            # Only a bone that starts where its parent ends may be drawn, and moved, as connected.
            bone.use_connect = bool(np.allclose(heads[i], tails[PARENTS[i]], atol=1e-7))


def _edit(obj: bpy.types.Object, work: Callable[[], None]) -> None:
    """Run `work` while `obj` is in edit mode, then put selection and active object back."""
    layer = bpy.context.view_layer
    active = layer.objects.active
    selected = [o for o in layer.objects if o.select_get()]
    for other in selected:
        other.select_set(False)
    layer.objects.active = obj
    bpy.ops.object.mode_set(mode="EDIT")
    try:
        work()
    finally:
        bpy.ops.object.mode_set(mode="OBJECT")
        obj.select_set(False)
        layer.objects.active = active
        for other in selected:
            other.select_set(True)
