"""From a captured hand's rotations to those of a character's bones, and back: every frame at once.

Let `d` be our segment of a joint at rest, `t` the character's, `G` how our joint is turned relative to the
wrist, and `B` the axes of the character's bone at rest. The palms are laid over each other by a rotation `A`
(`palm_frame` of both), and `C` is the smallest rotation that takes `t` onto `A d`. Then the bone is to stand
at `P = A G A^T C B`, relative to the hand's own bone at rest. Directions are met exactly whatever the rest
poses are; about its own length a bone is turned as it was.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from handfit_core.common.errors import HandModelError
from handfit_core.common.files import shown
from handfit_core.common.skeleton import FINGER_JOINTS, FINGERS, NUM_JOINTS, PARENTS, Side, other_side
from handfit_core.geometry.rotations import (
    quat_to_rotmat,
    rotmat_to_quat,
    rotmat_to_rotvec,
    rotvec_to_rotmat,
    swings,
    unflip_quats,
)
from handfit_core.hand_model.axes import MIRROR_X, points_to_rest
from handfit_core.hand_model.data import ShapedHand
from handfit_core.hand_model.files import OPEN_HAND
from handfit_core.retarget.bones import Bones
from handfit_core.retarget.hand_map import PALM_FINGERS, HandMap

_FOLD_SHARES = {"ring": 0.15, "little": 0.25}
"""Largest share of the first joint's bend that the metacarpal of ring or little finger takes over: a fist
cups the palm by 10 to 20 degrees"""


@dataclass(frozen=True, eq=False)
class SourceHand:
    """A captured hand at rest, in metres, in the rest space of `axes.py`."""

    side: Side
    joints: np.ndarray
    """(16, 3) metres: the joints in MANO's order"""
    tips: np.ndarray
    """(5, 3) metres: the fingertips of thumb, index, middle, ring and little finger"""
    model: str = OPEN_HAND
    """The name of the hand model"""

    @classmethod
    def of(cls, shaped: ShapedHand, side: Side, model: str = OPEN_HAND) -> SourceHand:
        """Make the source hand of a shaped hand of that side, for the hand model of that name."""
        return cls(side, points_to_rest(shaped.joints), points_to_rest(shaped.tips), model)

    def mirrored(self) -> SourceHand:
        """Return the hand of the other side, mirrored at x = 0 of rest space."""
        return SourceHand(other_side(self.side), self.joints @ MIRROR_X, self.tips @ MIRROR_X, self.model)

    def points(self, turns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return where the joints (T, 16, 3) and fingertips (T, 5, 3) of posed hands are, in metres, with the
        wrist neither turned nor moved. `turns` (T, 16, 3, 3) are each joint's rotations relative to its
        parent, as `TargetHand.local` takes them."""
        whole = globally(turns)
        joints = np.broadcast_to(self.joints, (len(turns), NUM_JOINTS, 3)).copy()
        for joint in range(1, NUM_JOINTS):
            parent = PARENTS[joint]
            joints[:, joint] = joints[:, parent] + whole[:, parent] @ (
                self.joints[joint] - self.joints[parent]
            )
        last = [FINGER_JOINTS[finger][2] for finger in FINGERS]
        reach = np.einsum("tfab,fb->tfa", whole[:, last], self.tips - self.joints[last])
        return joints, joints[:, last] + reach


def smoothed_travel(
    frames: np.ndarray, places: np.ndarray, turns: np.ndarray, reach: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return where a hand is (T, 3), and how it is turned (T, 3, 3), on frames (T,), increasing, without what
    shakes: on a straight line through the frames less than `reach` before and after each one, which count the
    less the farther they are. Even motion stays as it is, up to its ends, and nothing is late."""
    if reach <= 0.0 or len(frames) < 2:
        return places, turns
    values = np.concatenate([places, unflip_quats(rotmat_to_quat(turns))], axis=1)
    found = np.empty_like(values)
    low = np.searchsorted(frames, frames - reach, side="right")
    high = np.searchsorted(frames, frames + reach)
    for row, (first, end) in enumerate(zip(low.tolist(), high.tolist(), strict=True)):
        away = frames[first:end] - frames[row]
        weights = (1.0 - (away / reach) ** 2) ** 2
        total, mean = weights.sum(), weights @ away / weights.sum()
        slopes = weights * (away - mean)
        spread = slopes @ away
        # The line's value here, `mean` before the middle of what was seen.
        gain = weights / total - (mean / spread * slopes if spread > 0.0 else 0.0)
        found[row] = gain @ values[first:end]
    return found[:, :3], quat_to_rotmat(found[:, 3:])


def mirrored_turns(turns: np.ndarray) -> np.ndarray:
    """Return rotations (..., 3, 3) of rest space as a mirror at x = 0 shows them."""
    return MIRROR_X @ turns @ MIRROR_X


def globally(turns: np.ndarray) -> np.ndarray:
    """Turn each joint's rotations (T, 16, 3, 3) relative to its parent into rotations relative to the wrist,
    whose own is left out."""
    whole = np.array(turns)
    whole[:, 0] = np.eye(3)
    for joint in range(1, NUM_JOINTS):
        whole[:, joint] = whole[:, PARENTS[joint]] @ turns[:, joint]
    return whole


@dataclass(frozen=True, eq=False)
class TargetHand:
    """A character's hand that is to do what a captured one does: K bones that get keys."""

    hand_map: HandMap
    bones: tuple[str, ...]
    """The names of the K bones, parents before children"""
    joints: tuple[tuple[int, ...], ...]
    """For each bone the numbers of the joints that it follows, by their mean; none for a metacarpal that
    folds"""
    parents: tuple[int, ...]
    """For each bone the index of its nearest ancestor among the K; -1 for none, where the parent is the
    hand"""
    heads: np.ndarray
    """(K, 3) where the bones begin at rest, in the armature's space and units"""
    tips: np.ndarray
    """(5, 3) where the fingers end at rest, in the armature's space and units; NaN for fingers that are not
    there"""
    rest: np.ndarray
    """(K, 3, 3) the bones' axes at rest in the armature's space: B of the module's formula"""
    corrected: np.ndarray
    """(K, 3, 3) the rotations that lay each bone's direction over ours at rest: C of the module's formula"""
    aligned: np.ndarray
    """(3, 3) the rotation from our rest space to the armature's: A of the module's formula"""
    scale: float
    """How many of the armature's units a metre of the captured hand is, by the lengths of both palms"""
    wrist: np.ndarray
    """(3,) where the hand's own bone begins at rest, in the armature's space and units"""

    def standing(self, turns: np.ndarray) -> np.ndarray:
        """Return how the bones are to stand in the armature's space while the hand is at rest, P of the
        module's formula: (T, K, 3, 3).

        `turns` (T, 16, 3, 3) is each joint's rotation relative to its parent, in rest space; the wrist's is
        not looked at.
        """
        whole = globally(turns)
        found = np.empty((len(turns), len(self.bones), 3, 3))
        for k, joints in enumerate(self.joints):
            if joints:
                turned = _mean(whole[:, list(joints)])
            else:
                finger = PALM_FINGERS[self.hand_map.palm.index(self.bones[k])]
                bend = rotmat_to_rotvec(turns[:, FINGER_JOINTS[finger][0]])
                turned = rotvec_to_rotmat(self.hand_map.fold * _FOLD_SHARES[finger] * bend)
            found[:, k] = self.aligned @ turned @ self.aligned.T @ self.corrected[k] @ self.rest[k]
        return found

    def local(self, turns: np.ndarray) -> np.ndarray:
        """Return the bones' rotations (T, K, 3, 3) relative to their own rest, as their channels have them,
        from the joints' rotations `turns` (T, 16, 3, 3) relative to their parents."""
        return self.channels(self.standing(turns))

    def channels(self, standing: np.ndarray) -> np.ndarray:
        """Return the rotations (T, K, 3, 3) in the channels of bones that stand as `standing` says; bones
        between them rest."""
        found = np.empty_like(standing)
        for k in range(len(self.bones)):
            found[:, k] = np.swapaxes(self._carried(k, standing), -1, -2) @ standing[:, k]
        return found

    def _carried(self, k: int, standing: np.ndarray) -> np.ndarray:
        """Return how bone k at rest stands, (T, 3, 3), under a parent that stands as `standing` says."""
        parent = self.parents[k]
        return self.rest[k] if parent < 0 else standing[:, parent] @ self.rest[parent].T @ self.rest[k]

    def turns(self, local: np.ndarray) -> np.ndarray:
        """Return the joints' rotations (T, 16, 3, 3) that bones with these rotations show: the inverse of
        `local`. Joints without a bone do not turn; what of a bone's rotation ours cannot show is left in."""
        standing = np.empty_like(local)
        for k in range(len(self.bones)):
            standing[:, k] = self._carried(k, standing) @ local[:, k]
        whole = np.broadcast_to(np.eye(3), (len(local), NUM_JOINTS, 3, 3)).copy()
        known = {joint: k for k, joints in enumerate(self.joints) for joint in joints}
        for joint in range(1, NUM_JOINTS):
            whole[:, joint] = whole[:, PARENTS[joint]]
            if joint in known:
                k = known[joint]
                turned = standing[:, k] @ self.rest[k].T @ self.corrected[k].T
                whole[:, joint] = self.aligned.T @ turned @ self.aligned
        found = whole.copy()
        for joint in range(1, NUM_JOINTS):
            found[:, joint] = np.swapaxes(whole[:, PARENTS[joint]], -1, -2) @ whole[:, joint]
        return found

    def points(self, standing: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return where bones that stand so begin (T, K, 3), and where fingers end (T, 5, 3), in the
        armature's space and units while the hand is at rest. Tips of fingers that are not there are NaN."""
        turned = standing @ np.swapaxes(self.rest, -1, -2)
        heads = np.broadcast_to(self.heads, (len(standing), *self.heads.shape)).copy()
        for k, parent in enumerate(self.parents):
            if parent >= 0:
                heads[:, k] = heads[:, parent] + turned[:, parent] @ (self.heads[k] - self.heads[parent])
        tips = np.full((len(standing), len(FINGERS), 3), np.nan)
        for f, finger in enumerate(FINGERS):
            last = self.last(finger)
            if last is not None:
                tips[:, f] = heads[:, last] + turned[:, last] @ (self.tips[f] - self.heads[last])
        return heads, tips

    def last(self, finger: str) -> int | None:
        """Return the index of a finger's last bone among the K; None where the finger has none."""
        chosen = [self.hand_map.bones[joint] for joint in FINGER_JOINTS[finger] if self.hand_map.bones[joint]]
        return self.bones.index(chosen[-1]) if chosen else None


def target_hand(bones: Bones, hand_map: HandMap, source: SourceHand) -> TargetHand:
    """Return the target for a captured hand of the side of `hand_map`. Raises HandModelError where bones are
    missing, where the hand itself or what carries it stands for a finger, or where bones lie so that there is
    no telling where the palm faces."""
    hand_map.check(bones.index)
    names = sorted(hand_map.keyed, key=bones.index.__getitem__)
    at = [bones.index[name] for name in names]
    hand = bones.index[hand_map.bones[0]]
    carrying = {hand, *bones.ancestors(hand), bones.index[hand_map.moved_by]}
    wrong = next((name for name, bone in zip(names, at, strict=True) if bone in carrying), None)
    if wrong is not None:
        raise HandModelError(
            f"the bone {shown(wrong)!r} moves the whole {hand_map.side} hand, so that it cannot be one of a "
            "finger: choose another one in the table"
        )
    wrist = bones.heads[hand]
    knuckles = _knuckles(bones, hand_map)
    ours = {finger: source.joints[joints].mean(axis=0) for finger, (_, joints) in knuckles.items()}
    theirs, scale = palm_frame(wrist, {f: head for f, (head, _) in knuckles.items()}, hand_map.side)
    own, size = palm_frame(source.joints[0], ours, hand_map.side)
    aligned = theirs @ own.T

    followed = tuple(
        tuple(j for j, name in hand_map.mapped.items() if name == own_name) for own_name in names
    )
    corrected = np.broadcast_to(np.eye(3), (len(names), 3, 3)).copy()
    tips = np.full((len(FINGERS), 3), np.nan)
    segments: dict[int, tuple[np.ndarray, np.ndarray]] = {}  # theirs and ours, (3,), by joint
    for f, joints in enumerate(FINGER_JOINTS.values()):
        chain = [j for j in joints if hand_map.bones[j]]
        if chain:
            bones_there = [bones.index[hand_map.bones[j]] for j in chain]
            tips[f] = finger_end(bones, bones_there)
            to_next = np.diff([*bones.heads[bones_there], tips[f]], axis=0)
            ours_to_next = np.diff([*source.joints[chain], source.tips[f]], axis=0)
            for joint, their, our in zip(chain, to_next, ours_to_next, strict=True):
                segments[joint] = unit(their), unit(our)
    for k, joints in enumerate(followed):
        if not joints:
            continue
        theirs_along, ours_along = np.sum([segments[joint] for joint in joints], axis=0)
        along = unit(aligned @ ours_along)
        if not hand_map.keep_rest:
            corrected[k] = swings(unit(theirs_along), along[None])[0]
        if joints[0] in FINGER_JOINTS["thumb"] and hand_map.thumb_roll:
            sign = 1.0 if hand_map.side == "right" else -1.0
            axis = unit(theirs_along) if hand_map.keep_rest else along
            corrected[k] = rotvec_to_rotmat(np.radians(sign * hand_map.thumb_roll) * axis) @ corrected[k]
    return TargetHand(
        hand_map,
        tuple(names),
        followed,
        tuple(next((at.index(a) for a in bones.ancestors(bone) if a in at), -1) for bone in at),
        bones.heads[at],
        tips,
        bones.frames[at],
        corrected,
        aligned,
        scale / size,
        wrist,
    )


def _knuckles(bones: Bones, hand_map: HandMap) -> dict[str, tuple[np.ndarray, list[int]]]:
    """Return where each finger of a character begins (3,), and the joints that begin there, by the finger's
    name: of two fingers or more where one bone stands for all of them, by the first one's name."""
    found: dict[str, tuple[str, list[int]]] = {}
    for finger in hand_map.fingers:
        joint = next(j for j in FINGER_JOINTS[finger] if hand_map.bones[j])
        found.setdefault(hand_map.bones[joint], (finger, []))[1].append(joint)
    return {finger: (bones.heads[bones.index[bone]], joints) for bone, (finger, joints) in found.items()}


def palm_frame(wrist: np.ndarray, knuckles: Mapping[str, np.ndarray], side: Side) -> tuple[np.ndarray, float]:
    """Return the directions along the palm, towards the index finger and out of the back of the hand, as
    columns (3, 3), and the length of the palm.

    `knuckles`: where each finger that is there begins, by its name. Hands with fewer fingers are laid over by
    those that they have. Raises HandModelError where there are too few, or where they lie on a line.
    """
    fingers = [finger for finger in FINGERS[1:] if finger in knuckles]
    if not fingers or len(knuckles) < 2:
        raise HandModelError(
            "two fingers or more are needed, one of them no thumb, to tell where a palm faces"
        )
    middle = "middle" if "middle" in fingers else None
    along = (knuckles[middle] if middle else np.mean([knuckles[f] for f in fingers], axis=0)) - wrist
    first = fingers[0] if len(fingers) > 1 else "thumb"
    toward = knuckles[first] - knuckles[fingers[-1]]
    size = float(np.linalg.norm(along))
    if size > 0.0:
        toward = toward - along * (along @ toward) / size**2
    across = float(np.linalg.norm(toward))
    if not (size > 0.0 and across > 1e-3 * size):
        raise HandModelError(
            "the bones of this hand lie on one line or in one place, so that there is no telling where its "
            "palm faces: look whether the table names the right bones"
        )
    along, toward = along / size, toward / across
    back = np.cross(along, toward) * (1.0 if side == "right" else -1.0)
    return np.stack([along, toward, back], axis=-1), size


def leaning(bones: Bones, hand_map: HandMap) -> float:
    """Return how much a hand at rest looks like a left one, by where its fingers bend to and its thumb
    stands: below zero it looks like a right one, near zero (0.02) it is as flat as a glove."""
    heads = {j: bones.heads[bones.index[name]] for j, name in enumerate(hand_map.bones) if name}
    lines = {f: [heads[j] for j in FINGER_JOINTS[f] if j in heads] for f in hand_map.fingers}
    knuckles = {finger: head for finger, (head, _) in _knuckles(bones, hand_map).items()}
    frame, size = palm_frame(heads[0], knuckles, "left")
    lean, bend = 0.0, np.cross(frame[:, 2], frame[:, 0])
    for finger, line in lines.items():
        if finger == "thumb":
            others = [own[0] for other, own in lines.items() if other != finger]
            lean += float(frame[:, 2] @ (np.mean(others, axis=0) - line[-1])) / size
        elif len(line) == 3:
            lean += 0.5 * float(bend @ np.cross(unit(line[1] - line[0]), unit(line[2] - line[1])))
    return lean


def finger_end(bones: Bones, chain: list[int]) -> np.ndarray:
    """Return where a finger ends at rest, (3,) in the armature's space: where the bone behind its last one
    begins, if there is one.

    Else where its last bone ends, if tails mean anything in this finger: that of the bone before ends where
    the last one begins. Else a bit farther on the way from the bone before, or along the last one's Y.
    """
    last = chain[-1]
    behind = [c for c in bones.children[last] if np.linalg.norm(bones.heads[c] - bones.heads[last]) > 0.0]
    if len(behind) == 1:
        return bones.heads[behind[0]]
    if len(chain) > 1:
        step = bones.heads[last] - bones.heads[chain[-2]]
        gap = np.linalg.norm(bones.tails[chain[-2]] - bones.heads[last])
        # Distance from a tail to the next bone, in parts of the bone's length, up to which tails are where
        # bones end
        if gap > 0.1 * np.linalg.norm(step):
            return bones.heads[last] + 0.8 * step
    return bones.tails[last]


def _mean(rotations: np.ndarray) -> np.ndarray:
    """Return the mean (T, 3, 3) of rotations (T, N, 3, 3), by their quaternions, which are near each
    other."""
    if rotations.shape[1] == 1:
        return rotations[:, 0]
    quats = rotmat_to_quat(rotations)
    sign = np.where(np.sum(quats * quats[:, :1], axis=-1, keepdims=True) < 0.0, -1.0, 1.0)
    return quat_to_rotmat((sign * quats).sum(axis=1))


def unit(vector: np.ndarray) -> np.ndarray:
    """Return the vector (3,), which leads from one bone's beginning to another's, with length 1. Raises
    HandModelError where both begin in one place."""
    length = np.linalg.norm(vector)
    if not length > 0.0:
        raise HandModelError(
            "two of this hand's bones begin in the same place: look whether the table names the right bones"
        )
    return vector / length
