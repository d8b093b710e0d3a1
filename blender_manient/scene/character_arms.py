"""A captured arm on a character's: keys of its upper arm, forearm and hand, by FK or IK.

The arm is given relative to the character's chest, so that it goes along with whatever the body does. Its
keys lie between what its bones do without them and the captured arm, as far as that counts. Actions that were
made for captured arms before are not looked at then, so that an arm can be applied again.
"""

from __future__ import annotations

import contextlib
import functools
from collections.abc import Generator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import bpy
import numpy as np
from mathutils import Matrix

from handfit_core.common.errors import HandModelError
from handfit_core.common.skeleton import FINGER_JOINTS, other_side
from handfit_core.geometry.rotations import quat_to_rotmat, rotmat_to_quat, swings, unflip_quats
from handfit_core.retarget.arms import (
    THICKNESS,
    Capsules,
    CapturedArm,
    TargetArm,
    kept_outside,
    swivel_angles,
    target_arm,
)
from handfit_core.retarget.hand_map import HandMap
from handfit_core.retarget.transfer import TargetHand

from ..common.blender_versions import users_of
from ..rigs import arm_controls
from ..rigs.character import ArmControls, CharacterBones, bones_of
from ..rigs.rig import bone_path
from .actions import channels_of, curves_in, strips_of
from .characters import CharacterObjects, hand_map_of
from .hand_motion import BoneKeys
from .keys import PoseKeys
from .own_scene import with_values
from .sampling import rests, rotations_of, sampling_unseen
from .timing import frame_rate
from .transfer_options import TransferOptions

MARK = "manient_arms"
"""Custom property of an action that was made for captured arms"""

_VERTICES = 6000
"""About how many of a character's vertices are looked at"""


@dataclass(frozen=True, eq=False)
class Arm:
    """A character's arm that is to do what a captured one does."""

    target: TargetArm
    controls: ArmControls


def arm_of(armature: bpy.types.Object, hand_map: HandMap) -> Arm:
    """Return the arm of a character's hand. Raises HandModelError where the hand hangs on none."""
    bones, other = bones_of(armature), None
    with contextlib.suppress(HandModelError):
        other = hand_map_of(armature, other_side(hand_map.side)).bones[0]
    upright = rotations_of(np.array(armature.matrix_world, dtype=np.float64)).T
    target = target_arm(
        bones, hand_map.side, hand_map.bones[0], other if other in bones.index else None, upright
    )
    if target is None:
        raise HandModelError(
            f"the {hand_map.side} hand of {armature.name!r} hangs on no upper arm and forearm: its arm was "
            "left alone"
        )
    return Arm(target, arm_controls(armature, hand_map, target.bones))


