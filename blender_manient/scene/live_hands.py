"""Hands that follow a live source: an open hand that is made for it, or a character's.

They are posed without keys, and gone, or as they were, afterwards. Objects are named, never held.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Generator, Mapping

import bpy
import numpy as np

from handfit_core.common.errors import OptionError
from handfit_core.common.skeleton import NUM_JOINTS, Side
from handfit_core.common.slices import map_yields
from handfit_core.geometry.rotations import quat_to_rotmat, rotmat_to_quat
from handfit_core.hand_model.axes import RestPose, points_to_rest
from handfit_core.hand_model.files import kept_model
from handfit_core.hand_model.forearm import with_wrist
from handfit_core.hand_model.motion import HandMotion
from handfit_core.retarget.transfer import SourceHand

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
from .onto_character import (
    Anchor,
    Motion,
    TransferOptions,
    channels_of,
    check_movable,
    is_located,
    moved,
    prepared,
    within_locks,
)
from .own_scene import remove_blocks

Target = tuple[BlockReference, Side]
"""A character, and the side of its hand"""
Followed = Mapping[Side, Target | None]
"""What follows each hand of the person, by its side; None: an open hand"""
_CHANNELS = ("rotation_quaternion", "rotation_euler", "rotation_axis_angle", "location")


class LiveHand(ABC):
    """A hand of the scene that follows one hand of the person."""

    @abstractmethod
    def show(self, motion: HandMotion) -> None:
        """Show the pose of a motion of one frame. Raises OptionError where what follows is gone."""

    @abstractmethod
    def take_away(self) -> None:
        """Leave the scene as it was before. May be called twice."""


class OpenHand(LiveHand):
    """An open hand in a collection of its own, where the camera stands at the world's origin."""

    def __init__(self, scene: bpy.types.Scene, model: str, side: Side, betas: np.ndarray) -> None:
        """Build the open hand of a side in its collection. Raises HandModelError."""
        collection, rig = build_open_hand(scene, "Live", model, side, betas)
        collection.manient.is_live = True
        scene.collection.children.link(collection)
        self._collection = BlockReference.of("collections", collection)
        self._armature = BlockReference.of("objects", rig.armature)
        self._rest = rig.rest
        self._place = _Place(model, side, betas)

    def show(self, motion):
        """Show the pose of a motion of one frame, with the wrist where it was seen."""
        armature = self._armature.find()
        if armature is None:
            raise OptionError("the hand that followed the live source was deleted: press Start again")
        quats, locations = self._place.bones(self._rest, motion)
        set_pose(CapturedHandRig(armature, motion.side), quats[0], locations[0])

    def take_away(self):
        """Remove the hand."""
        remove_collection(self._collection.find())


class CharacterHand(LiveHand):
    """The fingers of a character's hand, and the hand itself where the character's panel asks for it."""

    def __init__(self, target: Target, model: str, of: HandMotion, anchors: dict[Target, Anchor]) -> None:
        """Prepare a character's hand for motions of the person's hand `of`, which anchors it where it has no
        anchor yet. Raises HandModelError and OptionError."""
        self._armature = target[0]
        self._side: Side = target[1]
        armature = self._found()
        check_unlayered(armature)
        self._as_source = AsSource(model, of)
        motion = self._as_source.motion(of, np.zeros(1)).on(self._side)
        self._onto = TransferOptions.of(armature)
        self._target, keyed, self.left_alone = prepared(
            armature, hand_map_of(armature, self._side), motion.source, fingers_only=not self._turns
        )
        self._not_keyed = ~keyed
        names, hand_map = [*self._target.bones], self._target.hand_map
        if self._turns:
            check_movable(armature, hand_map.moved_by)
            if target not in anchors:
                bpy.context.view_layer.update()  # the pose before may just have been given back
                hand = np.array(armature.pose.bones[hand_map.bones[0]].matrix, dtype=np.float64)
                anchors[target] = Anchor(motion.turns[0, 0], motion.places[0], hand)
            self._anchor = anchors[target]
            names.append(hand_map.moved_by)
        bones = armature.pose.bones
        self._before = {name: {k: tuple(getattr(bones[name], k)) for k in _CHANNELS} for name in names}

    @property
    def _turns(self) -> bool:
        return self._onto.wrist != "FINGERS"

    def _found(self) -> bpy.types.Object:
        armature = self._armature.find()
        if armature is None:
            raise OptionError(f"{self._armature.name!r}, which follows the live source, was deleted")
        return armature

    def show(self, motion):
        """Show the pose of a motion of one frame."""
        armature = self._found()
        shown = self._as_source.motion(motion, np.zeros(1)).on(self._side)
        quats = within_locks(armature, self._target.bones, rotmat_to_quat(self._target.local(shown.turns)))[0]
        quats[self._not_keyed] = np.nan
        set_pose(CharacterBones(armature, self._target.bones), quats)
        if self._turns:
            control = self._target.hand_map.moved_by
            bone = armature.data.bones[control]
            parent = np.array(armature.pose.bones[bone.parent.name].matrix) if bone.parent else np.eye(4)
            travel = self._onto.travel
            standing = moved(armature, self._target, self._anchor, shown.turns[:, 0], shown.places, travel)
            basis = channels_of(bone, standing[0], parent)
            located = is_located(bone, self._onto.wrist)
            place = np.array(basis.to_translation()) if located else None
            set_pose(CharacterBones(armature, [control]), np.array([basis.to_quaternion()]), place)

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
    """Feeds motions of one hand shape to the character transfer."""

    def __init__(self, model: str, of: HandMotion) -> None:
        """Prepare to transfer motions of a hand with the side and shape of the motion `of`. Raises
        HandModelError."""
        loaded = kept_model(model, of.side)
        self._shaped = loaded.shaped(of.betas)
        self._source = SourceHand.of(self._shaped, of.side, loaded.name)
        eyes, wrist = np.broadcast_to(np.eye(3), (NUM_JOINTS, 3, 3)), points_to_rest(self._shaped.joints[0])
        self._rest = RestPose(of.side, eyes, wrist)

    def motion(self, motion: HandMotion, frames: np.ndarray) -> Motion:
        """Return the motion (T frames) for the transfer, on scene frames (T,)."""
        quats, locations = self._rest.to_bones(self._shaped, *motion.pose)
        return Motion(self._source, frames, quat_to_rotmat(quats), self._rest.wrist + locations)


