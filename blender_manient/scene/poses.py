"""Poses that belong to no rig, put on a hand and read from it: of a captured hand as of a character.

On a captured hand a pose is a correction, which fades out over frames and can be cleared; on a character it
is a key. Ready poses come with the add-on, and every pose asset that the add-on saved is one too.
"""

from __future__ import annotations

import zlib
from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from typing import Any

import bpy
import bpy.utils.previews
import numpy as np

from handfit_core.common.errors import OptionError
from handfit_core.common.skeleton import FINGER_JOINTS, FINGERS, NUM_BETAS, NUM_JOINTS, SIDES, other_side
from handfit_core.common.slices import run_to_completion
from handfit_core.edit.corrections import changed_quats, correction_between
from handfit_core.hand_model.drawing import colored, drawn_pose
from handfit_core.hand_model.files import OPEN_HAND, kept_model
from handfit_core.hand_model.poses import Pose, ready_poses
from handfit_core.retarget.contacts import Fingertips
from handfit_core.retarget.hand_map import HandMap, empty_map
from handfit_core.retarget.transfer import SourceHand, target_hand

from ..common.blender_versions import property_group
from ..rigs.character import CharacterBones, bones_of
from ..rigs.controls import with_moved
from ..rigs.rig import PosedBones
from .characters import character_of, table_of, why_not_reachable
from .controls import rotations_now
from .corrections import correct_frames, corrections_of, timing_of
from .editable import why_not_keyable, why_not_readable
from .keys import (
    PoseKeys,
    check_unlocked,
    displayed_pose,
    frames_between,
    level_handles,
    pose_at,
    read_pose_keys,
    set_pose,
    union,
    write_pose_keys,
)
from .onto_character import Motion, TransferOptions, check_own_keys, computing
from .sampling import rotations_of
from .spans import RequestedFrames, Span, next_key, next_run_start, requested_span
from .store import CapturedHand, active_hand, captured_hands, hand_of
from .timing import span_of

PROPERTY = "manient_pose"
"""The key under which a pose asset's metadata keeps its pose"""
_PREVIEW = 128
"""Pixels of each side of an asset's picture"""


@dataclass(frozen=True, eq=False)
class Posed:
    """Rotations to key on a span of frames."""

    frames: np.ndarray
    """(N,) scene frames, increasing"""
    quats: np.ndarray
    """(N, B, 4) quaternions (w, x, y, z) relative to the bones' rest; NaN for bones that stay"""
    span: Span | None
    """The span of frames on which the pose stands; None: it is for the current frame alone"""

    @property
    def moved(self) -> np.ndarray:
        """Return (B,) bool: the bones that the pose moves."""
        return np.isfinite(self.quats[0, :, 0])


