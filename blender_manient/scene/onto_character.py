"""A captured hand's motion, or one pose of it, on a character's hand.

Fingers are keyed relative to the hand, whatever arm, switch of IK and FK or object carries it. The hand
itself is left alone unless it is asked for: pictures do not tell where in the character's world their camera
stood, so that one frame has to say it (`TransferOptions.reference`).
"""

from __future__ import annotations

import contextlib
from collections.abc import Generator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import bpy
import numpy as np
from mathutils import Matrix, Quaternion

from handfit_core.common.errors import HandModelError, OptionError
from handfit_core.common.skeleton import NUM_JOINTS, SIDES, Side, other_side
from handfit_core.common.slices import map_yields, run_to_completion
from handfit_core.geometry.rotations import quat_to_rotmat, rotmat_to_quat
from handfit_core.hand_model.axes import MIRROR_X, RestPose, points_to_rest
from handfit_core.hand_model.files import kept_model
from handfit_core.retarget.arms import CapturedArm
from handfit_core.retarget.contacts import Fingertips, keeping_contacts
from handfit_core.retarget.hand_map import HandMap
from handfit_core.retarget.recognition import DOUBTFUL, UNKNOWN
from handfit_core.retarget.transfer import (
    SourceHand,
    TargetHand,
    mirrored_turns,
    smoothed_travel,
    target_hand,
)
from handfit_core.take import HandTrack, Take

from ..common.blender_versions import action_slot, channels, new_slot
from ..common.wording import capitalised, counted
from ..rigs import troubles
from ..rigs.character import CharacterBones, bones_of
from ..rigs.controls import in_use, is_own
from ..rigs.rig import PosedBones, bone_path
from .actions import add_strip, is_layered, is_tweaked, own_action, present_curves, push_down, use_action
from .character_arms import MARK, Arm, arm_of, keying_arm
from .characters import (
    hand_map_of,
    is_damaged,
    kept_map,
    recognised,
    rig_used,
    said_without_keys,
    table_of,
    why_not_reachable,
    without_keys,
)
from .editable import check, check_unlayered
from .hand_motion import BoneKeys, record_written_keys, without_artist_keys, written_keys
from .holding import held_by
from .keys import (
    SAME_FRAME,
    PoseKeys,
    check_unlocked,
    computing_keys,
    frames_between,
    nearest,
    pose_at,
    read_pose_keys,
    remove_pose_keys,
    writing_pose_keys,
)
from .moving_body import check_moved_in_time
from .sampling import of_bones, rests, rotations_of, sample_unseen, sampling_unseen
from .store import CapturedHand, timing_of
from .timing import Timing, check_range, frame_rate
from .transfer_options import Anchor, Into, TransferOptions, Wrist

MAX_TOUCH_ERROR = 0.002
"""metres at the captured hand's size by which touching fingertips may miss each other unseen"""

_TURNING = {"COPY_ROTATION", "COPY_TRANSFORMS", "TRANSFORM", "ARMATURE", "CHILD_OF", "ACTION", "IK"} | {
    *("DAMPED_TRACK", "LOCKED_TRACK", "TRACK_TO", "STRETCH_TO", "SPLINE_IK", "PIVOT", "FOLLOW_PATH")
}
"""Constraints that turn a bone away from its keys. Limits only cut them off"""

_CHUNK = 250
"""How many frames are computed at once, in some milliseconds"""

_SURE, _LIKELY = 0.75, 0.45
"""How sure a hand must be recognised, 0..1, to be called sure, and likely"""


