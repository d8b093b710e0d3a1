"""Putting captured motion, or one pose of it, on a captured hand that is there already.

The target keeps its shape: fingers get the source's rotations, the wrist its place. A source of the other
side is mirrored about the vertical plane through its camera (x = 0 of the armature's own space).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Literal

import bpy
import numpy as np

from handfit_core.capturing.retiming import sampled
from handfit_core.common.errors import HandModelError, OptionError
from handfit_core.common.skeleton import NUM_JOINTS
from handfit_core.hand_model.files import kept_model
from handfit_core.hand_model.motion import HandMotion
from handfit_core.take import HandTrack, Take, at_rows

from .controls import shown_keys, shown_pose
from .corrections import end_corrections
from .editable import check_editable, check_keyable, check_unlayered
from .keys import (
    PoseKeys,
    align_signs,
    check_unlocked,
    frames_between,
    is_smooth,
    remove_pose_keys,
    write_pose_keys,
)
from .store import CapturedHand, captured_take, clip_timing, hand_of, scene_frames, timing_of
from .timing import Timing, in_scene

Mode = Literal["ANIMATION", "POSE"]


def apply_track(
    obj: bpy.types.Object,
    take: Take,
    track: HandTrack,
    mode: Mode,
    frame: float,
    *,
    source_frame: int | None = None,
    wrist: bool | None = None,
    timing: Timing | None = None,
) -> int:
    """Key a captured hand of a take on the captured hand `obj`. Returns how many frames were keyed.

    ANIMATION replaces the keys from the source's first frame to its last, and none outside. A take of the
    target's own pictures keeps their timing; any other one lies where `timing` says, or begins at the scene's
    `frame`, at the speed at which it was filmed. POSE keys one frame of the take, the one nearest to
    `source_frame` (None: the first with a hand), at the scene's `frame`. `wrist` says whether the wrist's
    place and rotation are applied too; None means yes, except for poses from other pictures, which would make
    the hand jump.

    Raises OptionError and HandModelError.
    """
    hand = _checked(obj, mode)
    own = tuple(take.source.files) == tuple(hand.take.source.files)
    rows = np.flatnonzero(track.present)
    if len(rows) == 0:
        raise OptionError(f"the {track.side} hand of {take.source.name} is in no frame, so there is no pose")
    if mode == "POSE":
        numbers = np.asarray(take.frame_numbers)[rows]
        wanted = numbers[0] if source_frame is None else source_frame
        rows, frames = rows[[int(np.argmin(np.abs(numbers - wanted)))]], np.array([frame])
    else:
        if own or timing is None:
            take, track, frames = _in_scene(hand, take, track, frame, own=own)
        else:
            frames = timing.scene_frames(take.frame_numbers)
        rows = np.flatnonzero(track.present)
        if len(rows) == 0:
            raise OptionError(
                f"the take of {take.source.name} has none of the frames of {hand.armature.name!r}"
            )
        frames = frames[rows]
    wrist_at_rest = _source_wrist(take, track, hand)
    keys = PoseKeys.everywhere(frames, *hand.to_bones(at_rows(track, rows), wrist_at_rest))
    return _apply(hand, keys, mode, mode == "ANIMATION" or own if wrist is None else wrist)


def apply_hand(
    obj: bpy.types.Object, source: bpy.types.Object, mode: Mode, frame: float, *, wrist: bool = True
) -> int:
    """Key another captured hand's motion on the captured hand `obj`: its keys as the artist left them, on
    their frames (POSE: its pose at the scene's `frame`). Returns how many frames were keyed. Raises as
    `apply_track`."""
    hand, other = _checked(obj, mode), _captured(source)
    check_unlayered(other.armature)
    if hand.armature == other.armature:
        raise OptionError(
            f"{hand.armature.name!r} is the hand that gets the motion; choose another one to take it from"
        )
    if mode == "POSE":
        frames = np.array([frame])
        keys = PoseKeys.everywhere(frames, *shown_pose(other.rig, frames))
    else:
        # Each bone gets its own keys, not one on every frame on which any other bone has one.
        keys = shown_keys(other.rig)
        if len(keys.frames) == 0:
            raise OptionError(f"{other.armature.name!r} has no keys to copy; apply its pose instead")
        if is_smooth(other.rig):  # what lies between keys would be lost
            frames, own = frames_between(keys.frames), keys
            keys = PoseKeys.everywhere(frames, *shown_pose(other.rig, frames))
            turns = np.asarray(own.rotation_keyed.any(axis=0))
            keys = keys.only(turns, bool(own.location_keyed.any()))
    return _apply(hand, keys.turned(other.rig.rest, hand.rig.rest), mode, wrist)


def apply_pose(obj: bpy.types.Object, motion: HandMotion, frame: float) -> None:
    """Key the fingers of a motion of one frame on the captured hand `obj` at the scene's `frame`. Raises
    OptionError and HandModelError."""
    hand = _checked(obj, "POSE")
    _apply(hand, PoseKeys.everywhere(np.array([frame]), *hand.to_bones(motion)), "POSE", wrist=False)


def _in_scene(
    hand: CapturedHand, take: Take, track: HandTrack, frame: float, *, own: bool
) -> tuple[Take, HandTrack, np.ndarray]:
    """Return the take and its track with rows where the scene gets keys, and the (N,) scene frames of these
    rows: those of the target's own pictures, else from `frame` on."""
    if not own:
        take, timing, _ = in_scene(bpy.context.scene, replace(take, hands=(track,)), frame)
        return take, take.hands[0], timing.scene_frames(take.frame_numbers)
    if captured_take(hand.collection) is hand.take:
        return take, track, timing_of(hand.collection).scene_frames(take.frame_numbers)
    frames = scene_frames(hand.collection, hand.take)
    times = clip_timing(hand.collection).source_frames(frames)
    inside = (times >= take.frame_numbers[0]) & (times <= take.frame_numbers[-1])
    return take, sampled(track, np.asarray(take.frame_numbers), times[inside]), frames[inside]


def track_for(take: Take, side: str) -> HandTrack:
    """Return the take's hand of that side, else its first hand, which is then mirrored. Raises
    OptionError."""
    if not take.hands:
        raise OptionError(f"the take of {take.source.name} has no hand in it")
    return next((t for t in take.hands if t.side == side), take.hands[0])


def _captured(obj: bpy.types.Object) -> CapturedHand:
    hand = hand_of(obj)
    if hand is None:
        raise OptionError(f"{obj.name!r} is no captured hand; choose one that a capture or an import made")
    hand.rig.check()
    return hand


def _checked(obj: bpy.types.Object, mode: Mode) -> CapturedHand:
    hand = _captured(obj)
    data = hand.armature.animation_data
    if mode == "POSE" or (data is not None and (data.action is not None or data.use_tweak_mode)):
        check_keyable(hand.armature)
    else:
        check_editable(hand.armature)  # a whole motion may well lie over strips in the NLA
    return hand


def _source_wrist(take: Take, track: HandTrack, hand: CapturedHand) -> np.ndarray:
    """Return where the source's wrist is before it is moved: (3,) metres in the hand model's frame."""
    try:
        return kept_model(take.model, track.side).shaped(track.betas).joints[0]
    except HandModelError:
        # Its model file is not here. The target's stands in: wrists of one size differ by millimetres.
        return kept_model(hand.take.model, track.side).shaped(track.betas).joints[0]


def _apply(hand: CapturedHand, keys: PoseKeys, mode: Mode, wrist: bool) -> int:
    joints: Sequence[int] = range(NUM_JOINTS)
    if not wrist:
        joints = range(1, NUM_JOINTS)
        keys = keys.only(np.arange(NUM_JOINTS) > 0, False)
    rig = hand.rig
    first, last = float(keys.frames[0]), float(keys.frames[-1])
    check_unlocked(rig, joints=list(joints), location=wrist)
    end_corrections(
        hand.armature,
        timing_of(hand.collection).source_frames(np.array([first, last])).tolist(),
        whole=True,
        joints=joints,
        location=wrist,
    )
    if mode == "ANIMATION":
        remove_pose_keys(rig, first, last, joints=list(joints), location=wrist)
    write_pose_keys(rig, keys)
    align_signs(rig)
    return len(keys.frames)
