"""The arms of captured hands, as bones and keys."""

from __future__ import annotations

import contextlib
from collections.abc import Generator
from dataclasses import replace
from typing import Any

import bpy
import numpy as np

from handfit_core.capturing.retiming import retimed
from handfit_core.common.errors import HandModelError, OptionError
from handfit_core.common.slices import run_to_completion
from handfit_core.hand_model.arm import ArmMotion
from handfit_core.hand_model.forearm import with_wrist
from handfit_core.take import Take

from ..common.blender_versions import channels
from ..rigs.arm import ArmBones, has_arm
from ..rigs.rig import Rig
from .actions import own_data
from .editable import check, why_not_bakeable
from .keys import PoseKeys, writing_pose_keys
from .mesh import follow_arm
from .own_scene import object_mode
from .reshape import reshape
from .simplify import keeping_simplified, own_kept_actions
from .store import CapturedHand, captured_take, hand_of, keep_take, keeping_take, kept_take, scene_frames


def check_lacks_arms(collection: bpy.types.Collection) -> None:
    """Raise OptionError where no hand of a capture can be given an arm."""
    hands = hands_of(collection)
    if all(hand.track.no_arm or has_arm(hand.armature) for hand in hands):
        reasons = (hand.track.no_arm for hand in hands if hand.track.no_arm)
        raise OptionError(next(reasons, "these hands have arms already"))
    for hand in hands:
        check(hand.armature, why_not_bakeable(hand.armature))


def keying_arm(
    rig: Rig, arm: ArmMotion, frames: np.ndarray, *, holder: Any = None
) -> Generator[float, None, None]:
    """Key the bones of a rig's arm on scene frames (T,), in its present action or in the channels `holder`, a
    bone per step; yields how much is done, 0..1."""
    bones = ArmBones(rig.armature)
    keys = PoseKeys.everywhere(frames[arm.present], *bones.to_bones(arm, rig.rest.origin))
    yield from writing_pose_keys(lambda: bones, keys, holder=holder)


def add_arm(hand: CapturedHand) -> None:
    """Give a hand without one the arm that its take has. Nothing else of it changes. Raises OptionError where
    it cannot be keyed."""
    armature, arm = hand.armature, hand.track.arm
    if arm is None or has_arm(armature):
        return
    check(armature, why_not_bakeable(armature))
    with object_mode():
        own_data(armature)
        hand.rig.add_arm(arm.lengths)
    if armature.manient.wrist != "open":
        armature.manient.forearm = True
    if hand.mesh is not None:
        with contextlib.suppress(HandModelError):
            reshape(armature)
            follow_arm(hand.mesh, with_wrist(hand.model(), armature.manient.wrist), armature)
    frames = scene_frames(hand.collection, hand.take)
    with keeping_simplified(armature):
        run_to_completion(keying_arm(hand.rig, arm, frames))
        for kept in own_kept_actions(armature):
            run_to_completion(keying_arm(hand.rig, arm, frames, holder=channels(*kept, make=True)))


def add_arms(collection: bpy.types.Collection, found: Take) -> None:
    """Have a capture know the arms of `found`, its captured take with arms, and give its hands these. Raises
    OptionError where one cannot be keyed, and then changes nothing."""
    check_lacks_arms(collection)
    kept, captured = kept_take(collection), captured_take(collection)
    if captured is not kept:
        run_to_completion(keeping_take(collection, found, captured=True))
        found = retimed(found, kept.fps / captured.fps)
    own = zip(kept.hands, found.hands, strict=False)  # the kept take may have hands that were added since
    hands = [replace(track, arm=with_arm.arm, no_arm=with_arm.no_arm) for track, with_arm in own]
    keep_take(collection, replace(kept, hands=(*hands, *kept.hands[len(hands) :])))
    for hand in hands_of(collection):
        add_arm(hand)


def hands_of(collection: bpy.types.Collection) -> list[CapturedHand]:
    """Return the captured hands of a collection's take."""
    armatures = [obj for obj in collection.all_objects if obj.type == "ARMATURE"]
    return [hand for hand in map(hand_of, armatures) if hand is not None and hand.collection == collection]