class PosableHand(ABC):
    """One hand that poses are put on and read from."""

    def __init__(self, rig: PosedBones, joints: list[tuple[int, ...]], own: set[str]) -> None:
        self.rig = rig
        self._joints = joints  # of each bone
        self._own = own  # names of all bones by which an artist chooses this hand

    @abstractmethod
    def read(self) -> Pose:
        """Return the pose that the hand shows."""

    def towards(
        self, context: bpy.types.Context, pose: Pose | None, blend: float, requested: RequestedFrames
    ) -> Posed:
        """Return the rotations that bring the fingers of selected bones, of none all fingers, towards a pose
        (None: the rest pose) on the frames that are asked for: by `blend`, 0..1, of the way from where they
        are.

        Changes nothing. Raises HandModelError, OptionError and TakeError."""
        requested.check()
        wanted = self._rest() if pose is None else self._quats(pose)
        wanted = np.where(self._chosen(context)[:, None], wanted, np.nan)
        span, frames = None, np.array([context.scene.frame_current_final])
        before, share = displayed_pose(self.rig)[None], np.array([blend])
        if requested.scope != "HERE":
            span, frames = self._frames(context, requested, np.isfinite(wanted[:, 0]))
            before, share = pose_at(self.rig, frames)[0], blend * span.weights(frames)
        way = share[:, None, None] * correction_between(before, wanted)
        return Posed(frames, changed_quats(before, np.zeros_like(way), way), span)

    @abstractmethod
    def opposite(self, context: bpy.types.Context) -> PosableHand:
        """Return the other side's hand, which gets this one's pose mirrored. Raises OptionError where there
        is none."""

    @abstractmethod
    def _frames(
        self, context: bpy.types.Context, requested: RequestedFrames, moved: np.ndarray
    ) -> tuple[Span, np.ndarray]:
        """Return the span, RANGE or HOLD, and the scene frames (N,) on which the bones that are moved (B,)
        get keys for it. Raises HandfitError."""

    def _rest(self) -> np.ndarray:
        """Return the bones' rotations at rest, (B, 4) quaternions (w, x, y, z)."""
        return np.tile([1.0, 0.0, 0.0, 0.0], (len(self.rig.bones), 1))

    def is_selected(self, context: bpy.types.Context) -> bool:
        """True if any bone of the hand is selected, in Pose mode."""
        return bool(self._selected(context))

    @abstractmethod
    def _quats(self, pose: Pose) -> np.ndarray:
        """Return the bones' rotations in the pose, (B, 4) quaternions (w, x, y, z); NaN for bones that cannot
        be keyed."""

    @abstractmethod
    def put(self, context: bpy.types.Context, posed: Posed) -> None:
        """Key, and at the current frame show, what `towards` returned. Raises OptionError and TakeError."""

    def _selected(self, context: bpy.types.Context) -> set[str]:
        if context.mode != "POSE":
            return set()
        bones = context.selected_pose_bones or ()
        names = {bone.name for bone in bones if bone.id_data == self.rig.armature}
        return with_moved(self.rig.armature, self.rig.bones, names) & self._own

    def _chosen(self, context: bpy.types.Context) -> np.ndarray:
        """Return (B,) bool: the bones that poses are put on, those of fingers with selected bones, or of all
        fingers where none has one."""
        selected = self._selected(context)
        of_selected = {
            j for name, js in zip(self.rig.bones, self._joints, strict=True) if name in selected for j in js
        }
        fingers = [joints for joints in FINGER_JOINTS.values() if of_selected & {*joints}]
        wanted = {j for joints in fingers or FINGER_JOINTS.values() for j in joints}
        return np.array([bool(wanted & {*js}) or (not js and not fingers) for js in self._joints])