@dataclass(frozen=True, eq=False)
class Motion:
    """The motion of a captured hand on N scene frames, in the space of its own armature."""

    source: SourceHand
    frames: np.ndarray
    """(N,) scene frames, increasing"""
    turns: np.ndarray
    """(N, 16, 3, 3) each joint's rotation relative to its parent, the wrist's to its rest, in rest space"""
    places: np.ndarray
    """(N, 3) metres: where the wrist is in the space of the armature"""
    skins: Fingertips | None = None
    """the hand's fingertips; None where it is not known which of them touch"""
    arm: CapturedArm | None = None
    """The motion of the hand's arm on these frames; None where there is none"""

    @classmethod
    def of(cls, hand: CapturedHand, frames: np.ndarray, turns: np.ndarray, places: np.ndarray) -> Motion:
        """Return the motion of a hand in the scene, from its turns and places on N scene frames. Raises
        HandModelError."""
        source = SourceHand.of(hand.shaped(), hand.side, hand.model().name)
        numbers = timing_of(hand.collection).source_frames(frames)
        arm = CapturedArm.of(hand.take, hand.track, numbers)
        return cls(source, frames, turns, places, Fingertips.of(hand.model(), hand.betas), arm)

    def on(self, side: Side, later: float = 0.0) -> Motion:
        """Return the motion for a hand of that side, mirrored if need be, and so many scene frames later."""
        moved = self if self.source.side == side else self.mirrored()
        return replace(moved, frames=moved.frames + later)

    def mirrored(self) -> Motion:
        """Return the motion mirrored at x = 0, for the other side."""
        turns, skins = mirrored_turns(self.turns), self.skins and self.skins.mirrored()
        arm = self.arm and self.arm.mirrored()
        return Motion(self.source.mirrored(), self.frames, turns, self.places @ MIRROR_X, skins, arm)


@dataclass(frozen=True, eq=False)
class Applied:
    """The result of a transfer to one hand."""

    frames: int
    bones: int
    left_alone: tuple[str, ...]
    """Why some bones got no keys, a sentence each"""
    apart: float = 0.0
    """metres of the captured hand's scale by which fingertips that touch do not meet as captured, at the
    worst"""
    missed: int = 0
    """the number of frames in which `apart` is more than `MAX_TOUCH_ERROR`"""


def shortcomings(applied: Sequence[Applied]) -> list[str]:
    """Return what is not as captured, in sentences that begin with a small letter."""
    found = list(dict.fromkeys(sentence for one in applied for sentence in one.left_alone))
    missed = max(one.missed for one in applied)
    if missed:
        found.append(
            f"in {counted(missed, 'frame')} fingertips that touch do not meet as captured, by up to "
            f"{1000.0 * max(one.apart for one in applied):.0f} mm of your hand's size: this character's "
            "fingers are too long or too short for it"
        )
    return found


def reading_motion(
    hand: CapturedHand, frames: Sequence[float] | None = None
) -> Generator[None, None, Motion]:
    """Read, in steps, what a captured hand does on scene frames, and return it; None: from its first key to
    its last, on its keys and on every frame between them. Raises OptionError where it has no keys.

    Its keys are read, or, where anything else moves it (layers, constraints, controls), what it shows: that
    takes a step per frame, and the scene is back where it was afterwards.
    """
    rig, rest = hand.rig, hand.rig.rest
    wanted = frames_between(read_pose_keys(rig).frames) if frames is None else np.asarray(frames, np.float64)
    if len(wanted) == 0:
        raise OptionError(f"{hand.armature.name!r} has no keys: apply its pose instead")
    if is_keyframed(rig):
        quats, locations = pose_at(rig, wanted)
    else:
        sampled = yield from map_yields(sampling_unseen(rig.armature, wanted), lambda: None)
        quats, locations = of_bones(rig, sampled)
    turns = rest.frames @ quat_to_rotmat(quats) @ np.swapaxes(rest.frames, -1, -2)
    return Motion.of(hand, wanted, turns, rest.wrist + locations @ rest.frames[0].T)


