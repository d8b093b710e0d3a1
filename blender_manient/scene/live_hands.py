"""Hands that follow a live source: an open hand that is made for it, or a character's.

They are posed without keys, and gone, or as they were, afterwards. Objects are named, never held.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping

import bpy
import numpy as np

from handfit_core.errors import OptionError
from handfit_core.geometry.rotations import quat_to_rotmat, rotmat_to_quat
from handfit_core.hand_model.axes import RestPose, points_to_rest
from handfit_core.hand_model.files import kept_model
from handfit_core.hand_model.forearm import with_wrist
from handfit_core.hand_model.motion import HandMotion
from handfit_core.retarget.transfer import SourceHand
from handfit_core.skeleton import NUM_JOINTS, Side
from handfit_core.slices import run_to_completion

from ..common.blender_versions import action_slot
from ..common.block_reference import BlockReference
from ..common.wording import named_after
from ..rigs.captured_hand import CapturedHandRig, build_rig
from ..rigs.character import CharacterBones
from .actions import use_action
from .characters import hand_map_of
from .editable import check_unlayered
from .keys import animating, computing_keys, set_pose
from .mesh import build_mesh
from .onto_character import Motion, prepared, within_locks

_ROTATIONS = ("rotation_quaternion", "rotation_euler", "rotation_axis_angle")


class LiveHand(ABC):
    """What follows one hand of the person."""

    @abstractmethod
    def show(self, motion: HandMotion) -> None:
        """Take the pose of a motion of one frame. Raises OptionError where what follows is gone."""

    @abstractmethod
    def take_away(self) -> None:
        """Leave the scene as it was before. May be called twice."""


class OpenHand(LiveHand):
    """An open hand in a collection of its own, where the camera stands at the world's origin."""

    def __init__(self, scene: bpy.types.Scene, model: str, side: Side, betas: np.ndarray) -> None:
        """Raises HandModelError."""
        collection, rig = build_open_hand(scene, "Live", model, side, betas)
        collection.manient.is_live = True
        self._collection = BlockReference.of("collections", collection)
        self._armature = BlockReference.of("objects", rig.armature)
        self._rest = rig.rest
        self._place = _Place(model, side, betas)

    def show(self, motion):
        """Take the pose, the wrist where it was seen."""
        armature = self._armature.find()
        if armature is None:
            raise OptionError("the hand that followed the live source was deleted: press Start again")
        quats, locations = self._place.bones(self._rest, motion)
        set_pose(CapturedHandRig(armature, motion.side), quats[0], locations[0])

    def take_away(self):
        """Remove the hand."""
        remove_collection(self._collection.find())


class CharacterHand(LiveHand):
    """The fingers of a character's hand."""

    def __init__(self, armature: bpy.types.Object, side: Side, model: str, of: HandMotion) -> None:
        """Prepare `armature`'s hand of that side for motions of the person's hand `of`. Raises HandModelError
        and OptionError."""
        check_unlayered(armature)
        self._armature = BlockReference.of("objects", armature)
        self._side: Side = side
        self._as_source = AsSource(model, of)
        source = self._as_source.motion(of, np.zeros(1)).on(side).source
        self._target, keyed, self.left_alone = prepared(
            armature, hand_map_of(armature, side), source, fingers_only=True
        )
        self._not_keyed = ~keyed
        bones = armature.pose.bones
        self._before = {
            name: {kind: tuple(getattr(bones[name], kind)) for kind in _ROTATIONS}
            for name in self._target.bones
        }

    def show(self, motion):
        """Take the fingers' pose."""
        armature = self._armature.find()
        if armature is None:
            raise OptionError(f"{self._armature.name!r}, which followed the live source, was deleted")
        turns = self._as_source.motion(motion, np.zeros(1)).on(self._side).turns
        quats = within_locks(armature, self._target.bones, rotmat_to_quat(self._target.local(turns)))[0]
        quats[self._not_keyed] = np.nan
        set_pose(CharacterBones(armature, self._target.bones), quats)

    def take_away(self):
        """Give the bones back what their channels had."""
        armature = self._armature.find()
        if armature is None:
            return
        for name, before in self._before.items():
            bone = armature.pose.bones.get(name)
            for kind, values in before.items() if bone is not None else ():
                setattr(bone, kind, values)


