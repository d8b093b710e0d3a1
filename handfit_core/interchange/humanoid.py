"""Hands of a humanoid as VRM and Unity have them: bones by name, turned relative to a T-pose.

The **humanoid** frame is glTF's, right-handed, metres, y up, the person looking along +z with the left hand
along +x. MANO's model frame has the same axes: the right hand's fingers along -x, its back +y, its thumb
between -x and +z. In VRM's T-pose fingers lie exactly along x and thumbs half-way to +z, and no bone is
turned; `retarget.transfer` meets the captured directions from there, and turns the thumb's nail as on any
character.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from handfit_core.common.errors import OptionError
from handfit_core.common.skeleton import FINGER_JOINTS, FINGERS, NUM_JOINTS, PARENTS, SIDES, Side
from handfit_core.geometry.rotations import rotmat_to_quat, rotvec_to_rotmat, unflip_quats
from handfit_core.hand_model.axes import REST_FROM_MODEL
from handfit_core.hand_model.files import kept_model
from handfit_core.retarget.bones import Bones
from handfit_core.retarget.hand_map import USUAL_THUMB_ROLL, HandMap
from handfit_core.retarget.transfer import SourceHand, TargetHand, target_hand
from handfit_core.take import Take

BODY: Final[dict[str, tuple[str, tuple[float, float, float]]]] = {
    "hips": ("", (0.0, 0.95, 0.0)),
    "spine": ("hips", (0.0, 1.05, 0.0)),
    "chest": ("spine", (0.0, 1.18, 0.0)),
    "upperChest": ("chest", (0.0, 1.30, 0.0)),
    "neck": ("upperChest", (0.0, 1.45, 0.0)),
    "head": ("neck", (0.0, 1.54, 0.0)),
    "leftShoulder": ("upperChest", (0.03, 1.40, 0.0)),
    "leftUpperArm": ("leftShoulder", (0.16, 1.40, 0.0)),
    "leftLowerArm": ("leftUpperArm", (0.43, 1.40, 0.0)),
    "leftHand": ("leftLowerArm", (0.68, 1.40, 0.0)),
    "leftUpperLeg": ("hips", (0.09, 0.88, 0.0)),
    "leftLowerLeg": ("leftUpperLeg", (0.09, 0.48, 0.0)),
    "leftFoot": ("leftLowerLeg", (0.09, 0.08, 0.0)),
}
"""VRM's names of a humanoid's bones but its fingers: the bone that each hangs from, and where it begins in
the T-pose of a person of 1.7 metres, in metres; `rightX` is `leftX` mirrored at x = 0"""
BODY.update(
    {
        "right" + name[4:]: (parent.replace("left", "right"), (-x, y, z))
        for name, (parent, (x, y, z)) in BODY.items()
        if name.startswith("left")
    }
)

_PARTS: Final = ("Proximal", "Intermediate", "Distal")


def bone_names(side: Side) -> tuple[str, ...]:
    """Return VRM 1.0's names of a hand's 16 bones, in the order of MANO's joints."""
    return _named(side, ("Metacarpal", "Proximal", "Distal"))


def unity_names(side: Side) -> tuple[str, ...]:
    """Return the names in Unity's HumanBodyBones of a hand's 16 bones, in the order of MANO's joints."""
    return _named(side.title(), _PARTS)


def _named(side: str, thumb: Sequence[str]) -> tuple[str, ...]:
    names = [f"{side}Hand"] * NUM_JOINTS
    for finger, joints in FINGER_JOINTS.items():
        for joint, part in zip(joints, thumb if finger == "thumb" else _PARTS, strict=True):
            names[joint] = f"{side}{finger.title()}{part}"
    return tuple(names)


def humanoid_bones(heads: Mapping[Side, np.ndarray]) -> dict[str, tuple[str, np.ndarray]]:
    """Return every bone of a humanoid in the T-pose, by VRM's name: the bone that it hangs from, and where it
    begins, in metres in the humanoid frame. `heads`: for each side the places that `t_pose` gives."""
    bones = {name: (parent, np.array(place)) for name, (parent, place) in BODY.items()}
    for side, places in heads.items():
        names = bone_names(side)
        bones |= {names[j]: (names[PARENTS[j]], places[j]) for j in range(1, NUM_JOINTS)}
    return bones