def motion_of(take: Take, track: HandTrack, model: str | None = None) -> Motion:
    """Return what a hand of a take does, on the take's own frames and on every frame in gaps, without
    building it.

    `model` is taken instead of the one that the take names. Raises HandModelError, and TakeError where frames
    lie beyond Blender's timeline.
    """
    check_range(take, Timing())
    hand = kept_model(model or take.model, track.side)
    shaped = hand.shaped(track.betas)
    wrist = points_to_rest(shaped.joints[0])
    rest = RestPose(track.side, np.broadcast_to(np.eye(3), (NUM_JOINTS, 3, 3)), wrist)
    keys = run_to_completion(computing_keys(track, shaped, rest, take.frame_numbers))
    frames = frames_between(keys.frames)
    curves = np.column_stack([keys.quats.reshape(len(keys.frames), -1), keys.locations])
    values = np.stack([np.interp(frames, keys.frames, curve) for curve in curves.T], axis=-1)
    quats = values[:, :-3].reshape(-1, NUM_JOINTS, 4)
    source, skins = SourceHand.of(shaped, track.side, hand.name), Fingertips.of(hand, track.betas)
    arm = CapturedArm.of(take, track, frames)
    return Motion(source, frames, quat_to_rotmat(quats), wrist + values[:, -3:], skins, arm)


def is_keyframed(rig: PosedBones) -> bool:
    """True if nothing but the present action's keys moves the bones: no layer, strip, constraint, driver or
    control, and no curve that is muted or modified."""
    armature, data = rig.armature, rig.armature.animation_data
    if any(
        c.enabled and c.influence > 0.0 and not is_own(c) for b in armature.pose.bones for c in b.constraints
    ):
        return False
    if in_use(armature) or is_layered(armature):
        return False
    if data is None:
        return True
    if data.use_tweak_mode or any(not track.mute for track in data.nla_tracks):
        return False
    changed = [c for c in present_curves(armature) if c.mute or len(c.modifiers)]
    starts = tuple(f"{bone_path(name)}." for name in rig.bones)
    return not any(curve.data_path.startswith(starts) for curve in (*data.drivers, *changed))


def putting(
    armature: bpy.types.Object,
    hands: Sequence[tuple[HandMap, CapturedHand]],
    onto: TransferOptions,
    frames: Sequence[float] | None = None,
) -> Generator[float, None, list[Applied]]:
    """Key what captured hands do on a character, in steps that tell how much is done, 0..1: on scene frames,
    or all that they do. Raises HandModelError and OptionError, before anything is changed."""
    motions = []
    for number, (hand_map, hand) in enumerate(hands):
        motion = yield from map_yields(reading_motion(hand, frames), lambda n=number: 0.5 * n / len(hands))
        motions.append((hand_map, motion))
    return (yield from applying(armature, motions, onto))


def applying(
    armature: bpy.types.Object, hands: Sequence[tuple[HandMap, Motion]], onto: TransferOptions
) -> Generator[float, None, list[Applied]]:
    """Key motions on a character's hands, in one action, in steps that each tell how much is done, 0..1.

    A motion of the other side is mirrored. Raises HandModelError and OptionError, before anything is changed.
    """
    check_own_keys(armature, onto.into)
    computed = yield from computing(armature, hands, onto)
    if onto.into == "STRIP":
        _check_uncovered(armature, computed.keys)
    if onto.into == "ACTION":
        _write_into_present(armature, computed.keys)
    else:
        yield from writing_anew(armature, computed.keys, onto.into)
    return computed.applied


@dataclass(frozen=True, eq=False)
class Computed:
    """The keys that hands are to get, before any of them is written."""

    keys: list[BoneKeys]
    applied: list[Applied]


