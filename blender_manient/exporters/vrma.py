"""VRM animation: what hands do, for any avatar in VRM's format."""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import bpy
import numpy as np

from handfit_core.common.errors import HandModelError, OptionError
from handfit_core.common.skeleton import FINGER_JOINTS, FINGERS, SIDES, Side
from handfit_core.geometry.rotations import rotmat_to_rotvec
from handfit_core.hand_model.files import kept_model
from handfit_core.interchange.formats.vrma import vrm_animation
from handfit_core.interchange.humanoid import HumanoidHand
from handfit_core.retarget.bones import Bones
from handfit_core.retarget.hand_map import HandMap
from handfit_core.retarget.transfer import SourceHand, TargetHand, target_hand

from ..rigs import rig_of
from ..rigs.character import bones_of
from ..rigs.rig import Rig
from ..scene.characters import CharacterObjects, hand_map_of
from ..scene.sampling import Sampled, rotations_of, sample
from .exporter import Exporter, HandObjects, Preset

_STILL = 1e-3
"""Radians by which a hand that is not turned to its forearm may be off"""
_ASIDE = 0.05
"""Metres at our hand's size: a bone that begins nearer to the wrist is a helping bone and no forearm"""


class VrmaExporter(Exporter):
    """Rotations of fingers, and of a character's hands to its forearms."""

    name = "vrma"
    label = "VRM"
    description = "VRM animation of the fingers, and of a character's wrists, for VRM avatars"
    suffix = ".vrma"
    bakes = False

    def write(self, path: Path, hands: Sequence[HandObjects], _preset: Preset, _final: Path, /) -> None:
        """Write one animation, a moment for each frame."""
        found = [moving for hand in hands for moving in _hands_of(hand)]
        for side in SIDES:
            if sum(hand.side == side for hand in found) > 1:
                raise OptionError(f"there are several {side} hands, and an avatar has one: export one alone")
        if not found:
            raise OptionError("no hand was found on this character: choose its bones in the panel first")
        path.write_bytes(vrm_animation(found))


def _hands_of(hand: HandObjects) -> list[HumanoidHand]:
    """Return what the context's scene shows of a captured hand, or of a character's hands, over its frame
    range."""
    bones, mapped = bones_of(hand.armature), list[tuple[HandMap, SourceHand]]()
    if hand.side is not None:
        rig = rig_of(hand.armature, hand.side)
        mapped.append((HandMap(hand.side, tuple(rig.bones)), _at_rest(rig, bones)))
    else:
        given = {m.side: m for m in hand.hand_maps} if isinstance(hand, CharacterObjects) else {}
        for side in SIDES:
            with contextlib.suppress(HandModelError):  # it has no such hand
                mapped.append((given.get(side) or hand_map_of(hand.armature, side), _open_hand(side)))
    sources = [source for _, source in mapped]
    targets = [target_hand(bones, replace(hand_map, fold=0.0), source) for hand_map, source in mapped]
    wrists = [_wrist_and_forearm(bones, target) for target in targets]
    read = {name for target in targets for name in (target.hand_map.bones[0], *target.bones)}
    if not read:
        return []
    scene = bpy.context.scene
    frames = range(scene.frame_start, scene.frame_end + 1)
    sampled = sample(hand.armature, frames, scene, read.union(*wrists))
    return [_moving(bones, *each, sampled) for each in zip(sources, targets, wrists, strict=True)]


def _open_hand(side: Side) -> SourceHand:
    return SourceHand.of(kept_model("open-hand", side).shaped(), side)


def _at_rest(rig: Rig, bones: Bones) -> SourceHand:
    """Return a captured hand's own joints, which are flat at rest; of a rig that says it rests otherwise, the
    open hand's."""
    if type(rig).from_bones is not Rig.from_bones:
        return _open_hand(rig.side)
    at = [bones.index[name] for name in rig.bones]
    last = [at[FINGER_JOINTS[finger][2]] for finger in FINGERS]
    return SourceHand(rig.side, bones.heads[at], bones.tails[last])


def _moving(
    bones: Bones, source: SourceHand, target: TargetHand, wrist: tuple[str, ...], sampled: Sampled
) -> HumanoidHand:
    """Return one hand as the scene shows it over its frame range; `wrist` as `_wrist_and_forearm` returns
    it."""

    def posed(name: str) -> np.ndarray:
        """Return (N, 3, 3), how a bone is turned from its rest, in the armature's space."""
        shown = sampled.pose[:, sampled.names.index(name)]
        return rotations_of(shown) @ bones.frames[bones.index[name]].T

    back = np.swapaxes(posed(target.hand_map.bones[0]), -1, -2)
    standing = np.stack([back @ posed(name) for name in target.bones], axis=1) @ target.rest
    turns = target.turns(target.channels(standing))
    if wrist:
        hand, forearm = map(posed, wrist)
        turns[:, 0] = target.aligned.T @ np.swapaxes(forearm, -1, -2) @ hand @ target.aligned
    turned = np.linalg.norm(rotmat_to_rotvec(turns[:, 0]), axis=-1).max() > _STILL
    render = bpy.context.scene.render
    times = np.arange(len(turns)) * render.fps_base / render.fps
    joints = [joint for finger in target.hand_map.fingers for joint in FINGER_JOINTS[finger]]
    return HumanoidHand.of(source, times, turns, wrist=bool(turned), joints=joints)


def _wrist_and_forearm(bones: Bones, target: TargetHand) -> tuple[str, ...]:
    """Return the names of the two bones between which a wrist bends; none where the hand hangs on no arm.

    Rigify's deforming bones share the wrist's twist, those of its chain (ORG) do not."""
    name = target.hand_map.bones[0]
    own = f"ORG-{name.removeprefix('DEF-').removeprefix('ORG-')}"
    hand = bones.index.get(own, bones.index[name])
    for bone in bones.ancestors(hand):
        if np.linalg.norm(bones.heads[bone] - bones.heads[hand]) > _ASIDE * target.scale:
            return bones.names[hand], bones.names[bone]
    return ()