class AsSource:
    """What motions of one shape are to a character."""

    def __init__(self, model: str, of: HandMotion) -> None:
        """`of` has the shape. Raises HandModelError."""
        loaded = kept_model(model, of.side)
        self._shaped = loaded.shaped(of.betas)
        self._source = SourceHand.of(self._shaped, of.side, loaded.name)
        eyes, wrist = np.broadcast_to(np.eye(3), (NUM_JOINTS, 3, 3)), points_to_rest(self._shaped.joints[0])
        self._rest = RestPose(of.side, eyes, wrist)

    def motion(self, motion: HandMotion, frames: np.ndarray) -> Motion:
        """The motion (T) on scene frames (T,)."""
        quats, locations = self._rest.to_bones(self._shaped, *motion.pose)
        return Motion(self._source, frames, quat_to_rotmat(quats), self._rest.wrist + locations)


class _Place:
    """Puts motions about the bones of a hand whose shape may be another one, the wrist where it was seen."""

    def __init__(self, model: str, side: Side, betas: np.ndarray) -> None:
        self._model = kept_model(model, side)
        self._shaped = self._model.shaped(betas)
        self._betas, self._shift = betas, np.zeros(3)

    def bones(self, rest: RestPose, motion: HandMotion) -> tuple[np.ndarray, np.ndarray]:
        """Quaternions (T, 16, 4) and the wrist's locations (T, 3), metres."""
        if not np.array_equal(motion.betas, self._betas):
            self._betas = motion.betas
            self._shift = self._model.shaped(motion.betas).joints[0] - self._shaped.joints[0]
        orient, pose, transl = motion.pose
        return rest.to_bones(self._shaped, orient, pose, transl + self._shift)


def build_open_hand(
    scene: bpy.types.Scene, name: str, model: str, side: Side, betas: np.ndarray
) -> tuple[bpy.types.Collection, CapturedHandRig]:
    """An open hand in a new collection of that name. Raises HandModelError."""
    loaded = with_wrist(kept_model(model, side), "forearm")
    shaped = loaded.shaped(betas)
    collection = bpy.data.collections.new(name)
    rig = build_rig(named_after(name, f"{side} hand"), shaped, side)
    rig.armature.scale = (1.0 / scene.unit_settings.scale_length,) * 3
    rig.armature.manient.side, rig.armature.manient.is_hand = side, True
    mesh = build_mesh(f"mesh of {rig.armature.name}", loaded, shaped, rig)
    for thing in (rig.armature, mesh):
        collection.objects.link(thing)
    scene.collection.children.link(collection)
    return collection, rig


def build_preview(
    scene: bpy.types.Scene, name: str, model: str, motion: HandMotion, frames: np.ndarray
) -> BlockReference:
    """An open hand that does a motion (T) on scene frames (T,); returns its collection. Raises
    HandModelError."""
    collection, rig = build_open_hand(scene, name, model, motion.side, motion.betas)
    shaped = kept_model(model, motion.side).shaped(motion.betas)
    keys = run_to_completion(computing_keys(motion, shaped, rig.rest, frames))
    for _ in animating(rig, keys):
        pass
    return BlockReference.of("collections", collection)


def remove_collection(collection: bpy.types.Collection | None) -> None:
    """Remove a collection of `build_open_hand` with all that is in it."""
    if collection is None:
        return
    objects = list(collection.objects)
    data = {o.data for o in objects}
    hung = {m for block in data for m in getattr(block, "materials", ())}
    hung |= {o.animation_data.action for o in objects if o.animation_data is not None}
    bpy.data.batch_remove([collection, *objects])
    for blocks in (data, hung):  # what hung on the first has no user only now
        bpy.data.batch_remove([block for block in blocks if block is not None and not block.users])


def remove_action(armature: bpy.types.Object, action: bpy.types.Action) -> None:
    """Remove an action of a character that `onto_character.applying` has made; what it put on top of the NLA
    to do so is the present action again."""
    data = armature.animation_data
    if data is None:
        return bpy.data.actions.remove(action)
    is_present = data.action == action
    for track in [t for t in data.nla_tracks if [strip.action for strip in t.strips] == [action]]:
        data.nla_tracks.remove(track)
    bpy.data.actions.remove(action)
    top = data.nla_tracks[-1] if is_present and len(data.nla_tracks) else None
    if top is not None and len(top.strips) == 1 and top.name == top.strips[0].action.name:
        strip = top.strips[0]
        use_action(data, strip.action, action_slot(strip))
        data.nla_tracks.remove(top)
    return None


def remove_leftovers() -> None:
    """Remove what followed a live source in a file that was saved, or a step that was made, meanwhile."""
    for collection in [c for c in bpy.data.collections if c.manient.is_live]:
        remove_collection(collection)


Followed = Mapping[Side, tuple[BlockReference, Side] | None]
"""By the person's side: the character and which of its hands follows; None: an open hand"""