def computing(
    armature: bpy.types.Object, hands: Sequence[tuple[HandMap, Motion]], onto: TransferOptions
) -> Generator[float, None, Computed]:
    """Compute the keys that `applying` writes without writing any; raises what `applying` raises."""
    keys, applied = [], []
    if onto.time_offset:
        check_moved_in_time(armature, [motion.frames for _, motion in hands], onto.time_offset)
    for hand_map, captured in hands:
        motion = captured.on(hand_map.side, onto.time_offset)
        of_arm: list[BoneKeys] = []
        arm, no_arm = _arm_of(armature, hand_map, motion) if onto.arms else (None, None)
        fingers_only = onto.wrist == "FINGERS" and arm is None
        target, keyed, left_alone = prepared(armature, hand_map, motion.source, fingers_only=fingers_only)
        left_alone += [no_arm] if no_arm is not None else []
        keyless = without_keys(armature, hand_map).get(UNKNOWN)
        left_alone += [said_without_keys({UNKNOWN: keyless})] if keyless else []
        kept = None
        if onto.contacts and motion.skins is not None:
            times = motion.frames / frame_rate(bpy.context.scene)
            held = held_by(armature, hand_map.bones[0], motion.frames)
            kept = yield from keeping_contacts(
                target, motion.source, motion.skins, motion.turns, times, keyed, held
            )
        quats = np.empty((len(motion.frames), len(target.bones), 4))
        for start in range(0, len(quats), _CHUNK):
            some = slice(start, start + _CHUNK)
            standing = target.standing(motion.turns[some]) if kept is None else kept.standing[some]
            quats[some] = within_locks(armature, target.bones, rotmat_to_quat(target.channels(standing)))
            yield 0.0
        fingers = CharacterBones(armature, target.bones)
        wanted = PoseKeys.everywhere(motion.frames, quats)
        keys.append(BoneKeys(fingers, wanted.only(keyed, False)))
        if arm is not None and motion.arm is not None:
            wrists = motion.turns[:, 0]
            of_arm = yield from keying_arm(armature, arm, target, motion.arm, motion.frames, wrists, onto)
            keys += of_arm
        elif not fingers_only:
            keys.append((yield from _moving(armature, target, motion, onto)))
        apart = np.zeros(1) if kept is None else kept.apart
        worst, missed = float(apart.max(initial=0.0)), int((apart > MAX_TOUCH_ERROR).sum())
        count = int(keyed.sum()) + len(of_arm)
        applied.append(Applied(len(motion.frames), count, tuple(left_alone), worst, missed))
    return Computed(keys, applied)


def _arm_of(armature: bpy.types.Object, hand_map: HandMap, motion: Motion) -> tuple[Arm | None, str | None]:
    """Return the character's arm that is to do what a motion's does, or a sentence why it cannot; None and
    None where the motion has no arm."""
    if motion.arm is None:
        return None, None
    try:
        arm = arm_of(armature, hand_map)
    except HandModelError as error:
        return None, str(error)
    missing = next((name for name in arm.controls.keyed if name not in armature.pose.bones), None)
    if missing is not None:
        return None, f"{armature.name!r} has no bone {missing}: its {hand_map.side} arm was left alone"
    reasons = (why_not_turned(armature, name) for name in arm.controls.keyed)
    why = next((why for why in reasons if why is not None), None)
    return (arm, None) if why is None else (None, why.replace(": it was", ": that arm was"))


def _write_into_present(armature: bpy.types.Object, keys: Sequence[BoneKeys]) -> None:
    """Replace keys of the present action in one step: a stop half-way would lose the former keys."""
    for one in keys:
        check_unlocked(one.rig, **one.keys.channels)
    own_action(armature)
    for one in keys:
        remove_pose_keys(one.rig, *one.keys.frames[[0, -1]].tolist(), **one.keys.channels)
    run_to_completion(writing(keys))
    record_all_written_keys(armature, keys)


def record_all_written_keys(armature: bpy.types.Object, keys: Sequence[BoneKeys]) -> None:
    """Note on the present action which keys were written into it."""
    data = armature.animation_data
    for one in keys:
        record_written_keys(armature, data.action, action_slot(data), one)


