"""Poses that belong to no rig, put on a hand and read from it: of a captured hand as of a character.

On a captured hand a pose is a correction, which fades out over frames and can be cleared; on a character it
is a key. Ready poses come with the add-on, and every pose asset that the add-on saved is one too.
"""

from __future__ import annotations

import zlib
from abc import ABC, abstractmethod
from typing import Any

import bpy
import bpy.utils.previews
import numpy as np

from handfit_core.edit.corrections import changed_quats, correction_between
from handfit_core.errors import OptionError
from handfit_core.hand_model.drawing import colored, drawn_pose
from handfit_core.hand_model.files import OPEN_HAND
from handfit_core.hand_model.kept import kept_model
from handfit_core.hand_model.poses import Pose, ready_poses
from handfit_core.retarget.contacts import Fingertips
from handfit_core.retarget.hand_map import HandMap, empty_map
from handfit_core.retarget.transfer import SourceHand, target_hand
from handfit_core.skeleton import FINGER_JOINTS, FINGERS, NUM_BETAS, NUM_JOINTS, SIDES
from handfit_core.slices import result_of

from ..blender_versions import property_group
from ..rigs.character import CharacterBones, bones_of
from ..rigs.controls import with_moved
from ..rigs.rig import PosedBones
from .characters import character_of, table_of, why_not_reachable
from .controls import rotations_now
from .corrections import correct_frames, corrections_of, timing_of
from .editable import why_not_keyable, why_not_readable
from .keys import PoseKeys, check_unlocked, displayed_pose, keyed_bones, set_pose, write_pose_keys
from .onto_character import Motion, Onto, check_own_keys, computing
from .sampling import rotations_of
from .store import CapturedHand, active_hand, hand_of

PROPERTY = "manient_pose"
"""What a pose asset's metadata keeps the pose under"""
_PREVIEW = 128
"""pixels of a side of an asset's picture"""


class PosableHand(ABC):
    """One hand that poses are put on and read from."""

    def __init__(self, rig: PosedBones, joints: list[tuple[int, ...]], own: set[str]) -> None:
        self.rig = rig
        self._joints = joints  # of each bone
        self._own = own  # names of all bones by which an artist chooses this hand

    @abstractmethod
    def read(self) -> Pose:
        """The pose that it shows."""

    def towards(self, context: bpy.types.Context, pose: Pose, blend: float) -> np.ndarray:
        """(B, 4) what brings the fingers of selected bones, of none all fingers, towards a pose: by `blend`,
        0..1, of the way from where they are; NaN for bones that stay. Changes nothing. Raises HandModelError
        and OptionError."""
        chosen = self._chosen(context)
        before = displayed_pose(self.rig)
        way = correction_between(before, self._quats(pose))
        quats = changed_quats(before, np.zeros_like(way), blend * way)
        return np.where(chosen[:, None], quats, np.nan)

    def is_selected(self, context: bpy.types.Context) -> bool:
        """Whether any bone of it is, in Pose mode."""
        return bool(self._selected(context))

    @abstractmethod
    def _quats(self, pose: Pose) -> np.ndarray:
        """(B, 4) the bones' rotations in the pose; NaN for bones that cannot be keyed."""

    @abstractmethod
    def put(self, context: bpy.types.Context, quats: np.ndarray) -> None:
        """Key at the current frame, and show, what `towards` returned. Raises OptionError and TakeError."""

    def _selected(self, context: bpy.types.Context) -> set[str]:
        if context.mode != "POSE":
            return set()
        bones = context.selected_pose_bones or ()
        names = {bone.name for bone in bones if bone.id_data == self.rig.armature}
        return with_moved(self.rig.armature, self.rig.bones, names) & self._own

    def _chosen(self, context: bpy.types.Context) -> np.ndarray:
        """(B,) bool"""
        selected = self._selected(context)
        of_selected = {
            j for name, js in zip(self.rig.bones, self._joints, strict=True) if name in selected for j in js
        }
        fingers = [joints for joints in FINGER_JOINTS.values() if of_selected & {*joints}]
        wanted = {j for joints in fingers or FINGER_JOINTS.values() for j in joints}
        return np.array([bool(wanted & {*js}) or (not js and not fingers) for js in self._joints])


