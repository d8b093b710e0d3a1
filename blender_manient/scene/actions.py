"""The actions that move an object, the present one and those of its NLA strips, and how they are exchanged.

A *user* is what uses an action: the object's animation data, or a strip. `blender_versions` knows slots.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import bpy
import numpy as np

from handfit_core.common.errors import OptionError

from ..common.blender_versions import action_slot, channels, users_of

BELOW = "manient_below"
"""Custom property of an action that lies as a layer on another one: the name of that one (scene/layer.py)"""


def strips_of(obj: bpy.types.Object) -> list[bpy.types.NlaStrip]:
    """Return all NLA strips of an object, from the bottom."""
    tracks = obj.animation_data.nla_tracks if obj.animation_data is not None else ()
    return [strip for track in tracks for strip in track.strips]


def channels_of(user: Any, *, make: bool = False) -> Any:
    """Return what holds the curves of a user's action; None where there is nothing, unless `make`."""
    return channels(user.action, action_slot(user), make=make) if user and user.action else None


def curves_in(holder: Any) -> list[bpy.types.FCurve]:
    """Return the curves of what `channels_of` gives; none of None."""
    return [] if holder is None else list(holder.fcurves)


def present_curves(obj: bpy.types.Object) -> list[bpy.types.FCurve]:
    """Return the curves of an object's present action."""
    return curves_in(channels_of(obj.animation_data))


def is_tweaked(armature: bpy.types.Object) -> bool:
    """True if an NLA strip of the armature is being edited, whose action has a time of its own."""
    data = armature.animation_data
    return data is not None and data.use_tweak_mode


def is_layered(armature: bpy.types.Object) -> bool:
    """True if the active action is only added to what lies below it in the NLA, so that its keys are no
    poses."""
    data = armature.animation_data
    return data is not None and data.action is not None and data.action_blend_type != "REPLACE"


def strip_below(armature: bpy.types.Object) -> Any:
    """Return the NLA strip with the motion on which the active action lies as a layer; None where it does
    not."""
    motion = armature.animation_data.action.get(BELOW) if is_layered(armature) else None
    return next((strip for strip in strips_of(armature) if motion and strip.action == motion), None)


def motion_user(armature: bpy.types.Object) -> Any:
    """Return the user of the action with the armature's motion: a strip below a layer, else the armature's
    animation data, else its topmost strip; None where there is none."""
    return strip_below(armature) or next(iter(users_of(armature)), None)


def same_slot(action: bpy.types.Action, slot: Any) -> Any:
    """Return the slot of an action that has the name of this one; None where there is none."""
    return next((s for s in action.slots if s.identifier == slot.identifier), None) if slot else None


def use_action(user: Any, action: bpy.types.Action, slot: Any) -> None:
    """Have a user take an action, with the slot that has the name of this one."""
    same = same_slot(action, slot)
    user.action = action
    if same is not None:
        user.action_slot = same


def own_action(armature: bpy.types.Object, *, nla: bool = False) -> None:
    """Copy the armature's action where other objects use it too, or where it is linked from another file.

    `nla` does the same with the actions of its NLA strips. Raises OptionError in the NLA's tweak mode, in
    which Blender lets nobody exchange actions.
    """
    data = armature.animation_data
    copies: dict[bpy.types.Action, bpy.types.Action] = {}
    for user in users_of(armature):
        action, slot = user.action, action_slot(user)
        if (user != data and not nla) or (action.library is None and not _is_shared(armature, action, slot)):
            continue
        if is_tweaked(armature):
            raise OptionError(
                f"the action {action.name!r} of {armature.name!r} is used by another object too: leave the "
                "NLA's tweak mode first, so that this hand can get one of its own"
            )
        if action not in copies:
            copies[action] = action.copy()
        use_action(user, copies[action], slot)
    for action, copy in copies.items():
        if data.action is not None and data.action.get(BELOW) == action:
            data.action[BELOW] = copy


def own_data(obj: bpy.types.Object) -> None:
    """Copy an object's data where other objects use it too, or where it is linked from another file."""
    if obj.data.users - obj.data.use_fake_user > 1 or obj.data.library is not None:
        obj.data = obj.data.copy()


def _is_shared(armature: bpy.types.Object, action: bpy.types.Action, slot: Any) -> bool:
    """True if another object uses that slot of an action."""
    others = bpy.data.objects if action.users - action.use_fake_user > 1 else ()
    users = (user for other in others if other != armature for user in users_of(other))
    return any(user.action == action and action_slot(user) == slot for user in users)


def push_down(data: bpy.types.AnimData) -> None:
    """Put the present action on a new NLA track, where it goes on doing what it did in the scene's range."""
    action, slot, scene = data.action, action_slot(data), bpy.context.scene
    how = data.action_blend_type, data.action_influence, data.action_extrapolation
    data.action = None
    # Curves may go on beyond their keys, in circles or straight on.
    strip = add_strip(data, action, slot, (scene.frame_start, scene.frame_end))
    strip.blend_type, strip.influence, strip.extrapolation = how
    data.action_blend_type, data.action_influence, data.action_extrapolation = "REPLACE", 1.0, "HOLD"


def add_strip(
    data: bpy.types.AnimData, action: bpy.types.Action, slot: Any, reach: Sequence[float] = ()
) -> bpy.types.NlaStrip:
    """Put an action on a new track on top of the NLA, where its keys are, or as far as it is to `reach`."""
    own = tuple(action.curve_frame_range)  # frame_range may be what an artist says
    first, last = min(*own, *reach), max(*own, *reach)
    track = data.nla_tracks.new()
    track.name = action.name
    strip = track.strips.new(action.name, int(np.floor(first)), action)
    if slot is not None:
        strip.action_slot = slot
    strip.use_sync_length = False
    strip.action_frame_start, strip.action_frame_end = first, max(last, first + 1.0)
    strip.frame_start, strip.frame_end = first, max(last, first + 1.0)
    return strip