def writing_anew(
    armature: bpy.types.Object, keys: Sequence[BoneKeys], into: Into
) -> Generator[float, None, None]:
    """Write an action that nobody uses until it is whole."""
    action = bpy.data.actions.new(f"{armature.name} hands")
    given = False
    try:
        slot = new_slot(action, armature.name)
        yield from writing(keys, channels(action, slot, make=True))
        if any(one.arm for one in keys):
            action[MARK] = True
        _give(armature, action, slot, into)
        given = True
        for one in keys:
            record_written_keys(armature, action, slot, one)
    finally:
        if not given:
            with contextlib.suppress(ReferenceError):  # an undo has taken it away already
                bpy.data.actions.remove(action)


def writing(keys: Sequence[BoneKeys], holder: Any = None) -> Generator[float, None, None]:
    """Write keys, a bone per step; yields how much is done, 0..1."""
    for number, one in enumerate(keys):
        for done in writing_pose_keys(lambda one=one: one.rig, one.keys, holder=holder):
            yield (number + done) / len(keys)


def within_locks(armature: bpy.types.Object, names: Sequence[str], quats: np.ndarray) -> np.ndarray:
    """Rotations (N, K, 4) without what lies about axes that are locked: these stay what they are, for
    quaternions as Euler angles XYZ, as Blender's own transforms keep them."""
    quats = quats.copy()
    for k, name in enumerate(names):
        bone = armature.pose.bones[name]
        if not any(bone.lock_rotation):
            continue
        order = bone.rotation_mode if bone.rotation_mode not in {"QUATERNION", "AXIS_ANGLE"} else "XYZ"
        present = bone.rotation_euler if order == bone.rotation_mode else None
        if present is None:
            present = bone.matrix_basis.to_euler(order)
        euler = present.copy()
        for row, quat in enumerate(quats[:, k].tolist()):
            euler = Quaternion(quat).to_euler(order, euler)
            for axis in np.flatnonzero(bone.lock_rotation):
                euler[axis] = present[axis]
            quats[row, k] = euler.to_quaternion()
    return quats


def _moving(
    armature: bpy.types.Object, target: TargetHand, motion: Motion, onto: TransferOptions
) -> Generator[float, None, BoneKeys]:
    """Compute the keys of the bone that moves the whole hand, in steps, as `moved` has it.

    What is in keys that were written with an offset before has that taken out of where the hand is in the
    marked frame."""
    side, control = target.hand_map.side, target.hand_map.moved_by
    check_movable(armature, control)
    anchor = onto.anchors.get(side)
    first, last = float(motion.frames[0]), float(motion.frames[-1])
    if anchor is None and not first - SAME_FRAME <= onto.reference <= last + SAME_FRAME:
        raise OptionError(
            f"the marked frame {onto.reference:g} is not among those of the motion, {first:g} to {last:g}: "
            "go to a frame in which the character's hand is as it is to be, and mark it"
        )
    at = int(np.argmin(np.abs(motion.frames - onto.reference)))
    own, bone = target.hand_map.bones[0], armature.data.bones[control]
    parent = bone.parent
    names = [own, *([parent.name] if parent else [])]
    marked = sample_unseen(armature, motion.frames[[at]], names).of(names)[0]
    parents = np.broadcast_to(marked[-1], (len(motion.frames), 4, 4))
    if parent is not None and not rests(armature, parent):
        parents = (yield from sampling_unseen(armature, motion.frames, names[1:])).of(names[1:])[:, 0]
    places, wrist = smoothed_travel(motion.frames, motion.places, motion.turns[:, 0], onto.smoothing)
    located = is_located(bone, onto.wrist)
    noted, offset, shift = None, np.zeros(3), np.zeros(3)
    if anchor is None:
        anchor, noted = Anchor(wrist[at], places[at], marked[0]), side
        before = written_keys(armature, side)
        if located:
            offset = np.asarray(onto.offsets.get(side, offset), dtype=np.float64)
        shift = offset - (before.offset if before is not None else 0.0)
    wanted = moved(armature, target, anchor, wrist, places, onto.travel)
    wanted[:, :3, 3] += shift
    quats, locations = np.empty((len(wanted), 1, 4)), np.empty((len(wanted), 3))
    for row, matrix in enumerate(wanted):
        basis = channels_of(bone, matrix, parents[row])
        quats[row, 0], locations[row] = basis.to_quaternion(), basis.to_translation()
    keys = PoseKeys.everywhere(motion.frames, quats, locations if located else None)
    settings = onto.travel, onto.smoothing, onto.reference, onto.time_offset
    return BoneKeys(CharacterBones(armature, [control]), keys, noted, offset, settings)


