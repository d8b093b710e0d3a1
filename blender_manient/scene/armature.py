"""The hand's armature: 16 bones, named so that Blender's mirror tools understand them."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator

import bpy
import numpy as np
from mathutils import Vector

from handfit_core.hand_model import ShapedHand
from handfit_core.skeleton import JOINT_NAMES, PARENTS, Side

from .. import axes


def bone_names(side: Side) -> list[str]:
    """The 16 bones of one side in MANO's order: `wrist.R`, `index_proximal.R`, ..."""
    return [name + axes.BONE_SUFFIX[side] for name in JOINT_NAMES]


def build_armature(name: str, shaped: ShapedHand, side: Side) -> bpy.types.Object:
    """An armature object at the world's origin whose rest pose is the shaped, flat hand.

    It is not linked to any collection. Pose bones are set to quaternions. The open scene, with the artist's
    mode, active object and selection, is not touched.
    """
    armature = bpy.data.armatures.new(name)
    obj = bpy.data.objects.new(name, armature)
    heads = axes.points_to_rest(shaped.joints)
    tails = axes.points_to_rest(axes.bone_tails(shaped))
    frames = axes.bone_frames(shaped, side)
    with edit_mode(obj):
        _add_bones(armature, bone_names(side), heads, tails, frames)

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


@contextlib.contextmanager
def edit_mode(obj: bpy.types.Object) -> Iterator[None]:
    """Have an unlinked armature in edit mode, in a scene that nobody sees and that is removed again.

    Bones can be made in edit mode only. There, the artist's own scene is neither seen nor evaluated.
    """
    scene = bpy.data.scenes.new("armature")
    try:
        scene.collection.objects.link(obj)
        layer = scene.view_layers[0]
        layer.objects.active = obj
        with bpy.context.temp_override(
            scene=scene,
            view_layer=layer,
            active_object=obj,
            object=obj,
            edit_object=None,
            selected_objects=[obj],
        ):
            bpy.ops.object.mode_set(mode="EDIT")
            try:
                yield
            finally:
                bpy.ops.object.mode_set(mode="OBJECT")
    finally:
        bpy.data.scenes.remove(scene)