@dataclass(frozen=True, eq=False)
class HumanoidHand:
    """The motion of a hand at N times, as rotations of a humanoid's bones."""

    side: Side
    times: np.ndarray
    """(N,) seconds, increasing: the times of the rotations"""
    quats: dict[str, np.ndarray]
    """By VRM's name of a bone: (N, 4) quaternions (w, x, y, z), each relative to the bone's parent, in the
    humanoid frame; without the hand's own where nobody knows how it is turned to the forearm"""
    heads: np.ndarray
    """(16, 3) metres in the humanoid frame: where bones begin in the T-pose, in the order of MANO's joints"""

    @classmethod
    def of(
        cls,
        source: SourceHand,
        times: np.ndarray,
        turns: np.ndarray,
        *,
        wrist: bool = False,
        joints: Sequence[int] = range(1, NUM_JOINTS),
    ) -> HumanoidHand:
        """Make the motion of a humanoid's hand of a captured hand's.

        `turns` (N, 16, 3, 3) as `TargetHand.local` takes them. `wrist`: turns[:, 0] is how the hand is turned
        relative to the forearm, in rest space, and is kept. Only bones of `joints` are turned.
        """
        target, heads = t_pose(source)
        names, quats = bone_names(source.side), {}
        if wrist:
            quats[names[0]] = target.aligned @ turns[:, 0] @ target.aligned.T
        local = target.local(turns)
        quats |= {name: local[:, target.bones.index(name)] for name in (names[j] for j in joints)}
        return cls(source.side, times, {n: unflip_quats(rotmat_to_quat(r)) for n, r in quats.items()}, heads)


def t_pose(source: SourceHand) -> tuple[TargetHand, np.ndarray]:
    """Return a humanoid's hand of the size of `source` in VRM's T-pose, none of whose bones is turned, and
    where its bones begin, (16, 3) metres in the humanoid frame."""
    own, tips = source.joints @ REST_FROM_MODEL, source.tips @ REST_FROM_MODEL
    sideways = 1.0 if source.side == "left" else -1.0
    heads, ends = own.copy(), tips.copy()
    for f, (finger, tip) in enumerate(zip(FINGERS, tips, strict=True)):
        first, second, third = FINGER_JOINTS[finger]
        along = np.array([sideways, 0.0, 1.0 if finger == "thumb" else 0.0])
        along /= np.linalg.norm(along)
        heads[second] = heads[first] + np.linalg.norm(own[second] - own[first]) * along
        heads[third] = heads[second] + np.linalg.norm(own[third] - own[second]) * along
        ends[f] = heads[third] + np.linalg.norm(tip - own[third]) * along
    places, last = np.concatenate([heads, ends]), [FINGER_JOINTS[finger][2] for finger in FINGERS]
    names = bone_names(source.side)
    bones = Bones(
        (*names, *(f"{finger} tip" for finger in FINGERS)),
        np.array([*PARENTS, *last]),
        places,
        places,
        np.broadcast_to(np.eye(3), (len(places), 3, 3)),
    )
    hand_map = HandMap(source.side, names, thumb_roll=USUAL_THUMB_ROLL)
    return target_hand(bones, hand_map, source), heads - heads[0] + BODY[names[0]][1]


def hands_of(take: Take, *, wrist: bool = False) -> list[HumanoidHand]:
    """Return the hands of a take, in the frames that they are in, timed from the take's first frame.

    Pictures of a hand do not tell how it is turned to its forearm. `wrist`: take the hand as straight in its
    first frame, and the forearm as still. Raises OptionError for a take without hands or with several of a
    side, which no humanoid has, and HandModelError.
    """
    found = [track for track in take.hands if track.present.any()]
    for side in SIDES:
        number = sum(track.side == side for track in found)
        if number > 1:
            raise OptionError(
                f"the take has {number} {side} hands, and a humanoid has one: build it in Blender and export "
                "the wanted hands from there, or capture again with --hands"
            )
    if not found:
        raise OptionError("there is no hand in this take")
    hands = []
    for track in found:
        rows = np.flatnonzero(track.present)
        pose = rotvec_to_rotmat(track.hand_pose[rows].reshape(len(rows), NUM_JOINTS - 1, 3))
        root = rotvec_to_rotmat(track.global_orient[rows])
        turns = np.concatenate([(root[0].T @ root)[:, None], pose], axis=1)
        source = SourceHand.of(kept_model(take.model, track.side).shaped(track.betas), track.side)
        times = (np.asarray(take.frame_numbers)[rows] - int(take.frame_numbers[0])) / take.fps
        turns = REST_FROM_MODEL @ turns @ REST_FROM_MODEL.T
        hands.append(HumanoidHand.of(source, times, turns, wrist=wrist))
    return hands
