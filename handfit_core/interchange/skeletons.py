"""The hands of any skeleton's animated bones: the inverse of what `retarget` does for characters."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from handfit_core.common.skeleton import FINGER_JOINTS, FINGERS, NUM_BETAS, Side
from handfit_core.geometry.rotations import rotmat_to_rotvec
from handfit_core.hand_model.axes import REST_FROM_MODEL
from handfit_core.hand_model.data import HandModel
from handfit_core.hand_model.motion import HandMotion
from handfit_core.retarget.bones import Bones
from handfit_core.retarget.hand_map import HandMap
from handfit_core.retarget.recognition import hands_in, the_surest
from handfit_core.retarget.transfer import SourceHand, TargetHand, palm_frame, target_hand

UP_AXES: Final = {
    "y": np.diag([1.0, -1.0, -1.0]),
    "z": np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]),
}
"""(3, 3) rotations to the camera's axes (x right, y down, z forward) from those of a space with that axis up:
y up and z towards whoever looks, as OpenGL, OpenXR and most motion capture have; z up, y away from whoever
looks, as Blender has it"""

_UNITS: Final = {"metres": 1.0, "centimetres": 0.01, "inches": 0.0254, "millimetres": 0.001}


@dataclass(frozen=True, eq=False)
class AnimatedBones:
    """The motion of B bones over T frames, in the skeleton's space and unit."""

    bones: Bones
    """The bones at rest, where each bone's frame is the identity"""
    turned: np.ndarray
    """(T, B, 3, 3) rotations of each bone from its rest, in the skeleton's space"""
    heads: np.ndarray
    """(T, B, 3) places in the skeleton's unit at which each bone begins"""


@dataclass(frozen=True, eq=False)
class HandOfBones:
    """A hand that was found in a skeleton."""

    posed: HandMotion
    hand_map: HandMap
    unit: float
    """How many metres the skeleton's unit is"""


def hand_of_bones(animated: AnimatedBones, model: HandModel, up: np.ndarray) -> HandOfBones | None:
    """Find the hand of the model's side; None where the bones have none.

    `up` (3, 3) leads from the skeleton's axes to the camera's. Directions of all bones are met; twists are
    kept relative to the rest pose. Where bones are as long as the model's own are with some shape, that
    shape is given. Raises HandModelError where several hands of the side are as likely.
    """
    bones, side = animated.bones, model.side
    found = the_surest(hands_in(bones, side), bones)
    if found is None:
        return None
    hand_map = found.hand_map
    target = target_hand(bones, hand_map, SourceHand.of(model.shaped(), side))
    unit = unit_of(1.0 / target.scale)
    betas = _own_shape(bones, hand_map, target, model, unit)
    if betas.any():
        target = target_hand(bones, hand_map, SourceHand.of(model.shaped(betas), side))
    hand = bones.index[hand_map.bones[0]]
    turned = animated.turned
    within = np.swapaxes(turned[:, hand, None], -1, -2) @ turned[:, [bones.index[b] for b in target.bones]]
    turns = target.turns(target.channels(within @ target.rest))
    fingers = REST_FROM_MODEL.T @ turns[:, 1:] @ REST_FROM_MODEL
    orient = up @ turned[:, hand] @ target.aligned @ REST_FROM_MODEL
    wrist = model.shaped(betas).joints[0]
    posed = HandMotion(
        side,
        betas,
        rotmat_to_rotvec(orient),
        rotmat_to_rotvec(fingers).reshape(len(turned), -1),
        animated.heads[:, hand] @ up.T * unit - wrist,
    )
    return HandOfBones(posed, hand_map, unit)


def unit_of(metres: float) -> float:
    """Return the usual unit that is nearest to one of so many metres, in metres; the argument itself where
    none is near."""
    nearest = min(_UNITS.values(), key=lambda unit: abs(np.log(metres / unit)))
    # Times our mean hand that other hands are long or short, where a unit is guessed by it
    return nearest if 1.0 / 1.35 < metres / nearest < 1.35 else metres


def name_of_unit(metres: float) -> str:
    """Return the name of a unit of so many metres."""
    return next((name for name, unit in _UNITS.items() if unit == metres), f"units of {metres:.3g} metres")


def _own_shape(
    bones: Bones, hand_map: HandMap, target: TargetHand, model: HandModel, unit: float
) -> np.ndarray:
    """Return the betas (10,) with which the model has bones of these lengths and knuckles in these places, in
    the skeleton's rest pose; zeros where it has none, as for characters' hands."""
    betas = np.zeros(NUM_BETAS)
    if "" in hand_map.bones or len(set(hand_map.bones)) != len(hand_map.bones):
        return betas
    heads = bones.heads[[bones.index[name] for name in hand_map.bones]] * unit
    tips = target.tips * unit
    wanted = _lengths(heads, tips, model.side)
    if not np.isfinite(wanted).all():
        return betas

    def made(betas: np.ndarray) -> np.ndarray:
        shaped = model.shaped(betas)
        return _lengths(shaped.joints, shaped.tips, model.side)

    for _ in range(6):
        off = made(betas)
        slopes = np.stack([(made(betas + step) - off) / 1e-4 for step in 1e-4 * np.eye(NUM_BETAS)], axis=1)
        betas = betas + np.linalg.lstsq(slopes, wanted - off, rcond=1e-6)[0]
        if np.abs(betas).max() > 20.0:
            return np.zeros(NUM_BETAS)
    # Metres: bones that differ no more from our model's are our model's
    return betas if np.abs(made(betas) - wanted).max() < 2e-4 else np.zeros(NUM_BETAS)


def _lengths(joints: np.ndarray, tips: np.ndarray, side: Side) -> np.ndarray:
    """Return (30,) metres that no pose of the fingers changes: where fingers begin, seen from the palm, and
    how long bones are."""
    begins = [FINGER_JOINTS[finger][0] for finger in FINGERS]
    knuckles = {finger: joints[joint] for finger, joint in zip(FINGERS, begins, strict=True)}
    frame, _ = palm_frame(joints[0], knuckles, side)
    ends = np.concatenate([joints, tips])
    chains = np.array([[*FINGER_JOINTS[finger], len(joints) + f] for f, finger in enumerate(FINGERS)])
    steps = np.linalg.norm(ends[chains[:, 1:]] - ends[chains[:, :-1]], axis=-1)
    return np.concatenate([((joints[begins] - joints[0]) @ frame).ravel(), steps.ravel()])


def no_hand(bones: Bones) -> str:
    """Return the sentence for a skeleton without hands."""
    named = ", ".join(name[:40] for name in bones.names[-6:])
    return (
        f"none of its {len(bones.names)} bones are a hand with fingers (the last ones are {named}); expected "
        "a hand with two fingers or more, of two bones or more each"
    )
