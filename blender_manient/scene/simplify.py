"""Fewer keys on a captured hand, or on a character's, and every one of them back.

The keys that are left go into a copy of the action. The action with all keys is kept beside it, and the copy
names it in a custom property: whoever has the copy can go back. `handfit_core.edit.simplify` has the
mathematics.
"""

from __future__ import annotations

import contextlib
import hashlib
from collections.abc import Generator, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import bpy
import numpy as np

from handfit_core.common.errors import OptionError
from handfit_core.common.skeleton import FINGER_JOINTS, FINGERS, NUM_JOINTS, SIDES
from handfit_core.edit.simplify import LOCATION, Channels, Sight, Simplified, simplifying
from handfit_core.geometry.rotations import channels_to_quat, unflip_quats
from handfit_core.retarget.hand_map import PALM_FINGERS, HandMap
from handfit_core.retarget.transfer import SourceHand

from ..common.blender_versions import action_slot, channels, property_group, used_actions
from ..common.wording import with_note
from ..rigs.arm import ArmBones, has_arm
from ..rigs.character import CharacterBones
from ..rigs.rig import PosedBones
from . import corrections
from .actions import curves_in, motion_user, same_slot, use_action
from .characters import active_character, table_of
from .editable import check_keyable
from .keys import (
    channel_values,
    check_unlocked,
    frames_between,
    nearest,
    pose_at,
    read_pose_keys,
    replace_keys,
)
from .store import CapturedHand, active_hand, hand_of

DENSE = "manient_all_keys"
"""Custom property of an action with fewer keys that points to the action with all of them"""
_NOTE = "manient_simplified"
"""Custom property of an action with fewer keys with what is needed to tell whether it was changed since, and
to go back"""
_MOST_FRAMES = 100_000
PARTS = (*FINGERS, "wrist")
"""The parts of a hand that can be simplified by themselves: each finger, and the place and rotation of the
hand"""


@dataclass(frozen=True)
class Bounds:
    """The bounds within which a motion is simplified."""

    degrees: float = 2.0
    pixels: float = 2.0
    """How far points may move in the picture, in pixels; not asked for where no camera saw the hand"""
    together: str = "FINGER"
    """Which bones have their keys on common frames: ALL, those of each FINGER, or nothing but each BONE by
    itself"""
    parts: frozenset[str] = frozenset(PARTS)
    """the names of `PARTS` to simplify; the others keep their keys"""


@dataclass(frozen=True, eq=False)
class Hand:
    """A hand whose keys can be simplified."""

    rig: PosedBones
    parts: tuple[str, ...]
    """the part, one of `PARTS`, that each bone belongs to"""
    captured: CapturedHand | None = None


@dataclass(frozen=True, eq=False)
class Thinned:
    """Fewer keys for a hand, not written yet."""

    hand: Hand
    frames: np.ndarray
    """(N,) scene frames on which the curves were compared"""
    chosen: tuple[int | None, ...]
    """The bones that get the keys of `result.splines`, in this order; None: the first one's location"""
    before: int
    """the number of keys that the chosen bones' channels had"""
    result: Simplified
    made_of: str
    """`state_of` the hand when it was read"""

    @property
    def after(self) -> int:
        """Return the number of keys that the chosen bones' channels will have."""
        return sum(spline.values.size for spline in self.result.splines)


def hands_to_simplify(context: bpy.types.Context) -> list[Hand]:
    """Return the active captured hand and its arm, else the hands of the active character; none where there
    is neither."""
    armature, captured = active_character(context), active_hand(context)
    if captured is not None and (armature is None or hand_of(context.active_object) is not None):
        parts = ["wrist"] * NUM_JOINTS
        for finger, joints in FINGER_JOINTS.items():
            for joint in joints:
                parts[joint] = finger
        hands = [Hand(captured.rig, tuple(parts), captured)]
        if has_arm(captured.armature):  # which goes with the wrist
            hands.append(Hand(ArmBones(captured.armature), ("wrist",) * 2))
        return hands
    tables = [table_of(armature, side) for side in SIDES] if armature is not None else []
    return [_of_character(armature, table) for table in tables if table.mapped]


def _of_character(armature: bpy.types.Object, hand_map: HandMap) -> Hand:
    parts = {hand_map.moved_by: "wrist"}
    parts |= dict(zip(hand_map.palm, PALM_FINGERS, strict=True))
    for finger, joints in FINGER_JOINTS.items():
        parts |= {hand_map.bones[joint]: finger for joint in joints}
    names = [hand_map.moved_by, *(name for name in hand_map.keyed if name != hand_map.moved_by)]
    return Hand(CharacterBones(armature, names), tuple(parts[name] for name in names))