class _Captured(PosableHand):
    """A captured hand."""

    def __init__(self, hand: CapturedHand) -> None:
        super().__init__(hand.rig, [(joint,) for joint in range(NUM_JOINTS)], {*hand.rig.bones})
        self._hand = hand

    def read(self) -> Pose:
        quats = rotations_now(self.rig)[None]
        return Pose(
            self._hand.side, self._hand.rig.from_bones(self._hand.shaped(), quats, np.zeros((1, 3)))[1][0]
        )

    def _quats(self, pose: Pose) -> np.ndarray:
        still = np.zeros((1, 3))
        return self._hand.rig.to_bones(self._hand.shaped(), still, pose.on(self._hand.side)[None], still)[0][
            0
        ]

    def put(self, context: bpy.types.Context, quats: np.ndarray) -> None:
        """Bones that are animated get a key, others only with Auto Keying."""
        armature, moved = self._hand.armature, np.isfinite(quats[:, 0])
        keyed = moved & (keyed_bones(self.rig) | context.scene.tool_settings.use_keyframe_insert_auto)
        if keyed.any():
            (frame,) = timing_of(armature).source_frames(np.array([context.scene.frame_current_final]))
            field = corrections_of(armature)
            # Points that hold other fingers go on holding them.
            free = {f for f, name in enumerate(FINGERS) if moved[list(FINGER_JOINTS[name])].any()}
            pins = {p: at for p, at in field.pins(frame).items() if (p - 1) // 4 not in free}
            touches = {
                a: b for a, b in field.touching(frame).items() if not {(a - 1) // 4, (b - 1) // 4} & free
            }
            correct_frames(
                armature,
                [frame],
                np.where(keyed[:, None], quats, np.nan)[None],
                np.full((1, 3), np.nan),
                context.scene.manient.spread,
                pins=[pins],
                touches=[touches],
                posed=True,
            )
        set_pose(self.rig, quats)


class _OfCharacter(PosableHand):
    """A character's hand."""

    def __init__(self, armature: bpy.types.Object, hand_map: HandMap) -> None:
        self._armature, self._model = armature, kept_model(OPEN_HAND, hand_map.side)
        self._source = SourceHand.of(self._model.shaped(), hand_map.side)
        self._target = target_hand(bones_of(armature), hand_map, self._source)
        rig = CharacterBones(armature, self._target.bones)
        super().__init__(rig, list(self._target.joints), {*rig.bones, *hand_map.bones, hand_map.moved_by})

    def read(self) -> Pose:
        """As constraints and controls leave it, relative to the hand's own bone."""
        shown = self._armature.evaluated_get(bpy.context.evaluated_depsgraph_get()).pose.bones
        names = [self._target.hand_map.bones[0], *self._target.bones]
        now = rotations_of(np.array([shown[name].matrix for name in names], dtype=np.float64))
        rest = np.array(self._armature.data.bones[names[0]].matrix_local.to_3x3(), dtype=np.float64)
        standing = rest @ now[0].T @ now[1:]
        turns = self._target.turns(self._target.channels(standing[None]))[0]
        return Pose.of_turns(self._source.side, turns)

    def _quats(self, pose: Pose) -> np.ndarray:
        skins = Fingertips.of(self._model, np.zeros(NUM_BETAS))
        turns = pose.turns(self._source.side)[None]
        motion = Motion(self._source, np.zeros(1), turns, np.zeros((1, 3)), skins)
        onto = Onto("ACTION", contacts=self._armature.manient.character.contacts)
        (found,) = result_of(computing(self._armature, [(self._target.hand_map, motion)], onto)).keys
        return np.where(found.keyed[:, None], found.keys.quats[0], np.nan)

    def towards(self, context: bpy.types.Context, pose: Pose, blend: float) -> np.ndarray:
        """The same; raises OptionError also where `put` could not key it."""
        check_own_keys(self._armature, "ACTION")
        quats = super().towards(context, pose, blend)
        moved = np.flatnonzero(np.isfinite(quats[:, 0])).tolist()
        check_unlocked(self.rig, joints=moved, location=False)
        return quats

    def put(self, context: bpy.types.Context, quats: np.ndarray) -> None:
        """All of them get a key."""
        frames = np.array([context.scene.frame_current_final])
        moved = np.isfinite(quats[:, 0])
        keys = PoseKeys(
            frames, np.nan_to_num(quats)[None], np.zeros((1, 3)), moved[None], np.zeros(1, dtype=bool)
        )
        write_pose_keys(self.rig, keys)
        set_pose(self.rig, quats)


def posed_by(context: bpy.types.Context) -> CapturedHand | bpy.types.Object | None:
    """What the artist's poses are put on: the active captured hand or the active character, else the scene's
    only captured hand."""
    obj = context.active_object
    hand = hand_of(obj) if obj is not None else None
    armature = character_of(obj)
    if hand is None and armature is not None and _maps(armature):
        return armature
    return hand or active_hand(context)


def why_not_posable(context: bpy.types.Context, *, reading: bool = False) -> str | None:
    """Why no pose can be put on a hand here, or read from one: a sentence for a tooltip."""
    owner = posed_by(context)
    if owner is None:
        return "Select a captured hand first, or a character whose hands are known: its armature or its mesh"
    if context.mode not in {"OBJECT", "POSE"} and not reading:
        return "Go to Object or Pose Mode first"
    if isinstance(owner, CapturedHand):
        return (why_not_readable if reading else why_not_keyable)(owner.armature)
    return None if reading else why_not_reachable(owner)


def posable_hands(context: bpy.types.Context) -> list[PosableHand]:
    """The hands that `posed_by` has: of a character's those with selected bones, of none both. Raises
    HandModelError."""
    owner = posed_by(context)
    assert owner is not None  # as the operators' polls see to
    if isinstance(owner, CapturedHand):
        return [_Captured(owner)]
    hands: list[PosableHand] = [_OfCharacter(owner, hand_map) for hand_map in _maps(owner)]
    return [hand for hand in hands if hand.is_selected(context)] or hands


def _maps(armature: bpy.types.Object) -> list[HandMap]:
    """The tables of its hands that are known and used."""
    tables = (table_of(armature, side) for side in SIDES if getattr(armature.manient.character, side).use)
    return [table for table in tables if table != empty_map(table.side)]


def pose_named(name: str) -> Pose:
    """A pose asset of this file, else a ready pose. Raises OptionError, HandModelError."""
    if not name:
        raise OptionError("choose a pose first")
    action = bpy.data.actions.get(name)
    if action is not None and _is_pose(action):
        return kept_pose(action.asset_data)
    ready = ready_poses().get(name)
    if ready is None:
        raise OptionError(f"there is no pose {name!r}: ready ones are {', '.join(ready_poses())}")
    return ready.pose


def kept_pose(metadata: Any) -> Pose:
    """The pose in an asset's metadata. Raises HandModelError."""
    return Pose.of_values(property_group(metadata, PROPERTY))


def keep_pose(action: bpy.types.Action, pose: Pose) -> None:
    """Have an action, which is an asset already, be a pose for every rig, with a picture of it."""
    action.asset_data[PROPERTY] = pose.values()
    drawn = drawn_pose(kept_model(OPEN_HAND, "right"), pose.on("right"), _PREVIEW)
    _show(action.preview_ensure(), drawn if pose.side == "right" else drawn[:, ::-1])


def _is_pose(action: bpy.types.Action) -> bool:
    return action.asset_data is not None and PROPERTY in action.asset_data


_previews: Any = None
_items: list[tuple[str, str, str, int, int]] = []
"""Blender does not keep the texts of an enumeration's items"""


def pose_items(_settings: Any, _context: bpy.types.Context | None) -> list[tuple[str, str, str, int, int]]:
    """All poses, as items with pictures: the ready ones, then those of this file."""
    global _previews
    if _previews is None:
        _previews = bpy.utils.previews.new()
        for name, ready in ready_poses().items():
            _show(_previews.new(name), ready.drawn)
    own = [action for action in bpy.data.actions if _is_pose(action)]
    found = [
        *((name, name, "A ready pose", _previews[name].icon_id) for name in _previews),
        *((a.name, a.name, "A pose asset of this file", a.preview_ensure().icon_id) for a in own),
    ]
    ready = list(_previews)
    # One's own pose takes the place of a ready one; numbers, which files keep, stay when poses come and go.
    _items[:] = [
        (*item, ready.index(name) if name in ready else zlib.crc32(name.encode()) % 2**30 + 2**30)
        for name, item in {item[0]: item for item in found}.items()
    ]
    return _items


def forget_previews() -> None:
    """Let go of the pictures."""
    global _previews
    if _previews is not None:
        bpy.utils.previews.remove(_previews)
        _previews = None


def _show(preview: bpy.types.ImagePreview, drawn: np.ndarray) -> None:
    """Give a preview a picture (S, S, 2) as `drawn_pose` makes it."""
    pixels = colored(drawn)[::-1].copy()
    pixels[pixels[..., 3] == 0] = 0  # Blender adds what is transparent to what is behind
    preview.image_size = pixels.shape[:2]
    preview.image_pixels.foreach_set(pixels.view(np.int32).ravel())