def check_movable(armature: bpy.types.Object, control: str) -> None:
    """Raise OptionError where keys of the bone that moves a whole hand would be for nothing."""
    why = why_not_turned(armature, control)
    if why is not None:
        raise OptionError(
            f"the hand of {armature.name!r} cannot be moved: {why.removesuffix(': it was left alone')}"
        )


def is_located(bone: bpy.types.Bone, wrist: Wrist) -> bool:
    """True if the bone that moves a whole hand is moved, and not only turned."""
    return wrist == "PLACED" and not bone.use_connect


def moved(
    armature: bpy.types.Object,
    target: TargetHand,
    anchor: Anchor,
    wrist: np.ndarray,
    places: np.ndarray,
    travel: float,
) -> np.ndarray:
    """Return (T, 4, 4), how the bone that moves the whole hand is to stand in the armature's space.

    Let the captured wrist be turned by O (T, 3, 3) and lie at p (T, 3), and the character's hand bone be
    turned by Q from its rest and lie at x. In the anchor's moment the two are to look alike, which makes
    K = Q A O^T the rotation from the capture's space to the armature's. Then Q(t) = K O(t) A^T, and
    x(t) = x + s K (p(t) - p), with the palms' ratio s times the travel.
    """
    bones = armature.data.bones
    rest, own = (
        np.array(bones[name].matrix_local, dtype=np.float64)
        for name in (target.hand_map.bones[0], target.hand_map.moved_by)
    )
    turned = rotations_of(anchor.hand) @ rotations_of(rest).T
    space = turned @ target.aligned @ anchor.wrist.T
    turns = space @ wrist @ target.aligned.T
    found = np.broadcast_to(np.eye(4), (len(turns), 4, 4)).copy()
    found[:, :3, :3] = turns @ own[:3, :3]
    way = travel * target.scale * (places - anchor.place) @ space.T
    found[:, :3, 3] = anchor.hand[:3, 3] + way + turns @ (own[:3, 3] - rest[:3, 3])
    return found


def channels_of(bone: bpy.types.Bone, standing: np.ndarray, parent: np.ndarray) -> Matrix:
    """Return the channels, as a (4, 4) matrix relative to its rest, of a bone that stands so in the
    armature's space (4, 4), where its parent, if it has one, stands as `parent` says."""
    above = {}
    if bone.parent is not None:
        above = {"parent_matrix": Matrix(parent), "parent_matrix_local": bone.parent.matrix_local}
    return bone.convert_local_to_pose(Matrix(standing), bone.matrix_local, invert=True, **above)


def is_adjusted(armature: bpy.types.Object) -> bool:
    """True if the keys that were written for its hands themselves are as the panel's settings are now."""
    onto = TransferOptions.of(armature)
    for side in SIDES:
        found = written_keys(armature, side)
        if found is None:
            continue
        offset = onto.offsets.get(side, np.zeros(3)) if found.placed else np.zeros(3)
        settings = onto.travel, onto.smoothing, onto.reference
        if found.settings[:3] != settings or np.any(found.offset != offset):
            return False
    return True


