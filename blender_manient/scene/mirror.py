"""The opposite hand of a captured one: mirrored rig, pose and keys."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import bpy
import numpy as np

from handfit_core.common.skeleton import other_side
from handfit_core.hand_model import HandModel, axes
from handfit_core.hand_model.axes import MIRROR_X, mirrored_pose
from handfit_core.hand_model.files import kept_model
from handfit_core.hand_model.forearm import with_wrist
from handfit_core.hand_model.motion import HandMotion
from handfit_core.take import HandTrack

from ..common.blender_versions import action_slot, assign_action
from ..common.wording import hand_part, named_after
from ..rigs.arm import ArmBones, has_arm
from ..rigs.captured_hand import build_rig
from ..rigs.rig import Rig, bone_path
from .actions import channels_of, curves_in
from .arms import add_arm
from .corrections import forget_corrections
from .editable import check_unlayered
from .keys import change_places, displayed_pose, read_pose_keys, set_pose, write_pose_keys
from .mesh import adding_correctives, build_mesh
from .simplify import forget_all_keys
from .store import CapturedHand, describe_hand, hand_of, keep_take

_GAP = 0.01
"""Metres between a hand that reaches across the middle and the mirror beside it"""


def mirror_hand(hand: CapturedHand) -> bpy.types.Object:
    """Build the opposite hand beside a captured one, in its collection. Returns its armature.

    It has the same betas, the mirrored pose, and a copy of the present action with every key mirrored. The
    mirror is the vertical plane through the camera (x = 0 of the armature's space); where the hand
    reaches across it, a plane beside the hand, so that the two never overlap. The kept take gets the mirrored
    track, whose frames count as filled: nothing of that hand was detected. Raises HandModelError, and
    OptionError where a layer lies on its motion.
    """
    side = other_side(hand.side)
    model, source_model = (kept_model(hand.take.model, s) for s in (side, hand.side))
    source, own = hand.armature, hand.rig
    betas = hand.betas
    shaped = model.shaped(betas)
    check_unlayered(source)
    keys = read_pose_keys(own)
    present = displayed_pose(own)
    present_place = np.array(source.pose.bones[own.bones[0]].location)
    plane = _plane(hand, source_model, betas, keys.quats, keys.locations, present, present_place)

    others = [o.manient for o in hand.collection.objects if o.manient.is_hand]
    part = hand_part(side, sum(other.side == side for other in others))
    rig = build_rig(named_after(hand.collection.name, part), shaped, side)
    armature = rig.armature
    armature.manient.origin = source.manient.origin
    for collection in source.users_collection:
        collection.objects.link(armature)
    armature.parent, armature.parent_type = source.parent, source.parent_type
    armature.matrix_parent_inverse = source.matrix_parent_inverse
    armature.rotation_mode = source.rotation_mode
    armature.matrix_basis = source.matrix_basis
    if own.controls:
        rig.add_controls(hand.take.model)
        armature.manient.use_controls, armature.manient.limits = (
            source.manient.use_controls,
            source.manient.limits,
        )
    for from_bone, to_bone in _pairs(own, rig):
        _mirror(source.pose.bones[from_bone], armature.pose.bones[to_bone])
    if hand.mesh is not None:
        _add_mesh(hand.mesh, rig, with_wrist(model, source.manient.wrist), betas)

    # What the rig shows and what its keys say, about the new bones.
    old, new = own.rest, rig.rest
    set_pose(rig, old.turned_to(new, present), old.moved_to(new, present_place, plane))
    holder = _mirrored_action(own, rig)
    if holder is not None and len(keys.frames):
        turned = keys.turned(old, new, plane)
        write_pose_keys(rig, turned, holder=holder)
        rig.allow(turned.quats)
    _keep(hand, armature, model, betas, plane)
    kept = hand_of(armature)
    if kept is not None and has_arm(source):
        add_arm(kept)
        armature.manient.forearm = source.manient.forearm
    return armature


def _pairs(source: Rig, rig: Rig) -> list[tuple[str, str]]:
    """Return the name of each bone, and of each control, with that of the other side's."""
    controls = rig.controls
    return [
        *zip(source.bones, rig.bones, strict=True),
        *((name, controls[role]) for role, name in source.controls.items()),
    ]


def _mirror(source: bpy.types.PoseBone, bone: bpy.types.PoseBone) -> None:
    """Pose a bone as the other side's, as Blender mirrors bones."""
    bone.rotation_mode = source.rotation_mode
    for attribute in ("location", "rotation_quaternion", "rotation_euler", "rotation_axis_angle"):
        for index, value in enumerate(getattr(source, attribute)):
            getattr(bone, attribute)[index] = -value if _turns_over(attribute, index) else value


def _plane(
    hand: CapturedHand,
    model: HandModel,
    betas: np.ndarray,
    quats: np.ndarray,
    locations: np.ndarray,
    present: np.ndarray,
    present_place: np.ndarray,
) -> float:
    """Return the place of the mirror on the x axis of the armature's space, in metres."""
    quats = np.concatenate([quats, present[None]])
    locations = np.concatenate([locations, present_place[None]])
    shaped = model.shaped(betas)
    points = model.keypoints(betas, *hand.rig.from_bones(shaped, quats, locations))[..., 0]
    low, high = float(points.min()), float(points.max())
    if low > _GAP or high < -_GAP:
        return 0.0
    return high + _GAP if high < -low else low - _GAP


def _add_mesh(source: bpy.types.Object, rig: Rig, model: HandModel, betas: np.ndarray) -> None:
    armature = rig.armature
    mesh = build_mesh(f"mesh of {armature.name}", model, model.shaped(betas), rig)
    for collection in armature.users_collection:
        collection.objects.link(mesh)
    # The artist's own materials, on both hands.
    own = list(mesh.data.materials)
    mesh.data.materials.clear()
    for material in source.data.materials:
        mesh.data.materials.append(material)
    bpy.data.batch_remove([m for m in own if m is not None])
    if source.data.shape_keys is not None and model.has_pose_blendshapes:
        for _ in adding_correctives(mesh, rig, axes.corrective_offsets(model, rig.rest.frames)):
            pass


def _mirrored_action(source: Rig, rig: Rig) -> Any:
    """Return the channels of a copy of the source's action for the new rig, whose curves are on the other
    side's bones and mirrored as Blender mirrors bones; None where there is no action."""
    data, armature = source.armature.animation_data, rig.armature
    if data is None or data.action is None:
        return None
    old_slot = action_slot(data)
    action = data.action.copy()
    action.name = armature.name
    forget_all_keys(action)  # they are those of the other side
    armature.animation_data_create().action = action
    if old_slot is not None:
        # Only this hand's part of an action that several objects share.
        for slot in list(action.slots):
            if slot.identifier != old_slot.identifier:
                action.slots.remove(slot)
        armature.animation_data.action_slot = action.slots[0]
        action.slots[0].name_display = armature.name
    forget_corrections(armature)
    holder = channels_of(armature.animation_data)
    if holder is None:
        return assign_action(armature, action)
    if has_arm(source.armature):  # the mirrored hand's is keyed as its take has it
        starts = tuple(f"{bone_path(name)}." for name in ArmBones(source.armature).bones)
        for curve in [c for c in curves_in(holder) if c.data_path.startswith(starts)]:
            holder.fcurves.remove(curve)
    groups = dict(_pairs(source, rig))
    names = {f'pose.bones["{a}"].': f'pose.bones["{b}"].' for a, b in groups.items()}
    for curve in curves_in(holder):
        start, dot, attribute = curve.data_path.partition("].")
        renamed = names.get(start + dot)
        if renamed is not None:
            curve.data_path = renamed + attribute
            if _turns_over(attribute, curve.array_index):
                change_places(curve, [1.0, -1.0], [0.0, 0.0])
    for group in holder.groups:
        group.name = groups.get(group.name, group.name)
    return holder


def _turns_over(attribute: str, index: int) -> bool:
    """True if a mirror across a bone's X changes the sign of this part of its transform."""
    return {
        "location": index == 0,
        "rotation_quaternion": index >= 2,
        "rotation_euler": index >= 1,
        "rotation_axis_angle": index >= 2,
    }.get(attribute, False)


def _keep(
    hand: CapturedHand, armature: bpy.types.Object, model: HandModel, betas: np.ndarray, plane: float
) -> None:
    """Add the mirrored track to the collection's take, and note on the armature which track it is."""
    track = hand.track
    old_wrist = kept_model(hand.take.model, hand.side).shaped(track.betas).joints[0]
    beside = np.array([2.0 * plane, 0.0, 0.0])
    place = (old_wrist + track.transl) @ MIRROR_X + beside
    orient, pose = mirrored_pose(track.global_orient, track.hand_pose)
    transl = place - model.shaped(betas).joints[0]
    motion = HandMotion(model.side, betas, orient, pose, transl).posed_at(track.present)
    arm, names = track.arm, ("shoulder", "elbow", "wrist")
    if arm is not None:
        arm = replace(arm, **{name: getattr(arm, name) @ MIRROR_X + beside for name in names})
    mirrored = replace(HandTrack.undetected(motion, model), arm=arm, no_arm=track.no_arm)
    take = replace(
        hand.take,
        hands=(*hand.take.hands, mirrored),
        # A hand of that side that an older model was fitted to keeps its own.
        model_digests={model.side: model.digest, **hand.take.model_digests},
    )
    keep_take(hand.collection, take)
    describe_hand(armature, hand.collection, take, len(take.hands) - 1, hand.armature.manient.wrist)