def keying_arm(
    armature: bpy.types.Object,
    arm: Arm,
    hand: TargetHand,
    captured: CapturedArm,
    frames: np.ndarray,
    wrists: np.ndarray,
    how: TransferOptions,
) -> Generator[float, None, list[BoneKeys]]:
    """Keys of an arm on frames (N,), in steps; `wrists` (N, 3, 3) is how the captured hand is turned in its
    capture's world. None at an influence of 0.

    Where something else moves the arm's bones, they get keys in all of its range, since the first and the
    last pose of an action stand for ever.
    """
    if how.arms_influence <= 0.0:
        return []
    target, own, captured = arm.target, arm.controls, captured.turned(how.arms_turn)
    moved = _moved_range(armature, own.keyed)
    every, weights = frames, np.full(len(frames), how.arms_influence)
    if moved is not None:
        more = np.arange(np.ceil(moved[0]), moved[1] + 1.0)
        every = np.union1d(frames, more[(more < frames[0]) | (more > frames[-1])])
        weights = np.zeros(len(every))
        weights[np.searchsorted(every, frames)] = how.arms_influence * captured.weights(frames, how.arms_ease)
    at = np.clip(np.searchsorted(frames, every), 0, len(frames) - 1)  # frames that are added weigh nothing

    capsules = _capsules(armature, target) if how.arms_outside else None
    shown = yield from _sampling(armature, arm, every, capsules.bones if capsules is not None else ())
    if moved is None and any(MARK in user.action for user in users_of(armature)):
        shown = replace(shown, at_rest=True)
    upper, fore = captured.upper[at] @ target.body.T, captured.fore[at] @ target.body.T
    turned = target.body @ captured.facing @ wrists[at] @ hand.aligned.T
    normals = target.normals(upper, fore)
    above = armature.data.bones[target.bones[0]].parent
    shoulder = shown.placed(above.name if above else "", target.joints[0])
    wrist = target.wrist_at(upper, fore)
    if capsules is not None and len(capsules.bones):
        names = [hand.hand_map.bones[FINGER_JOINTS[f][0]] for f in hand.hand_map.fingers]
        knuckles = [armature.data.bones[name].head_local for name in names if name]
        ways = np.concatenate([np.zeros((1, 3)), np.array(knuckles, dtype=np.float64) - hand.wrist])
        points = (shoulder + wrist)[:, None] + np.einsum("nab,kb->nka", turned, ways)
        ends = [
            [shown.placed(name, end) for end in pair]
            for name, pair in zip(capsules.bones, capsules.ends, strict=True)
        ]
        radii = capsules.radii + THICKNESS * np.linalg.norm(ways, axis=-1).max()
        seconds = every / frame_rate(bpy.context.scene)
        camera = target.body @ captured.facing @ [0.0, -1.0, 0.0]
        away = kept_outside(points, np.moveaxis(np.array(ends), 2, 0), radii, seconds, camera)
        upper, fore = target.reaching(wrist + away, normals)
        normals, wrist = target.normals(upper, fore), target.wrist_at(upper, fore)

    keys: list[BoneKeys] = []

    def key(name: str, basis: np.ndarray, *, turns: bool = True, goes: bool = False) -> None:
        quats, places = shown.own(armature, name)
        wanted, share = rotmat_to_quat(basis[:, :3, :3]), weights[:, None]
        wanted = np.where(np.sum(quats * wanted, axis=-1, keepdims=True) < 0.0, -wanted, wanted)
        mixed = (1.0 - share) * quats + share * wanted
        mixed = unflip_quats(mixed / np.linalg.norm(mixed, axis=-1, keepdims=True))
        places = (1.0 - share) * places + share * basis[:, :3, 3] if goes else None
        written = PoseKeys.everywhere(every, mixed[:, None], places)
        keys.append(BoneKeys(CharacterBones(armature, [name]), written.only(turns, True), arm=True))

    if own.upper:
        turns = target.turned(upper, fore, turned)
        whole = [*np.moveaxis(turns, 1, 0), turned]
        carried = rotations_of(shown.carried(own.upper))
        for name, turn, before in zip((own.upper, own.fore, own.hand), whole, [None, *whole], strict=False):
            rest = rotations_of(shown.rest[name])
            start = carried if before is None else before @ rest
            key(name, _matrices(np.swapaxes(start, -1, -2) @ turn @ rest))
        return keys
    rest = shown.rest[own.hand]
    place = shoulder + wrist + turned @ (rest[:3, 3] - target.joints[2])
    stands = _matrices(turned @ rotations_of(rest), place)
    key(own.hand, shown.basis(armature, own.hand, stands), goes=True)
    if own.pole:
        way = np.linalg.norm(wrist, axis=-1, keepdims=True)
        far = np.linalg.norm(shown.rest[own.pole][:3, 3] - target.joints[1])
        place = shoulder + target.lengths[0] * upper + far * np.cross(wrist / way, normals)
        stands = _matrices(rotations_of(shown.carried(own.pole)), place)
        key(own.pole, shown.basis(armature, own.pole, stands), turns=False, goes=True)
    elif own.swivel:
        along = wrist / np.linalg.norm(wrist, axis=-1, keepdims=True)
        swing = armature.data.bones[own.swivel].parent.name
        start = rotations_of(shown.carried(swing))
        axes = rotations_of(shown.rest[own.swivel])
        start = swings(start[..., 1], along) @ start @ rotations_of(shown.rest[swing]).T @ axes
        at_rest = (axes.T @ target.hinge, axes.T @ (target.joints[2] - target.joints[0]))
        half = 0.5 * np.unwrap(swivel_angles(start, *at_rest, along, normals))
        quats = np.stack([np.cos(half), 0.0 * half, np.sin(half), 0.0 * half], axis=-1)
        key(own.swivel, _matrices(quat_to_rotmat(quats)))
    return keys


@dataclass(frozen=True, eq=False)
class _Shown:
    """The poses that bones show on M frames, seen from the character's chest at rest."""

    pose: Mapping[str, np.ndarray]
    """By bone, (M, 4, 4) its posed matrix; of no bone, that of the armature's space itself"""
    rest: Mapping[str, np.ndarray]
    """By bone, (4, 4) its rest matrix in the armature's space"""
    parents: Mapping[str, str]
    at_rest: bool = False
    """True if nobody knows what the bones do without the arm, so that they count as resting"""

    def carried(self, name: str) -> np.ndarray:
        """Return (M, 4, 4), where a bone would lie if it rested relative to its parent."""
        parent = self.parents[name]
        if not parent:
            return self.pose[""] @ self.rest[name]
        return self.pose[parent] @ np.linalg.inv(self.rest[parent]) @ self.rest[name]

    def placed(self, name: str, point: np.ndarray) -> np.ndarray:
        """Return (M, 3), where the bone carries a point (3,) of the rest pose."""
        carrying = self.pose[name] @ np.linalg.inv(self.rest[name]) if name else self.pose[""]
        return carrying[:, :3, :3] @ point + carrying[:, :3, 3]

    def own(self, armature: bpy.types.Object, name: str) -> tuple[np.ndarray, np.ndarray]:
        """Return what a bone does without the arm: quaternions (M, 4) as (w, x, y, z) and locations (M, 3),
        relative to its rest."""
        basis = self.basis(armature, name, self.pose[name])
        if self.at_rest:
            basis = np.broadcast_to(np.eye(4), basis.shape)
        return rotmat_to_quat(rotations_of(basis)), basis[:, :3, 3]

    def basis(self, armature: bpy.types.Object, name: str, stands: np.ndarray) -> np.ndarray:
        """Return (M, 4, 4), the values of a bone's channels where it stands as (M, 4, 4) says."""
        bone, parent, found = armature.data.bones[name], self.parents[name], np.empty(stands.shape)
        for row, back in enumerate(np.linalg.inv(self.pose[""])):
            above = {}
            if parent:
                above = {"parent_matrix": Matrix(back @ self.pose[parent][row])}
                above["parent_matrix_local"] = bone.parent.matrix_local
            stand = Matrix(back @ stands[row])
            found[row] = bone.convert_local_to_pose(stand, bone.matrix_local, invert=True, **above)
        return found


