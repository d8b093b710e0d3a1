"""The rig that captures get: 16 bones, named so that Blender's mirror tools understand them."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from typing import Any

import bpy
import numpy as np
from mathutils import Vector

from handfit_core.common.skeleton import JOINT_NAMES, PARENTS, Side
from handfit_core.hand_model import ShapedHand, axes
from handfit_core.hand_model.anatomy import joint_limits

from . import arm, controls
from .rig import Rig

_SUFFIX: dict[Side, str] = {"right": ".R", "left": ".L"}
"""The ends of bones' names by which Blender's mirror tools know their side"""


def bone_names(side: Side) -> list[str]:
    """Return the names of the 16 bones of one side in MANO's order: `wrist.R`, `index_proximal.R`, ..."""
    return [name + _SUFFIX[side] for name in JOINT_NAMES]


class CapturedHandRig(Rig):
    """A hand that a capture, an import or Mirror Hand made."""

    @classmethod
    def recognises(cls, armature: bpy.types.Object, side: Side) -> float:
        """Return the share of the bones that are there, 0..1; at least 0.5 for a hand of that side that the
        add-on made, also without them, if its bones are not those of another kind of rig."""
        there = sum(name in armature.data.bones for name in bone_names(side)) / len(JOINT_NAMES)
        noted = getattr(armature, "manient", None)  # not there where the add-on is not registered
        if noted is not None and noted.is_hand:
            return 0.5 * (1.0 + there) if noted.side == side else 0.0
        return there

    @property
    def bones(self) -> list[str]:
        """Return the names of the 16 bones of the hand's side, as `bone_names` gives them."""
        return bone_names(self.side)

    def follow(self, shaped: ShapedHand) -> None:
        """Move the 16 rest bones, and the controls. Other bones that the artist added stay where they are."""
        names = self.controls
        with edited_bones(self.armature.data) as edit_bones:
            own = [edit_bones[name] for name in self.bones]
            connected = [bone.use_connect for bone in own]
            for bone in own:
                bone.use_connect = False  # else moving one end would move its neighbour's
            _place(own, shaped, self.side)
            for bone, was in zip(own, connected, strict=True):
                bone.use_connect = was
            controls.place_controls(edit_bones, self.bones, names)

    @property
    def controls(self) -> dict[str, str]:
        """Return the bones to animate the hand with, by what they control; none until they are added."""
        return controls.control_bones(self.armature)

    def add_controls(self, model: str) -> None:
        """Give a hand that has none its controls; `model` is its hand model's name."""
        with edited_bones(self.armature.data) as edit_bones:
            names = controls.make_bones(edit_bones, self.bones)
        controls.set_up(self.armature, self.bones, names, joint_limits(self.side, model))

    def remove_controls(self) -> None:
        """Take the hand's controls away, with all that they do."""
        names = self.controls
        controls.take_down(self.armature)
        with edited_bones(self.armature.data) as edit_bones:
            for name in names.values():
                edit_bones.remove(edit_bones[name])

    def add_arm(self, lengths: np.ndarray) -> None:
        """Give a hand that has none the bones of an arm; lengths (2,) in metres, of upper arm and forearm."""
        wrist = self.bones[0]
        with edited_bones(self.armature.data) as edit_bones:
            names = arm.make_bones(edit_bones, wrist, lengths)
        arm.set_up(self.armature, wrist, names)

    def allow(self, quats: np.ndarray) -> None:
        """Widen the joints' limits where poses go beyond them."""
        controls.widen(self.armature, self.bones, quats)


def build_rig(name: str, shaped: ShapedHand, side: Side) -> CapturedHandRig:
    """Build a rig at the world's origin whose rest pose is the shaped, flat hand.

    It is not linked to any collection. Pose bones are set to quaternions. The open scene, with the artist's
    mode, active object and selection, is not touched."""
    armature = bpy.data.armatures.new(name)
    obj = bpy.data.objects.new(name, armature)
    with edited_bones(armature) as edit_bones:
        bones = [edit_bones.new(bone) for bone in bone_names(side)]
        heads, tails = _place(bones, shaped, side)
        for i, bone in enumerate(bones[1:], start=1):
            bone.parent = bones[PARENTS[i]]
            # Only a bone that starts where its parent ends may be drawn, and moved, as connected.
            bone.use_connect = bool(np.allclose(heads[i], tails[PARENTS[i]], atol=1e-7))

    armature.display_type = "OCTAHEDRAL"
    obj.show_in_front = True
    for bone in obj.pose.bones:
        bone.rotation_mode = "QUATERNION"
    return CapturedHandRig(obj, side)


def _place(bones: list[bpy.types.EditBone], shaped: ShapedHand, side: Side) -> tuple[np.ndarray, np.ndarray]:
    """Put 16 bones in edit mode where the shaped, flat hand has them. Return heads and tails, (16, 3) metres
    each."""
    heads = axes.points_to_rest(shaped.joints)
    tails = axes.points_to_rest(axes.bone_tails(shaped))
    for bone, head, tail, frame in zip(bones, heads, tails, axes.bone_frames(shaped, side), strict=True):
        bone.head, bone.tail = Vector(head), Vector(tail)
        bone.align_roll(Vector(frame[:, 2]))
    return heads, tails


@contextlib.contextmanager
def edited_bones(armature: bpy.types.Armature) -> Iterator[Any]:
    """Yield the bones of an armature in edit mode, where they can be made.

    That is the mode of an object and a scene that nobody sees: the artist's own object may be in Pose mode,
    hidden or in a collection that is switched off, and the artist's scene is neither seen nor evaluated."""
    scene, editor = bpy.data.scenes.new("armature"), bpy.data.objects.new("edit", armature)
    try:
        scene.collection.objects.link(editor)
        layer = scene.view_layers[0]
        layer.objects.active = editor
        own = {"active_object": editor, "object": editor, "edit_object": None, "selected_objects": [editor]}
        with bpy.context.temp_override(scene=scene, view_layer=layer, **own):
            bpy.ops.object.mode_set(mode="EDIT")
            try:
                yield armature.edit_bones
            finally:
                bpy.ops.object.mode_set(mode="OBJECT")
    finally:
        bpy.data.scenes.remove(scene)
        bpy.data.objects.remove(editor)