def thinning(hand: Hand, bounds: Bounds) -> Generator[int, None, Thinned]:
    """Find fewer keys for a hand, in steps; nothing is changed. What was simplified before and not changed
    since is simplified from all its keys again. Blender is read before the first step only.

    Raises OptionError where there is nothing to simplify, or it could not be written, and TakeError.
    """
    armature, rig = hand.rig.armature, hand.rig
    check_keyable(armature)
    action, slot = _source(armature)
    holder = channels(action, slot) if action is not None else None
    if holder is None:
        raise OptionError(f"{armature.name!r} has no keys to simplify")
    keys = read_pose_keys(rig, holder=holder)
    wanted = [part in bounds.parts for part in hand.parts]
    chosen: list[int | None] = [*np.flatnonzero(keys.rotation_keyed.any(axis=0) & np.array(wanted)).tolist()]
    if keys.location_keyed.any() and wanted[0]:
        chosen.append(None)
    if not chosen:
        raise OptionError(f"{armature.name!r} has no keys to simplify on the chosen parts")
    check_unlocked(rig, joints=[j for j in chosen if j is not None], location=None in chosen)
    own = [keys.location_keyed if j is None else keys.rotation_keyed[:, j] for j in chosen]
    keyed = keys.frames[np.any(own, axis=0)]
    frames = frames_between(keyed) if keyed[-1] - keyed[0] < _MOST_FRAMES else keyed
    values, places = channel_values(rig, frames, holder=holder)
    groups = _groups([hand.parts[j or 0] for j in chosen], bounds.together)
    asked = []
    for joint, group in zip(chosen, groups, strict=True):
        if joint is None:
            arm = max(float(armature.data.bones[rig.bones[0]].length), 1e-6)
            asked.append(Channels(places, "LOCATION", group, arm, LOCATION))
            continue
        mode, own_values = armature.pose.bones[rig.bones[joint]].rotation_mode, values[joint]
        if mode == "QUATERNION":
            own_values = unflip_quats(channels_to_quat(own_values, mode))
        asked.append(Channels(own_values, mode, group, joint=joint))
    kept: Sequence[int] = ()
    sight = None
    if hand.captured is not None:
        rows, there = nearest(frames, corrections.corrected_places(armature))
        kept = rows[there].tolist()
        shaped = hand.captured.shaped()
        quats, _ = pose_at(rig, frames, holder=holder)
        source = SourceHand.of(shaped, hand.captured.side)
        sight = Sight(hand.captured.rig.rest, source, hand.captured.take.intrinsics, quats, places)
    before = sum(int(keys.sum()) * track.values.shape[1] for keys, track in zip(own, asked, strict=True))

    made_of = state_of(hand)

    def steps() -> Generator[int, None, Thinned]:
        found = simplifying(frames, asked, bounds.degrees, bounds.pixels, sight=sight, kept=kept)
        return Thinned(hand, frames, tuple(chosen), before, (yield from found), made_of)

    return steps()


def state_of(hand: Hand) -> str:
    """Return a digest of all that `thinning` reads of a hand: its keys, above all."""
    armature, data = hand.rig.armature, hand.rig.armature.animation_data
    users = (
        [] if data is None or data.action is None else [(data.action, action_slot(data)), _source(armature)]
    )
    pose = armature.pose.bones
    modes = [pose[name].rotation_mode for name in hand.rig.bones if name in pose]
    betas = [] if hand.captured is None else hand.captured.betas.tolist()
    state = [*(_digest(*user) for user in users), corrections.corrections_text(armature), modes, betas]
    return hashlib.sha256(repr(state).encode()).hexdigest()


def _groups(parts: Sequence[str], together: str) -> list[int]:
    """Return for each channel, given its part, the number of its group: channels of one group have their keys
    on common frames."""
    names = list(dict.fromkeys(parts))
    if together == "BONE":
        return list(range(len(parts)))
    return [names.index(part) if together == "FINGER" else 0 for part in parts]


def write(armature: bpy.types.Object, thinned: Sequence[Thinned]) -> None:
    """Give an armature a copy of its action with fewer keys on these hands, and keep the one with all keys.

    Raises OptionError and HandModelError as `thinning` does, before anything is changed.
    """
    check_keyable(armature)
    for one in thinned:
        check_unlocked(
            one.hand.rig, joints=[j for j in one.chosen if j is not None], location=None in one.chosen
        )
    data = armature.animation_data
    present, (dense, _) = data.action, _source(armature)
    note = _note(present)
    if dense is present:
        note = {"name": dense.name, "fake_user": dense.use_fake_user}
    action = present.copy()  # other parts may have been simplified before
    use_action(data, action, action_slot(data))
    for one in thinned:
        for joint, spline in zip(one.chosen, one.result.splines, strict=True):
            before, behind = spline.handles(one.frames)
            replace_keys(one.hand.rig, joint, one.frames[spline.rows], spline.values, before, behind)
    if dense is not present:
        remove_unused(present)
    elif dense.users == dense.use_fake_user:  # nobody else has it, who would miss its name
        dense.name = with_note(note["name"], "(all keys)")
    dense.use_fake_user = True
    action.name = note["name"]
    action[DENSE] = dense
    action[_NOTE] = {**note, "digest": _digest(action, action_slot(data))}


