"""VRM animation: what hands do, for any avatar in VRM's format."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import bpy
import numpy as np

from handfit_core.errors import HandModelError, OptionError
from handfit_core.geometry.rotations import rotmat_to_rotvec
from handfit_core.hand_model.kept import kept_model
from handfit_core.interchange.formats.vrma import vrm_animation
from handfit_core.interchange.humanoid import HumanoidHand
from handfit_core.retarget.bones import Bones
from handfit_core.retarget.hand_map import HandMap
from handfit_core.retarget.transfer import SourceHand, TargetHand, target_hand
from handfit_core.skeleton import FINGER_JOINTS, FINGERS, SIDES, Side

from ..rigs import rig_of
from ..rigs.character import bones_of
from ..rigs.rig import Rig
from ..scene.characters import CharacterObjects, hand_map_of
from ..scene.sampling import Sampled, rotations_of, sample
from .exporter import Exporter, HandObjects, Preset

_STILL = 1e-3
"""radians by which a hand that is not turned to its forearm may be off"""
_ASIDE = 0.05
"""metres of our hand's size: what begins nearer to the wrist is a helping bone and no forearm"""


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
    """What the context's scene shows of a captured hand, or of a character's hands, over its frame range."""
    bones = bones_of(hand.armature)
    sources: list[tuple[HandMap, SourceHand]] = []
    if hand.side is not None:
        rig = rig_of(hand.armature, hand.side)
        sources.append((HandMap(hand.side, tuple(rig.bones)), _flat(rig, bones)))
    else:
        given = hand.hand_maps if isinstance(hand, CharacterObjects) else ()
        for side in SIDES:
            try:
                hand_map = next((m for m in given if m.side == side), None) or hand_map_of(
                    hand.armature, side
                )
            except HandModelError:  # it has no such hand
                continue
            sources.append((hand_map, _open_hand(side)))
    if not sources:
        return []
    scene = bpy.context.scene
    frames = range(scene.frame_start, scene.frame_end + 1)
    times = np.arange(len(frames)) * scene.render.fps_base / scene.render.fps
    mapped = [_Mapped.of(bones, hand_map, source) for hand_map, source in sources]
    sampled = sample(hand.armature, frames, scene, {name for each in mapped for name in each.names})
    return [_moving(bones, each, times, sampled) for each in mapped]


@dataclass(frozen=True, eq=False)
class _Mapped:
    """One of an armature's hands."""

    hand_map: HandMap
    source: SourceHand
    target: TargetHand
    wrist: tuple[str, str] | None
    """the bones between which the wrist bends, as `_wrist_and_forearm` returns them"""

    @classmethod
    def of(cls, bones: Bones, hand_map: HandMap, source: SourceHand) -> _Mapped:
        target = target_hand(bones, replace(hand_map, fold=0.0), source)
        return cls(hand_map, source, target, _wrist_and_forearm(bones, hand_map, _ASIDE * target.scale))

    @property
    def names(self) -> tuple[str, ...]:
        """The bones from which the hand's motion is read."""
        return self.hand_map.bones[0], *self.target.bones, *(self.wrist or ())


def _open_hand(side: Side) -> SourceHand:
    return SourceHand.of(kept_model("open-hand", side).shaped(), side)


def _flat(rig: Rig, bones: Bones) -> SourceHand:
    """A captured hand's own joints, which are flat at rest; of a rig that says it rests otherwise, the open
    hand's."""
    if type(rig).from_bones is not Rig.from_bones:
        return _open_hand(rig.side)
    at = [bones.index[name] for name in rig.bones]
    last = [at[FINGER_JOINTS[finger][2]] for finger in FINGERS]
    return SourceHand(rig.side, bones.heads[at], bones.tails[last])


def _moving(bones: Bones, mapped: _Mapped, times: np.ndarray, sampled: Sampled) -> HumanoidHand:
    """One hand, as it is shown at those times."""
    hand_map, source, target = mapped.hand_map, mapped.source, mapped.target

    def posed(name: str) -> np.ndarray:
        """(N, 3, 3) how a bone is turned from its rest, in the armature's space."""
        shown = sampled.pose[:, sampled.names.index(name)]
        return rotations_of(shown) @ bones.frames[bones.index[name]].T

    back = np.swapaxes(posed(hand_map.bones[0]), -1, -2)
    standing = np.stack([back @ posed(name) for name in target.bones], axis=1) @ target.rest
    turns = target.turns(target.channels(standing))
    if mapped.wrist is not None:
        hand, forearm = map(posed, mapped.wrist)
        turns[:, 0] = target.aligned.T @ np.swapaxes(forearm, -1, -2) @ hand @ target.aligned
    turned = np.linalg.norm(rotmat_to_rotvec(turns[:, 0]), axis=-1).max() > _STILL
    joints = [joint for finger in hand_map.fingers for joint in FINGER_JOINTS[finger]]
    return HumanoidHand.of(source, times, turns, wrist=bool(turned), joints=joints)


def _wrist_and_forearm(bones: Bones, hand_map: HandMap, aside: float) -> tuple[str, str] | None:
    """The bones between which a wrist bends; None where the hand hangs on no arm, which begins farther from
    the wrist than `aside`. Rigify's deforming bones share the wrist's twist, those of its chain (ORG) do
    not."""
    name = hand_map.bones[0]
    own = f"ORG-{name.removeprefix('DEF-').removeprefix('ORG-')}"
    hand = bones.index.get(own, bones.index[name])
    for bone in bones.ancestors(hand):
        if np.linalg.norm(bones.heads[bone] - bones.heads[hand]) > aside:
            return bones.names[hand], bones.names[bone]
    return None