def adjusting(
    armature: bpy.types.Object, hands: Sequence[tuple[HandMap, CapturedHand]]
) -> Generator[float, None, int]:
    """Rewrite the keys that were written for the hands themselves, as the panel's settings are
    now. Returns how many frames keep keys that the artist has made of them since. Raises HandfitError, before
    anything is changed."""
    onto, computed, kept = TransferOptions.of(armature), [], 0
    for hand_map, hand in hands:
        found = written_keys(armature, hand_map.side)
        if found is None or found.bone != hand_map.moved_by or found.placed != (onto.wrist == "PLACED"):
            continue
        if not found.action.is_editable:
            raise OptionError(f"the action {found.action.name!r} is linked from another file")
        motion = yield from map_yields(reading_motion(hand), lambda: 0.0)
        motion = motion.on(hand_map.side, found.time_offset)
        target, _, _ = prepared(armature, hand_map, motion.source, fingers_only=False)
        as_before = replace(onto, time_offset=found.time_offset)
        one = yield from _moving(armature, target, motion, as_before)
        there = nearest(found.table[:, 0], one.keys.frames)[1]
        whole = one.keys.only(there[:, None], there)
        own = without_artist_keys(armature, replace(one, keys=whole))
        kept += int((whole.rotation_keyed & ~own.keys.rotation_keyed).sum())
        if not own.keys.rotation_keyed.any():
            raise OptionError(
                f"all keys of the bone {found.bone} were changed since: press Apply to Character to replace "
                "them"
            )
        computed.append((found, own))
    for found, one in computed:
        run_to_completion(writing([one], channels(found.action, found.slot)))
        record_written_keys(armature, found.action, found.slot, one)
    return kept


def prepared(
    armature: bpy.types.Object, hand_map: HandMap, source: SourceHand, *, fingers_only: bool
) -> tuple[TargetHand, np.ndarray, list[str]]:
    """Return what keys of a character's hand, from motion of its own side, need: the hand, which of its bones
    can be keyed (K,) bool, and why the others cannot. Raises HandModelError and OptionError where keys would
    be for nothing."""
    check(armature, why_not_reachable(armature))
    found = troubles(armature, replace(hand_map, control="") if fingers_only else hand_map)
    if found:
        raise OptionError(found[0])
    target = target_hand(bones_of(armature), hand_map, source)
    reasons = [why_not_turned(armature, name) for name in target.bones]
    keyed = np.array([reason is None for reason in reasons])
    if not keyed.any():
        raise OptionError(
            f"none of the fingers of {armature.name!r} can be keyed: {next(filter(None, reasons))}"
        )
    return target, keyed, [reason for reason in reasons if reason is not None]


def why_not_turned(armature: bpy.types.Object, name: str) -> str | None:
    """Return why keys on a bone's rotation would be for nothing, or are not wanted; None where they count."""
    bone = armature.pose.bones[name]
    for constraint in bone.constraints:
        if constraint.type in _TURNING and constraint.enabled and constraint.influence > 0.0:
            return f"the bone {name} is turned by its constraint {constraint.name}: it was left alone"
    data = armature.animation_data
    start = f"{bone_path(name)}.rotation"
    if data is not None and any(driver.data_path.startswith(start) for driver in data.drivers):
        return f"the bone {name} is turned by a driver: it was left alone"
    if all(bone.lock_rotation) and (bone.lock_rotation_w or bone.rotation_mode != "QUATERNION"):
        return f"the rotation of the bone {name} is locked: it was left alone"
    if not armature.data.bones[name].use_inherit_rotation:
        return f"the bone {name} does not turn with its parent (Inherit Rotation is off): it was left alone"
    return None


def check_own_keys(armature: bpy.types.Object, into: Into) -> None:
    """Raise OptionError where keys that are put there could not be written, or would not be shown."""
    check_unlayered(armature)
    data = armature.animation_data
    if data is None:
        return
    if is_tweaked(armature):
        raise OptionError(
            f"{armature.name!r} has an NLA strip in tweak mode: leave it first (Tab in the NLA)"
        )
    if into == "ACTION":
        if data.action is not None and not data.action.is_editable:
            raise OptionError(
                f"the action {data.action.name!r} of {armature.name!r} is linked from another file: choose a "
                "new action, or make it local"
            )
        return
    solo = next((track.name for track in data.nla_tracks if track.is_solo), None)
    if solo is not None:
        raise OptionError(
            f"the NLA track {solo!r} of {armature.name!r} is solo, so that nothing else would be shown: "
            "switch its star off first"
        )
    if not data.use_nla and (into == "STRIP" or data.action is not None):
        raise OptionError(
            f"the NLA of {armature.name!r} is switched off, so that strips would not be shown: switch it "
            "on, or choose the present action"
        )