class _Place:
    """Puts motions about the bones of a hand whose shape may be another one, the wrist where it was seen."""

    def __init__(self, model: str, side: Side, betas: np.ndarray) -> None:
        self._model = kept_model(model, side)
        self._shaped = self._model.shaped(betas)
        self._betas, self._shift = betas, np.zeros(3)

    def bones(self, rest: RestPose, motion: HandMotion) -> tuple[np.ndarray, np.ndarray]:
        """Return the pose of the bones: quaternions (T, 16, 4) as (w, x, y, z) and the wrist's locations (T,
        3) in metres."""
        if not np.array_equal(motion.betas, self._betas):
            self._betas = motion.betas
            self._shift = self._model.shaped(motion.betas).joints[0] - self._shaped.joints[0]
        orient, pose, transl = motion.pose
        return rest.to_bones(self._shaped, orient, pose, transl + self._shift)


def build_open_hand(
    scene: bpy.types.Scene, name: str, model: str, side: Side, betas: np.ndarray
) -> tuple[bpy.types.Collection, CapturedHandRig]:
    """Build an open hand in a new collection of that name, which is not linked yet; return both. Raises
    HandModelError."""
    loaded = with_wrist(kept_model(model, side), "cap")
    shaped = loaded.shaped(betas)
    collection = bpy.data.collections.new(name)
    rig = build_rig(named_after(name, f"{side} hand"), shaped, side)
    rig.armature.scale = (1.0 / scene.unit_settings.scale_length,) * 3
    rig.armature.manient.side, rig.armature.manient.is_hand = side, True
    mesh = build_mesh(f"mesh of {rig.armature.name}", loaded, shaped, rig)
    for thing in (rig.armature, mesh):
        collection.objects.link(thing)
    return collection, rig


def building_preview(
    scene: bpy.types.Scene, name: str, model: str, motion: HandMotion, frames: np.ndarray
) -> Generator[None, None, BlockReference]:
    """Build, in steps, an open hand that does a motion (T frames) on scene frames (T,); return its
    collection. Raises HandModelError."""
    collection, rig = build_open_hand(scene, name, model, motion.side, motion.betas)
    made = BlockReference.of("collections", collection)
    yield
    shaped = kept_model(model, motion.side).shaped(motion.betas)
    keys = yield from map_yields(computing_keys(motion, shaped, rig.rest, frames), lambda: None)
    for _ in animating(rig, keys):
        yield
    scene.collection.children.link(collection)
    return made


def remove_collection(collection: bpy.types.Collection | None) -> None:
    """Remove a collection of `build_open_hand` with all that is in it."""
    if collection is not None:
        remove_blocks([collection, *collection.objects])


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


def set_aside(collection: bpy.types.Collection | None, aside: bool) -> None:
    """Hide a recorded take in viewports while hands follow, which stand where it does, or show it again. What
    the artist shows or hides meanwhile stays so."""
    if collection is not None and collection.manient.is_aside != aside:
        collection.manient.is_aside = collection.hide_viewport = aside


def remove_leftovers() -> None:
    """Remove what followed a live source in a file that was saved, or a step that was made, meanwhile, and
    show what was set aside."""
    for collection in list(bpy.data.collections):
        if collection.manient.is_live:
            remove_collection(collection)
        else:
            set_aside(collection, False)