class _CapturedPosable(PosableHand):
    """A captured hand that poses are put on and read from."""

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

    def opposite(self, context: bpy.types.Context) -> PosableHand:
        """Return the other hand of the same capture, else the scene's only one of the other side."""
        others = [o for o in captured_hands(context.scene) if o.manient.side != self._hand.side]
        others = [o for o in others if o.manient.capture == self._hand.collection] or others
        found = [hand for hand in map(hand_of, others) if hand is not None]
        if len(found) != 1:
            raise OptionError(
                f"there are {len(found)} captured {other_side(self._hand.side)} hands whose pose this one "
                "could mirror, and not one: select the other hand and save its pose as an asset"
            )
        return _CapturedPosable(found[0])

    def _frames(
        self, context: bpy.types.Context, requested: RequestedFrames, moved: np.ndarray
    ) -> tuple[Span, np.ndarray]:
        """Return the span, and every frame of the captured motion in it, which gets a key."""
        keys, now = read_pose_keys(self.rig), context.scene.frame_current_final
        if len(keys.frames) == 0 or not keys.rotation_keyed[:, moved].any():
            raise OptionError(f"{self._hand.armature.name!r} has no keys: put the pose on this frame alone")
        first, last = float(keys.frames[0]), float(keys.frames[-1])
        scale = timing_of(self._hand.armature).scale  # a spread counts source frames
        span = requested_span(
            replace(requested, spread=requested.spread * scale),
            now,
            next_key(self._hand, now) if requested.scope == "HOLD" else None,
            last,
        )
        inside = keys.frames[(keys.frames >= span.first) & (keys.frames <= span.last)]
        ends = [min(max(end, first), last) for end in (span.first, span.last)]
        if span.first > last or span.last < first:
            raise OptionError(
                f"none of the frames {span.first:g} to {span.last:g} has a hand: its keys are on {first:g} "
                f"to {last:g}"
            )
        return span, frames_between(union([inside, np.array(ends)]))

    def put(self, context: bpy.types.Context, posed: Posed) -> None:
        """Key the pose on bones that are animated; on others, on the current frame, with Auto Keying."""
        armature, moved = self._hand.armature, posed.moved
        auto = posed.span is None and context.scene.tool_settings.use_keyframe_insert_auto
        keyed = moved & (read_pose_keys(self.rig).rotation_keyed.any(axis=0) | auto)
        if keyed.any():
            timing, field = timing_of(armature), corrections_of(armature)
            frames = timing.source_frames(posed.frames).tolist()
            spread = context.scene.manient.spread
            # Points that hold other fingers go on holding them.
            free = {f for f, name in enumerate(FINGERS) if moved[list(FINGER_JOINTS[name])].any()}
            correct_frames(
                armature,
                frames,
                np.where(keyed[:, None], posed.quats, np.nan),
                np.full((len(frames), 3), np.nan),
                spread if posed.span is None else posed.span.spread / timing.scale,
                pins=[
                    {p: at for p, at in pins.items() if (p - 1) // 4 not in free}
                    for pins in map(field.pins, frames)
                ],
                touches=[
                    {a: b for a, b in touches.items() if not {(a - 1) // 4, (abs(b) - 1) // 4} & free}
                    for touches in map(field.touching, frames)
                ],
                posed=True,
            )
        if posed.span is None:
            set_pose(self.rig, posed.quats[0])


class _CharacterPosable(PosableHand):
    """A character's hand that poses are put on and read from."""

    def __init__(self, armature: bpy.types.Object, hand_map: HandMap) -> None:
        self._armature, self._model = armature, kept_model(OPEN_HAND, hand_map.side)
        self._source = SourceHand.of(self._model.shaped(), hand_map.side)
        self._target = target_hand(bones_of(armature), hand_map, self._source)
        rig = CharacterBones(armature, self._target.bones)
        super().__init__(rig, list(self._target.joints), {*rig.bones, *hand_map.bones, hand_map.moved_by})

    def read(self) -> Pose:
        """Return the pose that is shown, with constraints and controls, relative to the hand's own bone."""
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
        onto = TransferOptions(into="ACTION", contacts=self._armature.manient.character.contacts)
        (found,) = run_to_completion(computing(self._armature, [(self._target.hand_map, motion)], onto)).keys
        return np.where(found.keyed[:, None], found.keys.quats[0], np.nan)

    def _rest(self) -> np.ndarray:
        """Return the rotations at rest, (B, 4) quaternions (w, x, y, z), of the bones that a pose would key;
        NaN for the others."""
        unkeyed = np.isnan(self._quats(Pose(self._source.side, np.zeros(3 * (NUM_JOINTS - 1)))))
        return np.where(unkeyed, np.nan, super()._rest())

    def opposite(self, context: bpy.types.Context) -> PosableHand:  # noqa: ARG002
        """Return the character's other hand."""
        side = other_side(self._source.side)
        table = table_of(self._armature, side)
        if table == empty_map(side):
            raise OptionError(
                f"the {side} hand of {self._armature.name!r} is not known: see Character > Bones"
            )
        return _CharacterPosable(self._armature, table)

    def towards(
        self, context: bpy.types.Context, pose: Pose | None, blend: float, requested: RequestedFrames
    ) -> Posed:
        """Return the rotations that bring the fingers towards a pose; raises OptionError where `put` could
        not key them."""
        check_own_keys(self._armature, "ACTION")
        posed = super().towards(context, pose, blend, requested)
        check_unlocked(self.rig, joints=np.flatnonzero(posed.moved).tolist(), location=False)
        return posed

    def _frames(
        self, context: bpy.types.Context, requested: RequestedFrames, moved: np.ndarray
    ) -> tuple[Span, np.ndarray]:
        """Return the span, and the frames of the keys that are there, of the span's ends and of those of its
        blending."""
        keys, now = read_pose_keys(self.rig), context.scene.frame_current_final
        own = keys.frames[keys.rotation_keyed[:, moved].any(axis=1)]
        upcoming = next_run_start(own, now)
        span = requested_span(requested, now, upcoming, max([span_of(context.scene)[1], *own]))
        reach = max(span.spread, 1.0)
        begin, end = span.first - reach, np.inf if span.is_open else span.last + reach
        ends = [begin, span.first, span.last] + ([] if span.is_open else [end])
        return span, union([own[(own > begin) & (own < end)], np.array(ends)])

    def put(self, context: bpy.types.Context, posed: Posed) -> None:  # noqa: ARG002
        """Key all bones that the pose moves."""
        keys = PoseKeys.everywhere(posed.frames, np.nan_to_num(posed.quats))
        write_pose_keys(self.rig, keys.only(posed.moved, False))
        if posed.span is None:
            set_pose(self.rig, posed.quats[0])
        else:
            joints = np.flatnonzero(posed.moved).tolist()
            level_handles(self.rig, joints, posed.span.first, posed.span.last)


def posed_by(context: bpy.types.Context) -> CapturedHand | bpy.types.Object | None:
    """Return what the artist's poses are put on: the active captured hand or the active character, else the
    scene's only captured hand."""
    obj = context.active_object
    hand = hand_of(obj) if obj is not None else None
    armature = character_of(obj)
    if hand is None and armature is not None and _maps(armature):
        return armature
    return hand or active_hand(context)


def why_not_posable(context: bpy.types.Context, *, reading: bool = False) -> str | None:
    """Return why no pose can be put on a hand here, or read from one, a sentence for a tooltip; None where it
    can."""
    owner = posed_by(context)
    if owner is None:
        return "Select a captured hand first, or a character whose hands are known: its armature or its mesh"
    if context.mode not in {"OBJECT", "POSE"} and not reading:
        return "Go to Object or Pose Mode first"
    if isinstance(owner, CapturedHand):
        return (why_not_readable if reading else why_not_keyable)(owner.armature)
    return None if reading else why_not_reachable(owner)


def posable_hands(context: bpy.types.Context) -> list[PosableHand]:
    """Return the hands that `posed_by` has: of a character's those with selected bones, of none both. Raises
    HandModelError."""
    owner = posed_by(context)
    assert owner is not None  # as the operators' polls see to
    if isinstance(owner, CapturedHand):
        return [_CapturedPosable(owner)]
    hands: list[PosableHand] = [_CharacterPosable(owner, hand_map) for hand_map in _maps(owner)]
    return [hand for hand in hands if hand.is_selected(context)] or hands


def _maps(armature: bpy.types.Object) -> list[HandMap]:
    """Return the tables of an armature's hands that are known and used."""
    tables = (table_of(armature, side) for side in SIDES if getattr(armature.manient.character, side).use)
    return [table for table in tables if table != empty_map(table.side)]


def pose_named(name: str) -> Pose:
    """Return the pose of a pose asset of this file, else the ready pose, of that name. Raises OptionError,
    HandModelError."""
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
    """Return the pose in an asset's metadata. Raises HandModelError."""
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
"""The items of the last list of poses, kept because Blender does not keep the texts of an enumeration's
items"""


def pose_items(_settings: Any, _context: bpy.types.Context | None) -> list[tuple[str, str, str, int, int]]:
    """Return all poses, as items with pictures: the ready ones, then those of this file."""
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
    """Forget the pictures of poses."""
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