def kept_action(armature: bpy.types.Object) -> bpy.types.Action | None:
    """Return the action with all keys behind the present one; None where there is none."""
    data = armature.animation_data
    return _dense_action(data.action) if data is not None else None


def own_kept_actions(armature: bpy.types.Object) -> list[tuple[bpy.types.Action, Any]]:
    """Return all actions with more keys behind the motion, each with the armature's slot. Those that
    something else uses too are copied first."""
    user, found = motion_user(armature), []
    action = user.action if user is not None else None
    while (dense := _dense_action(action)) is not None and dense not in [one for one, _ in found]:
        assert action is not None
        if dense.library is not None or dense.users - dense.use_fake_user > 1:
            dense = dense.copy()
            action[DENSE] = dense
        found.append((dense, same_slot(dense, action_slot(user))))
        action = dense
    return found


def all_actions(armature: bpy.types.Object) -> list[tuple[bpy.types.Action, Any]]:
    """Return all actions of an armature that can be changed, and those behind its motion, each with its slot:
    for who changes all keys alike."""
    return [*used_actions(armature), *own_kept_actions(armature)]


@contextlib.contextmanager
def keeping_simplified(armature: bpy.types.Object) -> Iterator[None]:
    """Have what is done within to the keys of an armature's motion be done to those of the actions behind it
    too: motion that was not changed since it was simplified still counts as not changed afterwards."""
    user = motion_user(armature)
    same = user is not None and _dense_action(user.action) is not None and _is_unchanged(user)
    yield
    if same:
        user = motion_user(armature)
        user.action[_NOTE]["digest"] = _digest(user.action, action_slot(user))


def _is_unchanged(user: Any) -> bool:
    """True if an action with fewer keys is as Simplify has left it."""
    return _digest(user.action, action_slot(user)) == _note(user.action)["digest"]


def _dense_action(action: bpy.types.Action | None) -> bpy.types.Action | None:
    dense = action.get(DENSE) if action is not None else None
    return dense if isinstance(dense, bpy.types.Action) else None


def restore(armature: bpy.types.Object) -> bpy.types.Action | None:
    """Give an armature its action with all keys back, as it was, with the corrections of the hand since then.

    Returns the one with fewer keys where it was changed since it was made: then it is kept beside. Raises
    OptionError where there is nothing to go back to.
    """
    check_keyable(armature)
    dense = kept_action(armature)
    if dense is None:
        raise OptionError(f"{armature.name!r} has all its keys: nothing was simplified in this action")
    data = armature.animation_data
    present, slot = data.action, action_slot(data)
    note, changed = _note(present), not _is_unchanged(data)
    with corrections.corrections_carried(armature):
        use_action(data, dense, slot)
    dense.use_fake_user = note["fake_user"]
    if changed:
        present.name = with_note(note["name"], "(fewer keys)")
        present.use_fake_user = True
        forget_all_keys(present)
    else:
        remove_unused(present)
    dense.name = note["name"]
    dense.update_tag()
    return present if changed else None


def remove_unused(action: bpy.types.Action) -> None:
    """Remove an action, unless another object or a strip uses it, too."""
    if action.users - action.use_fake_user == 0:
        bpy.data.actions.remove(action)


def forget_all_keys(action: bpy.types.Action) -> None:
    """Have an action be one of its own, behind which there is no other."""
    for name in (DENSE, _NOTE):
        if name in action:
            del action[name]


def _source(armature: bpy.types.Object) -> tuple[Any, Any]:
    """Return the action, and its slot, that is to be simplified: the present one, or where that was
    simplified and not changed since, the one with all keys."""
    data = armature.animation_data
    if data is None or data.action is None:
        return None, None
    action, slot = data.action, action_slot(data)
    dense = kept_action(armature)
    if dense is None or not _is_unchanged(data):
        return action, slot
    return dense, same_slot(dense, slot)


def _note(action: bpy.types.Action) -> dict[str, Any]:
    """Return the note that was made when an action was simplified; for an action without one, or with
    another's, the note that does least."""
    noted = property_group(action, _NOTE)
    return {
        "name": str(noted.get("name", action.name)),
        "fake_user": bool(noted.get("fake_user", True)),
        "digest": str(noted.get("digest", "")),
    }


def _digest(action: bpy.types.Action, slot: Any) -> str:
    """Return a digest of an action's keys."""
    found = hashlib.sha256()
    for curve in sorted(curves_in(channels(action, slot)), key=lambda c: (c.data_path, c.array_index)):
        points = curve.keyframe_points
        found.update(f"{curve.data_path} {curve.array_index} {len(points)} ".encode())
        places = np.empty((len(points), 2), dtype=np.float32)
        for name in ("co", "handle_left", "handle_right"):
            points.foreach_get(name, places.ravel())
            found.update(places.tobytes())
    return found.hexdigest()[:16]