def _sampling(
    armature: bpy.types.Object, arm: Arm, frames: np.ndarray, trunk: Sequence[str]
) -> Generator[float, None, _Shown]:
    """Sample, in steps, what an arm's bones show, those that carry them, and those of the trunk."""
    bones, names = armature.data.bones, dict.fromkeys([*trunk, *arm.controls.keyed, arm.target.bones[0]])
    if arm.controls.swivel:
        names[bones[arm.controls.swivel].parent.name] = None
    parents = {name: bones[name].parent.name if bones[name].parent else "" for name in names}
    wanted = [*dict.fromkeys([*names, *parents.values(), arm.target.chest])]
    wanted = [name for name in wanted if name]
    still = all(rests(armature, bones[name]) for name in wanted)
    around = functools.partial(_without_applied, armature)
    sampled = yield from sampling_unseen(armature, frames[: 1 if still else None], wanted, around)
    posed = np.broadcast_to(sampled.of(wanted), (len(frames), len(wanted), 4, 4))
    rest = {name: np.array(bones[name].matrix_local, dtype=np.float64) for name in wanted}
    chest = arm.target.chest
    back = rest[chest] @ np.linalg.inv(posed[:, wanted.index(chest)]) if chest else np.eye(4)[None]
    pose = {name: back @ posed[:, i] for i, name in enumerate(wanted)}
    pose[""] = np.broadcast_to(back, (len(frames), 4, 4))
    return _Shown(pose, rest, parents)


def _capsules(armature: bpy.types.Object, target: TargetArm) -> Capsules:
    """Return the trunk and the head of a character as capsules, by the vertices of its meshes at rest."""
    bones, points, owners = bones_of(armature), [], []
    meshes = CharacterObjects.of(armature).meshes
    step = max(1, sum(len(mesh.data.vertices) for mesh in meshes) // _VERTICES)
    for mesh in meshes:
        own = [bones.index.get(group.name, -1) for group in mesh.vertex_groups]
        places = np.array(armature.matrix_world.inverted() @ mesh.matrix_world, dtype=np.float64)
        vertices = mesh.data.vertices
        for vertex in (vertices[i] for i in range(0, len(vertices), step)):
            heaviest = max(vertex.groups, key=lambda one: one.weight, default=None)
            points.append(places[:3, :3] @ vertex.co + places[:3, 3])
            owners.append(own[heaviest.group] if heaviest is not None else -1)
    return Capsules.of(bones, np.array(points).reshape(-1, 3), np.array(owners, dtype=int), target)


def unapplied_users(armature: bpy.types.Object) -> list:
    """Return the users of an armature's actions that were not made for captured arms."""
    return [user for user in users_of(armature, acting=True) if MARK not in user.action]


def _moved_range(armature: bpy.types.Object, names: Sequence[str]) -> tuple[float, float] | None:
    """Return the first and last frame on which other actions move any of these bones, the scene's range at
    least; None where none does."""
    starts = tuple(f"{bone_path(name)}." for name in names)
    spans = []
    for user in unapplied_users(armature):
        if any(curve.data_path.startswith(starts) for curve in curves_in(channels_of(user))):
            is_strip = isinstance(user, bpy.types.NlaStrip)
            spans.append((user.frame_start, user.frame_end) if is_strip else user.action.curve_frame_range)
    if not spans:
        return None
    scene = bpy.context.scene
    spans.append((scene.frame_start, scene.frame_end))
    return min(float(first) for first, _ in spans), max(float(last) for _, last in spans)


def _without_applied(armature: bpy.types.Object) -> contextlib.AbstractContextManager[None]:
    """Have actions that were made for captured arms do nothing."""
    data = armature.animation_data
    values: list[tuple[Any, str, Any]] = [
        (strip, "mute", True) for strip in strips_of(armature) if strip.action and MARK in strip.action
    ]
    if data is not None and data.action is not None and MARK in data.action:
        values.append((data, "action_influence", 0.0))
    return with_values(values)


def _matrices(turns: np.ndarray, places: np.ndarray | None = None) -> np.ndarray:
    """Return matrices (M, 4, 4) of rotations (M, 3, 3) and places (M, 3)."""
    found = np.broadcast_to(np.eye(4), (len(turns), 4, 4)).copy()
    found[:, :3, :3] = turns
    if places is not None:
        found[:, :3, 3] = places
    return found