def _check_uncovered(armature: bpy.types.Object, keys: Sequence[BoneKeys]) -> None:
    """Raise OptionError where the present action, which lies above all strips, has curves of these bones."""
    paths = {curve.data_path for curve in present_curves(armature)}
    for one in keys:
        starts = tuple(f"{bone_path(name)}.rotation" for name in np.array(one.rig.bones)[one.keyed])
        if any(path.startswith(starts) for path in paths):
            raise OptionError(
                f"the present action of {armature.name!r} has keys of these bones too and lies above every "
                "strip: choose a new action or the present one"
            )


def _give(armature: bpy.types.Object, action: bpy.types.Action, slot: Any, into: Into) -> None:
    """Have the armature use a finished action."""
    data = armature.animation_data or armature.animation_data_create()
    if into == "STRIP":
        add_strip(data, action, slot)
        return
    if data.action is not None:
        push_down(data)
    use_action(data, action, slot)


def hand_messages(armature: bpy.types.Object, side: Side, wanted: bool) -> list[tuple[str, str]]:
    """Return sentences, with their icons, about what a hand was taken for and what stands in its way.

    That the character lacks it is no error where nothing would move it, and the other hand is known."""
    messages = []
    if is_damaged(armature, side):
        text = "The kept table of this hand is damaged and not used: press Bones > Recognise Again"
        messages.append((text, "ERROR"))
    try:
        hand_map = hand_map_of(armature, side)
    except HandModelError as error:
        lacked = not wanted and table_of(armature, other_side(side)).mapped
        return [*messages, (capitalised(str(error)), "INFO" if lacked else "ERROR")]
    try:
        rig, kept, used = hand_map.rig or "Unknown rig", kept_map(armature, side), rig_used(armature, side)
        if kept is not None:
            messages.append((f"{rig}, with your own table", "CHECKMARK"))
        elif used is not None:
            messages.append((used.label, "CHECKMARK"))
        elif (sure := recognised(armature, side).sure) >= _SURE:
            messages.append((f"{rig}, for sure", "CHECKMARK"))
        elif sure < DOUBTFUL:
            messages.append(("This may be no hand: look at Bones below", "ERROR"))
        else:
            doubt = "likely" if sure >= _LIKELY else "perhaps"
            messages.append((f"{rig}, {doubt}: look at Bones below", "QUESTION"))
        hand_map.check(armature.data.bones)
        if keyless := without_keys(armature, hand_map).get(UNKNOWN):
            messages.append((capitalised(said_without_keys({UNKNOWN: keyless})), "INFO"))
        if kept is None and used is None and (but := recognised(armature, side).but):
            messages.append((capitalised(but), "INFO"))
    except HandModelError as error:
        return [*messages, (capitalised(str(error)), "ERROR")]
    if armature.manient.character.wrist == "FINGERS":
        hand_map = replace(hand_map, control="")
    messages += [(text, "ERROR") for text in map(_capitalised_name_kept, troubles(armature, hand_map))]
    reasons = [why for name in hand_map.keyed if (why := why_not_turned(armature, name)) is not None]
    if reasons:
        more = f", and {counted(len(reasons) - 1, 'other bone')} too" if len(reasons) > 1 else ""
        text = _capitalised_name_kept(reasons[0].removesuffix(": it was left alone"))
        messages.append((f"{text}: it is left alone{more}", "INFO"))
    return messages


def _capitalised_name_kept(sentence: str) -> str:
    """Return a sentence with a capital letter, except where it begins with a bone's name."""
    return sentence if set("._") & set(sentence.partition(" ")[0]) else sentence[:1].upper() + sentence[1:]
